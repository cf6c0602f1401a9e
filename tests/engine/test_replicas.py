"""Replicated muscles (`benchmarks.opensim_speed`): more of them, the same strength, the same motion."""

import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks.replicas import MujocoC, replicate
from myowarp.osim.bundle.mjcf import mjcf
from myowarp.osim.convert.compose.convert import convert
from myowarp.osim.document.read.model import read_model

OSIM = Path(__file__).parents[1] / "data" / "osim"

SAME = 1e-9
"""rad and m over 0.2 s of MuJoCo C; the copies' forces are summed in another order, in float64."""
COPIES = 5


@pytest.fixture(scope="module", params=["arm26", "leg6dof9musc"])
def converted(request, tmp_path_factory):
    """A converted model, geometry only: it takes no time."""
    path = tmp_path_factory.mktemp("model") / "model.xml"
    path.write_text(mjcf(convert(read_model(OSIM / f"{request.param}.osim")).spec))
    return path


def motion(path, copies, share=True):
    """Return the end of an episode in MuJoCo C, and its model."""
    simulator = MujocoC(str(path), copies)
    simulator.model = mujoco.MjModel.from_xml_string(replicate(path, copies, share))
    simulator.data = mujoco.MjData(simulator.model)
    assert simulator.advance(0.2) == 0.2
    return np.array(list(simulator.pose().values())), simulator.model


def test_copies_are_as_strong_and_move_alike(converted):
    alone, model = motion(converted, 1)
    shared, many = motion(converted, COPIES)
    whole, strong = motion(converted, COPIES, share=False)
    assert many.nu == many.na == many.ntendon == COPIES * model.nu
    for parameters in ("actuator_gainprm", "actuator_biasprm"):
        force = getattr(model, parameters)[:, 2]
        np.testing.assert_allclose(
            getattr(many, parameters)[:, 2].reshape(model.nu, -1).sum(), force.sum(), rtol=1e-12
        )
        assert getattr(strong, parameters)[:, 2].sum() == pytest.approx(COPIES * force.sum())
    np.testing.assert_allclose(shared, alone, atol=SAME)
    assert np.abs(whole - alone).max() > 1e6 * SAME
    assert np.abs(alone - model.key_qpos[0]).max() > 1e6 * SAME


def test_every_copy_has_a_tendon_of_its_own(converted):
    _, model = motion(converted, COPIES)
    assert sorted(model.actuator_trnid[:, 0]) == list(range(model.ntendon))
    names = {model.actuator(i).name for i in range(model.nu)}
    muscle = ET.parse(converted).find("actuator")[0].get("name")
    assert {muscle, *(f"{muscle} {copy}" for copy in range(1, COPIES))} <= names


def test_forces_that_follow_from_inertia_cannot_be_shared(converted, tmp_path):
    root = ET.parse(converted).getroot()
    muscle = root.find("actuator")[0]
    values = muscle.get("gainprm").split()
    muscle.set("gainprm", " ".join([*values[:2], "-1", *values[3:]]))
    path = tmp_path / "model.xml"
    path.write_text(ET.tostring(root, encoding="unicode"))
    with pytest.raises(
        ValueError, match=f"^muscle '{muscle.get('name')}' needs a spatial tendon and a stored"
    ):
        replicate(path, 2)

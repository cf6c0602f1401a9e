"""Loops that constraints close, held exactly: against OpenSim 4.6, recorded by `record_opensim_loops.py`."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from myowarp.coordinates import free_coordinates
from myowarp.osim.bundle.loops import settled
from myowarp.osim.convert.check.engines import States
from myowarp.osim.convert.compose.convert import Options, convert
from myowarp.osim.document.read.model import read_model
from myowarp.sim.converted_step import OurStep

DATA = Path(__file__).parents[1] / "data"
RECORDED = np.load(DATA / "opensim/accelerations_loops.npz")
NAMES = RECORDED["coordinates"].tolist()

MEDIAN, WORST = 5e-4, 2e-3
"""Shares of the accelerations: float32, with segments of 30 g under a head of 4 kg."""
NEAREST = 0.005
"""rad by which linkages are off OpenSim's assembly, which moves coordinates in other proportions."""


@pytest.fixture(scope="module")
def looped():
    """Return the model, its conversion, and its spec with couplings."""
    model = read_model(DATA / "osim/loops.osim")
    converted = convert(model, Options(tendons=False))
    return model, converted, converted.into(converted.spec)


def off(looped):
    """Return errors of accelerations in all states, shares of their size."""
    model, converted, spec = looped
    order = [NAMES.index(name) for name in model.independent]
    values, speeds, forces, wanted = (
        RECORDED[key][:, order] for key in ("values", "speeds", "forces", "accelerations")
    )
    found = OurStep(converted.coordinates, spec.copy()).accelerations(States(values, speeds, forces))
    return np.linalg.norm(found - wanted, axis=1) / np.linalg.norm(wanted, axis=1)


def test_accelerations_in_loops_are_those_of_opensim(looped, monkeypatch):
    """Linkages that a point and a pin close, and a jaw that closes a loop over a neck that follows."""
    errors = off(looped)
    assert np.median(errors) < MEDIAN
    assert errors.max() < WORST
    monkeypatch.setattr(free_coordinates, "loop_rows", lambda model: 0)
    assert np.median(off(looped)) > 10 * MEDIAN


def test_the_start_closes_loops_near_the_default_pose(looped):
    _, converted, spec = looped
    model = spec.compile()
    qpos = settled(model, model.key_qpos[0])
    data = mujoco.MjData(model)
    data.qpos[:] = model.key_qpos[0]
    mujoco.mj_forward(model, data)
    loops = model.eq_type[data.efc_id[: data.ne]] != mujoco.mjtEq.mjEQ_JOINT
    assert np.abs(data.efc_pos[: data.ne][loops]).max() > 0.01
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    assert np.abs(data.efc_pos[: data.ne][loops]).max() < 1e-9
    linkages = [
        one for one in zip(NAMES, RECORDED["default"], strict=True) if one[0].startswith(("open", "shut"))
    ]
    assert len(linkages) == 7
    for name, value in linkages:
        entry = next(one for one in converted.coordinates.coordinates if one.name == name)
        assert abs(qpos[model.joint(entry.joint).qposadr[0]] - value) < NEAREST, name

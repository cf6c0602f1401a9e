"""Files that OpenSim's CMC and RRA write are motions and controls here; from `record_opensim_cmc.py`."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from myowarp.apps.policies.prescribed import prescribed
from myowarp.motion.movement import read_motion
from myowarp.motion.storage import read_storage
from myowarp.osim.body.skeleton import Bones

DATA = Path(__file__).parents[1] / "data"
CMC = DATA / "opensim/cmc"
ARM = DATA / "osim/arm26.osim"
TRACKED = 0.02
"""rad, by which OpenSim's own tracking is off what it was to follow."""


@pytest.mark.parametrize("tool", ["cmc", "rra"])
@pytest.mark.parametrize("file", ["Kinematics_q", "states"])
def test_angles_are_those_that_were_to_be_followed(tool, file):
    """One file is in degrees under names of coordinates, the other in radians under their paths."""
    found = read_motion(CMC / f"{tool}_{file}.sto", Bones.read(ARM))
    wanted = np.stack([0.3 + 0.3 * np.sin(4 * found.time), 1.2 + 0.4 * np.cos(4 * found.time)], axis=1)
    assert len(found.time) > 5
    assert not found.absent
    assert np.abs(found.values - wanted).max() < TRACKED


@pytest.mark.parametrize("tool", ["cmc", "rra"])
def test_speeds_are_no_motion(tool):
    with pytest.raises(ValueError, match="calls itself 'Speeds'; a motion holds coordinates"):
        read_motion(CMC / f"{tool}_Kinematics_u.sto", Bones.read(ARM))


def test_a_set_of_controls_says_what_their_table_does(tmp_path):
    """CMC writes its controls twice; the model that plays the set has them at the times of the table."""
    table, text = read_storage(CMC / "cmc_controls.sto"), ARM.read_text()
    controller = f"<ControlSetController><controls_file>{CMC / 'cmc_controls.xml'}</controls_file>"
    path = tmp_path / "arm.osim"
    controller = f"<objects>{controller}</ControlSetController></objects>"
    path.write_text(text.replace('name="controllerset">', f'name="controllerset">{controller}', 1))
    step = 1e-4
    found = prescribed(path, SimpleNamespace(physics_dt=step, num_substeps=1, horizon=2500))
    rows = np.ceil(table.time / step - 1e-3).astype(int)  # values hold up to their nodes
    assert len(rows) > 5
    for name in ("BRA", "TRIlong", "BIClong"):
        label = next(one for one in table.labels if one.rpartition("/")[2].startswith(name))
        wanted = table.values[:, table.labels.index(label)]
        values = found.values[rows, found.labels.index(name)]
        np.testing.assert_allclose(values, wanted, atol=1e-7)

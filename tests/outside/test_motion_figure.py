"""A user's script, with nothing of ours but `myowarp.motion`: .osim and .trc to a figure in 15 lines."""

import ast
import runpy
import sys
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from myowarp.motion.markers import Markers, write_trc
from myowarp.motion.storage import read_storage

SCRIPT = Path(__file__).with_name("motion_figure.py")
DATA = Path(__file__).parents[1] / "data"
LINES = 15


def test_from_osim_and_trc_to_a_figure(tmp_path, monkeypatch):
    """What it finds are OpenSim's angles, and forces are in the figure."""
    body = ast.parse(SCRIPT.read_text()).body[1:]  # without the docstring
    assert len({line for part in body for line in range(part.lineno, part.end_lineno + 1)}) <= LINES
    there = np.load(DATA / "opensim/motion_leg6dof9musc.npz")
    write_trc(tmp_path / "walk.trc", Markers(tuple(there["markers"]), there["time"], there["seen"]))
    mpl.use("Agg")
    files = SCRIPT, DATA / "osim/leg6dof9musc.osim", tmp_path / "walk.trc", tmp_path
    monkeypatch.setattr(sys, "argv", list(map(str, files)))
    plt.close("all")
    names = runpy.run_path(str(SCRIPT))
    angles = read_storage(tmp_path / "ik.mot")
    knee = list(there["coordinates"]).index("knee_angle_r")
    found = np.radians(angles.values[:, angles.labels.index("knee_angle_r")])
    np.testing.assert_allclose(found, there["fitted"][:, knee], atol=2e-5)
    drawn = plt.gca().lines
    np.testing.assert_array_equal(
        np.stack([line.get_ydata() for line in drawn], axis=1), names["found"].solved.force
    )
    assert names["found"].solved.force.max() > 50.0
    assert np.asarray(Image.open(tmp_path / "forces.png")).std() > 10.0
    plt.close("all")

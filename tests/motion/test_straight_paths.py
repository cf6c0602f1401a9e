"""Paths without wrap objects in SIMD lanes are those of the kernels, which OpenSim's values check."""

from pathlib import Path

import numpy as np
import pytest

from myowarp.osim.body.muscle_paths import PathsOfMuscles, muscle_paths
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.elements import ConditionalPathPoint, MovingPathPoint
from myowarp.osim.document.read.model import read_model

OSIM = Path(__file__).parents[1] / "data/osim"
FRAMES = 37
ROUNDING = 1e-12
"""Of lengths of a metre, in float64."""


@pytest.mark.parametrize("name", ["gait10dof18musc", "leg6dof9musc"])
def test_lanes_give_what_the_kernels_give(name):
    """Of bent and stretched joints, so that points come and go; the last lanes are empty."""
    bones = Bones(read_model(OSIM / f"{name}.osim"))
    random = np.random.default_rng(0)
    values = random.uniform(-1.2, 1.2, size=(FRAMES, len(bones.coordinates)))
    speeds = random.normal(size=values.shape)
    found = muscle_paths(bones, values, speeds)
    wanted = PathsOfMuscles(bones, FRAMES).along(values, speeds)
    straight = [k for k, own in enumerate(found.muscles) if not bones.model.muscles[own].path.wraps]
    assert straight
    points = [p for k in straight for p in bones.model.muscles[found.muscles[k]].path.points]
    assert any(isinstance(point, ConditionalPathPoint | MovingPathPoint) for point in points)
    for part in ("length", "velocity", "moment_arm"):
        there = getattr(wanted, part)
        np.testing.assert_allclose(getattr(found, part), there, atol=ROUNDING, err_msg=part)
        assert np.ptp(there[:, straight], axis=0).max() > 1e-2

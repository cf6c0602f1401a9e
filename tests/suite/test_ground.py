"""Drawn ground: its shape by the formula in float64, heights above it, bounds out of range."""

import mujoco
import numpy as np
import pytest

from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation
from myowarp.tasks.ground import GroundTask

HILLS, STAIRS, ROUGH = (f"myoLeg{name}TerrainWalk-v1" for name in ("Hilly", "Stair", "Rough"))
ROUNDING = 2e-5  # m, heights of up to 4 m in float32
GRID = np.linspace(-6.0, 6.0, 100)  # m
NUM_WORLDS = 6


def simulation(key):
    """Return a simulation after a reset, and its program."""
    sim = Simulation(TASKS[key], NUM_WORLDS, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.arange(NUM_WORLDS))
    return sim, sim.shards[0].program


def shape(program, world):
    """Return the heights that a world's draws ask for, without bumps, row by row [m]."""
    names = ("grade", "hill", "length", "rise", "tread")
    grade, hill, length, rise, tread = (float(getattr(program, name).numpy()[world, 0]) for name in names)
    s = np.maximum(0.0, -GRID - 0.5)
    wave = hill * (1.0 - np.cos(2.0 * np.pi * s / length)) / 2.0
    edge = np.abs(s / tread - np.round(s / tread)) * (rise > 0)  # where rounding decides the step
    return grade * s + wave + rise * np.floor(s / tread), (edge > 1e-4) | (s == 0.0) | (rise == 0)


@pytest.mark.parametrize("key", [HILLS, STAIRS, ROUGH])
def test_ground_has_the_drawn_shape(key):
    """And no two worlds have the same, nor two episodes of one."""
    sim, program = simulation(key)
    heights, bump = program.heights.numpy().copy(), program.bump.numpy()[:, 0]
    for world in range(NUM_WORLDS):
        expected, sure = shape(program, world)
        above = heights[world] - expected[:, None]
        assert (above[sure] >= -ROUNDING).all()
        assert (above[sure] <= bump[world] + ROUNDING).all()
        assert np.ptp(above[sure]) >= 0.99 * bump[world]
    assert np.ptp(heights, axis=(1, 2)).min() > 1e-3
    assert len(np.unique(heights.reshape(NUM_WORLDS, -1), axis=0)) == NUM_WORLDS
    sim.reset()
    assert (program.heights.numpy() != heights).any(axis=(1, 2)).all()


def test_heights_are_above_the_ground():
    """Of ankles and center of mass, on the triangles that MuJoCo has."""
    sim, program = simulation(ROUGH)
    rng, data, host = np.random.default_rng(0), sim.scene.data, sim.scene.oracle
    qpos = data.qpos.numpy().copy()
    qpos[:, :2] = rng.uniform(-5.0, 5.0, (NUM_WORLDS, 2))
    data.qpos.assign(qpos)
    sim.shards[0].bring_up(np.ones(NUM_WORLDS, dtype=bool))
    first = dict(zip((c.name for c in program.columns), program.first.numpy(), strict=True))
    obs = sim.transition.obs.numpy()
    one = mujoco.MjData(host)
    for world in range(NUM_WORLDS):
        host.hfield_data[:] = program.heights.numpy()[world].ravel() / host.hfield_size[0, 2]
        one.qpos[:] = qpos[world]
        mujoco.mj_forward(host, one)
        geom = int(np.flatnonzero(host.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD)[0])

        def below(place, geom=geom):
            top = np.array((place[0], place[1], 5.0))
            return 5.0 - mujoco.mj_rayHfield(host, one, geom, top, np.array((0.0, 0.0, -1.0)), None)

        ankles = [one.body(f"talus_{side}").xpos for side in "lr"]
        expected = [place[2] - below(place) for place in ankles]
        at = first["feet_heights"]
        np.testing.assert_allclose(obs[world, at : at + 2], expected, atol=ROUNDING)
        mass = host.body_mass / host.body_mass.sum()
        height = mass @ one.xipos[:, 2] - below(one.qpos)
        assert obs[world, first["height"]] == pytest.approx(height, abs=ROUNDING)
        assert below(one.qpos) > 10 * ROUNDING


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ({"grade": (0.0, 0.4)}, "grade of the ground must be .* from 0 to 0.3, got \\(0.0, 0.4\\)"),
        ({"rise": (0.2, 0.1)}, "rise of the ground must be .* from 0 to 0.25, got \\(0.2, 0.1\\)"),
        ({"tread": (0.1, 0.3)}, "tread of the ground must be .* from 0.2 to 12, got \\(0.1, 0.3\\)"),
        ({"bump": (0.1,)}, "bump of the ground must be .* from 0 to 0.2, got \\(0.1,\\)"),
        ({"length": (float("nan"), 3.0)}, "length must hold numbers, got \\(nan, 3.0\\)"),
    ],
)
def test_bounds_out_of_range(bounds, message):
    with pytest.raises(ValueError, match=message):
        GroundTask(**bounds)

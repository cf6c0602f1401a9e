"""What episodes draw: its distribution, and that it depends on a world's seed and episode and nothing else.

Draws are compared with MyoSuite's in `test_oracle.py` and `test_oracle_contact.py`; the generator is tested
in `test_random.py`, the way from a reset to the seeds in `test_contract.py`.
"""

from functools import lru_cache

import numpy as np
import pytest
import warp as wp
from often import of_each
from test_random import KOLMOGOROV, uniform_distance

from myowarp.definitions.task import TASKS
from myowarp.sim.build import compile_scene
from myowarp.tasks.hand_poses import DIGITS

PI = np.pi
HAND_RANGES = (
    *((-1.5708, 1.5708), (-0.174533, 0.436332), (-0.785398, 0.785398)),  # forearm, wrist
    *((-0.78, 0.7), (-0.5, 0.78), (-0.785398, 0.698132), (-1.309, 0.436332)),  # thumb
    *4 * ((0, 1.5708), (-0.261799, 0.261799), (0, 1.5708), (0, 1.5708)),  # fingers
)  # rad
TIPS = (
    *((-0.165, -0.537, 1.495), (-0.151, -0.547, 1.455), (-0.146, -0.547, 1.447)),
    *((-0.148, -0.543, 1.445), (-0.148, -0.528, 1.434)),
)  # m
REACH = (
    np.subtract(TIPS, ((0.02, 0.04, 0.04), *4 * ((0.04, 0.02, 0.01),))).ravel(),
    np.add(TIPS, ((0.04, 0.02, 0.04), *4 * ((0.04, 0.02, 0.01),))).ravel(),
)

DRAWS = {
    "myoFingerPoseRandom-v0": {"target": ((-0.2, -0.4, 0.1, 0.1), (0.2, 1, 1, 1))},
    "motorFingerPoseRandom-v0": {"target": ((-0.2, -0.4, 0.1, 0.1), (0.2, 1, 1, 1))},
    "myoElbowPose1D6MFixed-v0": {"configuration": (0, 2.26893)},
    "myoElbowPose1D6MRandom-v0": {"target": (0, 2.27), "configuration": (0, 2.26893)},
    "myoElbowPose1D6MExoRandom-v0": {"target": (0, 2.27), "weight": (0.1, 2.0)},
    "myoHandPoseRandom-v1": {
        "target": (np.min(DIGITS, axis=0), np.max(DIGITS, axis=0)),
        "configuration": tuple(np.transpose(HAND_RANGES)),
    },
    "myoFingerReachRandom-v0": {"row": (0, 57279)},
    "motorFingerReachRandom-v0": {"row": (0, 57279)},
    "myoHandReachRandom-v0": {"target": REACH},
    "myoHandReachRandom-v1": {"row": (0, 4096)},
    "myoLegStandRandom-v0": {
        "target": ((-0.05, -0.05, 0.92), (0.05, 0.05, 0.92)),
        "offset": (28 * (-0.2,), 28 * (0.2,)),
    },
    "myoLegDirectionalRandom-v0": {"heading": (0, 2 * PI)},
    "myoLegRoughTerrainWalk-v0": {"heights": (-0.02, 0.06)},
    "myoLegHillyTerrainWalk-v1": {"grade": (0, 0.15), "hill": (0, 0.4), "length": (2, 6)},
    "myoHandKeyTurnRandom-v1": {
        "key angle": (-PI / 2, PI / 2),
        "key position": ((-0.16, -0.56, 1.415), (-0.14, -0.54, 1.435)),
    },
    "myoHandObjHoldRandom-v0": {
        "goal": ((-0.265, -0.54, 1.42), (-0.205, -0.48, 1.48)),
        "object size": (3 * (0.02,), 3 * (0.03,)),
    },
    "myoHandObjHoldRandom-v1": {
        "goal": ((-0.245, -0.54, 1.455), (-0.205, -0.48, 1.48)),
        "object size": (3 * (0.02,), 3 * (0.03,)),
    },
    "myoHandPenTwirlRandom-v1": {"tilt": ((-1, -1), (1, 1))},
    "myoChallengeDieReorientP2-v1": {
        "goal": (3 * (-0.02,), 3 * (0.02,)),
        "turn": (3 * (-3.14,), 3 * (3.14,)),
        "die mass": (0.05, 0.25),
        "die growth": (-0.007, 0.007),
        "die friction": (15 * (0.8, 0.004, 0.00008), 15 * (1.2, 0.006, 0.00012)),
    },
    "myoHandReorient100-v0": {"shape row": (0, 100), "turn": ((-1, -0.8), (1, 1.2))},
    "myoChallengeRelocateP2-v0": {
        "goal": ((0, -0.45, 0.9), (0.3, -0.1, 1.05)),
        "turn": (3 * (-0.2,), 3 * (0.2,)),
        **{f"kind {part}": {2, 3, 4, 5, 6} for part in range(3)},
        "object place": ((-0.1, -0.35, 1.0), (0.1, -0.15, 1.0)),
        "part size": (9 * (0.015,), 9 * (0.025,)),
        "part place": (9 * (-1,), 9 * (1,)),
        "part turn": (9 * (-PI / 2,), 9 * (PI / 2,)),
        "part friction": (3 * (0.8, 0.004, 0.00008), 3 * (1.2, 0.006, 0.00012)),
        "object mass": (0.05, 0.2),
        "offset": (38 * (-0.01,), 38 * (0.01,)),
    },
    "myoHandBaodingRandom-v1": {
        "direction": {-1, 0, 1},
        "start angle": (0, 2 * PI),
        "half axes": ((0.02, 0.022), (0.03, 0.032)),
        "period": (4, 6),
        "ball mass": (2 * (0.03,), 2 * (0.3,)),
        "ball radius": (2 * (0.018,), 2 * (0.024,)),
        "ball friction": (2 * (0.8, 0.004, 0.00008), 2 * (1.2, 0.006, 0.00012)),
    },
}
"""Id of MyoSuite, or its correction: draw: upstream's bounds or values; rows of tables count from 0."""

NUM_WORLDS = 4096
OTHER_SIZE = 37
SEED = 1000  # of world 0; that of world i is i more
ROUNDING = 1e-6  # of a quantity's size, float32

GAP = 12 / NUM_WORLDS
"""Part of the range next to a bound; once in 160000 (exp(-12)) no draw of all worlds falls into it."""

CHI_SQUARE = {3: 13.82, 5: 18.47}
"""Number of values: what the chi-square statistic of so many equally likely ones exceeds once in 1000."""

SIGMAS = 5.0
"""Correlation of independent samples has standard deviation 1 / sqrt(n); 4000 pairs are looked at."""


def row_of(program):
    """Return which rows of the table the targets are; halves, so that they fill the bounds evenly."""
    rows = {row.tobytes(): i + 0.5 for i, row in enumerate(program.table.numpy())}
    return np.array([rows[target.tobytes()] for target in program.target.numpy()])


def tilt(program):
    """Return the angles (u, v) of the target pen's rotation Rx(u) Ry(v)."""
    quat = program.target_quat.numpy()[:, 0]
    return 2 * np.arctan2(quat[:, 1:3], quat[:, :1])


def of_balls(program, name):
    """Return a field of the two balls."""
    kind, model = name.split("_")[0], program.scene.oracle
    ids = [getattr(model, kind)(ball).id for ball in ("ball1", "ball2")]
    return getattr(program.scene.model, name).numpy()[:, ids]


READ = {
    "configuration": lambda program: program.scene.data.qpos.numpy(),
    "row": row_of,
    "key angle": lambda program: program.scene.data.qpos.numpy()[:, 23],
    "key position": lambda program: program.scene.model.body_pos.numpy()[:, program.key_body],
    "tilt": tilt,
    "heights": lambda program: program.heights.numpy()[:, ::33, ::33].copy(),
    "weight": lambda program: program.weight.mass.numpy(),
    "ball mass": lambda program: of_balls(program, "body_mass"),
    "ball radius": lambda program: of_balls(program, "geom_size")[:, :, 0],
    "ball friction": lambda program: of_balls(program, "geom_friction"),
    "direction": lambda program: program.orbits.direction.numpy(),
    "start angle": lambda program: program.orbits.start_angle.numpy(),
    "half axes": lambda program: program.orbits.radii.numpy(),
    "period": lambda program: program.orbits.period.numpy(),
}
"""Draw: where it ends up, if that is no array of the program of the draw's name."""


def read(program, name):
    """Return what was drawn, shape (num_worlds, ...)."""
    arrays = {draw.name: draw.array or draw.name for draw in program.spec.draws}
    return READ[name](program) if name in READ else getattr(program, arrays[name]).numpy()


def bounds_of(program):
    """Return what episodes draw, as the task says it: draw: bounds or values."""
    found = {}
    for draw in program.spec.draws:
        if not draw.varies:
            continue
        if "row of a table" in draw.doc:
            found["row"] = 0, len(program.table)
        elif draw.choices:
            found[draw.name] = set(draw.choices)
        else:
            found[draw.name] = (draw.low, draw.high) if draw.low else program.scene.oracle.jnt_range.T
    return found


def varied(spec):
    """Return what tells the draws of two tasks apart."""
    return spec.family, spec.body, tuple((d.name, d.doc, d.low, d.high) for d in spec.draws if d.varies)


DISTINCT = sorted({varied(TASKS[key]): key for key in TASKS if varied(TASKS[key])[2]}.values())
"""One id for everything that some task draws."""


@lru_cache(maxsize=2)
def program_of(key, num_worlds=NUM_WORLDS):
    """Return a task bound to a scene."""
    with wp.ScopedDevice("cpu"):
        spec = TASKS[key]
        return spec.program(spec, compile_scene(spec, num_worlds, device="cpu"))


def drawn(key, seeds, episode, mask=None):
    """Return what worlds with these seeds draw for an episode: quantity, shape (num_worlds, n)."""
    program, n = program_of(key, len(seeds)), len(seeds)
    program.scene.keys.seed.assign(seeds.astype(np.int32))
    program.scene.keys.episode.assign(np.full(n, episode, dtype=np.int32))
    with wp.ScopedDevice("cpu"):
        where = wp.array(np.ones(n, dtype=bool) if mask is None else mask, dtype=bool)
        program.sample_start(where)
        program.sample_goal(where)
    return {name: read(program, name).reshape(n, -1).astype(float) for name in bounds_of(program)}


SEEDS = SEED + np.arange(NUM_WORLDS)


def test_upstream_is_compared():
    """The bounds of every drawn task of upstream are compared with its own (`test_describe.py`)."""
    assert {TASKS[key].family for key in DISTINCT} == {TASKS[key].family for key in DRAWS}


@pytest.mark.parametrize("key", of_each(DISTINCT), scope="module")  # both tests of an id share its scene
def test_distribution(key):
    check_distribution(key)


def check_distribution(key):
    """Kolmogorov-Smirnov distance to uniform; counts of values; no column follows from another."""
    first, second = drawn(key, SEEDS, 1), drawn(key, SEEDS, 2)
    varied = []
    for name, expected in bounds_of(program_of(key)).items():
        values = first[name]
        if isinstance(expected, set):
            counts = np.array([np.count_nonzero(values == value) for value in expected])
            mean = NUM_WORLDS / len(expected)
            assert counts.sum() == NUM_WORLDS
            assert ((counts - mean) ** 2 / mean).sum() < CHI_SQUARE[len(expected)]
            varied += [values, second[name]]
            continue
        low, high = (np.atleast_1d(bound).astype(float) for bound in expected)
        low, high = (np.tile(bound, values.shape[1] // len(bound)) for bound in (low, high))  # of each ball
        scale = np.maximum(np.abs(low), np.abs(high))
        assert (values >= low - ROUNDING * scale).all(), name
        assert (values <= high + ROUNDING * scale).all(), name
        assert values.shape[1] == len(low)
        spread = high > low
        unit = (values[:, spread] - low[spread]) / (high - low)[spread]
        distances = np.array([uniform_distance(column.clip(0, 1)) for column in unit.T])
        assert (distances < KOLMOGOROV).all(), f"{name}: {distances}"
        assert (unit.min(axis=0) < GAP).all(), name
        assert (unit.max(axis=0) > 1 - GAP).all(), name
        assert not np.ptp(values[:, ~spread], axis=0).any(), name
        varied += [values[:, spread], second[name][:, spread]]
    columns = np.concatenate(varied, axis=1)
    correlation = np.corrcoef(columns, rowvar=False) - np.eye(columns.shape[1])
    assert np.abs(correlation).max() < SIGMAS / np.sqrt(NUM_WORLDS)


@pytest.mark.parametrize("key", of_each(DISTINCT), scope="module")  # both tests of an id share its scene
def test_draws_depend_on_seed_and_episode_alone(key):
    """Not on a world's place, nor on the number of worlds; where the mask is off nothing is drawn."""

    def table(seeds, episode, mask=None):
        return np.concatenate(list(drawn(key, seeds, episode, mask).values()), axis=1)

    rng = np.random.default_rng(0)
    order, mask = rng.permutation(NUM_WORLDS), rng.uniform(size=NUM_WORLDS) < 0.5
    first, second = table(SEEDS, 1), table(SEEDS, 2)
    np.testing.assert_array_equal(table(SEEDS[order], 1), first[order])
    np.testing.assert_array_equal(table(SEEDS[:OTHER_SIZE], 1), first[:OTHER_SIZE])
    assert (
        len(np.unique(first, axis=0)) > (0.6 if "row" in bounds_of(program_of(key)) else 0.999) * NUM_WORLDS
    )
    assert (first != second).any(axis=1).mean() > 0.999
    table(SEEDS, 1)
    np.testing.assert_array_equal(table(SEEDS, 2, mask), np.where(mask[:, None], second, first))

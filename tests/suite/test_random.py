"""Random numbers: what they depend on, what they do not, and how they are distributed."""

import numpy as np
import pytest
import warp as wp

from myowarp.kernels.random import GOAL, START, RandomKeys, open_stream

NUM_WORLDS = 4096
NUM_DRAWS = 16

SIGMAS = 4.0
"""Correlation of independent samples has standard deviation 1 / sqrt(n): one false alarm in 16000."""

KOLMOGOROV = 1.95
"""Quantile of sqrt(n) D, the largest distance to the uniform distribution function: exceeded once in
1000 (2 exp(-2 x^2)). The seeds are fixed, so a failure is a change of the generator."""


@wp.kernel(enable_backward=False)
def draw(
    # In:
    keys: RandomKeys,
    stream: int,
    low: float,
    high: float,
    # Out:
    numbers: wp.array2d[float],
):
    """numbers[world, i] ~ U(low, high)."""
    worldid = wp.tid()
    state = open_stream(keys, worldid, stream)
    for i in range(numbers.shape[1]):
        numbers[worldid, i] = wp.randf(state, low, high)


def numbers(seed, episode=1, stream=0, low=0.0, high=1.0):
    """Return draws of worlds with these seeds and episodes, shape (num_worlds, NUM_DRAWS)."""
    seed, episode = np.broadcast_arrays(np.atleast_1d(seed), episode)
    with wp.ScopedDevice("cpu"):
        keys = RandomKeys()
        keys.seed = wp.array(seed.astype(np.int32), dtype=wp.int32)
        keys.episode = wp.array(episode.astype(np.int32), dtype=wp.int32)
        values = wp.full((len(seed), NUM_DRAWS), np.nan, dtype=float)
        wp.launch(draw, dim=len(seed), inputs=[keys, stream, low, high], outputs=[values])
        return values.numpy().copy()


SEEDS = np.arange(NUM_WORLDS)  # neighbouring, as a user's seed plus the world's number


@pytest.mark.parametrize("num_worlds", [1, 7, 1000])
def test_same_numbers_for_any_number_of_worlds(num_worlds):
    assert np.array_equal(numbers(SEEDS[:num_worlds]), numbers(SEEDS)[:num_worlds])


def test_same_numbers_for_any_place_in_the_batch():
    order = np.random.default_rng(0).permutation(NUM_WORLDS)
    assert np.array_equal(numbers(SEEDS[order]), numbers(SEEDS)[order])


def test_seeds_cover_all_32_bits():
    extreme = np.array([0, 1, -1, 2**31 - 1, -(2**31)])
    drawn = numbers(extreme)
    assert len(np.unique(drawn[:, 0])) == len(extreme)


@pytest.mark.parametrize(
    "other",
    [
        {"stream": int(START)},
        {"stream": 2},
        {"episode": 2},
        {"episode": 1000},
        {"seed": SEEDS + 1},
        {"seed": SEEDS + NUM_WORLDS},
        {"episode": 2, "stream": int(START)},
    ],
    ids=str,
)
def test_streams_episodes_and_seeds_are_uncorrelated(other):
    base = {"seed": SEEDS, "episode": 1, "stream": int(GOAL)}
    ours, theirs = numbers(**base), numbers(**(base | other))
    assert np.mean(ours == theirs) < 1e-3  # 2^-24 a number by chance
    for shift in range(3):  # the same draw, and draws that lag behind
        a, b = ours[:, shift:].ravel(), theirs[:, : NUM_DRAWS - shift].ravel()
        assert abs(np.corrcoef(a, b)[0, 1]) < SIGMAS / np.sqrt(a.size)


def test_draws_of_one_stream_are_uncorrelated():
    drawn = numbers(SEEDS)
    for lag in (1, 2, 5):
        a, b = drawn[:, lag:].ravel(), drawn[:, :-lag].ravel()
        assert abs(np.corrcoef(a, b)[0, 1]) < SIGMAS / np.sqrt(a.size)


def test_episodes_of_one_world_do_not_repeat():
    first = numbers(np.zeros(NUM_WORLDS), episode=np.arange(NUM_WORLDS))[:, 0]
    expected = NUM_WORLDS**2 / 2.0 / 2**24  # pairs that agree by chance
    assert NUM_WORLDS - len(np.unique(first)) <= expected + SIGMAS * np.sqrt(expected)


def uniform_distance(values):
    """Return sqrt(n) times the Kolmogorov-Smirnov distance of values in [0, 1] to uniform."""
    values, n = np.sort(values.ravel()), values.size
    steps = np.arange(n + 1) / n
    return np.sqrt(n) * max((steps[1:] - values).max(), (values - steps[:-1]).max())


@pytest.mark.parametrize("axis", ["worlds", "episodes", "streams"])
def test_uniform_within_bounds(axis):
    count = np.arange(1, NUM_WORLDS + 1)
    if axis == "worlds":
        drawn = numbers(SEEDS, low=-0.5, high=2.0)
    elif axis == "episodes":
        drawn = numbers(np.full(NUM_WORLDS, 3), episode=count, low=-0.5, high=2.0)
    else:
        drawn = np.concatenate([numbers(3, stream=s, low=-0.5, high=2.0) for s in range(200)])
    assert drawn.min() >= -0.5
    assert drawn.max() <= 2.0
    unit = (drawn.astype(np.float64) + 0.5) / 2.5
    for column in (unit[:, 0], unit[:, -1], unit):
        assert uniform_distance(column) < KOLMOGOROV


def test_distance_sees_a_bias():
    """The statistic above rejects a distribution whose mean is off by one percent."""
    unit = numbers(SEEDS).astype(np.float64)
    assert uniform_distance(unit**1.05) > KOLMOGOROV

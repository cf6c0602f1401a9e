"""The paper's grid: 204 tasks, all registered, and one cell of every kind runs."""

from collections import Counter

import gymnasium
import numpy as np
import pytest
from often import covering, often

import myowarp  # noqa: F401
from myowarp.definitions.task import RESETS, TASKS
from myowarp.tasks.paper import grid

GRID = grid()
HARD = [row for row in GRID if row.difficulty == "hard"]
TIRING = [row for row in HARD if row.condition == "fatigue" and row.reset == "fixed"][:3]
SHOWN = [row for row in HARD if row.condition == "none" or row.reset == "fixed"]


def long(row):
    """Return whether a cell's table of random starts takes half a minute (see test_starts.py)."""
    return row.reset == "random" and TASKS[row.task].body == "contact_hand"


FEW = covering([row for row in SHOWN if not long(row)], lambda row: (row.family, row.condition, row.reset))


def test_the_grid_is_the_papers():
    """6 hand families x 2 x 3 x 4, 2 finger families x 2 x 3 x 3, the elbow 2 x 3 x 4."""
    assert len(GRID) == 204
    assert len({row.id for row in GRID}) == 204
    counts = Counter(row.family for row in GRID)
    assert sorted(counts.values()) == [18, 18] + 7 * [24]
    assert all(counts[family] == 24 for family in counts if family.startswith(("Hand", "Elbow")))
    for row in GRID:
        assert row.task in TASKS
        assert row.reset in RESETS
        spec = gymnasium.spec(row.id)
        assert spec.max_episode_steps == TASKS[row.task].horizon
        assert (spec.kwargs["task"], spec.kwargs["reset"]) == (row.task, row.reset)


@pytest.mark.parametrize("row", often(SHOWN, FEW), ids=lambda row: row.id)
def test_cells_run(row):
    env = gymnasium.make_vec(row.id, num_envs=2, device="cpu", progress=False)
    sim = env.unwrapped.sim
    assert sim.scene.reset == row.reset
    assert tuple(condition.name for condition in sim.conditions) == tuple(
        text.partition("(")[0] for text in row.conditions
    )
    assert bool(row.conditions) == (row.condition != "none")
    obs, _ = env.reset(seed=0)
    assert obs.std() > 0
    obs, reward, *_ = env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    assert np.isfinite(obs).all()
    assert np.isfinite(reward).all()
    env.close()


@pytest.mark.parametrize("row", often(TIRING, TIRING[:1]), ids=lambda row: row.id)
def test_fatigue_matters_within_an_episode(row):
    """c = exp(-k int F / F_max dt), k = 1/s: a second of full drive costs up to 1 - 1 / e, in 1/min 2 %."""
    env = gymnasium.make_vec(row.id, num_envs=2, device="cpu", progress=False, autoreset_mode="Disabled")
    sim = env.unwrapped.sim
    env.reset(seed=0)
    steps = round(1.0 / sim.scene.control_dt)
    for _ in range(steps):
        env.step(np.ones(env.action_space.shape, dtype=np.float32))
    lost = sim.info["fatigue"].numpy()
    assert 0.3 < lost.max() < 0.8
    env.close()

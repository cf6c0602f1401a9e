"""The paper's grid: 204 tasks, all registered; those whose condition exists run."""

from collections import Counter

import gymnasium
import numpy as np
import pytest

import myowarp  # noqa: F401
from myowarp.spec import RESETS, TASKS
from myowarp.tasks.paper import grid

GRID = grid()
RUNNING = [row for row in GRID if row.condition == "none"]


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


@pytest.mark.parametrize("row", [row for row in RUNNING if row.difficulty == "hard"], ids=lambda row: row.id)
def test_cells_without_condition_run(row):
    env = gymnasium.make_vec(row.id, num_envs=2, device="cpu", progress=False)
    assert env.unwrapped.sim.scene.reset == row.reset
    obs, _ = env.reset(seed=0)
    assert obs.std() > 0
    obs, reward, *_ = env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    assert np.isfinite(obs).all()
    assert np.isfinite(reward).all()
    env.close()


@pytest.mark.parametrize("condition", sorted({row.condition for row in GRID} - {"none"}))
def test_a_missing_condition_says_so(condition):
    row = next(row for row in GRID if row.condition == condition)
    with pytest.raises(ValueError, match=f"^condition '{condition}' unknown; available: none$"):
        gymnasium.make_vec(row.id, num_envs=2, device="cpu")

"""Targets that a body can reach, as tables to draw from.

python -m myowarp.tasks.reach_targets     # solves the hand's table again and rewrites it
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from myowarp.cache import cached
from myowarp.models.reachability import reachable_targets, tip_positions
from myowarp.scene import full_spec, oracle_model

if TYPE_CHECKING:
    from myowarp.tasks.reach import ReachTask

NUM_CONFIGURATIONS = 100_000  # MyoSuite 3.0.0
HAND_TABLE = Path(__file__).with_name("hand_reach_targets.npy")
HAND_ROWS = 4096
HAND_TOLERANCE = 1e-3  # m, residual norm over the five tips


def sampled(spec: ReachTask) -> np.ndarray:
    """Return tip positions of random configurations that lie in the target box.

    MyoSuite 3.0.0's recipe and seed: every joint uniform within its range, the draws of one joint after
    those of another.

    Returns:
        Points [m], shape (num_points, 3); 57279 of them for the finger. Kept on disk.
    """

    def make() -> np.ndarray:
        model = full_spec(spec).compile()
        rng = np.random.default_rng(0)
        draws = [rng.uniform(low, high, NUM_CONFIGURATIONS) for low, high in model.jnt_range]
        points = tip_positions(model, spec.tips, np.stack(draws, axis=1))
        center = np.asarray(spec.center)
        inside = (points >= center + spec.low) & (points <= center + spec.high)
        return points[inside.all(axis=1)]

    key = ("sampled", spec.scene_key, spec.center, spec.low, spec.high, NUM_CONFIGURATIONS)
    return cached(key, ".npy", make, lambda points, path: np.save(path, points), np.load)


def solved(spec: ReachTask) -> np.ndarray:
    """Return hand targets from the task's boxes that all five tips reach at once, to a millimetre.

    Drawn uniformly and kept where inverse kinematics within the joint ranges succeeds
    (`myowarp.models.reachability`): one draw in six. The table is part of the package, so that targets are
    the same everywhere.

    Returns:
        Targets [m], shape (4096, 15).
    """
    return np.load(HAND_TABLE)


def main() -> None:
    """Solve the hand's table again."""
    from myowarp.tasks.reach import TASKS, ReachTask

    spec = TASKS["myoHandReachRandom-v1"]
    assert isinstance(spec, ReachTask)
    center, low, high = (np.asarray(values) for values in (spec.center, spec.low, spec.high))
    targets = reachable_targets(
        oracle_model(spec), spec.tips, center, low, high, HAND_TOLERANCE, count=HAND_ROWS
    )
    np.save(HAND_TABLE, targets.astype(np.float32))


if __name__ == "__main__":
    main()

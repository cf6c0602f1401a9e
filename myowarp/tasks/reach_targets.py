"""Targets that a body can reach, as tables to draw from."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from myowarp.definitions.task import TaskSpec
from myowarp.disk import array_bytes, array_from_bytes, cached
from myowarp.models.reachability import tip_positions
from myowarp.sim.build import full_model

NUM_CONFIGURATIONS = 100_000  # MyoSuite 3.0.0
HAND_TABLE = Path(__file__).with_name("hand_reach_targets.npy")


def sampled(
    spec: TaskSpec,
    tips: tuple[str, ...],
    center: Sequence[float],
    low: Sequence[float],
    high: Sequence[float],
) -> np.ndarray:
    """Return tip positions of random configurations that lie in the target box.

    MyoSuite 3.0.0's recipe and seed: every joint uniform within its range, the draws of one joint after
    those of another.

    Args:
        spec: The task, whose body it is.
        tips: Names of the tip sites.
        center: Center of the box [m], three entries a tip.
        low: Lower bounds of the box, from the center on.
        high: Upper bounds.

    Returns:
        Points [m], shape (num_points, 3); 57279 of them for the finger. Kept on disk.
    """

    def make() -> np.ndarray:
        model = full_model(spec)
        rng = np.random.default_rng(0)
        draws = [rng.uniform(low, high, NUM_CONFIGURATIONS) for low, high in model.jnt_range]
        points = tip_positions(model, tips, np.stack(draws, axis=1))
        inside = (points >= np.add(center, low)) & (points <= np.add(center, high))
        return points[inside.all(axis=1)]

    key = ("sampled", spec.scene_key, center, low, high, NUM_CONFIGURATIONS)
    return cached(key, make, array_bytes, array_from_bytes)


def solved(*_: object) -> np.ndarray:
    """Return hand targets from the box of `myoHandReachRandom` that all tips reach at once, to a millimetre.

    Drawn uniformly and kept where inverse kinematics within the joint ranges succeeds
    (`myowarp.models.reachability`): one draw in six. The table is part of the package, so that targets are
    the same everywhere; tests/data/solve_reach_targets.py solves it again.

    Returns:
        Targets [m], shape (4096, 15).
    """
    return np.load(HAND_TABLE)

"""Solve the table of targets that all five tips of the hand reach at once again, and rewrite it (minutes)."""

import numpy as np

from myowarp.definitions.task import TASKS
from myowarp.models.reachability import reachable
from myowarp.sim.build import oracle_model
from myowarp.tasks.reach_targets import HAND_TABLE

ROWS = 4096
TOLERANCE = 1e-3  # m, residual norm over the five tips
MAX_DRAWS = 100  # for a row


def reachable_targets(model, tips, center, low, high, near, count, seed=0):
    """Draw targets uniformly from the part of a box that the tips can reach within `near` [m].

    Row i is the first of its own draws from U(center + low, center + high) whose residual is at most
    `near`. A borderline draw that another processor's rounding decides otherwise changes its row only.
    The search has one start: a minimum that it misses costs one more draw, and never admits a target.

    Returns:
        Targets [m], shape (count, 3 num_tips); the first rows are those of a smaller `count`.

    Raises:
        ValueError: A row met no reachable target in `MAX_DRAWS` draws, or as `reachable` raises.
    """
    targets = np.empty((count, len(center)))
    empty = np.arange(count)
    for draw in range(MAX_DRAWS):
        offset = np.random.default_rng((seed, draw)).uniform(low, high, targets.shape)
        candidates = center + offset[empty]
        accepted = reachable(model, tips, candidates, num_starts=1)[0] <= near
        targets[empty[accepted]] = candidates[accepted]
        empty = empty[~accepted]
        if not len(empty):
            return targets
    raise ValueError(
        f"{len(empty)} of {count} targets met no point within {near} m of the reach of the tips in "
        f"{MAX_DRAWS} draws; move the box or raise near"
    )


if __name__ == "__main__":
    spec = TASKS["myoHandReachRandom-v1"]
    center, low, high = (np.asarray(values) for values in (spec.center, spec.low, spec.high))
    targets = reachable_targets(oracle_model(spec), spec.tips, center, low, high, TOLERANCE, count=ROWS)
    np.save(HAND_TABLE, targets.astype(np.float32))

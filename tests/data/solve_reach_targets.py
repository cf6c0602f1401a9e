"""Solve the table of targets that all five tips of the hand reach at once again, and rewrite it (minutes)."""

import numpy as np

from myowarp.definitions.task import TASKS
from myowarp.models.reachability import reachable_targets
from myowarp.sim.build import oracle_model
from myowarp.tasks.reach_targets import HAND_TABLE

ROWS = 4096
TOLERANCE = 1e-3  # m, residual norm over the five tips

if __name__ == "__main__":
    spec = TASKS["myoHandReachRandom-v1"]
    center, low, high = (np.asarray(values) for values in (spec.center, spec.low, spec.high))
    targets = reachable_targets(oracle_model(spec), spec.tips, center, low, high, TOLERANCE, count=ROWS)
    np.save(HAND_TABLE, targets.astype(np.float32))

"""The experiments there are: those of the paper, in its order, then those beyond it."""

from myowarp.apps.studies.reproduce import (
    adaptation,
    baselines,
    cohort_exo,
    conditions,
    exo1,
    exo2,
    fatigue,
    grid,
    motor,
    recovery,
    sarcopenia,
    speed,
    tear,
    transfer,
    validation,
)
from myowarp.apps.studies.reproduce.experiment import Experiment
from myowarp.definitions.registry import Registry

EXPERIMENTS: Registry[Experiment] = Registry("experiment")
_PAPER = validation, speed, baselines, sarcopenia, fatigue, tear, transfer, exo1, exo2
for _file in (*_PAPER, grid, motor, conditions, cohort_exo, recovery, adaptation):
    EXPERIMENTS.add(_file.EXPERIMENT.name, _file.EXPERIMENT)

"""MyoWarp: musculoskeletal motor control, simulated in thousands of worlds at once.

    env = gymnasium.make_vec("MyoWarp/myoHandPoseRandom-v1", num_envs=256)

Importing the package registers every task with Gymnasium under `MyoWarp/<name>-v<version>`. What stands here
is public; everything else may move from one version to the next.
"""

__version__ = "0.1.0"

import importlib
from typing import Any

from myowarp.engine.quick_import import quick_import

with quick_import():
    import myowarp.models.bodies
    import myowarp.models.muscles
    import myowarp.tasks  # noqa: F401  (these register themselves)
    from myowarp.bridge_gym import make, make_vec, register_all
    from myowarp.definitions.body import BODIES, Body, Brace, CoarseStep, FatigueRates, Place, Transfer
    from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase
    from myowarp.definitions.muscle import (
        MUSCLES,
        Anatomy,
        BiasParams,
        FiberStates,
        MuscleGeometry,
        MuscleModel,
        MuscleResults,
        affine_bias,
    )
    from myowarp.definitions.muscle_table import MuscleTable
    from myowarp.definitions.parameter import Clock, Curve, Parameter, value_of
    from myowarp.definitions.program import Program
    from myowarp.definitions.scene import Scene
    from myowarp.definitions.task import TASKS, Column, Draw, RewardTerm, TaskSpec, register, task
    from myowarp.kernels.batching import batched
    from myowarp.kernels.episode import FAULTS
    from myowarp.kernels.launch import launch
    from myowarp.kernels.random import GOAL, START, RandomKeys, open_stream
    from myowarp.kernels.reward import minus_bhargava2004, minus_umberger2010
    from myowarp.kernels.world_function import Row
    from myowarp.models.conditions import (
        Exoskeleton,
        Fatigue3CCR,
        FatigueMa2009,
        JointDevice,
        Load,
        MotorNoise,
        NerveCrossing,
        PelvisSupport,
        Ramp,
        Reafferentation,
        Sarcopenia,
        StretchReflex,
        TendonTear,
        TendonTransfer,
        Uniform,
    )
    from myowarp.models.muscles.mujoco import MujocoMuscle, MujocoMuscleParams
    from myowarp.sim.signals import Signals
    from myowarp.sim.state import State
    from myowarp.tasks.pose import PoseTask
    from myowarp.tasks.reach import ReachTask

    for _registry in (TASKS, BODIES, MUSCLES, CONDITIONS):
        _registry.seal()
    register_all()

_LATER = {
    "extend": "myowarp.tasks.extend",
    "from_mjcf": "myowarp.tasks.from_file",
    "from_osim": "myowarp.tasks.from_file",
    "QUANTITIES": "myowarp.tasks.quantities",
    "Sb3VecEnv": "myowarp.apps.adapters.stable_baselines3",
    "RslRlVecEnv": "myowarp.apps.adapters.rsl_rl",
}


def __getattr__(name: str) -> Any:
    """Import what is not needed at every start, and adapters, which need their trainers, when first used."""
    if name not in _LATER:
        raise AttributeError(f"module 'myowarp' has no attribute {name!r}")
    return getattr(importlib.import_module(_LATER[name]), name)


__all__ = [  # noqa: RUF022 (by what they are for)
    # Environments
    "TASKS",
    "make",
    "make_vec",
    "Signals",
    "State",
    "FAULTS",
    "Sb3VecEnv",
    "RslRlVecEnv",
    # Patients
    "Sarcopenia",
    "Fatigue3CCR",
    "FatigueMa2009",
    "JointDevice",
    "TendonTear",
    "TendonTransfer",
    "Reafferentation",
    "NerveCrossing",
    "Exoskeleton",
    "Load",
    "MotorNoise",
    "StretchReflex",
    "PelvisSupport",
    "Uniform",
    "Ramp",
    "MuscleTable",
    # Tasks of one's own
    "from_mjcf",
    "from_osim",
    "extend",
    "register",
    "task",
    "PoseTask",
    "ReachTask",
    "QUANTITIES",
    "minus_bhargava2004",
    "minus_umberger2010",
    # Families, bodies, conditions and muscle models of one's own
    "TaskSpec",
    "Column",
    "Row",
    "RewardTerm",
    "Draw",
    "Program",
    "launch",
    "RandomKeys",
    "open_stream",
    "GOAL",
    "START",
    "BODIES",
    "Body",
    "CoarseStep",
    "FatigueRates",
    "Place",
    "Brace",
    "Transfer",
    "CONDITIONS",
    "Condition",
    "Effect",
    "Phase",
    "Scene",
    "Clock",
    "Parameter",
    "Curve",
    "value_of",
    "MUSCLES",
    "MuscleModel",
    "MuscleGeometry",
    "MuscleResults",
    "FiberStates",
    "MujocoMuscle",
    "MujocoMuscleParams",
    "Anatomy",
    "BiasParams",
    "affine_bias",
    "batched",
    "__version__",
]

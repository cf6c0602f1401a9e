"""Policies by name: built in, trained, recorded or the user's own.

A policy is a function of the observations, shape (num_worlds, obs_size), that returns actions in [-1, 1],
shape (num_worlds, num_actions). One that remembers takes `begins`, too: which worlds begin an episode. One
that takes `told` is told the parameters of the conditions, as a teacher is (`--expert` of DAgger).
"""

import inspect
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from myowarp.apps.policies.baselines import OWN, PREFIX, policy_folder
from myowarp.apps.policies.checkpoint import Checkpoint
from myowarp.apps.policies.hold import Hold, check_hold
from myowarp.apps.policies.learned import Act, Bound, Parameters, begins, read_policy
from myowarp.apps.policies.muscle_control import MuscleControl, check_muscle_control
from myowarp.apps.policies.reflex import Gait, ReflexControl, check_conditions, is_gait, read_gait
from myowarp.apps.policies.replay import Replay, is_replay
from myowarp.definitions.registry import did_you_mean
from myowarp.definitions.task import TaskSpec
from myowarp.models.bodies.from_file import OPENSIM
from myowarp.motion.storage import Storage, read_storage
from myowarp.sim.interop import on_host
from myowarp.sim.simulation import Simulation
from myowarp.tasks.outside import load

BUILT_IN = ("random", "zero", "hold", "muscle-control")
AVAILABLE = (
    f"available: {', '.join(BUILT_IN)}, {OWN}, {PREFIX}<task>, the folder of a trained policy, excitations "
    "(.sto, .mot, .csv), a gait (.json), a model's own controllers (.osim), package.module:function, "
    "file.py:function"
)
CHECKS = {"hold": check_hold, "muscle-control": check_muscle_control}


@dataclass(frozen=True)
class Policy:
    """A policy.

    Attributes:
        name: How the user called it.
        act: Function of the observations, and of `begins` and `told` if it has such parameters; None for the
            built-in policies.
        checkpoint: What was trained; None for all others.
        excitations: Excitations over time; None for all others.
        gait: Reflexes; None for all others.
    """

    name: str
    act: Callable[..., np.ndarray] | None = None
    checkpoint: Checkpoint | None = None
    excitations: Storage | None = None
    gait: Gait | None = None


class PolicyError(Exception):
    """A user's policy raised; the cause says where."""


def find_policy(name: str, spec: TaskSpec) -> Policy:
    """Return a policy by name; code of the user that defines it is run once.

    Args:
        name: "random", "zero", "hold", "muscle-control", "baseline", "baselines/<task>", the folder of a
            trained policy, a file of excitations, a gait, a model with controllers (each a file in
            `myowarp.apps.policies`),
            "package.module:function" or "file.py:function".
        spec: The task in which it is to act.

    Raises:
        ValueError: No such policy, or it cannot act in this task.
        OSError: Its file cannot be read.
    """
    if name in CHECKS:
        CHECKS[name](spec)
    if name in BUILT_IN:
        return Policy(name)
    if (folder := policy_folder(name, spec.key)) is not None:
        return Policy(name, checkpoint=read_policy(name, folder, spec))
    if is_replay(name):
        return Policy(name, excitations=read_storage(Path(name)))
    if is_gait(name):
        return Policy(name, gait=read_gait(Path(name)))
    if Path(name).suffix.lower() == OPENSIM:
        from myowarp.apps.policies.prescribed import prescribed  # reads models, which few policies are

        return Policy(name, excitations=prescribed(Path(name), spec))
    source, colon, attribute = name.rpartition(":")
    if not colon:
        absent = "there is no such folder; " if "/" in name else ""
        raise ValueError(
            f"policy {name!r} unknown; {absent}{did_you_mean(name, (*BUILT_IN, OWN)) or AVAILABLE}"
        )
    try:
        act = getattr(load(source), attribute, None)
    except ValueError as error:
        raise ValueError(f"policy {name!r} not found: {error}") from error
    if act is None:
        raise ValueError(f"policy {name!r} not found: {source} has no {attribute!r}")
    if not callable(act):
        raise ValueError(f"policy {name!r} must be a function of the observations, got {type(act).__name__}")
    return Policy(name, act)


def acting(policy: Policy, sim: Simulation) -> Act:
    """Return the function that acts: the user's, with its errors marked as such, or a built-in one.

    Random actions are drawn from the seed of the simulation's setup.
    """
    act, scene = policy.act, sim.scene
    if policy.checkpoint is not None:
        return Bound(policy.checkpoint, sim)
    if policy.excitations is not None:
        return Replay(policy.name, policy.excitations, sim)
    if policy.gait is not None:
        check_conditions(policy.name, policy.gait, sim)
        return ReflexControl(policy.gait.values[None], policy.gait.delays, sim)
    if act is not None:
        names, senses = _parameters(act), dict[str, Callable[[], np.ndarray]]()
        if "begins" in names:
            senses["begins"] = partial(begins, sim)
        if "told" in names:
            if not scene.parameters:
                raise ValueError(
                    f"policy {policy.name!r} needs conditions, whose parameters it is told; got none"
                )
            if scene.parameters[0].worlds.adjustable:  # what it is told would be of all conditions there are
                raise ValueError(
                    f"policy {policy.name!r} is told the parameters of chosen conditions, and cannot act "
                    "where all can be changed, as in myowarp view"
                )
            senses["told"] = Parameters(sim)

        def guarded(obs: np.ndarray) -> np.ndarray:
            try:
                actions = act(obs, **{name: sense() for name, sense in senses.items()})
            except (ValueError, OSError, RuntimeError, ImportError, StopIteration) as error:
                raise PolicyError(f"policy {policy.name!r} failed") from error
            if actions is None:  # which would go on with the actions before
                raise ValueError(
                    f"policy {policy.name!r} must return actions of shape {sim.action.shape}, got None; does "
                    "it end with return?"
                )
            return on_host(actions) if hasattr(actions, "detach") else actions

        return guarded
    if policy.name == "hold":
        return Hold(scene)
    if policy.name == "muscle-control":
        return MuscleControl(sim)
    shape = (scene.num_worlds, scene.num_actions)
    if policy.name == "zero":
        return lambda obs: np.zeros(shape, dtype=np.float32)
    rng = np.random.default_rng(sim.setup.seed)
    return lambda obs: rng.uniform(-1.0, 1.0, shape).astype(np.float32)


def _parameters(act: Callable[..., object]) -> Collection[str]:
    """Return the names of a function's parameters; none of one that is not written in Python."""
    try:
        return inspect.signature(act).parameters.keys()
    except ValueError:
        return ()

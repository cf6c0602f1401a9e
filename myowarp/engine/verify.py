"""Whether our physics step is the engine's: found out in states of the task, once per machine.

To verify stages and idle kernels the engine's step has to be compiled and run beside ours, which is most of
the time of a first start. The verdict is kept on disk, under a key that names everything it depends on.
"""

import json
import logging
import platform
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import warp as wp

from myowarp.definitions.body import POINT_JOINTS
from myowarp.definitions.condition import Condition
from myowarp.disk import cached, code_digest, files_digest, is_ours, model_digest, version
from myowarp.engine.compile import compile_kernels
from myowarp.engine.idle import idle_kernels
from myowarp.engine.stage import Stage
from myowarp.engine.step import Step
from myowarp.engine.stepped import Stepped

logger = logging.getLogger("myowarp")

SOURCES = (
    *("engine/**/*.py", "engine/**/*.cpp", "coordinates/*.py", "coordinates/*.cpp", "osim/bundle/*.py"),
    *("sim/*.py", "kernels/*", "laws/**/*.py", "models/muscles/*"),
)
"""Files of the package that decide a verdict."""

NUM_STATES = 16  # compared, at least
CONTROL_STEPS = 8  # between two states, at most
TRUSTED_SHARE = 0.9  # of the states that must agree: the engine itself loses single contacts
LEAST_CHANGE = 1e-6, 1e-2  # of velocities and positions, that errors are a share of; positions are rounded
USUAL_SHARE = 0.1
"""Errors are a share of at least so much of the median change over all states: where forces cancel in a state
of one joint, little changes but the rounding of its velocity."""
ROUNDINGS = 16
"""A stage may differ by as much as that many roundings of the state move the engine's step. Stiff equalities,
as in models converted from OpenSim, turn one rounding into up to 3e-4 of the change of velocity; stages were
seen to differ by up to 10 times the median of that."""
ROUNDING = 1e-4  # of the largest change in a world; float32 sums in any order

State = tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray]]
"""qpos, qvel, ctrl, and the muscles' own state by name."""


class Verdict(NamedTuple):
    """The result of a verification.

    Attributes:
        idle: Kernels of the engine to leave out.
        stages: Classes of the stages to use.
    """

    idle: frozenset[str]
    stages: frozenset[str]


def choose_stages(
    step: Step,
    kinds: Iterable[str | type[Stage]],
    also: Callable[[], None],
    progress: bool,
    conditions: Iterable[Condition] = (),
) -> tuple[tuple[Stage, ...], frozenset[str]]:
    """Return which stages of ours to use, and which kernels of the engine to leave out.

    Args:
        step: The physics step; the state of what it steps is overwritten.
        kinds: Stages to use where they apply: names in `STAGES`, or classes.
        also: Launches what else is to be compiled.
        progress: Whether to show progress bars.
        conditions: Conditions that may act in a physics step.
    """
    candidates = step.stages(kinds)

    def verify() -> Verdict:
        def launch_both() -> None:
            also()
            for number in range(len(candidates) + 1):  # what is compared below, one more stage at a time
                step.launches(candidates[:number])()

        compile_kernels(launch_both, step.stepped.device, show=progress)
        trusted = verified_stages(step, candidates)
        idle = verified_idle(step)
        return Verdict(idle, frozenset(type(stage).__name__ for stage in trusted))

    verdict = _cached_verdict(step, candidates, verify, conditions)
    return tuple(stage for stage in candidates if type(stage).__name__ in verdict.stages), verdict.idle


def _cached_verdict(
    step: Step,
    candidates: Iterable[Stage],
    verify: Callable[[], Verdict],
    conditions: Iterable[Condition] = (),
) -> Verdict:
    """Return what `verify` found for this step and these candidates, now or in an earlier process."""
    stepped = step.stepped
    package = Path(__file__).parents[1]
    files = sorted(
        file for pattern in SOURCES for file in package.glob(pattern) if file.suffix in (".py", ".cpp")
    )
    # Of ours, tests say that they go with every stage.
    theirs = [condition for condition in conditions if not is_ours(type(condition))]
    code = code_digest(type(stepped.muscles), *map(type, theirs))
    digests = (model_digest(stepped.oracle), files_digest(files), code)
    names = sorted(type(stage).__name__ for stage in candidates)
    where = (stepped.device.alias, stepped.device.name, stepped.device.arch, platform.machine())
    muscles, deterministic = type(stepped.muscles).__name__, int(stepped.model.opt.deterministic)
    key = (
        "verdict",
        *digests,
        type(step).__name__,
        names,
        muscles,
        [type(condition).__qualname__ for condition in theirs],
        sorted(stepped.batched),
        deterministic,
        where,
        version("mujoco-warp"),
        version("warp-lang"),
    )

    def load(content: bytes) -> Verdict:
        entry = json.loads(content)
        known = {"idle": idle_kernels(stepped), "stages": frozenset(names)}
        if not isinstance(entry, dict) or any(not isinstance(entry.get(part), list) for part in known):
            raise ValueError("it holds no verdict")
        parts = {part: frozenset(map(str, entry[part])) for part in known}
        if not all(parts[part] <= known[part] for part in known):
            raise ValueError("it names kernels or stages that are not there")
        return Verdict(**parts)

    def save(verdict: Verdict) -> bytes:
        return json.dumps({part: sorted(names) for part, names in verdict._asdict().items()}).encode()

    return cached(key, make=verify, save=save, load=load)


def verified_stages(step: Step, stages: Iterable[Stage]) -> tuple[Stage, ...]:
    """Return the stages whose step is the engine's; a line is logged for each that is left out.

    Args:
        step: The physics step; the state of what it steps is overwritten.
        stages: What `step.stages` returned.
    """
    candidates, trusted = tuple(stages), tuple[Stage, ...]()
    if not candidates:
        return trusted
    batches = list(_states(step))
    before = _changes(step, batches, trusted)
    # The median: single states where a rounding makes or breaks a contact must not count.
    rounding = float(np.median(_error(_changes(step, map(_rounded, batches), trusted), before)))
    for stage in candidates:
        changes = _changes(step, batches, (*trusted, stage))
        error, allowed = _error(changes, before), stage.TOLERANCE + ROUNDINGS * rounding
        if np.mean(error <= allowed) >= TRUSTED_SHARE:
            trusted, before = (*trusted, stage), changes
            continue
        logger.warning(
            "%s is left to mujoco-warp: a step with ours differs by %.1e of what a step changes (median), "
            "allowed is %.0e",
            type(stage).__name__,
            np.median(error),
            allowed,
        )
    return trusted


def verified_idle(step: Step) -> frozenset[str]:
    """Return the kernels to leave out, none if leaving them out changes the state.

    Args:
        step: The physics step; the state of what it steps is overwritten.
    """
    stepped = step.stepped
    host, data = stepped.oracle, stepped.data
    names = idle_kernels(stepped)
    rng = np.random.default_rng(0)
    low, high = np.where(host.jnt_limited[:, None], host.jnt_range, (-1.0, 1.0)).T
    qpos = np.tile(host.qpos0, (data.nworld, 1))
    scalar = np.isin(host.jnt_type, POINT_JOINTS)
    qpos[:, host.jnt_qposadr[scalar]] = rng.uniform(low, high, (data.nworld, host.njnt))[:, scalar]
    qvel = rng.standard_normal((data.nworld, host.nv))
    muscles = stepped.muscles.sample_state(rng)
    start = np.concatenate([qpos, qvel], axis=1)
    ends = []
    for skipped in (names, frozenset[str]()):
        set_state(stepped, (qpos, qvel, np.zeros((data.nworld, host.nu)), muscles))
        step.launches(idle=skipped)()
        ends.append(np.concatenate([data.qpos.numpy(), data.qvel.numpy()], axis=1).copy())
    ours, stock = ends
    return names if is_same_step(start, ours, stock, exact=stepped.device.is_cpu) else frozenset()


def is_same_step(start: np.ndarray, first: np.ndarray, second: np.ndarray, exact: bool) -> bool:
    """Whether two steps from the same states, (num_worlds, n) each, have led to the same states.

    Args:
        start: States before.
        first: States after the one step.
        second: States after the other.
        exact: Whether every bit counts. If not, half of the worlds may differ by more than rounding: a
            solver that stops one iteration earlier makes more of it, a kernel left out shows in all worlds.
    """
    if exact:
        return np.array_equal(first, second)
    change = np.abs(second - start).max(axis=1).clip(min=1e-6)
    return bool(np.median(np.abs(first - second).max(axis=1) / change) <= ROUNDING)


def _states(step: Step) -> Iterator[State]:
    """Yield states of all worlds, until NUM_STATES are reached: random motion of the physics."""
    stepped = step.stepped
    host, worlds = stepped.oracle, stepped.data.nworld
    rng = np.random.default_rng(0)
    low, high = np.where(host.actuator_ctrllimited[:, None], host.actuator_ctrlrange, (-1.0, 1.0)).T
    drawn = [(rng.uniform(low, high), rng.integers(1, CONTROL_STEPS)) for _ in range(NUM_STATES)]
    controls, numbers = (np.array(values) for values in zip(*drawn, strict=True))
    motion = list(zip(*step.motion(controls, stepped.num_substeps * numbers), strict=True))
    for first in range(0, NUM_STATES, worlds):
        chosen = [motion[(first + i) % NUM_STATES] for i in range(worlds)]
        ctrl = rng.uniform(low, high, (worlds, host.nu))
        qpos, qvel = (np.array(values) for values in zip(*chosen, strict=True))
        yield qpos, qvel, ctrl, stepped.muscles.sample_state(rng)


def set_state(stepped: Stepped, state: State) -> None:
    """Put the worlds into a state."""
    qpos, qvel, ctrl, muscles = state
    stepped.data.qpos.assign(qpos)
    stepped.data.qvel.assign(qvel)
    stepped.data.ctrl.assign(ctrl)
    stepped.data.qacc_warmstart.zero_()
    for name, values in muscles.items():
        stepped.muscles.state[name].assign(values)


def _rounded(state: State) -> State:
    """Return states whose positions and velocities are the next float32 numbers, up or down at random."""
    qpos, qvel, ctrl, muscles = state
    random = np.random.default_rng(0)

    def beside(values: np.ndarray) -> np.ndarray:
        way = np.where(random.integers(2, size=values.shape), np.float32(np.inf), np.float32(-np.inf))
        return np.nextafter(values.astype(np.float32), way)

    return beside(qpos), beside(qvel), ctrl, muscles


def _changes(step: Step, batches: Iterable[State], stages: Iterable[Stage]) -> tuple[np.ndarray, np.ndarray]:
    """Return what a physics step adds to velocities, (num_states, nv), and to positions, (num_states, nq)."""
    data, changes, stages = step.stepped.data, [], tuple(stages)
    stock, ours = step.launches(), step.launches(stages)
    for state in batches:
        # Fill Data from another state first, so that a stage that forgets a field is caught.
        data.qpos.assign(np.roll(state[0], 1, axis=0))
        stock()
        set_state(step.stepped, state)
        before = data.qvel.numpy().copy(), data.qpos.numpy().copy()
        for stage in stages:
            stage.begin()
        ours()
        wp.synchronize_device(step.stepped.device)
        changes.append((data.qvel.numpy() - before[0], data.qpos.numpy() - before[1]))
    velocities, positions = zip(*changes, strict=True)
    return np.concatenate(velocities), np.concatenate(positions)


def _error(ours: tuple[np.ndarray, np.ndarray], stock: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return by how much changes differ, as a share of the largest in each state, for the worse of both."""
    shares = []
    for mine, theirs, least in zip(ours, stock, LEAST_CHANGE, strict=True):
        change = np.abs(theirs).max(axis=1)
        usual = USUAL_SHARE * float(np.median(change))
        shares.append(np.abs(mine - theirs).max(axis=1) / change.clip(min=max(least, usual)))
    return np.maximum(*shares)

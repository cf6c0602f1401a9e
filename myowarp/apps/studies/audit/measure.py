"""One task measured: rollouts, targets and objects put together."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from myowarp.apps.rollouts import objects, targets
from myowarp.apps.rollouts.objects import Gimbal, Objects
from myowarp.apps.rollouts.run import seeds_of
from myowarp.apps.rollouts.targets import Targets
from myowarp.apps.studies.audit.runs import (
    POLICIES,
    ColumnRange,
    Failing,
    Load,
    Run,
    Score,
    TermRange,
    early_failures,
)
from myowarp.definitions.registry import check_least
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS, TaskSpec
from myowarp.engine.compile import quiet
from myowarp.sim.simulation import Simulation
from myowarp.tasks.setups import complete

NUM_WORLDS = 64
PROBED_RESETS = ("task", "fixed", "random")  # reset-free episodes have no start of their own

Tick = Callable[[float, str], None]
"""Called with the share of the work done, 0 to 1, and what comes next."""


@dataclass(frozen=True)
class Audit:
    """Findings of an audit of one id. Shares are 0 to 1, None means not applicable.

    Attributes:
        id: Gymnasium id.
        name: Id without version; ids that share it are versions of one task.
        task: Key in `TASKS` of the task that was run.
        version: Its version.
        upstream: Id of the version with MyoSuite's semantics; a corrected version has another id.
        family: Task family.
        doc: What the task asks for, and why this version exists.
        reset: What its episodes start from.
        conditions: Names of its muscle conditions.
        physics: Physics preset.
        device: Warp device.
        num_worlds: Worlds simulated together.
        steps: Control steps of each policy.
        horizon: Control steps in an episode.
        seed: World i resets with seed + i.
        scores: What each policy got, by its name in `POLICIES`.
        early_failure: Share of starts from which zero actions fail within `runs.EARLY_STEPS` steps, by
            the reset of `definitions.task.RESETS`.
        early_failure_why: Reset to why its share is None.
        targets: Which share of the targets can be met.
        columns: Range of every observation column over all policies.
        constant_columns: Names of the columns that never changed.
        terms: Range of every reward term.
        silent_terms: Names of the terms that never left 0.
        failing: Whether it pays to fail.
        faults: How many steps of a world had each fault, by its meaning.
        load: How full the arrays of contacts and constraint rows were.
        objects: Inertia, friction and gimbal of the task's objects.
    """

    id: str
    name: str
    task: str
    version: int
    upstream: str
    family: str
    doc: str
    reset: str
    conditions: tuple[str, ...]
    physics: str
    device: str
    num_worlds: int
    steps: int
    horizon: int
    seed: int
    scores: dict[str, Score]
    early_failure: dict[str, float | None]
    early_failure_why: dict[str, str]
    targets: Targets
    columns: tuple[ColumnRange, ...]
    constant_columns: tuple[str, ...]
    terms: tuple[TermRange, ...]
    silent_terms: tuple[str, ...]
    failing: Failing
    faults: dict[str, int]
    load: Load
    objects: Objects

    @property
    def corrected(self) -> bool:
        """Whether the id is another version than upstream's."""
        return self.id != self.upstream

    def named(self, env_id: str) -> "Audit":
        """Return the same figures under the id of a task that stands alone, such as a cell of the paper's."""
        return replace(self, id=env_id, name=env_id.rpartition("-v")[0], upstream=env_id)


def upstream_of(spec: TaskSpec) -> str:
    """Return the id of the version with MyoSuite's semantics: the lowest that is registered."""
    versions = [TASKS[key] for key in TASKS if TASKS[key].name == spec.name]
    return min([*versions, spec], key=lambda other: other.version).env_id


def audit(
    what: Setup | TaskSpec | str,
    num_worlds: int = NUM_WORLDS,
    steps: int | None = None,
    *,
    tick: Tick = lambda done, stage: None,
    **fields: Any,
) -> Audit:
    """Measure a task.

    Args:
        what: What is audited; its policies draw from its seed, too.
        num_worlds: Worlds simulated together, >= 1.
        steps: Control steps of each policy; None, and at least: a horizon, or two with reset "none", where
            only the second episode starts reset-free.
        tick: Called on the way.
        **fields: Fields of `Setup`, in place of those of `what`.

    Raises:
        ValueError: An argument is out of its range.
    """
    # One thread has the contacts of all worlds in one place.
    setup = dataclasses.replace(complete(Setup.of(what, **fields)), shards=1)
    if steps is not None:
        check_least(1, steps=steps)
    steps = max(setup.episode_steps * (2 if setup.reset == "none" else 1), int(steps or 0))
    with quiet():
        tick(0.0, "building")
        sim = _simulation(setup, num_worlds)
        gimbal, run = Gimbal(sim), Run(sim, steps)
        for i, policy in enumerate(POLICIES):
            run.run(policy, gimbal.look, _part(tick, 0.3 * i, 0.3, policy))
        tick(0.9, "targets")
        sim.reset(seeds=seeds_of(sim))
        goals, things = targets.measure(sim), objects.measure(sim, gimbal.worst)
        tick(0.95, "starts")
        early, early_why = _early(sim)
    columns, terms = run.columns(), run.terms()
    return Audit(
        **_identity(sim),
        physics=str(setup.physics),
        steps=steps,
        seed=setup.seed or 0,
        scores={policy: run.score(policy) for policy in POLICIES},
        early_failure=early,
        early_failure_why=early_why,
        targets=goals,
        columns=columns,
        constant_columns=tuple(column.name for column in columns if column.low == column.high),
        terms=terms,
        silent_terms=tuple(term.name for term in terms if term.low == term.high == 0.0),
        failing=run.failing(),
        faults=run.faults(),
        load=run.load(),
        objects=things,
    )


def _identity(sim: Simulation) -> dict[str, Any]:
    """Return the fields of `Audit` that say what was run."""
    spec = sim.scene.spec
    return {
        "id": spec.env_id,
        "name": f"MyoWarp/{spec.name}",
        "task": spec.key,
        "version": spec.version,
        "upstream": upstream_of(spec),
        "family": spec.family,
        "doc": spec.doc,
        "reset": sim.scene.reset,
        "conditions": tuple(condition.name for condition in sim.conditions),
        "device": str(sim.scene.device),
        "num_worlds": sim.num_worlds,
        "horizon": sim.horizon,
    }


def _part(tick: Tick, begin: float, share: float, stage: str) -> Callable[[float], None]:
    """Return what to call with the share done of a stage that is itself a share of the work."""
    return lambda done: tick(begin + share * done, stage)


def _simulation(setup: Setup, num_worlds: int) -> Simulation:
    """Return a simulation that resets a world in the step that ends its episode."""
    return Simulation(setup, num_worlds, autoreset="same_step", progress=False)


def _early(sim: Simulation) -> tuple[dict[str, float | None], dict[str, str]]:
    """Return `Audit.early_failure` and `Audit.early_failure_why`."""
    shares: dict[str, float | None] = {}
    why: dict[str, str] = {}
    for reset in PROBED_RESETS:
        shares[reset] = None
        if reset == sim.scene.reset:
            shares[reset] = early_failures(sim)
            continue
        try:
            probe = _simulation(dataclasses.replace(sim.setup, reset=reset), sim.num_worlds)
        except ValueError as error:  # too few random starts
            why[reset] = str(error)
            continue
        shares[reset] = early_failures(probe)
    return shares, why

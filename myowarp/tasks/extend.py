"""Reward terms and observations on top of a task, without a kernel: each is a Warp function of one world.

    @wp.func
    def effort(excitation: wp.array[float]) -> float:
        total = float(0.0)
        for muscle in range(excitation.shape[0]):
            total += excitation[muscle] * excitation[muscle]
        return total

    myowarp.extend(
        "myoElbowPose1D6MRandom-v0", "myElbowThriftyRandom-v0", rewards={"effort": (-0.1, effort)}
    )

The name of a parameter says what it is: one of `QUANTITIES`, or an array of the task's program with a row or
a value for each world, such as `target` of pose and reach. Values of a step belong to the state that
the step led to; a kernel around the function is part of the step's graph.

Indices are not checked, as in all of Warp: `qpos[-50]` reads what lies there. With `wp.config.mode = "debug"`
before an environment is made, the first index out of range ends the process, with a line that says so.
"""

from __future__ import annotations

import dataclasses
import inspect
import typing
from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias

import numpy as np
import warp as wp

from myowarp.definitions.registry import check_choice
from myowarp.definitions.task import TASKS, Column, RewardTerm, TaskSpec, register, split_key
from myowarp.engine.world_function import check_function
from myowarp.kernels.world_function import Row, num_numbers
from myowarp.tasks.extended import Extended, Extension, check_type, extended_family, reads
from myowarp.tasks.quantities import QUANTITIES, SITES

MOST = float(np.finfo(np.float32).max)  # what the device calls finite

Reward: TypeAlias = float | tuple[float, Any] | tuple[float, Any, str]
Observation: TypeAlias = Any  # str | wp.Function | tuple[str, wp.Function], which mypy does not see


def extend(
    task: str | TaskSpec,
    key: str,
    *,
    rewards: Mapping[str, Reward] | None = None,
    observations: Mapping[str, Observation] | None = None,
    sites: Iterable[str] = (),
    doc: str = "",
    replace: bool = False,
    **changes: Any,
) -> TaskSpec:
    """Return a task with more terms in its reward and more blocks in its observation; it is registered.

    Args:
        task: Task, or its id.
        key: Id of the new task, name and version.
        rewards: By name a weight and a Warp function that returns a float, if wanted with its unit after
            it; or for a term that the task has, a new weight alone.
        observations: By name a Warp function that returns a float, a vector or a quaternion, if wanted with
            its unit before it; or the name of a quantity in `QUANTITIES`, all of which is observed. What
            `myowarp describe` says of a function is the first paragraph of its docstring.
        sites: Names of the sites whose positions functions read as `site_xpos`.
        doc: One sentence: what the new task asks for; "": as the task's.
        replace: Whether it may take the place of a task that is registered.
        **changes: New values of fields of the task, such as `horizon=200`.

    Returns:
        The new task.

    Raises:
        ValueError: An argument is not as described; nothing was registered.
    """
    base = task if isinstance(task, TaskSpec) else TASKS[str(task).removeprefix("MyoWarp/")]
    name, version = split_key(key)
    fields = {field.name: getattr(base, field.name) for field in dataclasses.fields(base)}
    before = fields.pop("extension", Extension())
    if unknown := changes.keys() - fields.keys():
        raise ValueError(f"task {base.key!r} has no {min(unknown)!r}; it has {', '.join(fields)}")
    for what, given in (("rewards", rewards), ("observations", observations)):
        if given is not None and not (isinstance(given, Mapping) and all(isinstance(n, str) for n in given)):
            raise ValueError(f"{what} must be a mapping from names, got {given!r}")
    sites = (sites,) if isinstance(sites, str) else sites
    if not isinstance(sites, Iterable):
        raise ValueError(f"sites must be names of sites, got {sites!r}")
    terms, weights = _rewards(base, before, rewards or {})
    blocks = _observations(base, before, observations or {})
    seen = dict.fromkeys((*before.sites, *sites))
    if not seen and {"site_xpos", SITES} & set(reads(*terms, *blocks)):
        raise ValueError(f"task {key!r} reads site_xpos; name the sites, such as sites=('tip',)")
    family = type(base).__mro__[2] if isinstance(base, Extended) else type(base)
    fields |= {"name": name, "version": version, "doc": doc or base.doc} | changes
    extension = Extension(terms, blocks, weights, tuple(seen))
    return register(extended_family(family)(**fields, extension=extension), replace=replace)


Weights: TypeAlias = tuple[tuple[str, float], ...]


def _rewards(
    base: TaskSpec, before: Extension, rewards: Mapping[str, Reward]
) -> tuple[tuple[RewardTerm, ...], Weights]:
    """Return the new terms of an extension, and the new weights of the task's own."""
    terms = {block.name: block for block in before.rewards}
    own = [term.name for term in base.reward_terms() if term.name not in terms]
    weights = dict(before.weights)
    for name, given in rewards.items():
        pair = given if isinstance(given, tuple) else (given, None)
        unit = pair[2] if len(pair) == 3 else ""
        if (
            len(pair) not in (2, 3)
            or not isinstance(unit, str)
            or (pair[1] is None and name not in (*own, *terms))
        ):
            raise ValueError(
                f"reward {name!r} must be a weight and a function, got {given!r}; "
                f"terms of which the weight alone can be given: {', '.join((*own, *terms))}"
            )
        weight, function, *_ = pair
        is_number = isinstance(weight, (int, float)) and not isinstance(weight, bool)
        if not is_number or not abs(weight) <= MOST:  # NaN is not
            raise ValueError(f"weight of reward {name!r} must be a finite number, got {weight!r}")
        if function is None and name in own:
            weights[name] = float(weight)
        elif function is None:
            terms[name] = dataclasses.replace(terms[name], weight=float(weight))
        elif name in own:
            raise ValueError(
                f"reward {name!r} is a term of {base.key!r}; give its weight alone, or rename yours"
            )
        else:
            block = _block(name, function, unit)
            if block.size != 1:
                raise ValueError(f"reward {name!r} must return a float, got {block.size} numbers")
            terms[name] = RewardTerm(name, float(weight), unit, block.doc, function)
    return tuple(terms.values()), tuple(weights.items())


def _observations(
    base: TaskSpec, before: Extension, observations: Mapping[str, Observation]
) -> tuple[Column, ...]:
    """Return the new blocks of an extension."""
    blocks = {block.name: block for block in before.observations}
    taken = {column.name for column in base.columns(1, 1, 1)} - set(blocks)
    for name, observed in observations.items():
        if name in taken:
            raise ValueError(f"observation {name!r} is a block of {base.key!r}; choose another name")
        unit, source = observed if isinstance(observed, tuple) and len(observed) == 2 else ("", observed)
        if isinstance(source, str):
            check_choice(f"quantity of observation {name!r}", source, QUANTITIES)
            quantity = QUANTITIES[source]
            row = Row(SITES if source == "site_xpos" else source)
            blocks[name] = Column(name, 0, quantity.unit, quantity.meaning, source=row)
        else:
            blocks[name] = _block(name, source, str(unit))
    return tuple(blocks.values())


def _block(name: str, function: Any, unit: str) -> Column:
    """Return the block of a function whose parameters and result we can serve.

    Raises:
        ValueError: They are not such; parameters that are no quantities are left to the program.
    """
    if not isinstance(function, wp.Function) or function.func is None:
        raise ValueError(f"{name!r} must be a function under @wp.func, got {type(function).__name__}")
    types = typing.get_type_hints(function.func)
    result = types.get("return")
    size = num_numbers(function)
    if not size:
        got = getattr(result, "__name__", result)
        raise ValueError(f"{name!r} must say what it returns, -> float, wp.vec3 or wp.quat; got {got}")
    parameters = inspect.signature(function.func).parameters
    if not parameters or not set(parameters) <= set(types):
        raise ValueError(
            f"{name!r} must have parameters with types, such as qpos: wp.array[float]; "
            f"available: {', '.join(QUANTITIES)}"
        )
    doc = " ".join((inspect.getdoc(function.func) or "").partition("\n\n")[0].split())
    block = Column(name, size, unit, doc, source=function)
    for parameter in QUANTITIES.keys() & parameters.keys():
        check_type(block, parameter, QUANTITIES[parameter].dtype, 2)
    try:
        check_function(function)
    except ValueError as error:
        raise ValueError(f"{name!r} cannot be computed: {error}") from error
    return block

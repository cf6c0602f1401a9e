"""Every Gymnasium id: the tasks, their muscle conditions under upstream's names, and the paper's grid.

MyoSuite names a condition by a prefix: `myoSarc...` and `myoFati...` exist for every id that begins with
`myo`, `myoReaf...` for those that begin with `myoHand`. Source: MyoSuite 3.0.0, its registry.
"""

from dataclasses import dataclass

from myowarp.definitions.registry import Registry
from myowarp.definitions.task import LISTED_BY, TASKS
from myowarp.tasks.paper import grid

PREFIXES = {
    # prefix: (condition, beginning of the names that have it)
    "myoSarc": ("sarcopenia", "myo"),
    "myoFati": ("fatigue_3ccr", "myo"),
    "myoReaf": ("reafferentation", "myoHand"),
}


@dataclass(frozen=True)
class Variant:
    """The meaning of an id.

    Attributes:
        task: Key of the task in `TASKS`.
        reset: What episodes start from, one of `definitions.task.RESETS`.
        conditions: Names of muscle conditions in `CONDITIONS`.
    """

    task: str
    reset: str = "task"
    conditions: tuple[str, ...] = ()


def variants_of(key: str) -> dict[str, Variant]:
    """Return the ids of a task, such as `MyoWarp/myoSarcHandPoseFixed-v0`, and what they stand for."""
    found = {TASKS[key].env_id: Variant(key)}
    for prefix, (condition, beginning) in PREFIXES.items():
        if key.startswith(beginning):
            found[f"MyoWarp/{prefix}{key.removeprefix('myo')}"] = Variant(key, conditions=(condition,))
    return found


def paper_variants() -> dict[str, Variant]:
    """Return the ids of the paper's grid, and what they stand for."""
    return {cell.id: Variant(cell.task, cell.reset, cell.conditions) for cell in grid()}


def variants() -> dict[str, Variant]:
    """Return all ids and what they stand for."""
    found: dict[str, Variant] = {}
    for key in TASKS:
        found |= variants_of(key)
    return found | paper_variants()


def find_variant(name: str) -> Variant:
    """Return what an id stands for; "MyoWarp/" may be left out.

    Raises:
        ValueError: No such id; the message lists the close ones.
    """
    if not isinstance(name, str):
        raise ValueError(f"task must be an id, got {name!r}; {LISTED_BY}")
    name, found = name.removeprefix("MyoWarp/"), variants()
    if (variant := found.get(f"MyoWarp/{name}")) is not None:
        return variant
    known: Registry[Variant] = Registry("task", listed_by=LISTED_BY)
    for env_id, variant in found.items():
        known.add(env_id.removeprefix("MyoWarp/"), variant)
    return known[name]

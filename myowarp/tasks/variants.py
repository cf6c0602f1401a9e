"""Every Gymnasium id: the tasks, their muscle conditions under upstream's names, and the paper's grid.

MyoSuite names a condition by a prefix: `myoSarc...` and `myoFati...` exist for every id that begins with
`myo`, `myoReaf...` for those that begin with `myoHand`. Source: MyoSuite 3.0.0, its registry.
"""

from dataclasses import dataclass

from myowarp.spec.registry import Registry
from myowarp.spec.task import LISTED_BY, TASKS
from myowarp.tasks.paper import grid

PREFIXES = {
    # prefix: (condition, beginning of the names that have it)
    "myoSarc": ("sarcopenia", "myo"),
    "myoFati": ("fatigue_3ccr", "myo"),
    "myoReaf": ("reafferentation", "myoHand"),
}


@dataclass(frozen=True)
class Variant:
    """What an id stands for.

    Attributes:
        task: Key of the task in `TASKS`.
        reset: What episodes start from, one of `spec.RESETS`.
        conditions: Names of muscle conditions in `CONDITIONS`.
    """

    task: str
    reset: str = "task"
    conditions: tuple[str, ...] = ()


def variants() -> dict[str, Variant]:
    """Return all ids, such as `MyoWarp/myoSarcHandPoseFixed-v0`, and what they stand for."""
    found = {TASKS[key].env_id: Variant(key) for key in TASKS}
    for prefix, (condition, beginning) in PREFIXES.items():
        for key in TASKS:
            if key.startswith(beginning):
                found[f"MyoWarp/{prefix}{key.removeprefix('myo')}"] = Variant(key, conditions=(condition,))
    found |= {cell.id: Variant(cell.task, cell.reset, cell.conditions) for cell in grid()}
    return found


def find_variant(name: str) -> Variant:
    """Return what an id stands for; "MyoWarp/" may be left out.

    Raises:
        ValueError: No such id; the message lists the close ones.
    """
    known: Registry[Variant] = Registry("task", listed_by=LISTED_BY)
    for env_id, variant in variants().items():
        known.add(env_id.removeprefix("MyoWarp/"), variant)
    return known[name.removeprefix("MyoWarp/")]

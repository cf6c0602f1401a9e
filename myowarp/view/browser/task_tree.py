"""Tasks as a tree: family, what it varies, version.

    tree = task_tree(["myoHandPoseFixed-v0", "myoHandPoseFixed-v1", "myoHandPoseRandom-v1"])
    tree["pose, hand"]["easy"]["v1"]  # "myoHandPoseFixed-v1"

What is no registered task, a model's file or a task of the user's own, is a family of its own.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from myowarp.definitions.body import BODIES
from myowarp.definitions.task import TASKS

OWN = "your own"
LEVELS = {"Fixed": "easy", "Random": "hard"}
"""Meanings of the last word of a name: a fixed goal, or one that each episode draws."""
Tree = dict[str, dict[str, dict[str, str]]]
"""Id of a task by family, level and version; the newest version first."""


def task_tree(tasks: Sequence[str]) -> Tree:
    """Return tasks as a tree.

    Args:
        tasks: Ids.
    """
    tree: Tree = {}
    for task in tasks:
        family, level, version = place_of(task)
        tree.setdefault(family, {}).setdefault(level, {})[version] = task
    for levels in tree.values():
        for level, versions in levels.items():
            levels[level] = dict(sorted(versions.items(), reverse=True))
    return tree


def place_of(task: str) -> tuple[str, str, str]:
    """Return family, level and version of a task; of a file the end of its path, as lists are narrow."""
    if task not in TASKS:
        return OWN, "/".join(Path(task).parts[-2:]), "-"
    spec = TASKS[task]
    body = BODIES[spec.body].title or spec.body.replace("_", " ")
    return f"{spec.title.lower()}, {body}", _level(spec.name), f"v{spec.version}"


def title_of(task: str) -> str:
    """Return the name of a task or a model as people say it."""
    place, level, _ = place_of(task)
    family, _, body = place.partition(", ")
    return f"{body.capitalize()}: {family}" if body else level


def _level(name: str) -> str:
    """Return what the end of a task's name says: "easy" or "hard", which pose, which phase, which ground."""
    found = re.fullmatch(r"(my|mot)o.*?(\d*)(Fixed|Random|Swap|Demo|P\d)", name)
    if found is None:
        words = re.findall(r"[A-Z]+[a-z]*|\d+", re.sub(r"^(my|mot)o[A-Z][a-z]+", "", name))
        return " ".join(words).lower() or name
    _, number, word = found.groups()
    level = LEVELS.get(word, word if name.startswith("myoChallenge") else word.lower())
    return f"{level}, pose {number}" if number and word in LEVELS else level

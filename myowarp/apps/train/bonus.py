"""`--bonus`: an addition to the reward in training alone; evaluations always have the task's own reward.

A reward may pay nothing for the last step to the goal: a key's has bonuses at half of the turn that counts, a
reach's none within the radius that counts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from myowarp.definitions.task import TaskSpec
from myowarp.disk import NUMBER

if TYPE_CHECKING:
    import torch

OUTCOMES = ("solved", "success")  # of a control step, 0 or 1
PRECISION = "precision"  # 1 - error / near, at least 0
ERRORS = ("reach", "pose")  # terms that are minus the error


def weights(bonus: Sequence[str]) -> dict[str, float]:
    """Return weights by name.

    Raises:
        ValueError: An entry is not NAME=WEIGHT, or a name comes twice.
    """
    found: dict[str, float] = {}
    for entry in bonus:
        name, _, weight = entry.partition("=")
        number = float(weight) if NUMBER.fullmatch(weight) else math.inf
        if not math.isfinite(number):
            raise ValueError(f"--bonus must be NAME=WEIGHT with a number, such as solved=4, got {entry!r}")
        if name in found:
            raise ValueError(f"--bonus has {name!r} twice; give it one weight")
        found[name] = number
    return found


def names(spec: TaskSpec) -> tuple[str, ...]:
    """Return what can be weighed in a task."""
    terms = tuple(term.name for term in spec.reward_terms())
    return (
        *OUTCOMES,
        *((PRECISION,) if set(ERRORS).intersection(terms) and hasattr(spec, "near") else ()),
        *terms,
    )


def value(name: str, info: Mapping[str, torch.Tensor], spec: TaskSpec) -> torch.Tensor:
    """Return what is weighed, shape (num_worlds,), of the `info` of a control step."""
    if name in OUTCOMES:
        return info[name].float()
    if name == PRECISION:
        near: float = getattr(spec, "near")  # noqa: B009 (not every task has one; `names` asks)
        minus_error = next(info[f"terms/{term}"] for term in ERRORS if f"terms/{term}" in info)
        return (1.0 + minus_error / near).clamp_min(0.0)
    return info[f"terms/{name}"]

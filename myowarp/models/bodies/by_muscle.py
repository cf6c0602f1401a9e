"""Facts of muscles, written once a fact and found by muscle."""

from collections.abc import Mapping
from typing import TypeVar

T = TypeVar("T")


def by_muscle(muscles: Mapping[T, str]) -> dict[str, T]:
    """Return a fact of each muscle, from the muscles of each fact, separated by blanks."""
    return {muscle: fact for fact, names in muscles.items() for muscle in names.split()}


def on_both_sides(facts: Mapping[str, T]) -> dict[str, T]:
    """Return the facts of right muscles, which are named without `_r`, and of their left twins."""
    return {muscle + side: fact for side in ("", "_l") for muscle, fact in facts.items()}


def grouped_by_side(groups: Mapping[str, str]) -> dict[str, str]:
    """Return the group of right muscles, "right hip flexors", and of their left twins."""
    return {
        muscle + suffix: f"{side} {group}"
        for side, suffix in (("right", ""), ("left", "_l"))
        for muscle, group in groups.items()
    }

"""Names of models as people say them: `knee_angle_r` is the right knee."""

from __future__ import annotations

from collections.abc import Sequence

from myowarp.motion.gait import side_of

SIDES = {"l": "left ", "r": "right ", "": ""}


def spoken(name: str) -> str:
    """Return the name of a joint as people say it."""
    words, side = side_of(name)
    return SIDES[side] + words.removesuffix("_angle").replace("_", " ")


def places(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return names by what they are chosen with: both sides of what has two, then each of its own."""
    found: dict[str, tuple[str, ...]] = {}
    for name in names:
        own, side = side_of(name)
        if side:
            both = f"both: {spoken(own)}"
            found[both] = (*found.get(both, ()), name)
    pairs = {both: names for both, names in found.items() if len(names) > 1}
    return pairs | {spoken(name): (name,) for name in names}

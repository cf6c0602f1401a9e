"""Names of models as people say them: `knee_angle_r` is the right knee."""

from __future__ import annotations

from collections.abc import Sequence

from myowarp.motion.gait import SIDE, side_of

SIDES = {"l": "left ", "r": "right ", "": ""}


def spoken(name: str) -> str:
    """Return the name of a joint as people say it."""
    words = SIDE.sub("", name).removesuffix("_angle").replace("_", " ")
    return SIDES[side_of(name)] + words


def places(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return names by what they are chosen with: both sides of what has two, then each of its own."""
    found: dict[str, tuple[str, ...]] = {}
    for name in names:
        if side_of(name):
            both = f"both: {spoken(SIDE.sub('', name))}"
            found[both] = (*found.get(both, ()), name)
    pairs = {both: own for both, own in found.items() if len(own) > 1}
    return pairs | {spoken(name): (name,) for name in names}

"""Nerve crossing: muscles that pull against each other have exchanged their nerves.

    u_one <-> u_other   of every pair

A command for one muscle excites the other. No tendon moves, and no force changes. The pairs are facts of the
body (`Body.antagonists`), or named. Beside `reafferentation`, nerves are crossed first.

Source: Sperry (1941), doi:10.1002/cne.900750102, who crossed the nerves of flexors and extensors of rats.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp

from myowarp.definitions.body import BODIES, fact_for
from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase
from myowarp.definitions.muscle import muscle_index
from myowarp.definitions.parameter import Clock, Curve, Parameter, Value
from myowarp.kernels.launch import launch
from myowarp.models.conditions.tendon_transfer import affected_parameter, is_affected

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene
    from myowarp.definitions.task import TaskSpec


@dataclass(frozen=True, eq=False)
class NerveCrossing(Condition):
    """Pairs of muscles of which each obeys the command for the other.

    Attributes:
        affected: Whether a world has it: from 0.5 on; 0 is healthy.
        pairs: Names of the muscles of each pair; the side suffix `_r` may be left out. None: flexors and
            extensors that the body names.
    """

    PHASE = Phase.ROUTING
    WRITES = ("crossed nerves",)
    NEUTRAL: ClassVar = {"affected": 0.0}
    TITLE = "crossed nerves"
    LABELS: ClassVar = {"affected": "nerves crossed"}

    affected: Value = 1.0
    pairs: Sequence[Sequence[str]] | None = None

    def __post_init__(self) -> None:
        """Check what does not depend on the body."""
        if self.pairs is not None and not _are_pairs(self.pairs):
            raise ValueError(
                f"nerve_crossing needs pairs of muscles such as [('FDP2', 'EDC2')], got {self.pairs!r}"
            )

    def check(self, spec: TaskSpec) -> None:
        """Raise ValueError if the body lacks a muscle of a pair, or none are named and it has none."""
        self.indices(spec.body, BODIES[spec.body].muscle_names)

    def indices(self, body: str, names: Sequence[str]) -> list[list[int]]:
        """Return which of the muscles of a body, called `names`, are crossed, shape (num_pairs, 2).

        Raises:
            ValueError: A muscle is unknown or in the pairs twice, or there are no pairs.
        """
        pairs = self.pairs
        if pairs is None:
            pairs = fact_for("cross nerves without pairs of muscles", body, "antagonists")
        found = [[muscle_index(name, names) for name in pair] for pair in pairs]
        muscles = [muscle for pair in found for muscle in pair]
        if twice := [muscle for muscle in muscles if muscles.count(muscle) > 1]:
            raise ValueError(
                f"nerve_crossing needs pairs of different muscles, got {names[twice[0]]!r} twice"
            )
        return found

    def bind(self, scene: Scene, clock: Clock) -> NerveCrossingEffect:
        """Find the muscles."""
        muscles = scene.muscles
        pairs = muscles.actuator_id[self.indices(scene.spec.body, muscles.names)]
        return NerveCrossingEffect(
            scene, clock, pairs, affected_parameter("nerve_crossing", self.affected, scene)
        )


def _are_pairs(found: Any) -> bool:
    """Whether something is a sequence of pairs of names, at least one."""
    return bool(
        _several(found)
        and found
        and all(_several(pair) and len(pair) == 2 for pair in found)
        and all(isinstance(name, str) for pair in found for name in pair)
    )


def _several(found: Any) -> bool:
    return isinstance(found, Sequence) and not isinstance(found, str)


@wp.kernel(enable_backward=False)
def cross(
    # Params:
    pairs: wp.array2d[int],
    curve: Curve,
    # In:
    clock: Clock,
    # Data out:
    ctrl_out: wp.array2d[float],
):
    """ctrl[one] <-> ctrl[other], where affected; a thread a world."""
    worldid = wp.tid()
    if not is_affected(curve, clock, worldid):
        return
    for i in range(pairs.shape[0]):
        one, other = pairs[i, 0], pairs[i, 1]
        for_one = ctrl_out[worldid, one]
        ctrl_out[worldid, one] = ctrl_out[worldid, other]
        ctrl_out[worldid, other] = for_one


class NerveCrossingEffect(Effect):
    """A nerve crossing in a scene.

    Attributes:
        pairs: Actuators that exchange their commands, shape (num_pairs, 2).
    """

    def __init__(self, scene: Scene, clock: Clock, pairs: np.ndarray, parameter: Parameter) -> None:
        self.scene, self.clock, self.parameter, self.drawn = scene, clock, parameter, (parameter,)
        self.pairs = wp.array(pairs, dtype=int)

    def act(self) -> None:
        """Launch `cross`."""
        launch(cross, self.scene.num_worlds, self, self.parameter, self.scene.data)


CONDITIONS.add("nerve_crossing", NerveCrossing)

"""Nerve crossing: muscles that pull against each other have exchanged their nerves.

    u_one <-> u_other   of every pair

A command for one muscle excites the other. No tendon moves, and no force changes. The pairs are facts of the
body (`Body.antagonists`), or named. Beside `reafferentation`, nerves are crossed first.

Source: Sperry (1941), doi:10.1002/cne.900750102, who crossed the nerves of flexors and extensors of rats.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import warp as wp

from myowarp.definitions.body import fact_for
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

    def check(self, spec: TaskSpec) -> None:
        """Raise ValueError if pairs are no pairs, or none are named and the body has none."""
        self.pairs_in(spec.body)

    def pairs_in(self, body: str) -> list[tuple[str, str]]:
        """Return the pairs in a body.

        Raises:
            ValueError: There are none, or a muscle is named twice.
        """
        chosen = self.pairs
        if chosen is None:
            chosen = fact_for("cross nerves without pairs of muscles", body, "antagonists")
        pairs = [tuple(pair) for pair in chosen if not isinstance(pair, str)]
        names = [name for pair in pairs for name in pair]
        if not pairs or len(pairs) != len(chosen) or any(len(pair) != 2 for pair in pairs):
            raise ValueError(
                f"nerve_crossing needs pairs of muscles such as ('FDP2', 'EDC2'), got {chosen!r}"
            )
        if twice := [name for name in names if names.count(name) > 1]:
            raise ValueError(f"nerve_crossing needs pairs of different muscles, got {twice[0]!r} twice")
        return pairs

    def bind(self, scene: Scene, clock: Clock) -> NerveCrossingEffect:
        """Find the muscles."""
        muscles = scene.muscles
        pairs = [
            [int(muscles.actuator_id[muscle_index(name, muscles.names)]) for name in pair]
            for pair in self.pairs_in(scene.spec.body)
        ]
        return NerveCrossingEffect(
            scene, clock, pairs, affected_parameter("nerve_crossing", self.affected, scene)
        )


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

    def __init__(
        self, scene: Scene, clock: Clock, pairs: Sequence[Sequence[int]], parameter: Parameter
    ) -> None:
        self.scene, self.clock, self.parameter, self.drawn = scene, clock, parameter, (parameter,)
        self.pairs = wp.array(pairs, dtype=int)

    def act(self) -> None:
        """Launch `cross`."""
        launch(cross, self.scene.num_worlds, self, self.parameter, self.scene.data)


CONDITIONS.add("nerve_crossing", NerveCrossing)

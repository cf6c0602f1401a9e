"""Reafferentation: the command for one muscle goes to another, and the first gets none.

    u_lost <- u_donor,   u_donor <- 0

The muscles are those of the body's tendon transfer (`Body.transfer`), EIP and EPL in the hand. What the
policy asks of the lost one is ignored. No path, force or model changes. Source: MyoSuite 3.0.0, its
`myoReafHand...` tasks, which mean a tendon transfer by it; the transfer itself is `tendon_transfer`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import warp as wp

from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase
from myowarp.definitions.muscle import muscle_index
from myowarp.definitions.parameter import Clock, Curve, Parameter, Value
from myowarp.kernels.launch import launch
from myowarp.models.conditions.tendon_transfer import (
    TendonTransferEffect,
    affected_parameter,
    is_affected,
    transfer_of,
)

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene
    from myowarp.definitions.task import TaskSpec


@dataclass(frozen=True, eq=False)
class Reafferentation(Condition):
    """The lost muscle obeys the command for the donor.

    A world can have this or a `TendonTransfer`, of which this is upstream's stand-in, but not both.

    Attributes:
        affected: Whether a world has it: from 0.5 on; 0 is healthy.
    """

    PHASE = Phase.ROUTING
    WRITES = ("the command of the lost muscle",)
    NEUTRAL: ClassVar = {"affected": 0.0}
    TITLE = "nerve transfer (reafferentation)"
    LABELS: ClassVar = {"affected": "operated"}

    affected: Value = 1.0

    def check(self, spec: TaskSpec) -> None:
        """Raise ValueError if the body names no muscles for it."""
        transfer_of(spec.body, "have reafferentation")

    def bind(self, scene: Scene, clock: Clock) -> ReafferentationEffect:
        """Find the muscles."""
        return ReafferentationEffect(
            scene, clock, affected_parameter("reafferentation", self.affected, scene)
        )


def _ends(parameter: Parameter) -> np.ndarray:
    """Return the value of each world before and after it changes, shape (2, num_worlds)."""
    ends = (parameter.curve.start.numpy()[:, 0], parameter.curve.end.numpy()[:, 0])
    return np.stack([np.broadcast_to(end, parameter.worlds.number) for end in ends])


def _affected_time(parameter: Parameter) -> np.ndarray:
    """Return from when to when each world is affected [control steps], shape (2, num_worlds)."""
    start, end = _ends(parameter)
    turns = (start >= 0.5) != (end >= 0.5)
    share = np.divide(0.5 - start, end - start, out=np.zeros(len(start)), where=turns)
    onset = parameter.curve.onset.numpy()[:, 0].astype(np.float64)
    moment = onset + float(parameter.curve.duration) * share
    begin = np.where(start >= 0.5, 0.0, np.where(turns, moment, np.inf))
    return np.stack([begin, np.where(turns & (start >= 0.5), moment, np.inf)])


def check_apart(*both: Parameter) -> None:
    """Raise ValueError if both are to affect a world at a time.

    What is drawn is not known yet, nor when the time of an episode meets that of a life.
    """
    spans = {bool(p.curve.lifelong) for p in both if not np.array_equal(*_ends(p))}
    if any(p.draws for p in both) or len(spans) > 1:
        return
    begin, end = np.stack([_affected_time(p) for p in both], axis=1)
    overlap = np.flatnonzero(begin.max(axis=0) < end.min(axis=0))
    if overlap.size:
        world = both[0].worlds.given.start + overlap[0]
        raise ValueError(
            f"world {world} cannot have both 'reafferentation' and 'tendon_transfer'; "
            "set affected of one of them to 0 there, with one entry per world"
        )


@wp.kernel(enable_backward=False)
def redirect(
    # Params:
    donor: int,
    lost: int,
    curve: Curve,
    # In:
    clock: Clock,
    # Data out:
    ctrl_out: wp.array2d[float],
):
    """ctrl[lost] = ctrl[donor]; ctrl[donor] = 0, where affected."""
    worldid = wp.tid()
    if is_affected(curve, clock, worldid):
        ctrl_out[worldid, lost] = ctrl_out[worldid, donor]
        ctrl_out[worldid, donor] = 0.0


class ReafferentationEffect(Effect):
    """Reafferentation in a scene."""

    def __init__(self, scene: Scene, clock: Clock, parameter: Parameter) -> None:
        self.scene, self.clock, self.parameter, self.drawn = scene, clock, parameter, (parameter,)
        muscles, transfer = scene.muscles, transfer_of(scene.spec.body)
        self.donor, self.lost = (
            int(muscles.actuator_id[muscle_index(name, muscles.names)])
            for name in (transfer.donor, transfer.lost)
        )

    def check_beside(self, effects: Sequence[Effect]) -> None:
        """Raise ValueError if it is known now that a world is to have a tendon transfer at the same time."""
        for other in effects:
            if isinstance(other, TendonTransferEffect):
                check_apart(self.parameter, other.parameter)

    def act(self) -> None:
        """Launch `redirect`."""
        launch(redirect, self.scene.num_worlds, self, self.parameter, self.scene.data)


CONDITIONS.add("reafferentation", Reafferentation)

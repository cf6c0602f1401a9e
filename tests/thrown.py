"""A task whose bodies fly: a free root is thrown ahead, upwards or not, and fails where it has sunk."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import mujoco
import warp as wp

import myowarp

HOPPER = Path(__file__).parent / "outside" / "free_root.xml"
AHEAD, UPWARDS, LEAST = 1.5, 4.0, 1.9  # m/s, m/s, m; it starts at 2 m


@wp.func
def is_flying(qpos: wp.array[float]) -> bool:
    return qpos[2] > 0.0


@wp.func
def has_sunk(qpos: wp.array[float]) -> bool:
    return qpos[2] < LEAST


@wp.func
def seconds() -> float:
    return 1.0


@wp.kernel(enable_backward=False)
def throw(
    # In:
    mask: wp.array[bool],
    lift: wp.array2d[float],
    # Data out:
    qvel_out: wp.array2d[float],
):
    """v = (ahead, 0, lift)."""
    worldid = wp.tid()
    if mask[worldid]:
        qvel_out[worldid, 0] = AHEAD
        qvel_out[worldid, 2] = lift[worldid, 0]


class ThrownProgram(myowarp.Program):
    """Throws the body at the start."""

    def sample_start(self, mask):
        super().sample_start(mask)
        self.launch(throw, mask=mask)


@dataclass(frozen=True, kw_only=True)
class ThrownTask(myowarp.TaskSpec):
    """Fly."""

    program: ClassVar[type] = ThrownProgram
    measures: ClassVar = {"solved": is_flying, "failed": has_sunk}
    body: str = "thrown_hopper"
    num_substeps: int = 5
    horizon: int = 20
    lifts: tuple[float, ...] = (0.0, UPWARDS)

    @property
    def draws(self):
        lift = myowarp.Draw("lift", "m/s", (), (), "upwards", (), "start", self.lifts, "lift")
        return (lift,)

    def edit(self, spec):
        pass

    def columns(self, nq, nv, num_muscles):
        return (
            myowarp.Column("qpos", nq, "m, rad", source=myowarp.Row("qpos")),
            myowarp.Column("act", num_muscles, "1", source=myowarp.Row("activation")),
        )

    def reward_terms(self):
        return (myowarp.RewardTerm("seconds", 1.0, "1", source=seconds),)


def thrown(lifts=(0.0, UPWARDS)):
    """Return the task; those that are not thrown upwards fail after 0.14 s, in the 15th step."""
    if "thrown_hopper" not in myowarp.BODIES:
        build = lambda: mujoco.MjSpec.from_file(str(HOPPER))  # noqa: E731
        myowarp.BODIES.add("thrown_hopper", myowarp.Body(build, tips=("foot",)))
    return ThrownTask(name="thrownRandom" if len(lifts) > 1 else "thrown", lifts=lifts, doc="Fly.")

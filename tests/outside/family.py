"""A body and a task family with an observation and a reward of its own."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import warp as wp

import myowarp

MODEL = """<mujoco><worldbody><body name="arm">
  <joint name="hinge" axis="0 1 0" range="-1 1" limited="true" damping="0.1"/>
  <geom type="capsule" size="0.03" fromto="0 0 0 0 0 -0.4" contype="0" conaffinity="0"/>
  <site name="insertion" pos="0.03 0 -0.2"/><site name="tip" pos="0 0 -0.4"/></body>
  <site name="origin" pos="0.05 0 0.3"/></worldbody>
  <tendon><spatial name="muscle"><site site="origin"/><site site="insertion"/></spatial></tendon>
  <actuator><muscle name="muscle" tendon="muscle" force="200" lengthrange="0.3 0.6" ctrlrange="0 1"/>
  </actuator></mujoco>"""


def arm():
    return mujoco.MjSpec.from_string(MODEL)


myowarp.BODIES.add("outside_arm", myowarp.Body(arm, tips=("tip",)))


@wp.func
def arm_error(qpos: wp.array[float], target: wp.array[float]) -> float:
    """|target - qpos|."""
    return wp.abs(target[0] - qpos[0])


@wp.func
def minus_arm_error(error: float) -> float:
    return -error


@wp.func
def is_arm_near(error: float, near: float) -> bool:
    return error < near


@wp.func
def is_arm_lost() -> bool:
    return False


@dataclass(frozen=True, kw_only=True)
class ArmTask(myowarp.TaskSpec):
    """Bring the arm to an angle."""

    program: ClassVar[type] = myowarp.Program
    measures: ClassVar = {"error": arm_error, "solved": is_arm_near, "failed": is_arm_lost}
    num_substeps: int = 5
    horizon: int = 20
    near: float

    @property
    def draws(self):
        return (myowarp.Draw("target", "rad", (-1.0,), (1.0,), "target of the hinge", array="target"),)

    def edit(self, spec):
        pass

    def columns(self, nq, nv, num_muscles):
        return (
            myowarp.Column("qpos", nq, "rad", source=myowarp.Row("qpos")),
            myowarp.Column("target", 1, "rad", source=myowarp.Row("target")),
        )

    def reward_terms(self):
        return (myowarp.RewardTerm("error", 2.0, "rad", source=minus_arm_error),)


@myowarp.task("outsideArmRandom-v0")
def wide():
    """Bring the arm near a random angle."""
    return ArmTask(body="outside_arm", near=0.3)


narrow = myowarp.register(
    ArmTask(name="outsideArmNarrowRandom", body="outside_arm", near=0.01, doc="Closer.")
)

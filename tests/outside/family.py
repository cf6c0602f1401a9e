"""A body and a task family with an observation and a reward of its own."""

from dataclasses import dataclass
from enum import IntEnum
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
  <actuator><muscle name="muscle" tendon="muscle" force="200" lengthrange="0.3 0.6"/></actuator></mujoco>"""


def arm():
    return mujoco.MjSpec.from_string(MODEL)


myowarp.BODIES.add("outside_arm", myowarp.Body(arm, tips=("tip",)))

Obs = IntEnum("Obs", "qpos target", start=0)
Term = IntEnum("Term", "error", start=0)


@wp.kernel(enable_backward=False)
def sample_outside(keys: myowarp.RandomKeys, mask: wp.array[bool], target: wp.array2d[float]):
    """target ~ U(-1, 1)."""
    worldid = wp.tid()
    if mask[worldid]:
        target[worldid, 0] = wp.randf(myowarp.open_stream(keys, worldid, myowarp.GOAL), -1.0, 1.0)


@wp.kernel(enable_backward=False)
def observe_outside(
    first: wp.array[int],
    qpos_in: wp.array2d[float],
    target: wp.array2d[float],
    mask: wp.array[bool],
    obs: wp.array2d[float],
):
    """obs = [qpos, target]."""
    worldid = wp.tid()
    if mask[worldid]:
        myowarp.pack(obs, worldid, first[Obs.qpos], qpos_in, 1.0)
        myowarp.pack(obs, worldid, first[Obs.target], target, 1.0)


@wp.kernel(enable_backward=False)
def score_outside(
    qpos_in: wp.array2d[float],
    target: wp.array2d[float],
    near: float,
    terms: wp.array2d[float],
    solved: wp.array[bool],
    failed: wp.array[bool],
):
    """error = -|target - qpos|."""
    worldid = wp.tid()
    error = wp.abs(target[worldid, 0] - qpos_in[worldid, 0])
    terms[worldid, Term.error] = -error
    solved[worldid] = error < near
    failed[worldid] = False


class ArmProgram(myowarp.Program):
    def __init__(self, spec, scene):
        super().__init__(spec, scene)
        self.target = scene.zeros("task.target", 1)

    def sample_goal(self, mask):
        self.launch(sample_outside, mask=mask)

    def observe(self, mask, obs):
        self.launch(observe_outside, mask=mask, obs=obs)

    def score(self, step_count, terms, solved, failed):
        self.launch(score_outside, terms=terms, solved=solved, failed=failed)


@dataclass(frozen=True, kw_only=True)
class ArmTask(myowarp.TaskSpec):
    """Bring the arm to an angle."""

    program: ClassVar[type] = ArmProgram
    num_substeps: int = 5
    horizon: int = 20
    near: float

    def edit(self, spec):
        pass

    def columns(self, nq, nv, num_muscles):
        return myowarp.blocks({Obs.qpos: (nq, "rad"), Obs.target: (1, "rad")})

    def reward_terms(self):
        return myowarp.weighted({Term.error: 2.0})


@myowarp.task("outsideArmRandom-v0")
def wide():
    """Bring the arm near a random angle."""
    return ArmTask(body="outside_arm", near=0.3)


narrow = myowarp.register(
    ArmTask(name="outsideArmNarrowRandom", body="outside_arm", near=0.01, doc="Closer.")
)

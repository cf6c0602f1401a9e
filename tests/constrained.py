"""Small models with constraint rows of every kind, and states of them, solved by MuJoCo C."""

from functools import lru_cache

import mujoco
import mujoco_warp as mjw
import numpy as np

NUM_WORLDS = 13
NUM_ROWS = 90
NUM_CONTACTS = 32

EFC = ("J", "J_rownnz", "J_rowadr", "J_colind", "D", "aref", "frictionloss")

ROWS = """
<mujoco>
  <option jacobian="{jacobian}" cone="pyramidal"><flag island="disable"/></option>
  <worldbody>
    <geom type="plane" size="2 2 .1" condim="1"/>
    <body pos="0 0 .15">
      <joint name="shoulder" axis="0 1 0" range="-30 30" limited="true" frictionloss=".03"/>
      <geom type="capsule" fromto="0 0 0 .15 0 0" size=".02"/>
      <body pos=".15 0 0">
        <joint name="elbow" axis="0 1 0" frictionloss="2" damping=".01"/>
        <geom type="capsule" fromto="0 0 0 .15 0 0" size=".02"/>
        <body pos=".15 0 0">
          <joint name="wrist" axis="0 0 1"/>
          <geom type="capsule" fromto="0 0 0 .05 0 0" size=".015" condim="6"/>
        </body>
      </body>
    </body>
    <body pos="0 .2 .3">
      <joint name="twin" axis="1 0 0"/>
      <geom type="capsule" fromto="0 0 0 0 .1 0" size=".02" contype="0" conaffinity="0"/>
    </body>
    <body pos=".25 0 .05"><freejoint/><geom type="sphere" size=".05" condim="4"/></body>
    {more}
  </worldbody>
  <tendon><fixed name="pull" range="-.5 .5" limited="true">
    <joint joint="elbow" coef="1"/><joint joint="wrist" coef="-1"/>
  </fixed></tendon>
  <equality><joint joint1="twin" joint2="shoulder" polycoef="0 .5 0 0 0"/></equality>
</mujoco>
"""
BALL = '<body pos="{x} 1 .04"><freejoint/><geom type="sphere" size=".05" condim="{condim}"/></body>'
SLIDER = (
    '<body pos="0 1 .04"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
    '<joint type="slide" axis="0 0 1"/><geom type="sphere" size=".05" condim="1"/></body>'
)
MORE = {
    "dense": ("dense", SLIDER),
    "sparse": ("sparse", BALL.format(x=0, condim=1)),
    "wide": ("sparse", "".join(BALL.format(x=x, condim=3) for x in range(5))),
    "large": ("sparse", "".join(BALL.format(x=x, condim=1) for x in range(15))),
}
"""Name: layout of J, and bodies. J has 13, 16, 40 and 100 columns, more than 32 are never dense."""

LIMB = (
    '<body pos="0 0 -.2"><joint axis="1 0 0" range="-20 20" limited="true" margin=".1"/>'
    '<joint axis="0 1 0" range="-10 30" limited="true"/>'
    '<geom type="capsule" fromto="0 0 0 0 .05 -.2" size=".03"/>{inside}</body>'
)
LIMITS = """
<mujoco>
  <option jacobian="{jacobian}"><flag contact="disable" island="disable"/></option>
  <worldbody>{limbs}</worldbody>
</mujoco>
"""
LIMITED = {"limits": "dense", "sparse limits": "sparse"}
"""Name: layout of J of a tree in which rows are limits of joints, at most one for each of 10 dofs."""


@lru_cache
def model_of(name):
    """Return a model with rows of every kind that the solver knows, or with limits of joints alone."""
    if name in LIMITED:
        limbs = LIMB.format(inside=LIMB.format(inside=LIMB.format(inside="")) + LIMB.format(inside="") * 2)
        xml = LIMITS.format(jacobian=LIMITED[name], limbs=limbs)
    else:
        jacobian, more = MORE[name]
        xml = ROWS.format(jacobian=jacobian, more=more)
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.tolerance, model.opt.iterations = 0.0, 200
    return model


@lru_cache
def states(name):
    """Return MuJoCo C's data of random states, solved to the end."""
    model, rng = model_of(name), np.random.default_rng(3)
    found = []
    for _ in range(NUM_WORLDS):
        data = mujoco.MjData(model)
        data.qpos[:4] = rng.uniform(-1.5, 1.5, 4)
        data.qpos[6] -= rng.uniform(0.0, 0.02)
        data.qvel[:] = rng.standard_normal(model.nv)
        data.qfrc_applied[:4] = rng.uniform(-1, 1, 4)
        if name in LIMITED:
            data.qpos[:] = rng.uniform(-0.6, 0.6, model.nq)
            data.qvel[:] *= 8.0
            data.qfrc_applied[:] = rng.uniform(-5, 5, model.nv)
        mujoco.mj_forward(model, data)
        found.append(data)
    return found


@lru_cache
def rows_of(name):
    """Return the engine's arrays of the states of MuJoCo C, one in each world."""
    one = [mjw.put_data(model_of(name), data, njmax=NUM_ROWS, nconmax=NUM_CONTACTS) for data in states(name)]
    owners = {"": ("M", "ne", "nf", "nl", "nefc", "qfrc_smooth"), "efc": EFC}
    return {
        (owner, array): np.concatenate(
            [getattr(getattr(data, owner) if owner else data, array).numpy() for data in one]
        )
        for owner, arrays in owners.items()
        for array in arrays
    }

"""Legs on a plane, on slopes and on stairs of boxes: the force of the ground beside MuJoCo C's."""

from dataclasses import dataclass

import mujoco
import numpy as np
import pytest
from often import often
from stepping import forward

from myowarp.sim.simulation import Simulation
from myowarp.tasks.euler_angles import quat_of
from myowarp.tasks.walk import STEPPING_POSE, STEPPING_VELOCITY, WalkTask

NUM_WORLDS = 32
TOLERANCE = 1e-4  # of the force of the ground; measured 3.1e-5
TYPICAL = 100.0  # N, less than the median
DEPTHS = (0.001, 0.05)  # m, below where the first contact begins
RISE, TREAD, HALF_WIDTH = 0.1, 0.25, 1.0  # m, of the stairs
TILT = 0.15  # rad


def lay_nothing(spec):
    """The plane of the scene alone."""


def tilt_plane(spec):
    """The plane of the scene, rising ahead and to a side."""
    spec.geom("floor").quat = quat_of((-TILT, TILT / 2, 0.0))


def lay_ramp(spec):
    """A box whose top rises ahead."""
    ramp = spec.worldbody.add_geom(name="ramp", type=mujoco.mjtGeom.mjGEOM_BOX, size=(HALF_WIDTH, 2.0, 0.2))
    ramp.quat = quat_of((-TILT, 0.0, 0.3))


def lay_stairs(spec):
    """Boxes that overlap, each a step higher than the one before."""
    for step in range(8):
        height = RISE * (step + 1)
        box = spec.worldbody.add_geom(name=f"step_{step}", type=mujoco.mjtGeom.mjGEOM_BOX)
        box.size = (HALF_WIDTH, TREAD, height / 2)
        box.pos = (0.0, 0.6 - TREAD * step, height / 2)


GROUNDS = {"plane": lay_nothing, "tilted plane": tilt_plane, "ramp": lay_ramp, "stairs": lay_stairs}


@dataclass(frozen=True, kw_only=True)
class OnGround(WalkTask):
    """Walking on one of the grounds."""

    ground: str

    @property
    def scene_key(self):
        return (*super().scene_key, self.ground)

    def edit(self, spec):
        GROUNDS[self.ground](spec)


def on_ground(model):
    """Return postures that stand a little in the ground, and velocities."""
    rng = np.random.default_rng(1)
    hinges = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
    following = model.eq_obj1id[model.eq_type == mujoco.mjtEq.mjEQ_JOINT]
    free = model.jnt_qposadr[np.setdiff1d(hinges, following)]
    qpos = np.tile(STEPPING_POSE, (NUM_WORLDS, 1))
    qpos[:, free] += rng.normal(0.0, 0.05, (NUM_WORLDS, len(free)))
    qpos[:, :2] += rng.uniform(-0.3, 0.3, (NUM_WORLDS, 2))
    qpos[:, 2] = [height_of_touch(model, pose) for pose in qpos] - rng.uniform(*DEPTHS, NUM_WORLDS)
    return qpos, np.array(STEPPING_VELOCITY) * rng.uniform(-0.2, 0.2, (NUM_WORLDS, 1))


def height_of_touch(model, pose):
    """Return the height of the root at which the first contact begins [m]."""
    data, low, high = mujoco.MjData(model), 0.5, 2.5
    while high - low > 1e-5:
        data.qpos[:], data.qpos[2] = pose, (low + high) / 2
        mujoco.mj_fwdPosition(model, data)
        low, high = (data.qpos[2], high) if data.ncon else (low, data.qpos[2])
    return high


@pytest.mark.parametrize("ground", often([*GROUNDS], ["ramp", "stairs"]))
def test_force_of_the_ground(ground, record_property):
    """Force and moment of the ground on the root are those in MuJoCo C, as is the number of contacts."""
    start = {"start_pose": STEPPING_POSE, "start_velocity": STEPPING_VELOCITY}
    spec = OnGround(ground=ground, speed=(1.2, 1.2), **start)
    sim = Simulation(spec, NUM_WORLDS, device="cpu", graph=False, progress=False)
    host, scene_data = sim.scene.oracle, sim.scene.data
    qpos, qvel = on_ground(host)
    data, theirs, number = mujoco.MjData(host), [], []
    for data.qpos[:], data.qvel[:] in zip(qpos, qvel, strict=True):
        data.qacc_warmstart[:] = 0.0
        mujoco.mj_forward(host, data)
        theirs.append(data.qfrc_constraint[:6].copy())
        number.append(data.ncon)
    force = np.linalg.norm(np.array(theirs)[:, :3], axis=1)
    assert np.mean(number) > 2.0
    assert np.median(force) > TYPICAL

    scene_data.qpos.assign(qpos)
    scene_data.qvel.assign(qvel)
    scene_data.qacc_warmstart.zero_()
    forward(sim.scene, sim.shards[0].stages)
    worlds = scene_data.contact.worldid.numpy()[: scene_data.nacon.numpy()[0]]
    np.testing.assert_array_equal(np.bincount(worlds, minlength=NUM_WORLDS), number)
    error = np.linalg.norm(scene_data.qfrc_constraint.numpy()[:, :6] - theirs, axis=1) / force
    record_property("relative force, median and worst", np.quantile(error, [0.5, 1.0]).tolist())
    assert error.max() < TOLERANCE

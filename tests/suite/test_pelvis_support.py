"""Support of the pelvis: forces beside a law in NumPy and MuJoCo C, and that a walker stays on its line."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from myowarp.definitions.condition import resolve
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.models.conditions.pelvis_support import PelvisSupport
from myowarp.sim.simulation import Simulation

TASK = "myoLegWalkHuman-v0"
FORCE = 1e-4
"""Of the largest force: float32, and the arc tangent of small angles."""


def turned(quat, angle):
    """Return a quaternion after a turn about the vertical."""
    found = np.zeros(4)
    mujoco.mju_mulQuat(found, np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)]), np.array(quat))
    return found


def law(model, place, quat, qvel, line, heading):
    """Return force and torque of full support in the world, 3 each, from place, turn and velocities."""
    rate, stiff = 15.0, mujoco.MjData(model)
    mujoco.mj_forward(model, stiff)
    matrix, turn = np.zeros((model.nv, model.nv)), np.zeros(9)
    mujoco.mj_fullM(model, stiff, matrix)
    mujoco.mju_quat2Mat(turn, quat)
    turn = turn.reshape(3, 3)
    along, up = np.array([np.cos(heading), np.sin(heading), 0.0]), np.array([0.0, 0.0, 1.0])
    across, spin = np.cross(up, along), turn @ qvel[3:6]
    roll = np.arctan2(turn[2, 1], turn[2, 2])
    yaw = (np.arctan2(turn[1, 0], turn[0, 0]) - heading + np.pi) % (2.0 * np.pi) - np.pi
    off, speed = (place - line) @ across[:2], qvel[:3] @ across
    force = -model.body_mass.sum() * rate * (rate * off + speed) * across
    torque = -matrix[3, 3] * rate * (rate * roll + spin @ along) * along
    return force, torque - matrix[5, 5] * rate * (rate * yaw + spin[2]) * up


def test_forces_are_those_of_the_law_about_the_line_of_the_start():
    """Each world its own share; MuJoCo C brings force and torque into the coordinates of the root."""
    shares, rng, task = np.linspace(0.0, 1.0, 5), np.random.default_rng(2), TASKS[TASK]
    pose = np.array(task.start_pose)
    pose[:2], pose[3:7] = (0.3, -0.7), turned(pose[3:7], 0.6)
    support = PelvisSupport(shares)
    setup = Setup(task=replace(task, start_pose=tuple(pose)), conditions=(support,), device="cpu")
    sim = Simulation(setup, len(shares), graph=False, progress=False)
    sim.reset(seeds=np.arange(len(shares)))
    effect, data, model = sim.shards[0].effects[0], sim.scene.data, sim.scene.oracle
    effect.act()
    effect.act_in_substep()
    heading = 2.0 * np.arctan2(pose[6], pose[3])
    first = data.qfrc_applied.numpy()[:, :6].copy()
    qpos, qvel = np.tile(pose, (len(shares), 1)), rng.normal(size=(len(shares), model.nv))
    qpos[:, :3] += 0.1 * rng.normal(size=(len(shares), 3))
    for row in qpos:
        mujoco.mj_integratePos(model, row, np.r_[np.zeros(3), 0.2 * rng.normal(size=3), np.zeros(28)], 1.0)
    data.qpos.assign(qpos)
    data.qvel.assign(qvel)
    effect.act_in_substep()
    for number, share in enumerate(shares):
        for state, found in (
            ((pose[:2], pose[3:7], np.array(task.start_velocity)), first[number]),
            ((qpos[number, :2], qpos[number, 3:7], qvel[number]), data.qfrc_applied.numpy()[number, :6]),
        ):
            force, torque = law(model, *state, pose[:2], heading)
            c = mujoco.MjData(model)
            c.qpos[:] = pose
            c.qpos[:2], c.qpos[3:7] = state[:2]
            mujoco.mj_kinematics(model, c)
            mujoco.mj_comPos(model, c)
            wanted = np.zeros(model.nv)
            root = model.body("root").id
            mujoco.mj_applyFT(model, c, share * force, share * torque, c.xpos[root], root, wanted)
            assert found == pytest.approx(wanted[:6], abs=FORCE * 1e3)
    assert np.abs(data.qfrc_applied.numpy()[-1, [0, 3, 5]]).min() > 10.0
    assert not data.qfrc_applied.numpy()[:, 6:].any()


@pytest.mark.parametrize("physics", ["fast", "parity"])
def test_a_walker_falls_ahead_and_not_aside(physics):
    """Limp muscles: with support the fall is that of a plane, and the free one is not."""
    aside = []
    for share in (1.0, 0.0):
        setup = Setup(task=TASK, conditions=(PelvisSupport(share),), physics=physics, device="cpu")
        sim = Simulation(setup, 1, autoreset="disabled")
        sim.reset(seeds=np.arange(1))
        sim.action.fill_(-1.0)
        for _ in range(40):
            sim.step()
        qpos, model = sim.scene.data.qpos.numpy()[0], sim.scene.oracle
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, qpos[3:7].astype(float))
        aside.append(np.abs([qpos[0], *turn[[0, 7]]]))  # place, yaw and roll; -y is ahead
        assert qpos[2] < model.qpos0[2] - 0.1
        assert qpos[1] < -0.2
    assert (np.array(aside[0]) < 0.05).all()
    assert max(aside[1]) > 0.1


@pytest.mark.parametrize("share", [-0.1, 1.5])
def test_a_share_is_from_0_to_1(share):
    with pytest.raises(ValueError, match=rf"^pelvis_support share must be in 0\.\.1, got {share:g}$"):
        Simulation(Setup(task=TASK, conditions=(PelvisSupport(share),), device="cpu"), 1, graph=False)


def test_a_hand_is_not_supported():
    message = "^body 'hand' cannot be supported at the pelvis; bodies that can: legs$"
    with pytest.raises(ValueError, match=message):
        resolve("pelvis_support", TASKS["myoHandPoseRandom-v1"])

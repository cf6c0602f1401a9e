"""A model whose root is held in the page, against MuJoCo C with the root welded to the world."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from myowarp.apps.cli.options import Said
from myowarp.apps.cli.view import View
from myowarp.definitions.setup import Setup
from myowarp.tasks.from_file import from_mjcf
from myowarp.view.browser.held import root_of

FREE = Path(__file__).parents[1] / "outside" / "free_root.xml"
STEPS = 25
AGREES = 1e-3  # m and rad, against float32 over half a second


def opened(**options):
    command = View(Said(Setup(task=FREE, device="cpu")), **options)
    return command._open(command._title, command._policy)


def test_a_held_root_moves_the_others_as_a_welded_one_does():
    session = opened()
    model = session.sim.full_model
    assert (session.held, session.policy, session.scored) == (root_of(from_mjcf(FREE)), "zero", False)
    start = session.sim.scene.data.qpos.numpy()[session.world].astype(float)
    for _ in range(STEPS):
        session.step()
    ours = session.sim.scene.data.qpos.numpy()[session.world]
    spec = mujoco.MjSpec.from_file(str(FREE))
    for key in spec.keys:
        spec.delete(key)
    for joint in spec.body(session.held).joints:
        spec.delete(joint)
    welded = spec.compile()
    data = mujoco.MjData(welded)
    there = [model.joint(welded.joint(j).name).qposadr[0] for j in range(welded.njnt)]
    data.qpos[:] = start[there]
    data.ctrl[:] = session.sim.scene.data.ctrl.numpy()[session.world]
    for _ in range(round(session.time / welded.opt.timestep)):
        mujoco.mj_step(welded, data)
    moved = np.abs(data.qpos - start[there]).max()
    assert moved > 10 * AGREES
    np.testing.assert_allclose(ours[there], data.qpos, atol=AGREES)
    root = np.setdiff1d(np.arange(model.nq), there)
    np.testing.assert_allclose(ours[root], start[root], atol=AGREES)


@pytest.mark.parametrize("options", [{"free": True}, {"policy": f"{__file__}:still"}])
def test_a_root_that_is_free_falls(options):
    session = opened(**options)
    assert session.held == ""
    before = session.sim.scene.data.qpos.numpy()[session.world].copy()
    for _ in range(STEPS):
        session.step()
    assert np.abs(session.sim.scene.data.qpos.numpy()[session.world] - before).max() > 0.1


def still(obs):
    return np.zeros((len(obs), 2), dtype=np.float32)

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
    return command.open(command.title, command.first_policy)


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


FLOOR = '<worldbody><geom type="plane" size="9 9 1" pos="0 0 1.9"/>'
SOLID = '<freejoint name="root"/><geom size=".1"'


@pytest.mark.parametrize(
    ("options", "floor", "falls"), [((), False, True), (("--held",), False, False), ((), True, False)]
)
def test_a_rollout_says_that_nothing_holds_the_body(run, tmp_path, options, floor, falls):
    """Muscles at work do not hide it; a harness holds the body, and so does a floor under its pelvis."""
    text = FREE.read_text().replace("hopper", tmp_path.name)  # another task for each
    if floor:
        bare = SOLID + ' contype="0" conaffinity="0"'
        assert bare in text
        text = text.replace("<worldbody>", FLOOR).replace(bare, SOLID)
    path = tmp_path / "hopper.xml"
    path.write_text(text)
    status, _, err = run(
        "rollout", "--model", path, "--num-worlds", 1, "--steps", STEPS, "--device", "cpu", *options
    )
    assert status == 0, err
    assert ("Nothing holds pelvis: the model falls freely from the start; --held holds it" in err) == falls


def test_a_body_that_cannot_move_away_is_not_held(run):
    status, _, err = run("rollout", "myoElbowPose1D6MRandom-v0", "--held")
    assert status != 0
    assert "--held is for a body that can move away; that of task 'myoElbowPose1D6MRandom-v0' cannot" in err


def still(obs):
    return np.zeros((len(obs), 2), dtype=np.float32)

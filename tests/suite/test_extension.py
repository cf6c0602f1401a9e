"""What CONTRIBUTING promises, from outside the package: files in a folder of one's own (tests/outside)."""

import ast
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import mujoco
import numpy as np
import pytest
import test_draws
from often import often
from registries import as_before

import myowarp
from myowarp.apps.reports.describe import describe
from myowarp.apps.reports.evaluation import evaluate
from myowarp.apps.rollouts.targets import in_reach
from myowarp.apps.rollouts.targets import measure as measure_targets
from myowarp.disk import code_digest, is_ours
from myowarp.kernels.action import CENTER, STEEPNESS
from myowarp.sim.build import oracle_model
from myowarp.tasks.outside import find_task, load
from myowarp.view.drawing.render import NoGraphicsError

OUTSIDE = Path(__file__).parents[1] / "outside"
ENGINE = 2e-5  # rad or m over 10 control steps in float32, against MuJoCo C in float64
FLOAT32 = 1e-6  # rad or m

FILES = {
    # file and name of a task: options of the environment, and of the command
    "variant.py:near": ({}, ()),
    "family.py:wide": ({}, ()),
    "added.py:paced": ({}, ()),
    "condition.py:fading": ({"conditions": "outside_fading"}, ("--conditions", "outside_fading")),
    "muscle.py:elastic": ({"muscle": "outside_elastic"}, ("--muscle", "outside_elastic")),
    "free_root.py:pose": ({}, ()),
    "free_root.py:reach": ({}, ()),
    "mjcf.py:pose": ({}, ()),
    "mjcf.py:reach": ({}, ()),
}
FEW = ("family.py:wide", "muscle.py:elastic", "mjcf.py:reach")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Put the files into a folder of their own; what they register goes again."""
    shutil.copytree(OUTSIDE, tmp_path, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.chdir(tmp_path)
    with as_before(tmp_path):
        yield tmp_path


def key_of(folder, name):
    return find_task(f"{folder}/{name}").task


def rolled(key, steps=25, action=None, **options):
    """Return an environment, and the observations and infos of some steps of five worlds."""
    env = gym.make_vec(f"MyoWarp/{key}", num_envs=5, device="cpu", progress=False, **options)
    seen, infos = [env.reset(seed=3)[0]], []
    random = np.random.default_rng(0)
    for _ in range(steps):
        draw = random.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        obs, reward, *_, info = env.step(draw if action is None else np.full_like(draw, action))
        assert np.isfinite(reward).all()
        seen.append(obs)
        infos.append(info | {"reward": reward})
    return env, np.array(seen), infos


OWN_PROGRAM = """
@wp.kernel(enable_backward=False)
def sample_outside(keys: myowarp.RandomKeys, mask: wp.array[bool], target: wp.array2d[float]):
    worldid = wp.tid()
    if mask[worldid]:
        target[worldid, 0] = wp.randf(myowarp.open_stream(keys, worldid, myowarp.GOAL), -1.0, 1.0)


class OwnProgram(myowarp.Program):
    def __init__(self, spec, scene):
        super().__init__(spec, scene)
        self.target = wp.zeros((scene.num_worlds, 1), float)

    def sample_goal(self, mask):
        self.launch(sample_outside, mask=mask)


"""
"""A program that draws by a kernel of its own, into an array that it does not list as state."""


@pytest.mark.parametrize(
    "case", often([*FILES, "family.py:wide, not listed"], [*FEW, "family.py:wide, not listed"])
)
def test_a_state_goes_on(folder, case):
    """Bit for bit over another number of shards, whether arrays are allocated as state or by Warp alone."""
    name, _, unlisted = case.partition(", ")
    if unlisted:
        family = folder / "family.py"
        text = family.read_text()
        own = text.replace('array="target"', 'array=""')
        own = own.replace("= myowarp.Program\n", "= OwnProgram\n")
        own = own.replace("@dataclass", OWN_PROGRAM + "@dataclass", 1)
        assert own.count("OwnProgram") == 2
        family.write_text(own)
    options = {"num_envs": 5, "device": "cpu", "progress": False} | FILES[name][0]
    one, other = (gym.make_vec(f"MyoWarp/{key_of(folder, name)}", shards=n, **options) for n in (1, 2))
    one.reset(seed=0)
    other.reset(seed=50)
    for _ in range(15):
        one.step(one.action_space.sample())
    other.set_state(one.get_state())
    for _ in range(15):
        actions = one.action_space.sample()
        for ours, theirs in zip(one.step(actions)[:4], other.step(actions)[:4], strict=True):
            np.testing.assert_array_equal(ours, theirs)


def columns(env):
    """Return the slice of each block of the observation."""
    ends = np.cumsum([column.size for column in env.unwrapped.sim.columns])
    return {c.name: slice(end - c.size, end) for c, end in zip(env.unwrapped.sim.columns, ends, strict=True)}


@pytest.mark.parametrize("name", often(FILES, (*FEW, "condition.py:fading", "free_root.py:reach")))
def test_made_stepped_and_rendered(folder, name):
    """Through Gymnasium, for any split of the worlds, and the seed decides."""
    key, (options, _) = key_of(folder, name), FILES[name]
    env, obs, _ = rolled(key, shards=2, render_mode="rgb_array", render_size=(160, 120), **options)
    assert np.isfinite(obs).all()
    assert env.observation_space.shape == obs.shape[1:]
    assert np.abs(obs[-1] - obs[0]).max() > 0.01
    np.testing.assert_array_equal(rolled(key, shards=1, **options)[1], obs)
    try:
        pictures = env.render()
    except NoGraphicsError:
        pictures = ()
    for picture in pictures:
        assert picture.shape == (120, 160, 3)
        assert picture.std() > 5
    env.close()
    single = gym.make(f"MyoWarp/{key}", device="cpu", progress=False, **options)
    np.testing.assert_array_equal(single.reset(seed=5)[0], obs[0, 2])
    single.close()


@pytest.mark.parametrize("name", often(FILES, FEW))
def test_on_the_command_line(folder, run, name):
    arguments = ("--num-worlds", 4, "--steps", 3, "--device", "cpu", "--json", *FILES[name][1])
    status, out, err = run("rollout", name, *arguments)
    assert status == 0, err
    figures = json.loads(out)
    assert figures["task"] == f"MyoWarp/{key_of(folder, name)}"
    assert (figures["steps"], figures["faults"]) == (3, 0)


@pytest.mark.parametrize(
    "name", ["near", "outsideElbowNear", "outsideElbowNear-v0", "MyoWarp/outsideElbowNear-v0"]
)
def test_names_of_a_task(folder, name):
    assert find_task(f"variant.py:{name}").task == "outsideElbowNear-v0"
    assert find_task(f"variant:{name}").task == "outsideElbowNear-v0"


def test_every_command_takes_it(folder, run):
    (folder / "patients.csv").write_text("strength\n1.0\n0.5\n")
    few = ("--steps", 3, "--device", "cpu")
    for arguments in (
        ("audit", "variant.py:near", *few, "--num-worlds", 4, "--json"),
        ("cohort", "patients.csv", "--task", "variant.py:near", *few),
        ("warmup", "variant.py:near", "--device", "cpu"),
    ):
        status, _, err = run(*arguments)
        assert status == 0, err
    assert json.loads((folder / "out/audit/audit.json").read_text())["audits"][0]["id"].endswith(
        "ElbowNear-v0"
    )


def test_variant(folder):
    env, obs, infos = rolled(key_of(folder, "variant.py:near"))
    error = np.abs(obs[1:, :, columns(env)["pose_err"]][..., 0])
    solved = np.array([info["solved"] for info in infos])
    np.testing.assert_array_equal(solved, error < 0.5)
    assert solved.any()
    assert (solved != (error < 0.175)).any()


def test_family(folder):
    _, obs, infos = rolled(key_of(folder, "family.py:wide"), autoreset_mode="SameStep", steps=15)
    error = np.abs(obs[1:, :, 1] - obs[1:, :, 0])
    np.testing.assert_allclose([info["reward"] for info in infos], -2.0 * error, atol=FLOAT32)
    np.testing.assert_allclose([info["terms/error"] for info in infos], -error, atol=FLOAT32)
    np.testing.assert_array_equal([info["solved"] for info in infos], error < 0.3)
    assert len(np.unique(obs[0, :, 1])) == 5
    np.testing.assert_array_equal(rolled(key_of(folder, "family.py:narrow"), steps=15)[1], obs)


def test_what_is_added_to_a_family(folder):
    """A block, a term and a draw, each written once, are in the numbers, their names and the description."""
    key = key_of(folder, "added.py:paced")
    env, obs, infos = rolled(key, autoreset_mode="SameStep", steps=15, max_episode_steps=7)
    where = columns(env)
    assert env.observation_space.shape[1] == where["speed"].stop == where["act"].stop + 1
    speed = obs[..., where["speed"]][..., 0]
    qvel = obs[..., where["qvel"]][..., 0] / myowarp.TASKS[key].control_dt
    off = -np.abs(np.abs(qvel) - speed)
    running = np.setdiff1d(np.arange(15), (6, 13))  # not the first observation of the next episode
    pace = np.array([info["terms/pace"] for info in infos])
    np.testing.assert_allclose(pace[running], off[1:][running], rtol=1e-5, atol=FLOAT32)
    names = {name for name in infos[0] if name.startswith("terms/")}
    assert names == {f"terms/{name}" for name in ("pose", "bonus", "penalty", "act_reg", "sparse", "pace")}
    weights = {term.name: term.weight for term in env.unwrapped.sim.terms}
    total = sum(weights[name.removeprefix("terms/")] * infos[0][name] for name in names)
    np.testing.assert_allclose(infos[0]["reward"], total, rtol=1e-5)
    assert len(np.unique(speed)) == 5 * 3  # a new one in every episode
    facts = describe(myowarp.TASKS[key])
    (block,) = (block for block in facts["observation"]["blocks"] if block["name"] == "speed")
    assert (block["first"], block["unit"]) == (where["speed"].start, "rad/s")
    assert facts["reward"]["formula"].endswith(" + 0.5 pace")
    (draw,) = (draw for draw in facts["draws"] if draw["name"] == "speed")
    assert [(e["low"], e["high"]) for e in draw["entries"]] == [(0.5, 2.0)]
    assert test_draws.bounds_of(test_draws.program_of(key)).keys() == {"target", "speed"}
    test_draws.check_distribution(key)
    env.close()


def test_a_draw_needs_bounds():
    message = "^draw 'a' must have as many lower as upper bounds, or choices, got \\(0.0,\\) and \\(\\)$"
    with pytest.raises(ValueError, match=message):
        myowarp.Draw("a", "1", (0.0,), (), "a number", array="a")
    with pytest.raises(ValueError, match=r"^draw 'a' must be drawn at 'goal' or 'start', got 'posture'$"):
        myowarp.Draw("a", "1", (0.0,), (1.0,), "a number", when="posture", array="a")


def test_condition(folder):
    """The active force, the tension without its passive part, fades as written."""
    key = key_of(folder, "condition.py:fading")
    forces = []
    for conditions in ((), "outside_fading"):
        env = gym.make_vec(f"MyoWarp/{key}", 2, device="cpu", progress=False, conditions=conditions, shards=1)
        signals = myowarp.Signals(env.unwrapped.sim)
        env.reset(seed=0)
        for _ in range(2):
            env.step(np.ones(env.action_space.shape, dtype=np.float32))
            forces.append(signals.muscles.force.numpy()[0].copy())
        env.close()
    first, healthy, same, faded = forces
    np.testing.assert_allclose(first, same, rtol=1e-6)  # e^0 in the first step
    strong = healthy > 0.2 * healthy.max()
    np.testing.assert_allclose(faded[strong] / healthy[strong], np.exp(-2.0 * 0.02), rtol=0.02)


def test_muscle_with_state(folder):
    key = key_of(folder, "muscle.py:elastic")
    env, slow, _ = rolled(key, steps=3, action=1.0, muscle="outside_elastic")
    _, stiff, _ = rolled(key, steps=3, action=1.0)
    assert env.unwrapped.sim.scene.muscles.state["tendon_force"].numpy().max() > 1.0
    qvel = columns(env)["qvel"]
    assert np.abs(slow[1, :, qvel]).max() < 0.9 * np.abs(stiff[1, :, qvel]).max()


def simulated(env, actions, start, worlds=1):
    """Return the qpos of each control step in MuJoCo C, from a configuration at rest."""
    model = env.unwrapped.sim.full_model
    data = mujoco.MjData(model)
    data.qpos[:] = start
    found = []
    for action in actions:
        data.ctrl[:] = 1 / (1 + np.exp(-float(STEEPNESS) * (action - float(CENTER))))
        mujoco.mj_step(model, data, nstep=env.unwrapped.sim.scene.num_substeps)
        found.append(data.qpos.copy())
    return model, np.array(found)


def test_body_with_a_free_root(folder):
    """Angles are those of the joints behind the root, points those of the foot, as MuJoCo C moves them."""
    for name in ("pose", "reach"):
        env, obs, _ = rolled(key_of(folder, f"free_root.py:{name}"), steps=10, action=0.4)
        model, qpos = simulated(env, np.full((10, 2), 0.4), env.unwrapped.sim.scene.qpos_start.numpy())
        where = columns(env)
        np.testing.assert_allclose(obs[1:, 0, where["qpos"]], qpos, atol=ENGINE)
        assert np.abs(qpos[-1, 7:] - qpos[0, 7:]).max() > 10 * ENGINE
        assert {block: part.stop - part.start for block, part in where.items()}["qvel"] == 8
        if name == "pose":
            np.testing.assert_allclose(obs[1:, 0, where["pose_err"]], (0.7, -1.1) - qpos[:, 7:9], atol=ENGINE)
            continue
        data = mujoco.MjData(model)
        for row, configuration in zip(obs[1:, 0], qpos, strict=True):
            data.qpos[:] = configuration
            mujoco.mj_kinematics(model, data)
            foot = data.site("foot").xpos
            np.testing.assert_allclose(row[where["tip_pos"]], foot, atol=ENGINE)
            np.testing.assert_allclose(row[where["reach_err"]], (0.3, 0.0, 1.4) - foot, atol=ENGINE)


@pytest.mark.slow
def test_a_policy_on_a_free_root_is_evaluated(folder, caplog):
    """Which points its foot reaches is judged, too: with a free root every point."""
    key = key_of(folder, "free_root.py:reach")
    env = myowarp.make_vec(
        key, 3, device="cpu", progress=False, autoreset_mode="SameStep", max_episode_steps=4
    )
    found = evaluate(env.sim, lambda obs: np.zeros(env.action_space.shape, np.float32))
    assert (found.episodes, found.length_mean, found.reachable, found.success_reachable) == (3, 4, 3, 0.0)
    assert caplog.messages == []
    targets = measure_targets(env.sim)
    assert (targets.solvable, targets.exact, targets.why) == (1.0, 1.0, "")
    env.close()


def test_a_joint_without_range_has_every_angle(folder):
    """The hip has one, the knee has none."""
    path = folder / "free_root.xml"
    path.write_text(path.read_text().replace(' range="-120 0"', ""))
    task = myowarp.from_mjcf(path, "outsideNoRange-v0")
    rows = np.array([(0.5, 9.0), (2.0, 0.0), (0.5, -0.1)])
    np.testing.assert_array_equal(in_reach(task, oracle_model(task), rows), [True, False, True])


def test_own_mjcf(folder):
    """Episodes start from the keyframe; targets are within the ranges, and within reach."""
    env, obs, _ = rolled(key_of(folder, "mjcf.py:pose"), steps=30)
    where = columns(env)
    np.testing.assert_allclose(obs[0, :, where["qpos"]], np.tile((0, 0, 2, 1, 0, 0, 0, 0.2, -0.5), (5, 1)))
    target = obs[..., where["qpos"]][..., 7:] + obs[..., where["pose_err"]]
    low, high = np.radians([(-60, -120), (90, 0)])
    assert ((target > low - FLOAT32) & (target < high + FLOAT32)).all()
    assert np.ptp(target.reshape(-1, 2), axis=0).min() > 0.3
    env, obs, _ = rolled(key_of(folder, "mjcf.py:knee"), steps=2)
    error = obs[0, :, columns(env)["pose_err"]][:, 0]
    assert ((error >= -0.3 + 0.5) & (error <= -0.1 + 0.5)).all()
    assert env.unwrapped.sim.scene.num_substeps == 5
    env, obs, _ = rolled(key_of(folder, "mjcf.py:reach"), steps=2)
    where = columns(env)
    target = obs[0, :, where["tip_pos"]] + obs[0, :, where["reach_err"]]
    hip = np.array((0.0, 0.0, 2.0))  # leg of two links of 0.4 m in the plane y = 0
    assert (np.linalg.norm(target - hip, axis=1) < 0.8 + FLOAT32).all()
    assert np.abs(target[:, 1]).max() < FLOAT32
    assert len(np.unique(target[:, 0])) == 5
    spec = env.unwrapped.sim.scene.spec
    assert {term.name: term.weight for term in spec.reward_terms()}["act_reg"] == 1.0


BAD = {
    "no file": ("none.py:near", None, "file 'none.py' does not exist"),
    "no module": ("none:near", None, "module 'none' does not exist; a file ends in .py"),
    "no such task": (
        "variant.py:far",
        None,
        "variant.py has no task 'far'; tasks in it: outsideElbowNear-v0",
    ),
    "no name": (
        "variant.py",
        None,
        "variant.py needs the name of a task after a colon; tasks in it: outside",
    ),
    "syntax": (
        "variant.py:near",
        ("return replace(", "return replace(("),
        "variant.py cannot be imported: line 11: invalid syntax",
    ),
    "exception": (
        "variant.py:near",
        ("import myowarp", "import myowarp\n\nspeed = 1 / 0"),
        "variant.py cannot be imported: line 7: ZeroDivisionError: division by zero",
    ),
    "end": (
        "variant.py:near",
        ("import myowarp", "import myowarp\n\nraise SystemExit(3)"),
        "variant.py cannot be imported: line 7: SystemExit: 3",
    ),
    "no import": (
        "variant.py:near",
        ("import myowarp", "import myowarp\nimport nothing_of_the_kind"),
        "variant.py cannot be imported: line 6: ModuleNotFoundError: No module named 'nothing_of_the_kind'",
    ),
    "no version": (
        "variant.py:near",
        ("ElbowNear-v0", "ElbowNear"),
        "task id 'outsideElbowNear' must be a name and a version, such as 'myoHandPoseFixed-v0'",
    ),
    "taken": (
        "variant.py:near",
        ("outsideElbowNear-v0", "myoElbowPose1D6MRandom-v0"),
        "task 'myoElbowPose1D6MRandom-v0' belongs to myowarp; choose another name",
    ),
    "a variant's name": (
        "variant.py:near",
        ("outsideElbowNear-v0", "myoSarcElbowPose1D6MRandom-v0"),
        "id 'MyoWarp/myoSarcElbowPose1D6MRandom-v0' is a variant of task 'myoElbowPose1D6MRandom-v0'; choose",
    ),
    "no task": (
        "variant.py:near",
        ("return replace", "_ = replace"),
        "task 'outsideElbowNear-v0' must be a TaskSpec, got NoneType",
    ),
    "no body": (
        "family.py:wide",
        ('body="outside_arm", near=0.3', 'body="tail", near=0.3'),
        "task 'outsideArmRandom-v0' needs a body in BODIES, got 'tail'",
    ),
    "no measure": (
        "family.py:wide",
        ('{"error": arm_error, ', "{"),
        "task 'outsideArmRandom-v0' needs 'error'; it is not given, and no attribute of Program, ArmTask",
    ),
    "targets of a pose": (
        "free_root.py:pose",
        ("(0.7, -1.1)", "(0.7,)"),
        "needs one target angle for each of the 2 joints, got 1 and 1",
    ),
    "no tip": ("free_root.py:reach", ('("foot",)', '("feet",)'), "site 'feet' unknown in this body"),
    "no muscle model": (
        "muscle.py:elastic --muscle outside_elastix",
        None,
        "muscle model 'outside_elastix' unknown; did you mean outside_elastic?",
    ),
    "state": (
        "muscle.py:elastic --muscle outside_elastic",
        ("wp.zeros((num_worlds, len(self.names), 1)", "wp.zeros((len(self.names), 1, 1)"),
        "state 'tendon_force' of muscle model 'outside_elastic' must be float32 of shape (2, 6)",
    ),
    "no condition": (
        "condition.py:fading --conditions outside_fade",
        None,
        "condition 'outside_fade' unknown; did you mean outside_fading",
    ),
    "parameter": (
        "condition.py:fading --conditions outside_fading",
        ("RATE = 2.0", "RATE = -2.0"),
        "rate of fading must be >= 0, got -2.0",
    ),
    "kind": (
        "mjcf.py:reach",
        ('"reach", targets', '"walk", targets'),
        "kind 'walk' unknown; available: pose, reach",
    ),
    "site": (
        "mjcf.py:reach",
        ('targets="foot"', 'targets="toe"'),
        "targets of kind 'reach' must be sites of model",
    ),
    "joint": (
        "mjcf.py:knee",
        ('"knee": (', '"root": ('),
        "has no hinge or slide 'root' that its actuators move and no equality ties; it has hip, knee",
    ),
    "range": (
        "mjcf.py:knee",
        ("(-0.3, -0.1)", "(-0.3, 0.1)"),
        "target of joint 'knee' must be within its range, -2.0944 to 0, got -0.3 to 0.1",
    ),
    "bounds": (
        "mjcf.py:knee",
        ("(-0.3, -0.1)", "0.3"),
        "target of joint 'knee' must be two numbers, low and",
    ),
    "near": ("mjcf.py:knee", ("near=0.05", "near=-1"), "near must be a positive number, got -1"),
    "horizon": (
        "mjcf.py:pose",
        ("horizon=20", "horizon=2.5"),
        "horizon must be a positive integer",
    ),
    "control step": (
        "mjcf.py:knee",
        ("control_dt=0.01", "control_dt=0.011"),
        "control_dt must be a multiple of the file's time step, 0.002 s, got 0.011 s",
    ),
    "keyframe": (
        "mjcf.py:knee",
        ("near=0.05", 'keyframe="stretched"'),
        "has no keyframe 'stretched'; it has bent",
    ),
    "weight": (
        "mjcf.py:reach",
        ('{"act_reg": 1.0}', '{"effort": 1.0}'),
        "reward 'effort' must be a weight and a function, got 1.0; terms of which the weight alone",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_wrong(folder, run, case):
    command, edit, sentence = BAD[case]
    name, *more = command.split()
    if edit is not None:
        path = folder / name.partition(":")[0]
        assert edit[0] in path.read_text()
        path.write_text(path.read_text().replace(*edit))
    status, out, err = run("rollout", name, "--num-worlds", 2, "--steps", 2, "--device", "cpu", *more)
    assert (status, out) == (2, "")
    said = [line for line in err.splitlines() if line.startswith("myowarp: ")]
    assert len(said) == 1
    assert sentence in said[0]
    assert "Traceback" not in err


def test_a_cell_that_is_run_again():
    """A task is taken once; replaced if asked, what was made before keeps its own; ours never."""

    def cell(near, horizon, **options):
        task = myowarp.task("outsideCell-v0", **options)
        return task(
            lambda: myowarp.PoseTask(
                body="elbow", target_low=(1,), target_high=(1,), near=near, horizon=horizon
            )
        )

    cell(0.1, 10)
    cell(0.1, 10)  # unchanged
    old = myowarp.make("outsideCell-v0", device="cpu", progress=False)
    message = r"^task 'outsideCell-v0' is already registered; choose another name, or pass replace=True$"
    with pytest.raises(ValueError, match=message):
        cell(0.2, 20)
    assert gym.spec("MyoWarp/outsideCell-v0").max_episode_steps == 10
    cell(0.2, 20, replace=True)
    new = myowarp.make("MyoWarp/outsideCell-v0", device="cpu", progress=False)
    assert new.spec.max_episode_steps == 20
    assert [env.unwrapped.sim.scene.spec.near for env in (old, new)] == [0.1, 0.2]
    with pytest.raises(
        ValueError, match=r"^task 'myoFingerReachFixed-v0' belongs to myowarp; choose another"
    ):
        myowarp.task("myoFingerReachFixed-v0", replace=True)(lambda: myowarp.TASKS["outsideCell-v0"])
    unknown = myowarp.PoseTask(
        name="outsideMade", body="elbow", target_low=(1,), target_high=(1,), near=1, doc="It."
    )
    with pytest.raises(ValueError, match=r"^task 'outsideMade-v0' is not registered; call myowarp.register"):
        myowarp.make_vec(unknown)
    env = myowarp.make_vec(myowarp.register(unknown), 3, device="cpu", progress=False)
    assert env.num_envs == 3
    with pytest.raises(ValueError, match=r"^what is registered must be a TaskSpec, got str$"):
        myowarp.register("outsideMade-v0")


def test_a_replaced_body_is_stepped(folder):
    """Compiled models are shared in a process; what stands under a name counts, not the name."""
    task = myowarp.TASKS[key_of(folder, "family.py:wide")]
    body = myowarp.BODIES["outside_arm"]
    slow = body.build()
    slow.joints[0].damping[0] = 100.0
    ends = []
    for build in (body.build, slow.copy):
        myowarp.BODIES.add("outside_arm", myowarp.Body(build, body.tips), replace=True)
        ends.append(rolled(task.key, steps=5, action=1.0)[1][-1, 0, 0])
    assert abs(ends[1]) < 0.5 * abs(ends[0])


EDITS = {
    # what is edited: module, task, options, file, text before and after
    "a body": ("free_root", "outsideHopperPose-v0", {}, "free_root.xml", 'force="80"', 'force="60"'),
    "model from MJCF": (
        "mjcf",
        "outsideMjcfPoseRandom-v0",
        {},
        "free_root.xml",
        'damping=".2"',
        'damping=".9"',
    ),
    "body and task": ("family", "outsideArmRandom-v0", {}, "family.py", 'damping="0.1"', 'damping="9"'),
    "condition": (
        *("condition", "outsideElbowFading-v0", {"conditions": "outside_fading"}),
        *("condition.py", "RATE = 2.0", "RATE = 20.0"),
    ),
    "muscle model": (
        *("muscle", "outsideElbowElastic-v0", {"muscle": "outside_elastic"}),
        *("muscle.py", "constant(0.02)", "constant(0.2)"),
    ),
}
MOVED = """
import importlib, json, sys
import gymnasium
import numpy as np

ends = {}
for case, (module, key, options, *_) in json.loads(sys.argv[1]).items():
    importlib.import_module(module)
    env = gymnasium.make_vec(f"MyoWarp/{key}", 4, device="cpu", progress=False, shards=1, **options)
    env.reset(seed=0)
    for _ in range(5):
        env.step(np.ones(env.action_space.shape, dtype=np.float32))
    ends[case] = env.unwrapped.sim.scene.data.qpos.numpy()[0].tolist()
print(json.dumps(ends))
"""


@pytest.mark.slow
def test_an_edited_file_is_new_physics(folder):
    """In new processes, with the caches of the one before; files that a file reads count too."""
    environment = os.environ | {"MYOWARP_CACHE_DIR": str(folder / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    environment["PYTHONPATH"] = str(Path(myowarp.__file__).parents[1])

    def moved():
        command = [sys.executable, "-c", MOVED, json.dumps(EDITS)]
        done = subprocess.run(
            command, capture_output=True, text=True, cwd=folder, env=environment, check=False
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    first = moved()
    assert moved() == first
    for *_, file, old, new in EDITS.values():
        text = (folder / file).read_text()
        assert old in text
        (folder / file).write_text(text.replace(old, new))
    for case, end in moved().items():
        assert np.abs(np.array(end) - first[case]).max() > 1e-3, case


def test_code_is_known_by_its_files(folder):
    """What a user's file imports from another counts; a class without a file is another in each process."""
    (folder / "laws.py").write_text("GAIN = 1.0\n\n\ndef law(x):\n    return GAIN * x\n")
    (folder / "uses.py").write_text("from laws import law\nimport numpy\n\n\nclass Mine:\n    act = law\n")
    module, digests = load("uses.py"), []
    for gain in ("1.0", "2.0"):
        (folder / "laws.py").write_text((folder / "laws.py").read_text().replace("1.0", gain))
        digests += [code_digest(module.Mine), code_digest(module.Mine)]
    assert digests[0] == digests[1] != digests[2] == digests[3]
    scope = {"__name__": "in_no_file"}
    sys.modules["in_no_file"] = type(sys)("in_no_file")
    exec("class Typed: pass", scope)
    assert code_digest(scope["Typed"]) != code_digest(scope["Typed"])
    assert is_ours(myowarp.PoseTask, myowarp.Sarcopenia)
    assert not is_ours(load("family.py").ArmTask)
    del sys.modules["in_no_file"]


def test_one_variant_does_not_get_the_model_of_another(folder):
    """A field that an outside task edits the model by need be named in no key."""
    path = folder / "family.py"
    text = path.read_text().replace("def edit(self, spec):\n        pass", EDITS_BY_FIELD)
    path.write_text(text.replace("    near: float\n", "    near: float\n    damping: float = 0.1\n"))
    task = myowarp.TASKS[key_of(folder, "family.py:wide")]
    stiff = myowarp.register(replace(task, name="outsideStiff", damping=7.0))
    assert [oracle_model(spec).dof_damping[0] for spec in (task, stiff, task)] == [0.1, 7.0, 0.1]


EDITS_BY_FIELD = """def edit(self, spec):
        spec.joints[0].damping[0] = self.damping"""


def snippets():
    """Return the Python of examples, of what is outside here, and of README and documentation."""
    root = OUTSIDE.parents[1]
    files = (*OUTSIDE.glob("*.py"), *(root / "examples").rglob("*.py"))
    found = {path: path.read_text() for path in files if not path.name.startswith("test_")}
    for path in (root / "README.md", root / "CONTRIBUTING.md", *(root / "docs").rglob("*.md")):
        for number, text in enumerate(re.findall(r"```python\n(.*?)```", path.read_text(), re.DOTALL)):
            found[path.with_suffix(f".{number}")] = text
    return found


SNIPPETS = snippets()


@pytest.mark.parametrize("path", SNIPPETS, ids=lambda path: path.name)
def test_only_public_names(path):
    """What users read imports nothing of ours but `myowarp` itself, and of it what is public."""
    for node in ast.walk(ast.parse(SNIPPETS[path])):
        modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        names = []
        if isinstance(node, ast.ImportFrom):
            modules = [node.module]
            names = [alias.name for alias in node.names] if node.module == "myowarp" else []
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id == "myowarp"
        ):
            names = [node.attr]
        assert not {module for module in modules if module.startswith("myowarp.")} - {"myowarp.muscle"}
        assert set(names) <= {*myowarp.__all__, "motion"}  # a room with a face of its own


def test_the_public_face():
    assert len(set(myowarp.__all__)) == len(myowarp.__all__)
    assert all(hasattr(myowarp, name) for name in myowarp.__all__)
    assert set(myowarp.CONDITIONS) == {
        name for name in myowarp.CONDITIONS if myowarp.CONDITIONS[name].__name__ in myowarp.__all__
    }


def test_the_example(folder):
    """It runs, within the lines that it may have, and by its name on the command line."""
    path = OUTSIDE.parents[1] / "examples" / "own_task.py"
    assert len(path.read_text().splitlines()) <= 60
    task = find_task(f"{path}:thrifty")
    assert task.task == "myElbowThriftyRandom-v0"
    for name in ("thrifty", "reach", "precise"):
        _, obs, _ = rolled(find_task(f"{path}:{name}").task, steps=3)
        assert np.isfinite(obs).all()

"""The command line: what it prints, what it writes, and how it says no."""

import dataclasses
import json
import os
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from often import covering, kinds, often

from myowarp.apps.cli.main import COMMANDS, command
from myowarp.apps.cli.motion import Motion
from myowarp.definitions.task import TASKS
from myowarp.disk import sentence
from myowarp.kernels.episode import SUCCESS_RULE
from myowarp.tasks.paper import grid
from myowarp.view.drawing.render import NoGraphicsError, WorldRenderer

ROOT = Path(__file__).parents[2]

ELBOW = "myoElbowPose1D6MRandom-v0"
SCENES = sorted({TASKS[key].scene_key: key for key in TASKS}.values())
COLUMNS = ["qpos[0]", "qvel[0]", "pose_err[0]", *(f"act[{i}]" for i in range(6))]
MUSCLES = ["TRIlong", "TRIlat", "TRImed", "BIClong", "BICshort", "BRA"]
PENDULUM = '<mujoco><worldbody><body><joint type="hinge"/><geom size=".1"/></body></worldbody></mujoco>'
POLICY = """
import numpy as np

gains = np.linspace(-1.0, 1.0, 6)

def act(obs):
    return np.tanh(obs[:, 2:3] * gains)
"""


@pytest.fixture
def rollout(run):
    """Roll out a few elbows; return the figures printed as JSON and the error stream."""

    def call(*arguments, worlds=3, device="cpu"):
        status, out, err = run(
            "rollout", ELBOW, "--num-worlds", worlds, "--device", device, "--json", *arguments
        )
        assert status == 0, err
        return json.loads(out), err

    return call


def direct(policy, num_steps, seed, worlds=3):
    """Roll out through Gymnasium; return what a recording should hold, and the successes of what ended."""
    env = gym.make_vec(f"MyoWarp/{ELBOW}", num_envs=worlds, device="cpu", autoreset_mode="same_step")
    rows = {name: [] for name in ("obs", "action", "reward", "terminated", "truncated")}
    obs, _ = env.reset(seed=seed)
    successes = []
    for _ in range(num_steps):
        action = policy(obs)
        after, reward, terminated, truncated, info = env.step(action)
        for name, value in zip(rows, (obs, action, reward, terminated, truncated), strict=True):
            rows[name].append(value)
        obs = after
        if "final_info" in info:
            successes += info["final_info"]["success"][info["_final_info"]].tolist()
    return {name: np.stack(values) for name, values in rows.items()}, successes


def user_policy(obs):
    return np.tanh(obs[:, 2:3] * np.linspace(-1.0, 1.0, 6))


def assert_recorded(path, expected):
    with np.load(path) as saved:
        assert set(saved.files) == {*expected, "columns", "muscles", "control_dt"}
        for name, values in expected.items():
            np.testing.assert_array_equal(saved[name], values, err_msg=name)
            assert saved[name].shape[:2] == (len(values), 3)
        assert saved["columns"].tolist() == COLUMNS
        assert saved["muscles"].tolist() == MUSCLES
        assert saved["control_dt"] == 0.02


def ids_in(out):
    """Return the first words of the lines of a list."""
    return [line.split()[0] for line in out.splitlines() if line.strip()]


def test_an_error_in_line_100_has_no_picture(run):
    """Rich makes pictures of words between colons."""
    _, _, err = run("rollout", ELBOW, "--policy", "model.osim:100: no such line.py:act")
    assert "file 'model.osim:100: no such line.py' does not exist" in err


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("describe", ELBOW),
        ("motion", "dynamics", "examples/arm.osim", "--motion", "examples/arm_bend.mot", "-o", "{out}"),
    ],
    ids=lambda words: words[0],
)
def test_a_machine_without_a_gpu_is_told_nothing(words, tmp_path):
    """Warp's native code says so at the start of a process, past Python's error stream."""
    words = [word.format(out=tmp_path / "out") for word in words]
    done = subprocess.run(
        [sys.executable, "-m", "myowarp", *words], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert "CUDA driver" not in done.stderr


def test_tasks_prints_every_id(run):
    """Whole ids, each on the line of its description, as for `grep`; versions of a task side by side."""
    status, out, _ = run("tasks")
    assert status == 0
    assert out.startswith(f"{len(TASKS)} tasks")
    printed = [name for name in ids_in(out) if name in TASKS]
    assert sorted(printed) == sorted(TASKS)
    assert printed.index("myoHandPoseFixed-v1") == printed.index("myoHandPoseFixed-v0") + 1
    (line,) = (line for line in out.splitlines() if "myoElbowPose1D6MExoFixed-v0" in line)
    assert line.endswith(TASKS["myoElbowPose1D6MExoFixed-v0"].summary)
    assert "pose, elbow: 9 observations, 6 actions, 100 steps of 0.02 s" in out


def test_paper_prints_every_id(run):
    status, out, _ = run("tasks", "--paper")
    assert status == 0
    assert max(map(len, out.splitlines())) <= 80
    assert set(ids_in(out)) >= {cell.id.removeprefix("MyoWarp/") for cell in grid()}
    assert re.search(r"^paperElbowPoseHardRExo-v0 +myoElbowPose1D6MRandom-v0 +random exoskeleton$", out, re.M)


def test_tasks_fit_a_terminal(run, monkeypatch):
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")
    _, out, _ = run("tasks")
    assert max(map(len, out.splitlines())) <= 80
    assert set(TASKS) <= set(ids_in(out))


@pytest.mark.parametrize("name", [None, *COMMANDS])
def test_help_can_be_read(run, monkeypatch, name):
    """No type of Python's in place of a value; every option is explained; a list says one sentence each."""
    monkeypatch.setenv("COLUMNS", "80")
    status, out, _ = run(*([] if name is None else [name]), "--help")
    assert status == 0
    assert "{None}" not in out
    assert "STR" not in out
    assert "no-json" not in out
    text = " ".join(re.sub("[│╭╮╰╯─]", " ", out).split())
    if name is None:
        assert all(kind.__doc__.splitlines()[0] in text for kind in COMMANDS.values())
        assert "Example" not in text
    else:
        assert " ".join(COMMANDS[name].__doc__.split())[:150] in text


@pytest.mark.parametrize("name", Motion.COMMANDS)
def test_help_of_a_step_is_its_own(run, monkeypatch, name):
    """It says what the step is, and its options alone; the list of steps says one sentence each."""
    monkeypatch.setenv("COLUMNS", "80")
    own, listed = (run("motion", *of, "--help")[1] for of in ([name], []))
    step, shown = Motion.COMMANDS[name], set(re.findall(r"^[│ ] (?:-o PATH, )?--([a-z-]+)", own, re.M))
    assert shown == {one.name.replace("_", "-") for one in dataclasses.fields(step)[1:]}
    own, listed = (" ".join(re.sub("[│╭╮╰╯─•]", " ", out).split()) for out in (own, listed))
    assert " ".join(step.__doc__.split())[:150] in own
    assert f"{name} {step.__doc__.splitlines()[0]}" in listed


@pytest.mark.parametrize(
    ("step", "option"),
    [
        *(("forces", option) for option in ("--strength", "--markers", "--emg")),
        ("study", "--span"),
        *(("dynamics", "--reserve"), ("emg", "--reserve"), ("analyze", "--loads")),
    ],
)
def test_options_of_other_steps_are_refused(run, tmp_path, step, option):
    """By name, before anything is read or written; a step that has it is named."""
    result = run("motion", step, "none.osim", option, "--output", tmp_path / "out")
    assert_one_sentence(result, f"motion {step} has no option {option}; motion ")
    owner = Motion.COMMANDS[re.search(r"; motion (\w+) has ", result[2])[1]]
    assert option.removeprefix("--") in {one.name for one in dataclasses.fields(owner)}
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("typed", "sentence"),
    [
        ("motion forces --reserv 3", "motion forces has no option --reserv; it has --reserve"),
        ("motion dynamics --reserv 3", "motion dynamics has no option --reserv; motion forces has --reserve"),
        ("motion dynamics --filtr=6", "motion dynamics has no option --filtr; it has --filter"),
        (f"train {ELBOW} --sampels 10", "train has no option --sampels; it has --samples"),
        ("view --num_world 3", "view has no option --num-world; it has --worlds"),
        (f"eval {ELBOW} --zzzz", "eval has no option --zzzz; myowarp eval --help lists its options"),
        (f"eval {ELBOW} --video x.gif", "eval has no option --video; myowarp eval --help lists its options"),
        (f"train {ELBOW} --policy x", "train has no option --policy; myowarp train --help lists its options"),
    ],
)
def test_an_unknown_option_names_the_nearest(run, typed, sentence):
    """Also where the model, which comes first, was forgotten."""
    assert_one_sentence(run(*typed.split()), sentence)


@pytest.mark.parametrize(
    ("typed", "sentence"),
    [
        (f"rollot {ELBOW}", "there is no command 'rollot'; did you mean rollout"),
        ("motion forcs arm.osim", "motion has no step 'forcs'; did you mean forces?"),
        ("qqqq", "there is no command 'qqqq'; myowarp --help lists them"),
        (f"rollout {ELBOW} --policy randm", "policy 'randm' unknown; did you mean random?"),
        (f"rollout {ELBOW} --policy runs/none", "policy 'runs/none' unknown; there is no such folder; "),
        ("eval baselines/myoElbowPose1D6MFixd-v0", "has no baseline; did you mean myoElbowPose1D6MFixed-v0"),
        ("improve runs/none", "policy 'runs/none' is no folder of a run; name one, or a policy of the pack"),
    ],
)
def test_a_misspelt_name_finds_the_nearest(run, typed, sentence):
    assert_one_sentence(run(*typed.split()), sentence)


@pytest.mark.parametrize("option", [("--address", "auto"), ("--cpus", "2")])
def test_options_of_a_cluster_need_one(run, tmp_path, option):
    status, _, err = run("motion", "study", "none.csv", *option, "--output", tmp_path / "out")
    assert status == 2
    assert err == f"myowarp: {option[0]} belongs to a cluster; give it with --ray\n"


@pytest.mark.parametrize("module", often(("myowarp", "myowarp.apps.cli.main"), ("myowarp",)))
def test_version_and_module(module, tmp_path):
    command = [sys.executable, "-m", module, "--version"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"myowarp {version('myowarp')} (mujoco {mujoco.__version__}, ")


def test_an_id_like_no_other_lists_none(run):
    result = run("describe", "walker")
    assert_one_sentence(result, "task 'walker' unknown; there are ")
    assert "`myowarp tasks` lists them" in result[2]
    assert len(result[2]) < 300


def test_tasks_of_a_family(run):
    _, out, _ = run("tasks", "--family", "reach", "--json")
    ids = [row["id"].removeprefix("MyoWarp/") for row in json.loads(out)]
    assert ids == [key for key in TASKS if TASKS[key].family == "reach"]
    assert 0 < len(ids) < len(TASKS)


FEW = covering([key for key in SCENES if not TASKS[key].large], kinds)


@pytest.mark.parametrize(
    "keys", [FEW, pytest.param(sorted({*SCENES} - {*FEW}), marks=pytest.mark.slow)], ids=["few", "others"]
)
def test_tasks_as_json_is_what_the_environments_are(keys, run):
    _, out, _ = run("tasks", "--json")
    rows = {row["id"]: row for row in json.loads(out)}
    assert list(rows) == [TASKS[key].env_id for key in TASKS]
    assert keys
    for key in keys:
        env, row = gym.make(TASKS[key].env_id, device="cpu"), rows[TASKS[key].env_id]
        assert (row["obs"],) == env.observation_space.shape
        assert (row["act"],) == env.action_space.shape
        assert row["muscles"] == len(env.unwrapped.muscle_names)
        assert row["horizon"] == env.spec.max_episode_steps
        assert row["control_dt"] == pytest.approx(1 / env.metadata["render_fps"])
        assert (row["family"], row["body"]) == (TASKS[key].family, TASKS[key].body)
        assert row["doc"] == TASKS[key].doc
        assert row["doc"].startswith(row["summary"])


def test_rollout_of_one_episode(rollout, tmp_path):
    """Figures and file agree with each other and with a rollout through Gymnasium."""
    path = tmp_path / "zero.npz"
    figures, err = rollout("--policy", "zero", "--save", path, "--seed", 3)
    expected, successes = direct(lambda obs: np.zeros((3, 6), np.float32), 100, seed=3)
    assert_recorded(path, expected)
    assert expected["truncated"].sum() == 3
    assert "Saved" in err
    returns = expected["reward"].astype(float).sum(axis=0)
    rates = {name: figures.pop(name) for name in ("env_steps_per_s", "physics_steps_per_s")}
    assert rates["env_steps_per_s"] > 0
    assert rates["physics_steps_per_s"] == pytest.approx(10 * rates["env_steps_per_s"])
    assert figures.pop("return_mean") == pytest.approx(returns.mean())
    assert figures.pop("return_std") == pytest.approx(returns.std())
    assert figures.pop("success_percent") == pytest.approx(100 * np.mean(successes))
    assert figures == {
        "task": f"MyoWarp/{ELBOW}",
        "policy": "zero",
        "device": "cpu",
        "num_worlds": 3,
        "steps": 100,
        "episodes": 3,
        "failed": 0,
        "faults": 0,
    }


def test_random_rollout_repeats(rollout, tmp_path):
    files = [tmp_path / f"{name}.npz" for name in ("first", "again", "other")]
    for path, seed in zip(files, (5, 5, 6), strict=True):
        figures, _ = rollout("--steps", 12, "--seed", seed, "--save", path)
        assert figures["policy"] == "random"
        assert (figures["steps"], figures["episodes"], figures["return_mean"]) == (12, 0, None)
    first, again, other = (dict(np.load(path)) for path in files)
    assert set(first) == set(again)
    for name in first:
        np.testing.assert_array_equal(first[name], again[name])
    assert not np.array_equal(first["action"], other["action"])
    assert not np.array_equal(first["obs"][0], other["obs"][0])
    assert first["action"].dtype == np.float32
    assert -1.0 <= first["action"].min() < -0.9 < 0.9 < first["action"].max() <= 1.0
    actions = iter(first["action"])
    assert_recorded(files[0], direct(lambda obs: next(actions), 12, seed=5)[0])


@pytest.mark.parametrize("kind", ["file", "module"])
def test_policy_of_the_user(rollout, tmp_path, monkeypatch, kind):
    """It acts as it does outside the command; its file runs once."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    package = tmp_path / "policies_of_test_cli"
    package.mkdir()
    (package / "reach.py").write_text(f"{POLICY}\nopen('runs', 'a').write('once')\n")
    name = {"file": f"{package.name}/reach.py:act", "module": f"{package.name}.reach:act"}[kind]
    rollout("--policy", name, "--steps", 9, "--seed", 2, "--save", "data.npz")
    assert_recorded("data.npz", direct(user_policy, 9, seed=2)[0])
    assert (tmp_path / "runs").read_text() == "once"


def test_policy_of_torch(rollout, tmp_path, monkeypatch):
    """What a network returns knows its gradient, and is an action all the same."""
    torch = pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "net.py").write_text(
        "import torch\n\nnet = torch.nn.Linear(9, 6)\nact = lambda obs: net(torch.from_numpy(obs)).tanh()\n"
    )
    torch.manual_seed(0)
    rollout("--policy", "net.py:act", "--steps", 3, "--save", "data.npz")
    action = np.load("data.npz")["action"]
    assert action.dtype == np.float32
    assert np.ptp(action) > 0.5


def test_fast_physics_takes_fewer_steps(rollout):
    per_step = []
    for physics in ("parity", "fast"):
        figures, _ = rollout("--physics", physics, "--steps", 2)
        per_step.append(figures["physics_steps_per_s"] / figures["env_steps_per_s"])
    assert per_step == pytest.approx([10, 2])  # 20 ms in steps of 2 and 10 ms


def test_figures_as_a_table(run):
    status, out, err = run("rollout", f"MyoWarp/{ELBOW}", "--num-worlds", 2, "--steps", 2, "--device", "cpu")
    assert status == 0, err
    assert out.startswith(f"MyoWarp/{ELBOW}\n")
    cells = [[cell.strip() for cell in line.split("│")[1:3]] for line in out.splitlines() if "│" in line]
    table = dict(cells)
    assert table["policy"] == "random (default)"
    assert (table["num worlds"], table["steps"], table["episodes"]) == ("2", "2", "0")
    assert {"env steps/s", "physics steps/s"} <= set(table)
    assert "return mean" not in table
    assert "Success" not in out


def test_success_is_explained(run):
    """Where a rollout says how many episodes succeed, it says what that means here."""
    _, out, _ = run("rollout", ELBOW, "--num-worlds", 2, "--policy", "zero", "--device", "cpu")
    said = " ".join(out.split())
    assert f"Success: {SUCCESS_RULE}." in said
    assert "solved, in a row or not (MyoSuite's rule), and neither failure nor fault ends it" in SUCCESS_RULE
    assert TASKS[ELBOW].solved_when in said


BAD = {
    "unknown family": (["tasks", "--family", "juggle"], "family 'juggle' unknown; available: "),
    "unknown task": (["rollout", "myoElbowPose1D6MRandm-v0"], f"unknown; did you mean {ELBOW}, "),
    "unknown task to warm up": (["warmup", "myoElbowPose1D6MRandm-v0"], f"unknown; did you mean {ELBOW}, "),
    "no steps": (["rollout", ELBOW, "--steps", "0"], "--steps must be at least 1, got 0"),
    "no filmed worlds": (
        ["rollout", ELBOW, "--video-worlds", "-1"],
        "--video-worlds must be at least 1, got -1",
    ),
    "wrong suffix": (["rollout", ELBOW, "--save", "data.csv"], "output 'data.csv' must end in .npz"),
    "wrong video": (["rollout", ELBOW, "--video", "film.avi"], "output 'film.avi' must end in .mp4 or .gif"),
    "a folder": (
        ["rollout", ELBOW, "--video", "folder.mp4"],
        "output 'folder.mp4' is no file and is left alone; choose another name",
    ),
    "no permission": (
        ["rollout", ELBOW, "--save", "locked/data.npz"],
        "output 'locked' cannot be written; it must be a folder, or a new one, and writable",
    ),
}
BAD_LATER = {
    "no worlds": (["--num-worlds", "0"], "num_worlds must be a positive integer, got 0"),
    "no such device": (["--device", "cuda:77"], "device 'cuda:77' is not available; available: "),
    "no such physics": (["--physics", "exact"], "physics 'exact' unknown; available: parity, fast"),
    "negative seed": (["--seed", "-1"], "seed"),
    "no such policy": (
        ["--policy", "best"],
        "policy 'best' unknown; available: random, zero, hold, muscle-control, baseline, baselines/<task>, "
        "the folder of a trained policy, excitations (.sto, .mot, .csv), a gait (.json), a model's own "
        "controllers (.osim), package.module:function, file.py:function",
    ),
    "no such file": (["--policy", "none.py:act"], "file 'none.py' does not exist"),
    "no such module": (["--policy", "none:act"], "module 'none' does not exist; a file ends in .py"),
    "no such function": (["--policy", "math:act"], "policy 'math:act' not found: math has no 'act'"),
    "no function in file": (
        ["--policy", "policy.py:none"],
        "policy 'policy.py:none' not found: policy.py has no 'none'",
    ),
    "no function": (["--policy", "math:pi"], "must be a function of the observations, got float"),
    "wrong actions": (
        ["--policy", "policy.py:narrow"],
        "actions must be floating point of shape (2, 6), got float64 of shape (2, 5)",
    ),
    "no actions": (
        ["--policy", "policy.py:nothing"],
        "policy 'policy.py:nothing' must return actions of shape (2, 6), got None; does it end with return?",
    ),
    "actions and a state": (
        ["--policy", "policy.py:pair"],
        "actions must be floating point of shape (2, 6), got tuple that is no array",
    ),
}


def assert_one_sentence(result, sentence):
    status, out, err = result
    assert status == 2
    assert out == ""
    assert "Traceback" not in err
    said = [line for line in err.splitlines() if line.startswith("myowarp: ")]
    assert len(said) == 1
    assert sentence in said[0]
    assert err.rstrip().endswith(said[0].rstrip())


@pytest.mark.parametrize("case", BAD)
def test_refusal_before_any_simulation(run, no_simulation, monkeypatch, tmp_path, case):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.mp4").mkdir()
    (tmp_path / "locked").mkdir()
    access = os.access
    monkeypatch.setattr("os.access", lambda path, mode: "locked" not in str(path) and access(path, mode))
    arguments, sentence = BAD[case]
    assert_one_sentence(run(*arguments), sentence)


@pytest.mark.parametrize("case", BAD_LATER)
def test_refusal(run, monkeypatch, tmp_path, case):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "policy.py").write_text(
        "import numpy as np\n\nnarrow = lambda obs: np.zeros((len(obs), 5))\nnothing = lambda obs: None\n"
        "pair = lambda obs: (np.zeros((len(obs), 6)), None)\n"
    )
    arguments, sentence = BAD_LATER[case]
    arguments = [*([] if "--num-worlds" in arguments else ["--num-worlds", "2"]), *arguments]
    arguments = [*([] if "--device" in arguments else ["--device", "cpu"]), *arguments]
    assert_one_sentence(run("rollout", ELBOW, *arguments, "--save", "data.npz"), sentence)
    assert not (tmp_path / "data.npz").exists()


@pytest.mark.parametrize("arguments", [["bogus"], ["rollout"], ["rollout", ELBOW, "--steps", "many"]])
def test_wrong_usage(run, no_simulation, arguments):
    status, _, err = run(*arguments)
    assert status == 2
    assert "Traceback" not in err
    assert "myowarp" in err


def test_warmup_builds_each_scene_once(run, monkeypatch):
    built = []
    monkeypatch.setattr(
        "myowarp.sim.simulation.Simulation", lambda *args, **options: built.append((*args, options))
    )
    assert run("warmup", "--device", "cpu", "--physics", "fast")[0] == 0
    bodies = {TASKS[key].body for key in SCENES}
    ours = [setup.spec.scene_key for setup, *_ in built if setup.spec.body in bodies]
    assert sorted(ours) == sorted(TASKS[key].scene_key for key in SCENES)
    assert all((setup.device, setup.physics) == ("cpu", "fast") for setup, *_ in built)


def test_warmup_runs(run):
    status, _, err = run("warmup", ELBOW, "MyoWarp/myoElbowPose1D6MFixed-v0", "--device", "cpu")
    assert status == 0
    assert err.count("pose with elbow") == 1
    assert "hand" not in err


@pytest.fixture(scope="module")
def graphics():
    try:
        WorldRenderer(mujoco.MjModel.from_xml_string(PENDULUM), 16, 16).close()
    except NoGraphicsError as error:
        pytest.skip(str(error))


@pytest.mark.slow
@pytest.mark.usefixtures("graphics")
def test_video(rollout, tmp_path):
    """Two of three worlds side by side, a frame a step and one of the start."""
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "film.mp4"
    _, err = rollout("--video", path, "--video-worlds", 2, "--steps", 4, "--policy", "zero")
    assert "Saved" in err
    assert [file.name for file in tmp_path.iterdir()] == ["film.mp4"]
    reader = imageio_ffmpeg.read_frames(path)
    about = next(reader)
    frames = [np.frombuffer(frame, dtype=np.uint8).reshape(240, 642, 3) for frame in reader]
    assert about["size"] == (642, 240)
    assert about["fps"] == 50
    assert len(frames) == 5  # the first one is the start
    assert not np.array_equal(frames[0], frames[-1])
    assert frames[0][:, :320].std() > 1
    assert frames[0][:, 322:].std() > 1


def test_rollout_without_graphics(rollout, monkeypatch, tmp_path):
    """No OpenGL: data and figures come all the same, and what to install is said."""

    def no_context(*args):
        raise RuntimeError("no EGL device")

    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setattr(mujoco, "GLContext", no_context)
    video, data = tmp_path / "film.mp4", tmp_path / "data.npz"
    figures, err = rollout("--video", video, "--save", data, "--steps", 2, "--policy", "zero")
    assert figures["steps"] == 2
    assert "No video: drawing needs OpenGL" in err
    assert "apt-get install libegl1 libgl1" in " ".join(err.split())
    assert [file.name for file in tmp_path.iterdir()] == ["data.npz"]


def shell(*arguments, cwd, **environment):
    command = [sys.executable, "-m", "myowarp.apps.cli.main", *arguments]
    return subprocess.run(
        command, cwd=cwd, env=os.environ | environment, capture_output=True, text=True, check=False
    )


def test_command_in_a_process_of_its_own(tmp_path):
    """The output is JSON and nothing else, also where drawing was switched off."""
    arguments = ("rollout", ELBOW, "--num-worlds", "2", "--steps", "3", "--device", "cpu", "--json")
    done = shell(*arguments, "--video", "film.mp4", cwd=tmp_path, MUJOCO_GL="disable")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["steps"] == 3
    assert "No video: drawing needs OpenGL, got MUJOCO_GL=disable" in done.stderr
    assert not any(tmp_path.iterdir())


@pytest.mark.slow
def test_paths_with_umlauts_where_the_locale_is_ascii(tmp_path):
    """Parquet takes a path in UTF-8, whatever Python makes of it."""
    ascii_alone = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    arguments = ("rollout", ELBOW, "--num-worlds", "2", "--steps", "3", "--device", "cpu")
    done = shell(*arguments, "--signals", "Übung.parquet", cwd=tmp_path, **ascii_alone)
    assert done.returncode == 0, done.stderr
    assert "Übung.parquet" in {file.name for file in tmp_path.iterdir()}


@pytest.mark.slow
def test_signs_that_a_terminal_lacks_end_nothing(tmp_path):
    done = shell("motion", "--help", cwd=tmp_path, PYTHONUTF8="1", PYTHONIOENCODING="ascii")
    assert done.returncode == 0, done.stderr
    assert r"\u2022 kinematics" in " ".join(done.stdout.split())


def test_a_name_that_is_no_utf_8_is_one_sentence():
    with pytest.raises(UnicodeEncodeError) as caught:
        "tmp\udcff.parquet".encode()
    assert sentence(caught.value) == (
        r"'tmp\udcff.parquet' has characters that are none of utf-8; choose another name"
    )


@pytest.mark.slow
def test_error_of_a_process_of_its_own(tmp_path):
    done = shell("rollout", ELBOW, "--device", "cuda:77", cwd=tmp_path)
    result = (done.returncode, done.stdout, done.stderr)
    assert_one_sentence(result, "device 'cuda:77' is not available; available: ")


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments", often([("tasks", "--paper"), ("view", "--help")], [("tasks", "--paper")])
)
def test_a_reader_that_has_left_ends_the_command_silently(arguments):
    """As `myowarp tasks | head` does; the status is what a shell reports of tools that a signal ends."""
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "myowarp", *arguments]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True)
    os.close(writing)
    assert done.returncode == 141
    assert not re.search(r"Traceback|[Pp]ipe|Exception", done.stderr)


def test_ctrl_c_ends_the_command_without_a_traceback(monkeypatch):
    """Wherever it comes; the status is what a shell reports of tools that a signal ends."""

    def interrupted(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(COMMANDS["tasks"], "__call__", interrupted)
    monkeypatch.setattr("gc.freeze", lambda: None)
    monkeypatch.setattr(sys, "argv", ["myowarp", "tasks"])
    with pytest.raises(SystemExit) as ended:
        command()
    assert ended.value.code == 130


def test_a_model_without_a_task_has_no_success(run, tmp_path):
    driven = PENDULUM.replace('type="hinge"', 'name="hinge" range="-1 1" limited="true"')
    motor = '<actuator><motor joint="hinge" ctrlrange="-1 1"/></actuator></mujoco>'
    (tmp_path / "arm.xml").write_text(driven.replace("</mujoco>", motor))
    options = ("--model", tmp_path / "arm.xml", "--num-worlds", 2, "--steps", 101, "--device", "cpu")
    status, out, err = run("rollout", *options)
    assert status == 0, err
    assert "episodes" in out
    assert "uccess" not in out
    figures = json.loads(run("rollout", *options, "--json")[1])
    assert [figures[name] for name in ("return_mean", "return_std", "success_percent")] == [None] * 3

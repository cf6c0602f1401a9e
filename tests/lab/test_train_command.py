"""`myowarp train` and `myowarp eval`: a policy that learns, figures, and how they say no."""

import csv
import dataclasses
import errno
import importlib.util
import json
import os
import shlex
import signal
import time
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from tiny_runs import ELBOW, TINY, said

from myowarp.apps.cli import train as command
from myowarp.apps.cli.options import Said
from myowarp.apps.cli.rollout import Rollout
from myowarp.apps.policies import checkpoint as checkpoints
from myowarp.apps.policies.checkpoint import eval_command, resume_command
from myowarp.apps.policies.run_folder import held
from myowarp.apps.reports.evaluation import evaluate
from myowarp.apps.reports.intervals import wilson
from myowarp.apps.train.plan import plan
from myowarp.apps.train.run import start, train
from myowarp.apps.train.settings import ALGORITHMS, choose, preset_algorithm
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.extras import to_install
from myowarp.models.conditions.fatigue_3ccr import Fatigue3CCR
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import State

pytestmark = pytest.mark.usefixtures("registered")

OTHER = "myoElbowPose1D6MFixed-v0"
GOES_ON = "--resume goes on with the settings of its run, where "
PRESETS = sorted(f.name for f in resources.files("myowarp.apps.train").joinpath("presets").iterdir())


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """Train an elbow with its preset; return the folder of the run."""
    folder = tmp_path_factory.mktemp("runs") / "elbow"
    train(plan(ELBOW, output=folder, device="cpu", seed=1))
    return folder


def test_the_elbow_learns_in_seconds(learned, run):
    report = json.loads((learned / "report.json").read_text())
    reached = "at least 99.5 % of the episodes succeeded with mean actions (solved on the last step)"
    assert report["ended"] == reached
    assert report["samples"] <= 250_000
    best, last = report["selection"]["best"], report["selection"]["last"]
    assert best == last
    assert best["samples"] == report["samples"]
    assert best["success"] >= 0.995
    assert 0.0 < report["training_seconds"] < report["seconds"]
    assert 0.0 < report["training_cpu_seconds"] < report["cpu_seconds"] < report["seconds"] * report["cores"]
    assert 0.0 <= report["cores_busy_with_others"] < report["cores"] + 1
    assert report["resumed_after"] == 0
    status, out, err = run("eval", learned, "--device", "cpu", "--json")
    assert status == 0, err
    figures = json.loads(out)
    assert figures["physics"] == "parity"
    for mode in ("deterministic", "sampled"):
        assert figures[mode]["episodes"] == 256
        assert figures[mode]["success"] >= 0.9
        assert figures[mode]["intervals"]["success"][0] > 0.85
    assert figures["deterministic"]["activation_rate"] < figures["sampled"]["activation_rate"]
    for law in ("bhargava2004", "umberger2010"):
        assert 3.0 < figures["deterministic"][law] < figures["sampled"][law] < 300.0
        per_kg = figures["deterministic"][law] / figures["deterministic"][f"{law}_per_kg"]
        assert per_kg == pytest.approx(1.534, rel=1e-3)  # mass of the moved arm, kg
    assert {path.name for path in learned.iterdir()} >= {"progress.csv", "curve.png", "checkpoints", "best"}
    assert any(path.name.startswith("events.out") for path in learned.iterdir())


def test_rollout_plays_it(learned, run):
    status, out, err = run(
        "rollout", ELBOW, "--policy", learned, "--num-worlds", 64, "--device", "cpu", "--json"
    )
    assert status == 0, err
    assert json.loads(out)["success_percent"] >= 90.0


def test_a_cohort_is_driven_by_it(learned, run, tmp_path):
    (tmp_path / "patients.csv").write_text("patient,strength\nwell,1.0\nweak,0.4\n")
    status, _, err = run(
        *("cohort", tmp_path / "patients.csv", "--task", OTHER, "--policy", learned, "--device", "cpu"),
        *("--format", "csv", "--output", tmp_path / "out"),
    )
    assert status == 0, err
    with (tmp_path / "out" / "summary.csv").open() as file:
        well, weak = csv.DictReader(file)
    assert well["success"] == "True"
    assert float(weak["mean_activation"]) != float(well["mean_activation"])


@pytest.mark.slow
def test_a_training_ends_with_a_video(run, tmp_path, monkeypatch):
    """The trained policy acts in it, or a word says what is missing."""
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    film, filmed = tmp_path / "film.mp4", []

    def short(asked, **options):
        filmed.append(options)
        return Rollout(asked, **options, steps=3, num_worlds=2, video_worlds=1)

    monkeypatch.setattr(command, "Rollout", short)
    _, out, err = run("train", ELBOW, "--output", tmp_path / "run", *TINY, "--samples", 64, "--video", film)
    assert f"MyoWarp/{ELBOW}" in out
    assert filmed[0]["policy"] == str(tmp_path / "run")
    if "No video" in err:
        pytest.skip("drawing needs OpenGL")
    assert imageio_ffmpeg.count_frames_and_secs(film)[0] == 4


def test_a_video_is_refused_before_the_training(run, no_simulation, tmp_path):
    (tmp_path / "old.mp4").touch()
    for name, words in (("old.mp4", "exists; choose another name"), ("film.gif", "must end in .mp4")):
        options = ("--output", tmp_path / "run", "--video", tmp_path / name)
        assert said(run("train", ELBOW, *options)) == f"output {str(tmp_path / name)!r} {words}"
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["trpo", "sac"])
def test_the_elbow_learns_with_other_algorithms(algorithm, run, tmp_path):
    options = ("--algorithm", algorithm, "--stop-success", 0.95, "--samples", 120_000, "--device", "cpu")
    status, _, err = run("train", ELBOW, "--output", tmp_path / "run", *options)
    assert status == 0, err
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["selection"]["best"]["success"] >= 0.9


def test_a_checkpoint_that_is_replaced_while_it_is_read_is_read_again(tiny, tmp_path, monkeypatch):
    whole = checkpoints.load_checkpoint(tiny)
    content = {k: v for k, v in whole.manifest.items() if k != "files"}, whole.policy, {}
    checkpoints.save_checkpoint(tmp_path, 1, *content)
    read, calls = checkpoints.read_manifest, []

    def replaced(folder):
        calls.append(folder.name)
        if len(calls) == 1:
            checkpoints.save_checkpoint(tmp_path, 2, *content)
        return read(folder)

    monkeypatch.setattr(checkpoints, "read_manifest", replaced)
    assert checkpoints.load_checkpoint(tmp_path).folder.name == "000000000002"
    assert len(calls) == 2


def test_another_task_with_the_same_contract_can_be_named(learned, run):
    status, out, _ = run("eval", learned, "--task", OTHER, "--episodes", 16, "--device", "cpu", "--json")
    assert status == 0
    assert json.loads(out)["task"] == f"MyoWarp/{OTHER}"


def test_conditions_weaken_it(learned, run):
    options = ("--episodes", 64, "--mode", "deterministic", "--device", "cpu", "--json")
    healthy = json.loads(run("eval", learned, *options)[1])["deterministic"]
    weak = json.loads(run("eval", learned, *options, "--conditions", "sarcopenia")[1])
    assert weak["conditions"] == ["sarcopenia"]
    assert weak["deterministic"]["return_mean"] != healthy["return_mean"]


def test_evaluation_counts_each_world_once(monkeypatch):
    """The figures are those of a plain loop over a world that stops when its episode ends."""
    sim = Simulation(TASKS[ELBOW], 6, device="cpu", autoreset="same_step", horizon=30, seed=7)
    gains = np.linspace(-1.0, 1.0, 6)

    def act(obs):
        return np.tanh(3.0 * obs[:, 2:3] * gains)

    in_reach = np.arange(6) % 2 == 0
    monkeypatch.setattr("myowarp.apps.reports.evaluation.in_reach", lambda *of: in_reach)
    got = evaluate(sim, act)
    returns, solved, success, effort, rate = [], [], [], [], []
    for world in range(6):
        one = MyoWarpVectorEnv(ELBOW, 1, device="cpu", autoreset_mode="disabled", max_episode_steps=30)
        obs, _ = one.reset(seed=7 + world)
        total, hits, activations, ended = 0.0, [], [obs[0, 3:9]], False
        while not ended:
            obs, reward, terminated, truncated, info = one.step(act(obs))
            total, ended = total + reward[0], bool(terminated[0] | truncated[0])
            hits.append(bool(info["solved"][0]))
            activations.append(obs[0, 3:9])
        returns.append(total)
        solved.append(hits)
        success.append(sum(hits) > 5)
        seen = np.array(activations[:-1])  # the step that ends an episode shows the next one's activation
        effort.append(seen[1:].mean())
        rate.append(np.abs(np.diff(seen, axis=0)).mean() / 0.02)
    assert got.episodes == 6
    assert 0.0 < got.success < 1.0 or 0.0 < got.success_any <= 1.0
    np.testing.assert_allclose(got.return_mean, np.mean(returns), rtol=1e-6)
    assert got.success == np.mean(success)
    assert (got.reachable, got.success_reachable) == (3, np.mean(np.array(success)[in_reach]))
    assert got.intervals["success_reachable"] == wilson(sum(np.array(success)[in_reach]), 3)
    assert got.success_any == np.mean([any(hits) for hits in solved])
    assert got.success_last == np.mean([hits[-1] for hits in solved])
    np.testing.assert_allclose(got.mean_activation, np.mean(effort), rtol=1e-5)
    np.testing.assert_allclose(got.activation_rate, np.mean(rate), rtol=1e-5)


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_of_tasks_and_within_bounds(name):
    task = name.removesuffix(".toml")
    assert task in {TASKS[key].name for key in TASKS}
    assert preset_algorithm(task) in ALGORITHMS
    for algorithm in ALGORITHMS:
        choose(task, algorithm, {"expert": "hold"} if algorithm == "improve" else {})


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--num-worlds", 0), "--num-worlds must be at least 1, got 0"),
        (("--samples", 0), "--samples must be at least 1, got 0"),
        (("--learning-rate", "nan"), "--learning-rate must be at least 0.0, got nan"),
        (("--discount", 1.5), "--discount must be from 0.0 to 1.0, got 1.5"),
        (("--save-seconds", -1), "--save-seconds must be at least 0, got -1.0"),
        (("--replay", 64), "ppo has no setting --replay; it belongs to sac and dagger and improve"),
        (
            ("--algorithm", "trpo", "--learning-rate", 1e-3),
            "trpo has no setting --learning-rate; it belongs to ppo and sac and dagger and improve",
        ),
        (("--algorithm", "flashsac"), "algorithm 'flashsac' is called sac now"),
        (("--algorithm", "a3c"), "algorithm 'a3c' unknown; available: ppo, trpo, sac, dagger"),
        (("--selections", -1), "--selections must be at least 0, got -1"),
        (("--average", 1), "--average must be from 0.0 to 0.9999, got 1.0"),
        (("--start-share", 1.5), "--start-share must be from 0.0 to 1.0, got 1.5"),
        (("--precision", "float16"), "--precision 'float16' unknown; available: auto, bfloat16, float32"),
        (
            ("--bonus", "solved=4", "key=1"),
            "term of --bonus 'key' unknown; available: solved, success, precision, pose",
        ),
        (("--physics", "quick"), "physics 'quick' unknown; available: parity, fast"),
        (
            ("--num-worlds", 8, "--rollout-steps", 8, "--minibatches", 7),
            "--minibatches must divide the samples of an iteration, 8 worlds x 8 steps = 64, got 7",
        ),
        (
            ("--num-worlds", 8, "--rollout-steps", 8, "--minibatches", 2, "--samples", 63),
            "--samples must be at least one iteration, 8 worlds x 8 steps = 64, got 63",
        ),
        (
            ("--algorithm", "sac", "--num-worlds", 48),
            "--replay must be a multiple of the 48 worlds, got 1048576",
        ),
        (
            ("--algorithm", "sac", "--num-worlds", 8, "--replay", 64),
            "--batch-size must be at most --replay, 64 samples, got 512",
        ),
        (("--resume", "nowhere"), "'nowhere' holds no checkpoint; a run's folder has "),
    ],
)
def test_settings_are_refused_before_anything_is_built(arguments, sentence, run, no_simulation, tmp_path):
    assert said(run("train", ELBOW, "--output", tmp_path / "new", *arguments)).startswith(sentence)
    assert not (tmp_path / "new").exists()


def test_a_folder_that_holds_something_is_left_alone(tiny, run, no_simulation):
    assert said(run("train", ELBOW, "--output", tiny)) == (
        f"output {str(tiny)!r} is not empty; choose a new folder, or go on with myowarp train --resume {tiny}"
    )


def test_one_training_one_folder(run, tmp_path, monkeypatch):
    """Who comes second, anew or to go on, is told who is there, and touches nothing."""
    from myowarp.apps.train.loop import Run

    iterate, folder = Run.iterate, tmp_path / "run"
    begun = (Setup(task=ELBOW, device="cpu"), folder, None), (Setup(), None, folder)
    new, again = (command.Train(Said(setup), output=path, resume=old) for setup, path, old in begun)

    def files():
        return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    def disturbed(self):
        before = files()
        for other in (new, again):
            with pytest.raises(ValueError, match=f"is in use by process {os.getpid()} on .*; wait for it"):
                other()
        assert files() == before
        iterate(self)

    monkeypatch.setattr(Run, "iterate", disturbed)
    status, _, err = run("train", ELBOW, "--output", folder, *TINY, "--samples", 128, "--save-seconds", 0)
    assert status == 0, err
    assert json.loads((folder / "report.json").read_text())["samples"] == 128


def test_a_checkpoint_is_not_gone_on_with_in_place_of_its_run(run, tiny):
    """The run would delete the folder that the other one writes into."""
    last = max((tiny / "checkpoints").iterdir())
    status, _, err = run("train", "--resume", last)
    assert status == 2
    assert "is a checkpoint in a run; name the run's folder" in " ".join(err.split())


def test_a_run_that_went_on_meanwhile_is_left_alone(tiny):
    job = plan(resume=tiny)
    older = dataclasses.replace(job.checkpoint, folder=tiny / "checkpoints" / "000000000064")
    for other in (None, older):
        with (
            pytest.raises(ValueError, match="has a new checkpoint, which another process wrote just now"),
            held(tiny, other, job.resume_command),
        ):
            pass
    with held(tiny, job.checkpoint, job.resume_command):
        pass


def test_a_killed_start_does_not_occupy_its_folder(run, tmp_path):
    (tmp_path / ".lock").write_text("process 1 on elsewhere")
    status, _, err = run("train", ELBOW, "--output", tmp_path, *TINY, "--samples", 64)
    assert status == 0, err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--epochs", 7), f"{GOES_ON}--epochs is 5, got 7"),
        (("--hidden", 8), f"{GOES_ON}--hidden is [16], got (8,)"),
        (("--replay", 8), f"{GOES_ON}--replay is None, got 8"),
        (("--stop-rule", "success_any"), f"{GOES_ON}--stop-rule is "),
        (("--algorithm", "sac"), f"{GOES_ON}--algorithm is 'ppo', got 'sac'; leave it out"),
        ((OTHER,), f"{GOES_ON}task is {ELBOW!r}, got {OTHER!r}; leave it out"),
    ],
)
def test_a_run_goes_on_with_its_own_settings(arguments, sentence, tiny, run, no_simulation):
    assert said(run("train", "--resume", tiny, *arguments)).startswith(sentence)


def test_a_run_starts_from_another_one_and_says_so(tiny, run, tmp_path):
    options = ("--output", tmp_path / "child", *TINY, "--samples", 64, "--parent", tiny)
    status, _, err = run("train", OTHER, *options)
    assert status == 0, err
    parent, child = checkpoints.load_checkpoint(tiny), checkpoints.load_checkpoint(tmp_path / "child")
    origin = {"task": ELBOW, "samples": 128, **parent.manifest["files"][checkpoints.POLICY]}
    assert child.manifest["parent"] == origin
    assert child.manifest["settings"]["parent"] == str(tiny)
    assert parent.manifest["parent"] is None
    apart = np.abs(child.policy["net.0.weight"] - parent.policy["net.0.weight"]).max()
    assert 0.0 < apart < 0.05  # an iteration away
    status, _, err = run("train", "--resume", tmp_path / "child", "--samples", 128)
    assert status == 0, err
    assert checkpoints.load_checkpoint(tmp_path / "child").manifest["parent"] == origin


@pytest.mark.parametrize(
    ("task", "arguments", "words"),
    [
        (ELBOW, ("--parent", "nowhere"), "--parent 'nowhere' must be a run's folder, baseline or baselines/"),
        (ELBOW, ("--hidden", 32), "--hidden must be that of --parent"),
        (
            ELBOW,
            ("--hidden", 16, "--algorithm", "sac"),
            "was trained by ppo, whose policies sac cannot train",
        ),
        (
            "myoFingerPoseFixed-v0",
            ("--hidden", 16),
            "cannot act in 'myoFingerPoseFixed-v0' (pose with finger)",
        ),
    ],
)
def test_a_parent_that_does_not_fit_is_refused(task, arguments, words, tiny, run, no_simulation, tmp_path):
    arguments = ("--output", tmp_path / "new", "--parent", tiny, *arguments)
    assert words in said(run("train", task, *arguments))
    assert not (tmp_path / "new").exists()


def test_a_cohort_learns_together(tmp_path):
    """Worlds of a patient are alike, those of a weaker one are not."""
    (tmp_path / "patients.csv").write_text("patient,strength\nwell,1.0\nweak,0.3\n")
    options = {"num_worlds": 4, "rollout_steps": 8, "minibatches": 2, "device": "cpu"}
    job = plan(ELBOW, output=tmp_path / "x", cohort=str(tmp_path / "patients.csv"), **options)
    env = start(job).env
    env.reset(seed=[3] * 4)
    for _ in range(10):
        env.step(np.ones((4, 6), np.float32))
    well, same, weak, alike = env.get_state().arrays["data.qpos"][:, 0]
    assert (well, weak) == (same, alike)
    assert abs(well - weak) > 1e-3


@pytest.mark.slow
def test_episodes_start_in_a_state(tmp_path, run):
    """Worlds take the states in turn, and again after every episode; a resumed run goes on alike."""
    env = MyoWarpVectorEnv(ELBOW, 3, device="cpu", progress=False)
    env.reset(seed=0)
    for _ in range(98):  # two steps from the end of the episode
        env.step(np.zeros((3, 6), np.float32))
    state = env.get_state([2, 1])
    state.save(tmp_path / "state.npz")
    given = (*TINY, "--start", tmp_path / "state.npz")
    for name, samples in (("whole", 192), ("halves", 64)):
        status, _, err = run("train", ELBOW, "--output", tmp_path / name, *given, "--samples", samples)
        assert status == 0, err
    status, _, err = run("train", "--resume", tmp_path / "halves", "--samples", 192)
    assert status == 0, err
    whole, halves = (checkpoints.load_checkpoint(tmp_path / name) for name in ("whole", "halves"))
    assert all(np.array_equal(halves.policy[name], array) for name, array in whole.policy.items())
    arrays = whole.state()
    np.testing.assert_array_equal(arrays["world.data.qpos"], state.arrays["data.qpos"][[0, 1] * 4])
    assert arrays["tally.episodes"] == 8 * 24 / 2
    (tmp_path / "state.npz").unlink()
    env.get_state([0, 1]).save(tmp_path / "state.npz")
    assert said(run("train", "--resume", tmp_path / "halves", "--samples", 256)) == (
        f"--start {str(tmp_path / 'state.npz')!r} has changed since the run began"
    )


@pytest.mark.parametrize(
    ("option", "sentence"),
    [
        (("--cohort", "three.csv"), "--num-worlds must be a multiple of the 3 patients of --cohort, got 8"),
        (("--cohort", "three.csv", "--conditions", "sarcopenia"), "--num-worlds must be a multiple"),
        (("--cohort", "none.csv"), "cohort table 'none.csv' does not exist"),
        (("--start", "none.npz"), "--start 'none.npz' does not exist"),
        (("--start", "other.npz"), f"--start 'other.npz' holds states of {OTHER!r}, not of {ELBOW!r}"),
        (("--start", "over.npz"), "--start 'over.npz' holds episodes that have ended; save others"),
    ],
)
def test_files_of_a_run_are_checked_first(option, sentence, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "three.csv").write_text("strength\n1.0\n0.5\n0.2\n")
    State(OTHER, {"episode.ended": np.zeros(1, bool)}).save("other.npz")
    State(ELBOW, {"episode.ended": np.ones(1, bool)}).save("over.npz")
    assert said(run("train", ELBOW, "--output", "new", *TINY, *option)).startswith(sentence)
    assert not (tmp_path / "new").exists()


def test_a_policy_cannot_act_in_another_body(tiny, run, no_simulation):
    assert said(run("rollout", "myoHandReachFixed-v0", "--policy", tiny)) == (
        f"policy {str(tiny)!r} was trained in {ELBOW!r} (pose with elbow) and cannot act in "
        "'myoHandReachFixed-v0' (reach with hand)"
    )
    assert "cannot act" in said(run("rollout", "myoFingerPoseFixed-v0", "--policy", tiny))


def test_a_policy_cannot_act_with_another_contract(tiny, run):
    folder = str(checkpoints.find_folder(tiny))
    other = "myoElbowPose1D6MExoRandom-v0"
    assert said(run("eval", tiny, "--task", other, "--episodes", 2, "--device", "cpu")) == (
        f"checkpoint {folder!r} was trained in {ELBOW!r} and cannot act in {other!r}: "
        "body is 'elbow' there and 'elbow_exo' here"
    )


def test_other_muscles_are_said(tiny, caplog):
    """The checkpoint names its muscle model; the policy acts, and one sentence says on what."""
    whole = checkpoints.load_checkpoint(tiny)
    assert whole.manifest["settings"]["muscle"] == "mujoco"
    for muscle, sentences in (("mujoco", 0), ("thelen2003_rigid", 1)):
        env = MyoWarpVectorEnv(ELBOW, 1, device="cpu", muscle=muscle, progress=False)
        for _ in range(2):
            checkpoints.check_contract(whole, env.sim)
        assert caplog.text.count("was trained with mujoco muscles and acts on thelen2003_rigid") == sentences


def test_contracts_differ_in_columns(tiny):
    """A condition that shows its state appends columns."""
    whole = checkpoints.load_checkpoint(tiny)
    shown = Fatigue3CCR(observe=True)
    env = MyoWarpVectorEnv(ELBOW, 1, device="cpu", conditions=shown)
    with pytest.raises(checkpoints.CheckpointError, match="columns have 4 entries there and 5 here"):
        checkpoints.check_contract(whole, env.sim)


def test_a_run_does_not_go_on_with_another_reward(tiny, run, tmp_path):
    whole = checkpoints.load_checkpoint(tiny)
    manifest = json.loads(json.dumps({k: v for k, v in whole.manifest.items() if k != "files"}))
    manifest["contract"]["reward"][0][1] = 2.5
    checkpoints.save_checkpoint(tmp_path, 128, manifest, whole.policy, whole.state())
    sentence = said(run("train", "--resume", tmp_path))
    assert f"cannot learn in {ELBOW!r}: reward have ['pose', 2.5] there and ['pose', 1.0] here" in sentence


@pytest.mark.parametrize("call", range(1, 7))
def test_a_full_disk_keeps_the_checkpoint_before(call, tiny, tmp_path, monkeypatch):
    """Whatever write or flush of a save fails, what was there is still there, whole and alone."""
    whole = checkpoints.load_checkpoint(tiny)
    arrays, manifest = whole.policy, {k: v for k, v in whole.manifest.items() if k != "files"}
    checkpoints.save_checkpoint(tmp_path, 1, manifest, arrays, arrays)
    calls, fsync = [], os.fsync

    def full(handle):
        calls.append(handle)
        if len(calls) == call:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(handle)

    monkeypatch.setattr(os, "fsync", full)
    try:
        checkpoints.save_checkpoint(tmp_path, 2, manifest, arrays, arrays)
        assert call == 6  # there are five
    except OSError:
        pass
    monkeypatch.undo()
    folder = checkpoints.find_folder(tmp_path)
    assert int(folder.name) == (1 if call <= 4 else 2)
    assert set(checkpoints.load_checkpoint(tmp_path).state()) == set(arrays)


@pytest.mark.parametrize("seconds", [0.0, 1e-4])
def test_saving_takes_little_of_a_run(seconds, tmp_path, monkeypatch):
    """After a checkpoint that takes long, such as one with a replay, it waits; 0 means every iteration."""
    save, at = checkpoints.save_checkpoint, []

    def slow(folder, samples, *content):
        at.append(samples)
        time.sleep(0.2)
        return save(folder, samples, *content)

    monkeypatch.setattr(checkpoints, "save_checkpoint", slow)
    small = {"num_worlds": 8, "rollout_steps": 8, "minibatches": 2, "hidden": (16,), "samples": 6 * 64}
    train(plan(ELBOW, output=tmp_path / "run", device="cpu", selections=0, save_seconds=seconds, **small))
    assert at[0] == 0
    assert at[-1] == 6 * 64
    assert len(set(at)) == 7 if seconds == 0.0 else len(at) <= 3  # at the begin, once, at the end


def test_a_full_disk_ends_the_run_with_one_sentence(run, tmp_path, monkeypatch):
    save, calls = checkpoints.save_checkpoint, []

    def full(*arguments, **options):
        calls.append(arguments)
        if len(calls) == 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return save(*arguments, **options)

    monkeypatch.setattr(checkpoints, "save_checkpoint", full)
    folder = tmp_path / "full"
    sentence = said(run("train", ELBOW, "--output", folder, *TINY, "--save-seconds", 0))
    assert sentence.startswith("checkpoint after 64 samples could not be written (No space left on device)")
    assert checkpoints.load_checkpoint(folder).manifest["samples"] == 0


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no such limit")
def test_files_that_may_not_grow_end_the_run_with_one_sentence(run, tmp_path):
    import resource

    folder, before = tmp_path / "run", resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, before[1]))
    try:
        result = run("train", ELBOW, "--output", folder, *TINY, "--stop-success", 2)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "Traceback" not in result[2]
    assert said(result) == (
        f"figures could not be written (File too large); the last checkpoint is in {folder}, go on with "
        f"myowarp train --resume {folder}"
    )
    status, _, err = run("train", "--resume", folder, "--samples", 128)
    assert status == 0, err
    assert len((folder / "progress.csv").read_text().splitlines()) == 3


def test_tensorboard_reads_the_events(tiny):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(tiny)).Reload()
    with (tiny / "progress.csv").open() as file:
        rows = list(csv.DictReader(file))
    scalars = events.Scalars("action_std")
    assert [scalar.step for scalar in scalars] == [int(row["samples"]) for row in rows] == [64, 128]
    np.testing.assert_allclose([s.value for s in scalars], [float(r["action_std"]) for r in rows], rtol=1e-6)


@pytest.mark.parametrize(
    ("folder", "words"),
    [
        ("/proc/x", "output '/proc/x' cannot be "),  # made, or written by who is not root
        ("a" * 300, f"output {'a' * 300!r} cannot be written; it must be a folder"),
    ],
)
def test_a_folder_that_cannot_be_made_is_refused_first(folder, words, run, no_simulation):
    assert said(run("train", ELBOW, "--output", folder)).startswith(words)


def test_ctrl_c_leaves_a_checkpoint_and_a_report(run, tmp_path, monkeypatch):
    from myowarp.apps.train.loop import Run

    iterate = Run.iterate

    def interrupted(self):
        if self.updates == 2:
            os.kill(os.getpid(), signal.SIGINT)
        iterate(self)

    monkeypatch.setattr(Run, "iterate", interrupted)
    before = signal.getsignal(signal.SIGINT)  # ignored, where the tests run in the background
    status, _, err = run("train", ELBOW, "--output", tmp_path / "run", *TINY)
    assert status == 0, err
    assert "stopped by a signal" in err
    assert json.loads((tmp_path / "run" / "report.json").read_text())["updates"] == 3
    assert checkpoints.load_checkpoint(tmp_path / "run").manifest["samples"] == 3 * 64
    assert signal.getsignal(signal.SIGINT) is before


def test_a_run_goes_on_under_parity_physics(run, tmp_path, monkeypatch):
    """After the turn its worlds do what parity physics alone does with their states and actions."""
    from myowarp.apps.train.loop import Run

    moved, steps, move, step = [], [], Run.move, MyoWarpVectorEnv.step

    def noted_move(self, env):
        moved.append((self.samples, len(steps), self.env.get_state()))
        move(self, env)

    def noted_step(self, actions):
        result = step(self, actions)
        steps.append((actions.numpy().copy(), result[0].numpy().copy()))
        return result

    with monkeypatch.context() as patched:
        patched.setattr(Run, "move", noted_move)
        patched.setattr(MyoWarpVectorEnv, "step", noted_step)
        turned = (*TINY, "--samples", 256, "--physics", "fast", "--parity-after", 100)
        status, _, err = run("train", ELBOW, "--output", tmp_path / "run", *turned)
    assert status == 0, err
    assert "from 128 samples on under parity physics" in err
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert (report["physics"], report["parity_after"]) == ("fast", 100)
    ((samples, at, state),) = moved
    assert samples == 128
    for physics in ("parity", "fast"):
        setup = Setup(task=ELBOW, physics=physics, device="cpu")
        env = MyoWarpVectorEnv(setup, 8, autoreset_mode="disabled", progress=False)
        env.reset(seed=0)
        env.set_state(state)
        apart = max(np.abs(env.step(actions)[0] - obs).max() for actions, obs in steps[at:])
        env.close()
        assert apart == 0.0 if physics == "parity" else apart > 1e-2, physics


OWN_TASK = """
import myowarp
thrifty = myowarp.extend("myoElbowPose1D6MRandom-v0", "thriftyTrain-v0", rewards={"act_reg": 5.0})
"""


def test_printed_commands_work_for_a_task_from_a_file(run, tmp_path, monkeypatch):
    from myowarp.apps.train.loop import Run

    monkeypatch.chdir(tmp_path)
    (tmp_path / "my tasks.py").write_text(OWN_TASK)
    iterate = Run.iterate

    def interrupted(self):
        os.kill(os.getpid(), signal.SIGINT)
        iterate(self)

    def printed(text, start):
        (line,) = [line for line in text.splitlines() if line.startswith(start)]
        return line.removeprefix(start)

    with monkeypatch.context() as patched:
        patched.setattr(Run, "iterate", interrupted)
        options = ("--output", "runs/thrifty", *TINY, "--samples", 128)
        status, _, err = run("train", "my tasks.py:thrifty", *options)
    assert status == 0, err
    again = printed(err, "Go on: ")
    assert again == "myowarp train 'my tasks.py:thrifty' --resume runs/thrifty"
    judge = printed(err, "Evaluate: ")
    assert judge == "myowarp eval runs/thrifty --task 'my tasks.py:thrifty'"
    assert said(run("train", "--resume", "runs/thrifty")).endswith(f"go on with {again}")
    assert said(run("eval", "runs/thrifty")).endswith(f"try {judge}")
    assert "is not empty" in (sentence := said(run("train", "my tasks.py:thrifty", *options)))
    assert sentence.endswith(again)
    status, _, err = run(*shlex.split(again)[1:])
    assert status == 0, err
    assert json.loads((tmp_path / "runs" / "thrifty" / "report.json").read_text())["samples"] == 128
    status, out, err = run(*shlex.split(judge)[1:], "--episodes", 4, "--device", "cpu")
    assert status == 0, err
    assert "thriftyTrain-v0" in out


def test_printed_commands_name_model_and_ranks():
    assert eval_command(Setup(task=Path("a b.xml")), "runs/x") == "myowarp eval runs/x --model 'a b.xml'"
    assert (
        resume_command(Setup(task=Path("a.xml")), "runs/x", 1)
        == "myowarp train --model a.xml --resume runs/x"
    )
    ranks = "torchrun --nproc-per-node 2 -m myowarp train --resume runs/x"
    assert resume_command(Setup(task=ELBOW), "runs/x", 2) == ranks


def test_a_diverged_run_keeps_the_last_good_checkpoint(run, tmp_path, monkeypatch):
    from myowarp.apps.train.loop import Run

    iterate = Run.iterate

    def broken(self):
        if self.updates == 2:
            with __import__("torch").no_grad():
                next(self.learner.value.parameters())[0, 0] = float("nan")
        iterate(self)

    monkeypatch.setattr(Run, "iterate", broken)
    folder = tmp_path / "run"
    sentence = said(run("train", ELBOW, "--output", folder, *TINY, "--save-seconds", 0))
    assert sentence == (
        f"value loss was not finite in update 3; the last good checkpoint is in {folder}, try a lower "
        "--learning-rate"
    )
    assert checkpoints.load_checkpoint(folder).manifest["samples"] == 2 * 64


FAULTY_TASK = """
import myowarp
import warp as wp

@wp.func
def root(qpos: wp.array[float]) -> float:
    return wp.sqrt({inside})

rooted = myowarp.extend("myoElbowPose1D6MRandom-v0", "{name}-v0", rewards={{"root": (1.0, root)}})
"""


def test_a_fault_in_training_names_term_and_task(run, tmp_path):
    (tmp_path / "task.py").write_text(FAULTY_TASK.format(inside="1.5 - qpos[0]", name="rootSometimes"))
    task = f"{tmp_path / 'task.py'}:rooted"
    status, _, err = run("train", task, "--output", tmp_path / "run", *TINY, "--samples", 8 * 160)
    assert status == 0, err
    sentence = f"worlds of {task} ended by a fault, with reward 0: reward not finite: term 'root'"
    assert err.count(sentence) == err.count("a fault") == 1


def test_a_task_whose_worlds_all_have_faults_ends_the_training(run, tmp_path):
    (tmp_path / "task.py").write_text(FAULTY_TASK.format(inside="-1.0", name="rootNever"))
    task = f"{tmp_path / 'task.py'}:rooted"
    sentence = said(run("train", task, "--output", tmp_path / "run", *TINY))
    assert sentence == (
        "every world of 'rootNever-v0' had a fault in each of 50 control steps (reward not finite: term "
        "'root'); nothing can be learned before the task is mended"
    )


def test_settings_are_all_in_the_manifest(tiny):
    recorded = checkpoints.load_checkpoint(tiny).manifest["settings"]
    assert recorded.keys() == Setup().plain().keys() | {f.name for f in dataclasses.fields(ALGORITHMS["ppo"])}
    assert recorded["num_worlds"] == 8


@pytest.mark.parametrize(
    ("package", "arguments", "sentence"),
    [
        ("tensorboard", (), f"training needs tensorboard; run {to_install('train')}"),
        ("wandb", ("--wandb",), "--wandb needs wandb, which is not installed; run `pip install wandb`"),
    ],
)
def test_a_missing_package_is_named(package, arguments, sentence, run, no_simulation, tmp_path, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == package else find(name))
    assert said(run("train", ELBOW, "--output", tmp_path / "new", *arguments)) == sentence


def test_a_preset_chooses_the_algorithm(run, no_simulation, tmp_path):
    task = next(name.removesuffix(".toml") for name in PRESETS if preset_algorithm(name[:-5]) == "sac")
    options = ("--output", tmp_path / "new", "--num-worlds", 48)
    assert said(run("train", f"{task}-v0", *options)).startswith(
        "--replay must be a multiple of the 48 worlds"
    )
    sentence = "sac has no setting --epochs; it belongs to ppo and trpo"
    assert said(run("train", f"{task}-v0", *options, "--epochs", 4)) == sentence
    assert said(run("train", f"{task}-v0", *options, "--algorithm", "ppo", "--epochs", 0)).startswith(
        "--epochs"
    )

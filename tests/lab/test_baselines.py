"""Baselines: every one acts, two still reach their table, and what is missing or damaged is refused."""

import dataclasses
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tiny_runs import said

from benchmarks.baselines import DOCS, MOST_BYTES, add, page
from myowarp.apps.policies import baselines
from myowarp.apps.policies import checkpoint as checkpoints
from myowarp.apps.policies.checkpoint import check_contract
from myowarp.apps.policies.learned import LearnedPolicy, read_policy
from myowarp.apps.reports.evaluation import evaluate_policy, plan_evaluation
from myowarp.apps.train import selection
from myowarp.apps.train.plan import plan
from myowarp.apps.train.run import STOPPED, train
from myowarp.apps.train.settings import ALGORITHMS, TRAINING, divided, preset, restore
from myowarp.definitions.task import TASKS
from myowarp.process import warn_once
from myowarp.sim.simulation import Simulation

NAMES = baselines.baseline_tasks()
REACHED = ("myoElbowPose1D6MRandom-v0", "myoFingerReachFixed-v0")
"""Baselines that are evaluated here; the quickest."""


@pytest.fixture
def copies(tmp_path, monkeypatch):
    """Work on a copy of a baseline, which may be damaged; return its folder."""
    shutil.copytree(baselines.FOLDER / REACHED[0], tmp_path / REACHED[0])
    monkeypatch.setattr(baselines, "FOLDER", tmp_path)
    return tmp_path / REACHED[0]


def test_there_are_baselines():
    assert set(REACHED) <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_baseline_is_whole_small_and_what_its_table_is_about(name):
    baseline = baselines.load_baseline(name)
    manifest, first = baseline.checkpoint.manifest, baseline.runs[0]
    assert manifest["contract"]["task"] == name == TASKS[name].key
    # A run goes on after its best policy.
    assert manifest["samples"] == first["evaluation"]["samples"] <= first["training"]["samples"]
    assert manifest["settings"]["seed"] == first["training"]["seed"]
    corrected = name.replace("-v0", "-v1")
    for run in baseline.runs:
        kinds = {"evaluation": name} | ({"corrected": corrected} if corrected in set(TASKS) - {name} else {})
        assert set(run) == {"training", *kinds}
        for kind, task in kinds.items():
            assert run[kind]["task"] == TASKS[task].env_id
            assert run[kind]["physics"] == "parity"
            assert all(run[kind][mode]["episodes"] >= 256 for mode in ("deterministic", "sampled"))
    assert sum(file.stat().st_size for file in baseline.checkpoint.folder.iterdir()) < MOST_BYTES
    act = LearnedPolicy(baseline.checkpoint)
    obs = np.zeros((2, sum(size for _, size, _ in manifest["contract"]["columns"])))
    assert act(obs).shape == (2, len(manifest["contract"]["actuators"]))


@pytest.mark.parametrize("name", NAMES)
def test_train_remakes_a_baseline_by_its_preset(name):
    """The settings of the run are those of `myowarp train`, apart from when it stops and where it runs."""
    manifest = baselines.load_baseline(name).checkpoint.manifest
    if manifest.get("learner") != checkpoints.LEARNER:
        pytest.skip("it is of the trainer before this one, whose settings were others")
    kind = ALGORITHMS[manifest["algorithm"]]
    wanted, found = (
        divided(values) for values in (preset(TASKS[name].name, manifest["algorithm"]), manifest["settings"])
    )
    now, then = (vars(restore(kind, settings)) for _, settings in (wanted, found))
    now |= dataclasses.replace(wanted[0].over(TRAINING), device="cpu", seed=found[0].seed).plain()
    then |= dataclasses.replace(found[0], device="cpu").plain()
    ends = ("samples", "stop_success", "stop_rule", "precision")
    assert not [key for key, value in then.items() if value != now[key] and key not in ends]


@pytest.mark.parametrize("name", REACHED)
def test_a_baseline_reaches_its_table(name):
    evaluation = baselines.load_baseline(name).runs[0]["evaluation"]
    folder = Path(f"{baselines.PREFIX}{name}")
    head, figures = evaluate_policy(plan_evaluation(folder, seed=evaluation["seed"], device="cpu"))
    assert head["physics"] == "parity"
    assert {mode: entry["episodes"] for mode, entry in figures.items()} == {
        "deterministic": 256,
        "sampled": 256,
    }
    assert not baselines.shortfall(figures, evaluation)


def test_a_policy_that_forgot_does_not_reach_it(copies):
    whole = checkpoints.load_checkpoint(copies)
    policy = {k: v if "mean" in k or "variance" in k else np.zeros_like(v) for k, v in whole.policy.items()}
    checkpoints.save_policy(copies, checkpoints.Checkpoint(copies, whole.manifest, policy))
    evaluation = baselines.load_baseline(copies.name).runs[0]["evaluation"]
    options = {"mode": "deterministic", "seed": evaluation["seed"], "device": "cpu"}
    _, figures = evaluate_policy(plan_evaluation(copies, **options))
    assert "% deterministic, at least 98.5 % are needed" in baselines.shortfall(figures, evaluation)


def test_shortfall_looks_at_the_lower_end_of_the_interval():
    table = {"sampled": {"intervals": {"success_myosuite": (0.9, 0.97)}}}
    assert baselines.shortfall({"sampled": {"success_myosuite": 0.9}}, table) == ""
    assert baselines.shortfall({"sampled": {"success_myosuite": 0.896}}, table) == (
        "89.6 % sampled, at least 90.0 % are needed"
    )


def test_a_baseline_acts_wherever_a_policy_is_taken(run, tmp_path):
    elbow = REACHED[0]
    options = ("--num-worlds", 32, "--device", "cpu", "--json")
    figures = [
        json.loads(run("rollout", elbow, "--policy", name, *options)[1])
        for name in ("baseline", f"baselines/{elbow}", baselines.FOLDER / elbow)
    ]
    assert figures[0]["success_percent"] > 90.0
    assert len({entry["return_mean"] for entry in figures}) == 1
    (tmp_path / "patients.csv").write_text("patient,strength\nwell,1.0\nweak,0.4\n")
    status, _, err = run(
        *("cohort", tmp_path / "patients.csv", "--task", elbow, "--policy", "baseline", "--device", "cpu"),
        *("--output", tmp_path / "out", "--format", "csv"),
    )
    assert status == 0, err


@pytest.mark.slow
def test_a_run_becomes_a_baseline(run, tmp_path, monkeypatch):
    """Its policy, figures and curve; a second seed is a row more, the first seed again takes its place.

    The policy that it started from, which it replaces, goes with it.
    """
    monkeypatch.setattr(baselines, "FOLDER", tmp_path / "baselines")
    monkeypatch.setattr(selection, "EPISODES", 8)
    for name, seed, steps, parent in (("a", 1, 64, ()), ("b", 3, 128, ()), ("c", 1, 192, (tmp_path / "a",))):
        options = (
            "--num-worlds",
            8,
            "--rollout-steps",
            8,
            "--minibatches",
            2,
            "--hidden",
            16,
            "--samples",
            steps,
            "--selections",
            1,
        )
        options += ("--device", "cpu", "--seed", seed, "--output", tmp_path / name)
        options += tuple(part for folder in parent for part in ("--parent", folder))
        assert run("train", REACHED[0], *options)[0] == 0
        add(tmp_path / name)
    baseline = baselines.load_baseline(REACHED[0])
    assert [(r["training"]["seed"], r["training"]["samples"]) for r in baseline.runs] == [(1, 192), (3, 128)]
    policy = checkpoints.load_checkpoint(tmp_path / "c").policy
    assert all(np.array_equal(policy[key], array) for key, array in baseline.checkpoint.policy.items())
    assert baseline.checkpoint.manifest["learner"] == checkpoints.LEARNER
    assert baseline.checkpoint.manifest["settings"]["parent"] == f"baselines/{REACHED[0]}/parent"
    shipped = checkpoints.load_checkpoint(baselines.policy_folder(f"baselines/{REACHED[0]}/parent", None))
    first = checkpoints.load_checkpoint(tmp_path / "a").policy
    assert all(np.array_equal(first[key], array) for key, array in shipped.policy.items())
    _, figures = evaluate_policy(plan_evaluation(tmp_path / "c", device="cpu"))
    evaluated = baseline.runs[0]["evaluation"]
    assert evaluated["sampled"]["return_mean"] == figures["sampled"]["return_mean"]
    assert str(tmp_path) not in (baseline.checkpoint.folder / "result.json").read_text()
    assert (baseline.checkpoint.folder / "curve.csv").read_text().startswith("samples,return,success,")


@pytest.mark.parametrize("name", ["myoHandReachRandom-v1", "myoHandReachFixed-v1"])
def test_a_version_without_a_baseline_takes_that_of_another(name, run, caplog, tmp_path):
    other = name.replace("-v1", "-v0")
    sentence = f"task {name!r} has no baseline; that of another version acts, baselines/{other}"
    options = ("--device", "cpu", "--json")
    returns = []
    for policy in ("baseline", f"baselines/{other}"):
        warn_once.cache_clear()
        caplog.clear()
        status, out, err = run(
            "rollout", name, "--policy", policy, "--num-worlds", 4, "--steps", 100, *options
        )
        assert status == 0, err
        returns.append(json.loads(out)["return_mean"])
        assert [record.getMessage() for record in caplog.records] == [sentence] * (policy == "baseline")
    assert returns[0] == returns[1]
    warn_once.cache_clear()
    status, out, err = run("eval", "baseline", "--task", name, "--episodes", 4, *options)
    assert status == 0, err
    assert json.loads(out)["checkpoint"].endswith(other)
    assert sentence in caplog.text


@pytest.mark.slow  # a simulation of every task that has a baseline
def test_all_versions_share_the_contract():
    """Whoever takes the baseline of another version can act with it."""
    for name in NAMES:
        for task in (task for task in TASKS if task.rpartition("-")[0] == name.rpartition("-")[0]):
            taken = baselines.policy_folder("baseline", task).name
            assert taken == task if task in NAMES else taken.rpartition("-")[0] == name.rpartition("-")[0]
            sim = Simulation(TASKS[task], 1, device="cpu", graph=False, progress=False)
            check_contract(baselines.load_baseline(name).checkpoint, sim)


def test_the_demo_shows_a_baseline():
    makefile = (DOCS.parent / "Makefile").read_text()
    task, policy = re.search(r"rollout MyoWarp/(\S+) .*--policy (\S+).* --video", makefile).groups()
    assert read_policy(policy, baselines.policy_folder(policy, task), TASKS[task]).task in NAMES


def test_list_prints_what_is_committed(run):
    status, out, _ = run("baselines", "list", "--json")
    assert status == 0
    listed = json.loads(out)
    assert list(listed) == NAMES
    status, out, _ = run("baselines", "list", REACHED[0])
    assert status == 0
    training = listed[REACHED[0]]["runs"][0]["training"]
    assert f"{training['samples'] / 1e6:.2f}" in out


def test_list_sets_strict_success_beside_the_papers(run, monkeypatch):
    """Legs that fall succeed by the paper's rule; equal episodes are one; corrected tasks are named so."""
    monkeypatch.setenv("COLUMNS", "200")
    _, out, _ = run("baselines", "list")
    rows = [re.split(r"\s{2,}", line.strip()) for line in out.splitlines()]
    cells = {name: row for name, *row in rows if row}
    stand = baselines.load_baseline("myoLegStandRandom-v0").runs[0]["evaluation"]["deterministic"]
    strict, paper = (float(cells["myoLegStandRandom-v0"][k]) for k in (1, 2))
    assert strict == pytest.approx(100 * (1 - stand["failed"] / stand["episodes"]), abs=3.0)
    assert paper > 80.0
    assert cells["myoHandReachFixed-v0"][1] == "1 of 1"
    assert {name.partition(" ")[0] for name in cells if name.endswith(" *")} == {
        name for name in NAMES if name.endswith("-v1")
    }
    assert {name.partition(" ")[0] for name, row in cells.items() if row[-1] == "yes"} == {
        name for name in NAMES if baselines.load_baseline(name).is_todays
    }
    monkeypatch.setenv("COLUMNS", "80")
    table = run("baselines", "list")[1].partition("strict: ")[0]
    assert "…" not in table
    assert max(map(len, table.splitlines())) <= 80


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Make the elbow's baseline by this trainer; return the folder of all baselines."""
    folder = tmp_path_factory.mktemp("made")
    train(plan(REACHED[0], output=folder / "run", device="cpu", stop_success=0.5))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(baselines, "FOLDER", folder / "baselines")
        add(folder / "run")
    return folder / "baselines"


@pytest.mark.slow
def test_run_remakes_a_baseline_and_compares(made, run, tmp_path, monkeypatch):
    """Bit for bit, on the processor that made it: it stops by itself after as many samples."""
    monkeypatch.setattr(baselines, "FOLDER", made)
    status, out, err = run(
        "baselines", "run", REACHED[0], "--output", tmp_path / "run", "--device", "cpu", "--json"
    )
    assert status == 0, err
    remade, baseline = json.loads(out), baselines.load_baseline(REACHED[0])
    assert not baselines.shortfall(remade["remade"], baseline.runs[0]["evaluation"])
    manifest = checkpoints.load_checkpoint(tmp_path / "run").manifest
    assert manifest["algorithm"] == "ppo"
    assert remade["same_policy"]
    assert manifest["samples"] == baseline.checkpoint.manifest["samples"] < manifest["settings"]["samples"]


def test_a_baseline_has_the_settings_of_its_run(made, monkeypatch):
    """A run that ended by itself has all samples, for its rates; one that was stopped has as many."""
    monkeypatch.setattr(baselines, "FOLDER", made)
    baseline = baselines.load_baseline(REACHED[0])
    (first,) = baseline.runs
    assert baseline.settings()["samples"] == baseline.checkpoint.manifest["settings"]["samples"]
    assert baseline.settings(seed=7) == baseline.settings() | {"seed": 7}
    stopped = first | {"training": first["training"] | {"ended": STOPPED}}
    other = dataclasses.replace(baseline, runs=[stopped])
    assert other.settings()["samples"] == first["training"]["samples"] < baseline.settings()["samples"]


@pytest.mark.slow
def test_run_says_when_a_baseline_is_not_reached(made, run, tmp_path, monkeypatch):
    copies = tmp_path / "baselines" / REACHED[0]
    shutil.copytree(made / REACHED[0], copies)
    monkeypatch.setattr(baselines, "FOLDER", copies.parent)
    result = json.loads((copies / "result.json").read_text())
    for mode in ("deterministic", "sampled"):
        result["runs"][0]["evaluation"][mode]["intervals"]["success_myosuite"][0] = 1.001
    (copies / "result.json").write_text(json.dumps(result))
    words = said(run("baselines", "run", copies.name, "--output", tmp_path / "run", "--device", "cpu"))
    assert words.startswith(f"baseline {copies.name!r} was not reached: ")
    assert "at least 100.1 % are needed" in words


@pytest.mark.slow
def test_listing_and_playing_import_no_torch():
    code = f"""
import sys
sys.modules["torch"] = None
from myowarp.apps.cli.baselines import Baselines
from myowarp.apps.cli.rollout import Rollout
from myowarp.apps.cli.options import Said
from myowarp.definitions.setup import Setup
Baselines("list", Said(Setup()))()
Rollout(Said(Setup(task="{REACHED[0]}", device="cpu")), policy="baseline", num_worlds=2, steps=2)()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def flip(path):
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("damage", "file", "words"),
    [
        (flip, "policy.safetensors", "was changed: policy.safetensors does not have its checksum"),
        (Path.unlink, "policy.safetensors", "lacks policy.safetensors"),
        (flip, "manifest.json", "has no readable manifest.json"),
        (Path.unlink, "manifest.json", "holds no checkpoint"),
    ],
)
def test_a_damaged_baseline_is_refused(damage, file, words, copies, run, no_simulation):
    damage(copies / file)
    name = copies.name
    for arguments in (
        ("rollout", name, "--policy", "baseline"),
        ("eval", f"baselines/{name}"),
        ("baselines", "list"),
        ("baselines", "run", name),
    ):
        assert words in said(run(*arguments))


@pytest.mark.parametrize("damage", [flip, Path.unlink, lambda path: path.write_text('{"runs": [{}]}')])
def test_a_damaged_table_is_refused(damage, copies, run, no_simulation):
    damage(copies / "result.json")
    assert said(run("baselines", "list", copies.name)).startswith(
        f"baseline {copies.name!r} has no readable result.json ("
    )


def test_a_baseline_of_the_trainer_before_is_not_remade(copies, run, no_simulation):
    manifest = checkpoints.load_checkpoint(copies).manifest
    if manifest.get("learner") == checkpoints.LEARNER:
        entries = {name: entry for name, entry in manifest.items() if name not in ("learner", "files")}
        whole = checkpoints.Checkpoint(copies, entries, checkpoints.load_checkpoint(copies).policy)
        checkpoints.save_policy(copies, whole)
    assert said(run("baselines", "run", copies.name)) == (
        f"baseline {copies.name!r} is of the trainer before this one, whose settings were others; train a "
        f"policy with `myowarp train {copies.name}`"
    )


def test_what_is_not_there_is_said(copies, run, no_simulation):
    none = f"task 'myoHandPoseRandom-v1' has no baseline; available: {copies.name}"
    for arguments in (
        ("rollout", "myoHandPoseRandom-v1", "--policy", "baseline"),
        ("eval", "baselines/myoHandPoseRandom-v1"),
        ("baselines", "run", "myoHandPoseRandom-v1"),
        ("baselines", "list", "myoHandPoseRandom-v1"),
    ):
        assert said(run(*arguments)) == none
    other = copies.name.replace("-v0", "-v1")  # of which `baseline` alone is another name
    assert said(run("eval", f"baselines/{other}")) == (
        f"task {other!r} has no baseline; that of another version is baselines/{copies.name}"
    )
    assert said(run("baselines", "run")) == f"baselines run needs a task: {copies.name}"
    assert said(run("eval", "baseline")).startswith("policy 'baseline' needs a task")
    assert said(run("train", "--resume", copies)) == (
        f"checkpoint {str(copies)!r} holds a policy alone and cannot be resumed"
    )


def test_the_page_is_what_the_results_say():
    assert (DOCS / "baselines.md").read_text() == page()


def test_a_policy_of_another_observation_is_refused_before_kernels_compile(
    tmp_path, run, monkeypatch, registered
):
    """An observation that the task has on top is named; no simulation is built, which takes minutes."""

    def refuse(*rest, **options):
        pytest.fail("a simulation was built")

    monkeypatch.setattr(Simulation, "__init__", refuse)
    file, policy = tmp_path / "tasks.py", "baselines/myoElbowPose1D6MRandom-v0"
    file.write_text(
        "import myowarp\n\nseen = myowarp.extend('myoElbowPose1D6MRandom-v0', 'seenElbowPoseRandom-v0', "
        "observations={'pull': 'tension'})\n"
    )
    (tmp_path / "patients.csv").write_text("strength\n1.0\n")
    task = f"{file}:seen"
    cohort = "cohort", tmp_path / "patients.csv", "--output", tmp_path / "out"
    for arguments in (
        ("rollout", task, "--policy", policy),
        ("eval", policy, "--task", task),
        (*cohort, "--task", task, "--policy", policy),
    ):
        words = said(run(*arguments))
        assert "columns have 4 entries there and 5 here; only here: pull" in words

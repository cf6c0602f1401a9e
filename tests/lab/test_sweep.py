"""Studies over a cluster: every run once whatever dies, impossible ones refused before anything starts."""

import csv
import json
import os
import subprocess
import sys

import numpy as np
import pytest
import yaml
from clusters import PATIENCE, fill_store, kill_worker, replace_node, start, wait_until

from myowarp.apps.studies.sweep.report import measures, summary
from myowarp.apps.studies.sweep.study import read_study
from myowarp.apps.studies.sweep.work import RESULT, finished
from myowarp.extras import to_install

ELBOW = "myoElbowPose1D6MRandom-v0"
TINY = {"num_worlds": 8, "rollout_steps": 16, "minibatches": 2, "epochs": 1, "hidden": [16, 16]}
TRAIN = {"kind": "train", "tasks": [ELBOW], "episodes": 8}
EXO = {"kind": "reproduce", "tasks": ["exo1"]}
EVAL = {"kind": "eval", "tasks": [ELBOW], "policies": ["baseline"], "episodes": 8}


def study(path, **entries):
    """Write a study."""
    path.write_text(yaml.safe_dump(entries))
    return path


def train_study(path, seeds, iterations):
    """Write a study of trainings of so many iterations, two conditions with these seeds."""
    settings = TINY | {"samples": 8 * 16 * iterations, "stop_success": 2.0, "device": "cpu", "selections": 0}
    return study(path, **TRAIN, conditions=["none", "sarcopenia"], seeds=seeds, settings=settings)


def sweep(path, output, *options):
    """Start a sweep in a process of its own."""
    return start("sweep", path, "--output", output, *options)


def results(output):
    """Return the results that are there by run."""
    return {path.parent.name: path for path in output.glob(f"*/{RESULT}")}


@pytest.mark.scale
def test_every_run_of_a_study_ends_once_whatever_dies(cluster, tmp_path):
    path, output = train_study(tmp_path / "study.yaml", 12, 12), tmp_path / "out"
    address = cluster.address
    full = fill_store(cluster)
    first = sweep(path, output, "--address", address)
    wait_until(lambda: len(results(output)) >= 2 and kill_worker(cluster), first)
    wait_until(lambda: len(results(output)) >= 5, first)
    replace_node(cluster)
    wait_until(lambda: len(results(output)) >= 9, first)
    first.kill()  # the driver
    first.communicate()
    full.communicate()
    before = {name: (path.stat().st_ino, path.read_bytes()) for name, path in results(output).items()}
    assert 9 <= len(before) < 24
    second = sweep(path, output, "--address", address)
    said, _ = second.communicate(timeout=PATIENCE)
    assert second.returncode == 0, said
    after = {name: (path.stat().st_ino, path.read_bytes()) for name, path in results(output).items()}
    assert len(after) == 24
    assert before.items() <= after.items()  # what was done was not done again
    rows = list(csv.DictReader((output / "runs.csv").open()))
    assert len(rows) == len({row["run"] for row in rows}) == 24
    assert {float(row["samples [M]"]) for row in rows} == {8 * 16 * 12 / 1e6}
    assert {(row["conditions"], row["seed"]) for row in rows} == {
        (condition, str(seed)) for condition in ("none", "sarcopenia") for seed in range(12)
    }
    done = sweep(path, output, "--address", address)
    said, _ = done.communicate(timeout=PATIENCE)
    assert done.returncode == 0
    assert "24 runs, 24 done before" in said


@pytest.mark.scale
def test_two_nodes_do_a_study(tmp_path, cluster):
    """Nodes answer with their versions; runs write results; the table is that of the files."""
    path, output = study(tmp_path / "study.yaml", **EVAL, seeds=2), tmp_path / "out"
    process = sweep(path, output, "--address", cluster.address)
    said, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, said
    found = [json.loads(path.read_text()) for path in results(output).values()]
    values = [one["figures"]["deterministic"]["success"] for one in found]
    rows = {row["measure"]: row for row in csv.DictReader((output / "table.csv").open())}
    row = rows["success, deterministic [%]"]
    assert float(row["mean"]) == pytest.approx(100 * np.mean(values))
    assert row["n"] == "2"
    assert (output / "study.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"kind": "train"}, "tasks must be a list with at least one entry, got None"),
        ({"kind": "walk", "tasks": [ELBOW]}, "kind 'walk' unknown"),
        (TRAIN | {"task": [ELBOW]}, "key 'task' unknown"),
        (TRAIN | {"tasks": ["myoElbowPose-v9"]}, "myoElbowPose-v9"),
        (TRAIN | {"settings": {"samples": 10}}, "--samples must be at least one iteration"),
        (TRAIN | {"settings": {"algorithm": ["ppo", "sac"], "clip": 0.1}}, "sac has no setting --clip"),
        (TRAIN | {"settings": {"speed": 3}}, "setting 'speed' unknown"),
        (TRAIN | {"conditions": ["tired"]}, "tired"),
        (TRAIN | {"seeds": [0, 0]}, "runs of one name"),
        (TRAIN | {"seeds": -1}, "seeds must be a number of seeds or a list of integers >= 0, got -1"),
        (TRAIN | {"policies": ["baseline"]}, "train has no policies; leave it out"),
        (EVAL | {"policies": ["nowhere"]}, "nowhere"),
        (EVAL | {"conditions": ["tendon_transfer"]}, "tendon_transfer"),
        ({"kind": "reproduce", "tasks": ["exo9"]}, "exo9"),
        (TRAIN | {"settings": {"hidden": ["x"]}}, "--hidden must be integers, got 'x'"),
        (TRAIN | {"settings": {"hidden": [1.5]}}, "--hidden must be integers, got 1.5"),
        (TRAIN | {"settings": {"hidden": [True]}}, "--hidden must be integers, got True"),
        (
            TRAIN | {"settings": {"hidden": [10**9, 10**9]}},
            "--hidden must be from 1 to 16384, got 1000000000",
        ),
        (TRAIN | {"settings": {"samples": None}}, "setting 'samples' must have a value, got None"),
        (TRAIN | {"settings": {"threads": 10**6}}, "--threads must be from 1 to 1024, got 1000000"),
        (TRAIN | {"settings": {"device": "../x"}}, "device must be cpu, cuda or cuda:N, got '../x'"),
        (
            TRAIN | {"settings": {"learning_rate": "1e-4x"}},
            "--learning-rate must be of type float, got '1e-4x'",
        ),
        (TRAIN | {"settings": []}, "settings must have names and values, got []"),
        (
            TRAIN | {"seeds": [2**64]},
            "--seed must be at most 9223372036854775807, got 18446744073709551616",
        ),
        (TRAIN | {"seeds": 10**9}, "must have at most 10,000 runs, got 1,000,000,000; make several studies"),
        (TRAIN | {"seeds": 10**30}, "must have at most 10,000 runs"),
        (TRAIN | {"episodes": 10**20}, "--episodes must be at most 2147483647, got 100000000000000000000"),
        (EVAL | {"policies": [5]}, "'5' holds no checkpoint"),
        (EVAL | {"policies": [None]}, "'None' holds no checkpoint"),
        (EVAL | {"settings": {"mode": "x"}}, "mode 'x' unknown; available: both, deterministic, sampled"),
        (EVAL | {"settings": {"reset": 5}}, "reset 5 unknown; available: task, fixed, random, none"),
        (EVAL | {"settings": {"muscle": 5}}, "muscle model 5 unknown; available: "),
        (EVAL | {"settings": {"physics": [[["fast"]]]}}, "physics (['fast'],) unknown; available: "),
        (EVAL | {"settings": {"device": 5}}, "device must be cpu, cuda or cuda:N, got 5"),
        (EXO | {"settings": {"quick": 5}}, "quick must be True or False, got 5"),
        (EXO | {"settings": {"retrain": "x"}}, "retrain must be True or False, got 'x'"),
        (EXO | {"settings": {"seeds": 10**12}}, "--seeds must be at most 10000, got 1000000000000"),
        (EXO | {"settings": {"num_worlds": "x"}}, "--num-worlds must be an integer, got 'x'"),
    ],
)
def test_an_impossible_study_is_refused_before_anything_starts(entries, message, run, tmp_path):
    path = study(tmp_path / "study.yaml", **entries)
    status, _, err = run("sweep", path, "--output", tmp_path / "out")
    assert status == 2
    assert message in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_what_else_is_refused(run, tmp_path, monkeypatch):
    good = study(tmp_path / "study.yaml", **EVAL)
    for arguments, message in {
        (tmp_path / "none.yaml",): "does not exist",
        (tmp_path,): "Is a directory",
        (good, "--address", "127.0.0.1:9"): "has no Ray cluster",
        (good, "--address", "nonsense"): "has no Ray cluster",
        (good, "--cpus", 0): "--cpus must be at least 1, got 0",
    }.items():
        status, _, err = run("sweep", *arguments, "--output", tmp_path / "out")
        assert status == 2
        assert message in err
    for text, message in (
        ("kind: [train", "is no YAML file"),
        (200_001 * "#", "must have at most 200,000 characters, got 200,001; make several studies"),
        (20_000 * "[", "must be nested at most 10 deep"),
        ("kind: train\ntasks: " + 900 * "[" + 900 * "]", "must be nested at most 10 deep"),
        ("kind: train\ntasks: &a [*a]", "has an alias, *a; write out what it stands for"),
    ):
        (tmp_path / "study.yaml").write_text(text)
        status, _, err = run("sweep", good, "--output", tmp_path / "out")
        assert (status, message in err, err.count("\n")) == (2, True, 1)


def test_a_dry_run_counts_and_starts_nothing(run, tmp_path):
    path = study(tmp_path / "study.yaml", **TRAIN, conditions=["none", "sarcopenia"], seeds=3)
    status, out, _ = run("sweep", path, "--output", tmp_path / "out", "--dry-run")
    assert status == 0
    assert "6 runs: 0 done, 6 to do" in out
    assert "h one by one" in out
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_two_sweeps_in_one_folder(run, tmp_path):
    from myowarp.disk import locked

    path, output = study(tmp_path / "study.yaml", **EVAL), tmp_path / "out"
    output.mkdir()
    with locked(output / ".lock", wait=False):
        process = sweep(path, output)
        said, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2
    assert f"is in use by process {os.getpid()} on" in " ".join(said.split())


def test_a_finished_run_of_other_settings_is_kept(run, tmp_path):
    output = tmp_path / "out"
    (one,) = read_study(study(tmp_path / "a.yaml", **EVAL), output)
    folder = output / one.name
    folder.mkdir(parents=True)
    (folder / RESULT).write_text(json.dumps({"run": one.as_dict(), "seconds": 1.0, "figures": {}}))
    assert finished(one, output)["seconds"] == 1.0
    status, _, err = run(
        "sweep", study(tmp_path / "b.yaml", **EVAL | {"episodes": 9}), "--output", output, "--dry-run"
    )
    assert status == 2
    assert "was made with other settings (episodes is 8 there and 9 here)" in err


def test_intervals_are_students_over_seeds_and_wilsons_of_one(tmp_path):
    """Against SciPy's t and the closed form of Wilson's interval."""
    stats = pytest.importorskip("scipy.stats")
    runs = read_study(study(tmp_path / "a.yaml", **EVAL, seeds=3), tmp_path / "out")
    found = {}
    for run, share in zip(runs, (0.5, 0.75, 1.0), strict=True):
        figures = {"success": share, "intervals": {"success": (0.1, 0.9)}, "return_mean": share}
        found[run.name] = {"figures": {"sampled": figures}}
    rows = {row["measure"]: row for row in summary(runs, found)}
    low, high = stats.t.interval(0.95, 2, loc=75.0, scale=stats.sem([50.0, 75.0, 100.0]))
    row = rows["success, sampled [%]"]
    np.testing.assert_allclose((row["mean"], row["low"], row["high"]), (75.0, low, high), rtol=1e-4)
    (row, *_) = summary(runs[:1], found)
    assert (row["low"], row["high"], row["n"]) == (10.0, 90.0, 1)
    assert measures(found[runs[0].name])["return, sampled"][0] == 0.5
    found[runs[0].name]["figures"]["sampled"]["one_episode"] = True
    (row, *_) = summary(runs[:1], found)
    assert np.isnan((row["low"], row["high"])).all(), "all its episodes were the same"


@pytest.mark.slow
def test_without_ray_a_message_names_what_to_install(run, tmp_path, monkeypatch):
    find = __import__("importlib.util").util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "ray" else find(name))
    status, _, err = run("sweep", study(tmp_path / "a.yaml", **EVAL), "--output", tmp_path / "out")
    assert status == 2
    assert f"a sweep needs ray, which is not installed; run {to_install('ray')}" in err
    code = "import sys, myowarp.apps.cli.main; print({'ray', 'yaml', 'torch'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"

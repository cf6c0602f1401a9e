"""Killed at any moment and resumed, a run is the run that nothing disturbed, bit for bit on the CPU."""

import csv
import random
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from often import often

from myowarp.apps.policies.checkpoint import BEST, FOLDER, MANIFEST, find_folder, load_checkpoint

ELBOW = "myoElbowPose1D6MRandom-v0"
KEPT = ("--replay", 2048, "--batch-size", 64, "--gradient-steps", 1)
ALGORITHMS = {
    "ppo": (
        *("--minibatches", 2, "--epochs", 2, "--physics", "fast", "--parity-after", 8 * 16 * 35),
        *("--kl", 1e-3, "--noise", "repeated", "--start-share", 0.5, "--bonus", "solved=2"),
        *("--selections", 4),
    ),
    "memory": ("--minibatches", 2, "--epochs", 2, "--memory", 5),
    "trpo": ("--minibatches", 2, "--epochs", 2),
    "sac": (*KEPT, "--random-steps", 4, "--critic-width", 16, "--atoms", 21, "--start-share", 0.5),
    "dagger": (*KEPT, "--expert-steps", 16, "--physics", "fast", "--parity-after", 8 * 16 * 35),
    "improve": (*KEPT, "--expert", "hold", "--copies", 4),
}
KILLED = 8 * 16 * 30  # samples before the kill, five episodes a world
SAMPLES = 8 * 16 * 120  # of a run; more than it can have when it is killed
PATIENCE = 600.0  # s
TIMES = ("seconds", "samples_per_s", "share_simulation", "share_learner", "share_rest")


def arguments(algorithm):
    """Return the command of a small run with a checkpoint after every iteration."""
    sizes = ("--num-worlds", 8, "--rollout-steps", 16, "--hidden", 16, 16, "--samples", SAMPLES)
    places = ("--device", "cpu", "--save-seconds", 0, "--stop-success", 2, "--seed", 3)
    own = ("--selections", 0, *ALGORITHMS[algorithm])
    algorithm = "ppo" if algorithm == "memory" else algorithm
    return [str(a) for a in ("train", ELBOW, "--algorithm", algorithm, *sizes, *places, *own)]


@pytest.fixture(scope="module", params=often(ALGORITHMS, ("ppo",)))
def killed(request, tmp_path_factory):
    """Start a long run of each algorithm and kill it at a random moment; return its folder."""
    folder = tmp_path_factory.mktemp("killed") / request.param
    command = [sys.executable, "-m", "myowarp.apps.cli.main"]
    process = subprocess.Popen(
        [*command, *arguments(request.param), "--output", str(folder)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    begin = time.monotonic()
    while samples_of(folder) < KILLED:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() - begin < PATIENCE
        time.sleep(0.002)
    time.sleep(random.uniform(0.0, 0.1))
    process.send_signal(signal.SIGKILL)
    process.communicate()
    return folder


def samples_of(run):
    """Return the samples of the last checkpoint of a run, 0 while there is none."""
    try:
        return int(find_folder(run, learning=True).name)
    except (ValueError, OSError):
        return 0


def rows(run):
    with (run / "progress.csv").open() as file:
        return [{k: v for k, v in row.items() if k not in TIMES} for row in csv.DictReader(file)]


@pytest.mark.slow
def test_killed_and_resumed_is_undisturbed(killed, run, tmp_path):
    at = samples_of(killed)
    if "--start-share" in ALGORITHMS[killed.name]:
        assert load_checkpoint(killed, learning=True).state()["starts.counts"][1] > 0
    status, _, err = run("train", "--resume", killed, "--save-seconds", 0)
    assert status == 0, err
    undisturbed = tmp_path / "undisturbed"
    status, _, err = run(*arguments(killed.name), "--output", undisturbed)
    assert status == 0, err
    one, other = (load_checkpoint(folder, learning=True) for folder in (killed, undisturbed))
    assert one.manifest["samples"] == other.manifest["samples"] >= SAMPLES > at >= KILLED
    for before, after in ((one.policy, other.policy), (one.state(), other.state())):
        assert before.keys() == after.keys()
        for name, array in before.items():
            np.testing.assert_array_equal(array, after[name], err_msg=name)
    assert rows(killed) == rows(undisturbed)
    assert len(rows(killed)) == one.manifest["updates"] == other.manifest["updates"]
    assert one.manifest["selection"] == other.manifest["selection"]
    best = [load_checkpoint(folder) for folder in (killed, undisturbed)]
    assert best[0].folder.relative_to(killed) == best[1].folder.relative_to(undisturbed)
    assert best[0].manifest["files"] == best[1].manifest["files"]
    assert (best[0].folder.parent.name == BEST) == ("--selections" in ALGORITHMS[killed.name])


def test_a_kill_leaves_one_whole_checkpoint_and_nothing_that_is_taken_for_one(killed):
    assert load_checkpoint(killed, learning=True).state()
    assert 1 <= sum((folder / MANIFEST).is_file() for folder in (killed / FOLDER).iterdir()) <= 3

"""Training over ranks: the same worlds, the same weights, moments merged, what is refused, kills survived."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import rank_work

from myowarp.apps.policies.checkpoint import find_folder, load_checkpoint
from myowarp.apps.rollouts.ranks import Ranks
from myowarp.bridge_gym import MyoWarpVectorEnv

TORCHRUN = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node", "2"]
ELBOW, FINGER = "myoElbowPose1D6MRandom-v0", "myoFingerPoseRandom-v0"
PATIENCE = 240.0  # s
SAMPLES = 8 * 16 * 150  # of a run that is killed
ROUNDING = 1e-12  # of float64, over eighty samples


@pytest.fixture(scope="module", params=[pytest.param(2, marks=pytest.mark.scale)])
def ranks(tmp_path_factory):
    """Return what two gloo ranks have found."""
    folder = tmp_path_factory.mktemp("ranks")
    command = [*TORCHRUN, str(Path(rank_work.__file__)), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
    return [dict(np.load(folder / f"rank_{rank}.npz")) for rank in range(2)]


def test_two_ranks_see_what_one_sees_bit_for_bit(ranks):
    one, two = rank_work.moved(), np.concatenate([rank["moved"] for rank in ranks])
    assert len(np.unique(one, axis=0)) == len(one) == rank_work.ALL_WORLDS
    np.testing.assert_array_equal(two, one)


def test_moments_are_those_of_all_samples(ranks):
    for rank in ranks:
        for name, expected in zip(("mean", "variance", "count"), rank_work.alone(), strict=True):
            np.testing.assert_allclose(rank[name], expected, rtol=ROUNDING)


def test_ranks_act_differently_and_learn_the_same(ranks):
    one, other = ({k: a for k, a in rank.items() if k.startswith(("learned.", "average."))} for rank in ranks)
    own = {"learned.torch_generator", "learned.noise.noise", "learned.noise.left"}
    for name in one.keys() - own:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
    assert not np.isclose(*(rank["actions"] for rank in ranks)).any()
    samples = rank_work.ITERATIONS * 8 * 16
    np.testing.assert_array_equal(one["learned.normaliser.count"], 1 + samples)
    assert ranks[0]["figures"][-1] == 8  # episodes, of both


def test_a_checkpoint_has_the_noise_and_the_generator_of_every_rank(ranks):
    """Else a rank that goes on would act with the numbers of another one."""
    for name in ("noise.noise", "noise.left"):
        both = np.concatenate([rank[f"learned.{name}"] for rank in ranks])
        np.testing.assert_array_equal(ranks[0][f"saved.agent.{name}"], both)
    assert not np.isclose(*(rank["learned.noise.noise"] for rank in ranks)).any()
    both = np.concatenate([rank["learned.torch_generator"] for rank in ranks])
    np.testing.assert_array_equal(ranks[0]["saved.agent.torch_generator"], both)


def test_each_network_sends_one_message_a_minibatch(ranks):
    """With all its gradients; besides a divergence where the rate follows it, and moments of normalisers."""
    steps = rank_work.SETTINGS["epochs"] * rank_work.SETTINGS["minibatches"]
    for rank in ranks:
        assert rank["sums"] == rank_work.ITERATIONS * (2 * steps + 2)
        assert rank["sums with an aim"] == rank_work.ITERATIONS * (3 * steps + 2)


def test_no_thread_of_the_group_outlives_it(ranks):
    """Such a thread aborts the process at its end, once in twenty runs."""
    for rank in ranks:
        assert len(rank["threads"])
        assert not [name for name in rank["threads"] if "gloo" in name]


def test_start_states_and_seeds_go_on_through_ranks():
    one = MyoWarpVectorEnv(ELBOW, 4, device="cpu", progress=False)
    other = MyoWarpVectorEnv(ELBOW, 2, rank=(1, 2), device="cpu", progress=False)
    np.testing.assert_array_equal(other.reset(seed=3)[0], one.reset(seed=3)[0][2:])
    np.testing.assert_array_equal(other.reset(seed=[5, 6])[0], one.reset(seed=[0, 0, 5, 6])[0][2:])


@pytest.mark.parametrize(
    ("rank", "message"),
    [
        ((2, 2), r"rank \(r, R\) must have 0 <= r < R, got \(2, 2\)"),
        ((0, True), r"rank must be a pair of integers \(r, R\), got \(0, True\)"),
        (1, r"rank must be a pair of integers \(r, R\), got 1"),
    ],
)
def test_no_such_rank(rank, message):
    with pytest.raises(ValueError, match=message):
        MyoWarpVectorEnv(ELBOW, 2, rank=rank, device="cpu")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--num-worlds", 63), "--num-worlds must be a multiple of the 2 ranks, got 63"),
        (
            ("--num-worlds", 2, "--rollout-steps", 3, "--minibatches", 2),
            "--minibatches must divide the samples of a rank and iteration, 2 worlds / 2 ranks x 3 steps = 3",
        ),
        (("--algorithm", "trpo"), "training over 2 ranks is for ppo; start trpo without torchrun"),
        (("--start-share", 0.5), "--start-share is for one process, got 2 ranks; leave one of both out"),
        (("--device", "cuda:0"), "--device of 2 ranks must be cpu, cuda or left out, got 'cuda:0'"),
        (("--device", "cuda"), "2 ranks of one machine need as many CUDA devices, got 0"),
    ],
)
def test_what_ranks_cannot_do(options, message, run, monkeypatch, tmp_path):
    monkeypatch.setattr("warp.get_cuda_device_count", lambda: 0)
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.setenv("LOCAL_WORLD_SIZE", "2")
    status, _, err = run("train", ELBOW, "--output", tmp_path / "new", *options)
    assert status == 2
    assert message in err
    assert not (tmp_path / "new").exists()


def test_each_rank_has_a_cuda_device_of_its_own(monkeypatch):
    monkeypatch.setattr("warp.get_cuda_device_count", lambda: 2)
    assert Ranks(3, 4, local=1, local_size=2).device(None) == "cuda:1"
    assert Ranks().device("cuda:1") == "cuda:1"


def small(folder, samples, *options):
    """Return a run of two ranks with a checkpoint after every iteration."""
    sizes = ("--num-worlds", 8, "--rollout-steps", 16, "--hidden", 16, 16, "--samples", samples)
    rest = ("--device", "cpu", "--save-seconds", 0, "--stop-success", 2, "--minibatches", 2)
    rest += ("--selections", 3, "--noise", "repeated")
    return [str(word) for word in ("train", ELBOW, "--output", folder, *sizes, *rest, *options)]


def saved(folder):
    """Return the samples of the last checkpoint, 0 while there is none."""
    try:
        return int(find_folder(folder, learning=True).name)
    except (ValueError, OSError):
        return 0


def children(pid):
    """Return the processes that a process has started."""
    return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The folder of a run of which nothing was killed."""
    folder = tmp_path_factory.mktemp("ranks") / "undisturbed"
    command = [*TORCHRUN, "-m", "myowarp", *small(folder, SAMPLES)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.scale
@pytest.mark.parametrize("victim", [0, 1])
def test_a_killed_rank_ends_where_an_undisturbed_run_ends(victim, undisturbed, tmp_path):
    killed = tmp_path / "killed"
    command = [*TORCHRUN, "--max-restarts", "1", "-m", "myowarp", *small(killed, SAMPLES)]
    errors = tmp_path / "errors"
    with (
        errors.open("w") as file,
        subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=file) as process,
    ):
        begin = time.monotonic()
        while saved(killed) < 8 * 16 * 5:
            assert process.poll() is None, errors.read_text()
            assert time.monotonic() - begin < PATIENCE
            time.sleep(0.01)
        os.kill(sorted(children(process.pid))[victim], signal.SIGKILL)
        assert process.wait(PATIENCE) == 0, errors.read_text()
    report = json.loads((killed / "report.json").read_text())
    assert 8 * 16 * 5 <= report["resumed_after"] < SAMPLES == report["samples"]
    one, other = (load_checkpoint(folder, learning=True) for folder in (killed, undisturbed))
    assert one.manifest["selection"] == other.manifest["selection"]
    assert load_checkpoint(killed).manifest["files"] == load_checkpoint(undisturbed).manifest["files"]
    for before, after in ((one.policy, other.policy), (one.state(), other.state())):
        assert before.keys() == after.keys()
        for name, array in before.items():
            np.testing.assert_array_equal(array, after[name], err_msg=name)


@pytest.mark.scale
@pytest.mark.parametrize(("task", "success"), [(ELBOW, 0.99), (FINGER, 0.99)])
def test_two_ranks_learn_what_one_learns(task, success, tmp_path):
    """The presets stop at 99.5 % of the episodes of a selection, in one process and over two ranks."""
    found = {}
    for ranks in (1, 2):
        start = TORCHRUN if ranks == 2 else [sys.executable]
        folder = tmp_path / str(ranks)
        words = [*start, "-m", "myowarp", "train", task, "--output", str(folder), "--device", "cpu"]
        subprocess.run(words, check=True, capture_output=True)
        command = [*start, "-m", "myowarp", "eval", str(folder), "--device", "cpu", "--json"]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        found[ranks] = json.loads(done.stdout)
        assert found[ranks]["samples"] <= 3_000_000
    for figures in found.values():
        assert figures["deterministic"]["success"] >= success - 0.02
        assert figures["deterministic"]["episodes"] == 256


def test_a_run_goes_on_with_as_many_ranks(run, tmp_path, monkeypatch):
    status, _, err = run(*small(tmp_path / "one", 8 * 16))
    assert status == 0, err
    monkeypatch.setenv("WORLD_SIZE", "2")
    status, _, err = run("train", "--resume", tmp_path / "one", "--samples", 8 * 16 * 2)
    assert status == 2
    assert "goes on with the number of ranks that it began with, 1, got 2" in err

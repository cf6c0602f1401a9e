"""Selection: which policy of a run is kept, what stops a run, what plays, and what the evaluations are of."""

import csv
import dataclasses
import errno
import io
import json
import os
import shutil
import signal
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

from myowarp.apps.policies import checkpoint as checkpoints
from myowarp.apps.policies.checkpoint import BEST, STATE, find_folder, load_checkpoint
from myowarp.apps.reports.curve import SELECTED, draw_curve
from myowarp.apps.reports.evaluation import evaluate_policy, plan_evaluation
from myowarp.apps.train import selection
from myowarp.apps.train.loop import Run
from myowarp.apps.train.plan import plan
from myowarp.apps.train.run import train
from myowarp.definitions.setup import Setup
from myowarp.models.conditions.sarcopenia import Sarcopenia

ELBOW = "myoElbowPose1D6MRandom-v0"
ITERATION = 8 * 8  # samples
SMALL = {"num_worlds": 8, "rollout_steps": 8, "minibatches": 2, "hidden": (16,)}
SMALL |= {"device": "cpu", "samples": 12 * ITERATION, "selections": 6, "stop_success": 0.9}
SMALL |= {"stop_rule": "success"}


@dataclasses.dataclass
class Found:
    """What an evaluation is made to find."""

    success: float
    success_last: float
    return_mean: float


@pytest.fixture
def scripted(monkeypatch):
    """Let evaluations find what a test wants.

    Returns the list that it fills with (success, return), and the policies that were evaluated.
    """
    wanted, policies = [], []

    class Nothing:
        def close(self):
            pass

    def found(sim, act, **options):
        policies.append(act.checkpoint)
        success, returns = wanted[len(policies) - 1]
        return Found(success, success / 2, returns)

    monkeypatch.setattr(selection, "evaluate", found)
    monkeypatch.setattr(selection, "Bound", lambda checkpoint, sim: SimpleNamespace(checkpoint=checkpoint))
    monkeypatch.setattr(selection, "evaluated_worlds", lambda job: Nothing())
    return wanted, policies


def run_of(folder, **given):
    return train(plan(ELBOW, output=folder, **SMALL | given))


def rows(folder):
    with (folder / "progress.csv").open() as file:
        return list(csv.DictReader(file))


def test_the_best_is_kept_and_plays(scripted, tmp_path, run):
    """Success counts first, then the return; of two alike the first. What resumes is the last."""
    wanted, policies = scripted
    wanted += [(0.25, 1.0), (0.5, 3.0), (0.5, 4.0), (0.375, 9.0), (0.5, 4.0), (0.25, 8.0)]
    report = run_of(tmp_path)
    assert report["ended"] == "all samples"
    taken = [int(policy.manifest["samples"]) for policy in policies]
    assert taken == [number * ITERATION for number in (2, 4, 6, 8, 10, 12)]
    best, last = load_checkpoint(tmp_path), load_checkpoint(tmp_path, learning=True)
    assert (best.folder, last.folder) == (
        tmp_path / BEST / f"{6 * ITERATION:012d}",
        tmp_path / "checkpoints" / f"{12 * ITERATION:012d}",
    )
    assert [folder.name for folder in (tmp_path / BEST).iterdir()] == [best.folder.name]
    assert best.manifest["samples"] == 6 * ITERATION
    assert STATE not in best.manifest["files"]
    for name, array in policies[2].policy.items():
        np.testing.assert_array_equal(best.policy[name], array)
    assert any((array != last.policy[name]).any() for name, array in best.policy.items())
    scores = {
        "best": {"samples": 6 * ITERATION, "success": 0.5, "returns": 4.0},
        "last": {"samples": 12 * ITERATION, "success": 0.25, "returns": 8.0},
        "risen": {"samples": 4 * ITERATION, "success": 0.5, "returns": 3.0},
    }
    assert report["selection"] == last.manifest["selection"] == scores
    assert best.manifest["selection"]["best"] == scores["best"]
    shown = [float(row["selection_success"]) for row in rows(tmp_path)]
    np.testing.assert_array_equal(shown, [np.nan, *np.repeat([0.25, 0.5, 0.5, 0.375, 0.5], 2), 0.25])
    assert float(rows(tmp_path)[7]["selection_return"]) == 9.0
    status, out, err = run("eval", tmp_path, "--episodes", 4, "--device", "cpu", "--json")
    assert status == 0, err
    assert json.loads(out)["checkpoint"] == str(best.folder)
    assert json.loads(out)["samples"] == 6 * ITERATION


def test_no_run_plays_worse_than_its_parent(scripted, tmp_path):
    """A parent that nothing exceeds is the best; it ends no training, however good it is."""
    wanted, policies = scripted
    wanted += [(0.25, 1.0)] * 6 + [(1.0, 5.0)] + [(0.5, 9.0)] * 6
    run_of(tmp_path / "parent")
    report = run_of(tmp_path / "child", parent=str(tmp_path / "parent"))
    assert report["ended"] == "all samples"
    assert len(policies) == 13
    assert report["selection"]["best"] == {"samples": 0, "success": 1.0, "returns": 5.0}
    child, parent = load_checkpoint(tmp_path / "child"), load_checkpoint(tmp_path / "parent")
    assert child.folder == tmp_path / "child" / BEST / f"{0:012d}"
    for name, array in parent.policy.items():
        if name != "log_std":  # which a child begins with anew
            np.testing.assert_allclose(child.policy[name], array, rtol=1e-6, atol=1e-7)


def test_the_last_selection_stops_a_run(scripted, tmp_path):
    wanted, _ = scripted
    wanted += [(0.89, 1.0), (0.91, 0.0)]
    report = run_of(tmp_path)
    assert (report["ended"], report["samples"]) == (
        "at least 90.0 % of the episodes succeeded with mean actions (more than 5 solved steps, no failure)",
        4 * ITERATION,
    )
    assert report["success"] != report["success"]  # no episode of the training has ended
    assert load_checkpoint(tmp_path).manifest["samples"] == 4 * ITERATION


@pytest.mark.parametrize(("later", "sentences"), [(0.25, 1), (0.75, 0)])
def test_a_run_that_gets_no_better_for_half_of_its_budget_says_so_once(later, sentences, scripted, tmp_path):
    """The best of six evaluations is the first, or the fourth; half of the budget are three of them.

    Returns that rise from one to the next are no success.
    """
    wanted, _ = scripted
    successes = (0.5, 0.25, 0.5, later, 0.5, 0.5)
    wanted += [(success, float(returns)) for returns, success in enumerate(successes)]
    console = Console(file=io.StringIO(), width=1000)
    train(plan(ELBOW, output=tmp_path, bonus=("solved=2",), **SMALL), console)
    said = [
        line for line in console.file.getvalue().splitlines() if line.startswith("for half of the budget")
    ]
    assert len(said) == sentences
    for line in said:
        assert f"nothing was better than 50.0 % after {2 * ITERATION} samples; tried was ppo" in line
        assert "--num-worlds 8 --rollout-steps 8 --bonus solved=2" in line
        assert line.endswith(f"`myowarp improve {tmp_path}`")


def test_the_rule_that_stops_is_the_one_that_selects(scripted, tmp_path):
    """Here half of them succeed on the last step."""
    wanted, _ = scripted
    wanted += [(0.95, 1.0), (1.0, 0.0)]
    report = run_of(tmp_path, stop_rule="success_last", stop_success=0.5)
    assert (report["ended"], report["samples"]) == (
        "at least 50.0 % of the episodes succeeded with mean actions (solved on the last step)",
        4 * ITERATION,
    )
    assert report["selection"]["best"]["success"] == 0.5


def test_a_resumed_run_goes_on_with_the_same_best(scripted, tmp_path, run):
    wanted, policies = scripted
    wanted += [(0.25, 1.0), (0.75, 2.0), (0.5, 5.0), (0.75, 1.0), (0.8, 0.0), (0.5, 0.0)]
    report = stopped(tmp_path, updates=7)
    assert (report["ended"], len(policies)) == ("stopped by a signal", 3)
    assert load_checkpoint(tmp_path).manifest["samples"] == 4 * ITERATION
    job = plan(resume=tmp_path)
    resumed = selection.Selection(job)
    assert dataclasses.asdict(resumed.best) == {"samples": 4 * ITERATION, "success": 0.75, "returns": 2.0}
    assert resumed.last.success == 0.5
    train(job)
    assert [policy.manifest["samples"] for policy in policies[3:]] == [n * ITERATION for n in (8, 10, 12)]
    assert load_checkpoint(tmp_path).manifest["samples"] == 10 * ITERATION
    assert len(list((tmp_path / BEST).iterdir())) == 1
    shown = [float(row["selection_success"]) for row in rows(tmp_path)][1:]
    np.testing.assert_array_equal(shown, [*np.repeat([0.25, 0.75, 0.5, 0.75, 0.8], 2), 0.5])


def test_a_best_policy_that_is_gone_is_not_waited_for(scripted, tmp_path, caplog):
    """A later one is kept, though the lost one was better; before, nothing was, and the last one played."""
    wanted, _ = scripted
    wanted += [(0.25, 1.0), (0.75, 2.0), (0.5, 5.0), (0.5, 1.0), (0.6, 0.0), (0.5, 0.0)]
    stopped(tmp_path, updates=7)
    shutil.rmtree(tmp_path / BEST)
    report = train(plan(resume=tmp_path))
    assert report["selection"]["best"] == {"samples": 10 * ITERATION, "success": 0.6, "returns": 0.0}
    assert load_checkpoint(tmp_path).manifest["samples"] == 10 * ITERATION
    assert [record.getMessage() for record in caplog.records] == [
        f"the best policy of {str(tmp_path)!r}, after {4 * ITERATION} samples, is gone; the next evaluation "
        "is the first that counts"
    ]


def stopped(folder, updates):
    """Run until a signal comes in an iteration."""
    iterate = Run.iterate

    def interrupted(self):
        iterate(self)
        if self.updates == updates:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Run, "iterate", interrupted)
        return run_of(folder)


def test_a_killed_run_takes_its_best_again(scripted, tmp_path, monkeypatch):
    """The best policy was written, the checkpoint after it was not: the run finds the same once more."""
    wanted, policies = scripted
    wanted += [(0.25, 1.0), (0.75, 2.0)]
    saved, save = [], checkpoints.save_checkpoint

    def killed(run, samples, *content, root="checkpoints", **more):
        if root == "checkpoints" and samples >= 4 * ITERATION:
            raise KeyboardInterrupt
        saved.append((root, samples))
        return save(run, samples, *content, root=root, **more)

    with monkeypatch.context() as patched:
        patched.setattr(checkpoints, "save_checkpoint", killed)
        with pytest.raises(KeyboardInterrupt):
            run_of(tmp_path, save_seconds=0.0)
    assert saved[-1] == (BEST, 4 * ITERATION)
    last = load_checkpoint(tmp_path, learning=True)
    assert (last.manifest["samples"], last.manifest["selection"]["best"]["success"]) == (3 * ITERATION, 0.25)
    wanted += [(0.75, 2.0), (0.5, 0.0), (0.5, 0.0), (0.5, 0.0), (0.5, 0.0)]
    assert train(plan(resume=tmp_path))["selection"]["best"]["samples"] == 4 * ITERATION
    assert load_checkpoint(tmp_path).manifest["samples"] == 4 * ITERATION
    for name, array in policies[1].policy.items():
        np.testing.assert_array_equal(policies[2].policy[name], array)


def test_a_full_disk_at_the_best_policy_is_a_sentence(scripted, tmp_path, monkeypatch):
    wanted, _ = scripted
    wanted += [(0.25, 1.0), (0.75, 2.0)]
    save = checkpoints.save_checkpoint

    def full(run, samples, *content, root="checkpoints", **more):
        if root == BEST and samples == 4 * ITERATION:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return save(run, samples, *content, root=root, **more)

    monkeypatch.setattr(checkpoints, "save_checkpoint", full)
    sentence = (
        f"^the best policy, after {4 * ITERATION} samples could not be written \\(No space left on device"
    )
    with pytest.raises(OSError, match=sentence):
        run_of(tmp_path)
    assert load_checkpoint(tmp_path).manifest["samples"] == 2 * ITERATION


def test_without_selections_the_last_policy_plays(scripted, tmp_path):
    """And the last 256 episodes of the training stop it."""
    _, policies = scripted
    report = run_of(tmp_path, selections=0)
    assert not policies
    assert not (tmp_path / BEST).exists()
    assert load_checkpoint(tmp_path).folder == find_folder(tmp_path, learning=True)
    assert report["selection"] == {"best": None, "last": None, "risen": None}
    assert {row["selection_success"] for row in rows(tmp_path)} == {"nan"}


def test_more_selections_than_iterations_are_one_an_iteration(scripted, tmp_path):
    wanted, policies = scripted
    wanted += [(0.0, 0.0)] * 12
    run_of(tmp_path, selections=500)
    assert [policy.manifest["samples"] for policy in policies] == [n * ITERATION for n in range(1, 13)]


def test_a_selection_is_what_myowarp_eval_finds(tmp_path, monkeypatch):
    """Means under parity, the task's own reward and condition, other seeds; whatever the training is paid."""
    monkeypatch.setattr(selection, "EPISODES", 16)
    given = {"physics": "fast", "bonus": ("solved=50", "pose=7"), "conditions": ("sarcopenia",)}
    report = run_of(tmp_path, selections=1, samples=20 * ITERATION, **given)
    where = Setup(seed=selection.SEED, device="cpu")
    head, figures = evaluate_policy(plan_evaluation(tmp_path, where, episodes=16, mode="deterministic"))
    assert (head["physics"], head["conditions"]) == ("parity", ["sarcopenia"])
    best, found = report["selection"]["best"], figures["deterministic"]
    assert best["returns"] == pytest.approx(found["return_mean"], rel=1e-6)
    assert best["success"] == found["success"]
    assert len({report["seed"], selection.SEED, 1_000_000}) == 3


@pytest.mark.parametrize("given", ["cohort", "conditions"])
def test_patients_have_as_many_worlds_as_in_the_training(given, tmp_path, monkeypatch):
    worlds, evaluate = [], selection.evaluate

    def counted(sim, act, **options):
        worlds.append(sim.num_worlds)
        return evaluate(sim, act, **options)

    monkeypatch.setattr(selection, "evaluate", counted)
    if given == "cohort":
        (tmp_path / "patients.csv").write_text("strength\n1.0\n0.3\n")
        own = {"cohort": str(tmp_path / "patients.csv")}
    else:
        own = {"conditions": (Sarcopenia(np.linspace(0.3, 1.0, 8)),)}
    run_of(tmp_path / "run", selections=1, samples=2 * ITERATION, **own)
    assert worlds == [8]


def test_the_curve_shows_the_selections(scripted, tmp_path, monkeypatch):
    wanted, _ = scripted
    wanted += [(0.25, 1.0)] * 12
    run_of(tmp_path, samples=16 * ITERATION)
    lines, savefig = [], Figure.savefig
    monkeypatch.setattr(
        Figure,
        "savefig",
        lambda self, *of, **more: (lines.extend(self.axes[1].lines), savefig(self, *of, **more))[1],
    )
    assert draw_curve(tmp_path, "elbow").is_file()
    (line,) = [line for line in lines if line.get_label() == SELECTED]
    assert set(np.asarray(line.get_ydata())[np.isfinite(line.get_ydata())]) == {25.0}

"""Policies that remember and policies that are told: trained, imitated, played where more is observed."""

import numpy as np
import pytest

from myowarp.apps.policies.checkpoint import CheckpointError, find_folder, load_checkpoint
from myowarp.apps.policies.find import acting, find_policy
from myowarp.apps.policies.learned import LearnedPolicy
from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation

pytest.importorskip("torch")

from myowarp.apps.train.plan import plan
from myowarp.apps.train.run import train

TASK = "myoElbowPose1D6MRandom-v0"
CONDITIONS = ("sarcopenia(strength=Ramp(1.0, Uniform(0.2, 0.6, each=True), onset=Uniform(0.1, 0.4)))",)
SMALL = {"device": "cpu", "hidden": (64,), "rollout_steps": 16, "num_worlds": 64, "samples": 8192}
WEAK = ("sarcopenia(strength=0.4)",)
WORLDS = 8


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """A policy that was told the parameters."""
    folder = tmp_path_factory.mktemp("memory") / "told"
    fast = {"learning_rate": 1e-2, "average": 0.0}  # so that its actions soon differ
    train(plan(TASK, output=folder, conditions=CONDITIONS, observe=("parameters",), **SMALL, **fast))
    return folder


@pytest.fixture(scope="module")
def student(told):
    """A policy that remembers, and has learned from the one that was told."""
    folder = told.parent / "student"
    fit = {
        "algorithm": "dagger",
        "expert": str(told),
        "expert_steps": 64,
        "gradient_steps": 8,
        "learning_rate": 2e-3,
        "average": 0.0,
    }
    train(plan(TASK, output=folder, conditions=WEAK, observe=("history=4",), **SMALL, **fit))
    return find_folder(folder, learning=True)  # the last one, which fits best


def simulation(*observe, conditions=CONDITIONS):
    options = {"device": "cpu", "progress": False, "shards": 2}
    sim = Simulation(TASKS[TASK], WORLDS, conditions=conditions, observe=observe, **options)
    sim.reset(seeds=np.arange(WORLDS))
    return sim


def played(folder, sim, steps=12):
    """Return the actions of a policy."""
    act, actions = acting(find_policy(str(folder), TASKS[TASK]), sim), []
    for _ in range(steps):
        actions.append(act(sim.transition.obs.numpy().copy()))
        sim.action.assign(actions[-1])
        sim.step()
    return np.array(actions)


@pytest.mark.slow
def test_whoever_is_told_acts_alike_wherever_more_or_less_is_observed(told):
    own = played(told, simulation("parameters"))
    for observe in ((), ("history=3",), ("parameters", "history=3")):
        np.testing.assert_array_equal(played(told, simulation(*observe)), own)
    assert (own != played(told, simulation("parameters", conditions=("sarcopenia(strength=1.0)",)))).any()


@pytest.mark.slow
def test_a_student_imitates_who_is_told(told, student):
    """Its actions follow its teacher's in the same states, where it was told nothing."""
    assert load_checkpoint(student).manifest["settings"]["observe"] == ["history=4"]
    sim = simulation("history=4", "parameters", conditions=WEAK)
    teacher, pupil = (acting(find_policy(str(f), TASKS[TASK]), sim) for f in (told, student))
    wrong, size = [], []
    for _ in range(40):
        obs = sim.transition.obs.numpy().copy()
        wanted, done = teacher(obs), pupil(obs)
        wrong.append(np.abs(done - wanted).mean())
        size.append(np.abs(wanted).mean())
        sim.action.assign(done)
        sim.step()
    assert np.mean(wrong) < 0.1 * np.mean(size)


def test_numpy_sees_the_history_that_torch_was_trained_with(student):
    policy = LearnedPolicy(load_checkpoint(student))
    assert policy.obs_size == simulation("history=4").transition.obs.shape[1]


def test_a_memory_that_is_not_observed_is_said(student):
    with pytest.raises(
        CheckpointError, match=r"only there: history; it was trained with --observe history=4$"
    ):
        played(student, simulation())
    with pytest.raises(CheckpointError, match=r"it was trained with --observe history=4$"):
        played(student, simulation("history=2"))


def test_a_function_is_told_without_observing(tmp_path):
    """What it is told is the block of worlds that observe parameters, before and after the change."""
    (tmp_path / "teacher.py").write_text("def act(obs, told):\n    return told[:, :6]\n")
    name = f"{tmp_path}/teacher.py:act"
    plain, observing = simulation(), simulation("parameters")
    act, seen = acting(find_policy(name, TASKS[TASK]), plain), []
    for _ in range(24):
        seen.append(observing.transition.obs.numpy()[:, observing.blocks["parameters"]].copy())
        np.testing.assert_array_equal(act(plain.transition.obs.numpy()), seen[-1])
        for sim in (plain, observing):
            sim.step()
    assert np.abs(seen[-1] - seen[0]).min() > 0.3
    with pytest.raises(ValueError, match="act' needs conditions, whose parameters it is told; got none"):
        acting(find_policy(name, TASKS[TASK]), simulation(conditions=()))
    page = Simulation(TASKS[TASK], 2, conditions=CONDITIONS, device="cpu", progress=False, adjustable=True)
    with pytest.raises(ValueError, match="cannot act where all can be changed, as in myowarp view"):
        acting(find_policy(name, TASKS[TASK]), page)

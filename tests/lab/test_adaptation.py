"""Policies in patients who change in mid-episode: figures beside a loop by hand, what is refused, files."""

import csv
import json

import numpy as np
import pytest

from myowarp.apps.policies.find import acting, find_policy
from myowarp.apps.studies import adaptation
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.models.conditions import Ramp, Sarcopenia, Uniform
from myowarp.sim.simulation import Simulation
from myowarp.tasks.setups import complete

TASK, EPISODES, HORIZON = "myoElbowPose1D6MRandom-v0", 24, 60
BROKEN = Sarcopenia(Ramp(1.0, 0.0, onset=Uniform(0.5, 0.9)))


def setup(*conditions, **fields):
    return complete(Setup(task=TASK, conditions=conditions, horizon=HORIZON, device="cpu", **fields))


@pytest.fixture(scope="module")
def result():
    return adaptation.study(setup(BROKEN), ["muscle-control", "zero"], EPISODES)


def by_hand(name):
    """Return solved (HORIZON, EPISODES) and the step of each change, read from the muscles themselves."""
    sim = Simulation(setup(BROKEN), EPISODES, autoreset="disabled", graph=False)
    act = acting(find_policy(name, TASKS[TASK]), sim)
    sim.reset(seeds=np.arange(EPISODES))
    solved, changed = [], np.full(EPISODES, -1)
    for step in range(HORIZON):
        sim.action.assign(act(sim.transition.obs.numpy().copy()))
        sim.step()
        weak = sim.scene.muscles.anatomy.strength.numpy()[:, 0] == 0.0
        changed[weak & (changed < 0)] = step
        solved.append(sim.transition.solved.numpy().copy())
    return np.array(solved), changed, sim.scene.control_dt


@pytest.mark.parametrize("which", [0, 1])
def test_figures_are_those_of_a_loop_by_hand(result, which):
    solved, changed, dt = by_hand(["muscle-control", "zero"][which])
    assert np.ptp(changed) > 3
    found = result.policies[which]
    assert found.episodes == EPISODES
    after = [solved[c:, w].mean() for w, c in enumerate(changed)]
    np.testing.assert_allclose(found.after, np.mean(after), atol=1e-12)
    curve = result.curves[which]
    for k in (-10, -1, 0, 5, 12):
        expected = np.mean([solved[c + k, w] for w, c in enumerate(changed) if c + k < HORIZON])
        at = np.argmin(np.abs(result.seconds - k * dt))
        np.testing.assert_allclose(curve[at], expected, atol=1e-12)
    late = [k for k in range(HORIZON) if np.mean(changed + k < HORIZON) >= 0.5]
    falls = [np.mean([solved[c + k, w] for w, c in enumerate(changed) if c + k < HORIZON]) for k in late]
    np.testing.assert_allclose(found.drop, found.before - min(falls), atol=1e-12)
    if which == 0:  # an arm without muscles falls out of its pose
        assert found.before > 0.5
        assert found.drop > 0.3
        low, high = found.after_interval
        assert low < found.after < high


def test_gain_is_over_the_first_policy_in_the_same_episodes(result):
    first, second = result.policies
    assert first.gain is None
    np.testing.assert_allclose(second.gain, second.after - first.after, atol=1e-12)
    low, high = second.gain_interval
    assert low < second.gain < high


def test_files(result, tmp_path):
    files = adaptation.save(result, tmp_path / "out")
    assert [file.name for file in files] == ["adaptation.json", "curves.csv", "adaptation.png"]
    saved = json.loads(files[0].read_text())
    assert [row["policy"] for row in saved["policies"]] == ["muscle-control", "zero"]
    assert saved["policies"][1]["gain"] == result.policies[1].gain
    rows = list(csv.reader(files[1].open()))
    assert rows[0] == ["seconds_after_change", "muscle-control", "zero"]
    assert len(rows) == 1 + len(result.seconds)
    assert files[2].stat().st_size > 5_000


def test_patients_of_a_table_change_each_at_their_time(run, tmp_path):
    table = tmp_path / "patients.csv"
    table.write_text("strength\n1 -> 0 @ 0.4\n1 -> 0 @ 0.8\n")
    made = adaptation.with_patients(setup(), table, 6)
    strength = made.conditions[0].strength
    np.testing.assert_array_equal(strength.onset, [0.4] * 3 + [0.8] * 3)
    command = ("adapt", TASK, "--cohort", table, "--policies", "zero", "--output", tmp_path / "out")
    status, out, _ = run(*command, "--episodes", 6, "--json", "--device", "cpu")
    assert status == 0
    assert json.loads(out)[0]["episodes"] == 6
    status, _, err = run(*command, "--episodes", 5, "--overwrite")
    assert status == 2
    assert "--episodes must be a multiple of the 2 patients of --cohort, got 5" in err


@pytest.mark.parametrize(
    ("conditions", "policies", "message"),
    [
        ((), ["zero"], r"^observe parameters needs conditions, which have them; got none$"),
        ((Sarcopenia(0.5),), ["zero"], r"^adapt needs conditions that change while an episode of .* lasts"),
        ((Sarcopenia(Ramp(1.0, 0.5, onset=9.0)),), ["zero"], r"of 2 episodes none had a change$"),
        ((BROKEN,), ["zero", "zero"], r"^adapt compares different policies, got 'zero' twice$"),
        ((BROKEN,), ["nobody"], r"^policy 'nobody' unknown"),
    ],
)
def test_what_cannot_be_compared_is_refused(conditions, policies, message):
    with pytest.raises(ValueError, match=message):
        adaptation.study(setup(*conditions), policies, 2)

"""Policies in patients who change in mid-episode: figures beside a loop by hand, what is refused, files."""

import csv
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import bootstrap

from myowarp.apps.policies.find import Policy, acting, find_policy
from myowarp.apps.studies import adaptation, leaderboard
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.models.conditions import NerveCrossing, Ramp, Sarcopenia, TendonTear, Uniform
from myowarp.sim.simulation import Simulation
from myowarp.tasks.setups import complete

BOARD = Path(__file__).parents[2] / "benchmarks" / "results" / "adaptation.csv"
CHANGING = BOARD.parents[2] / "examples" / "changing.csv"
TASK, EPISODES, HORIZON = "myoElbowPose1D6MRandom-v0", 24, 60
BROKEN = Sarcopenia(Ramp(1.0, 0.0, onset=Uniform(0.5, 0.9)))


def setup(*conditions, **fields):
    return complete(Setup(task=TASK, conditions=conditions, horizon=HORIZON, device="cpu", **fields))


def policies(*names):
    return [find_policy(name, TASKS[TASK]) for name in names]


@pytest.fixture(scope="module")
def result():
    return adaptation.study(setup(BROKEN), policies("muscle-control", "zero"), EPISODES)


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


def test_a_teacher_undoes_what_crossed_nerves_do():
    """With it hands move as healthy ones do with the healthy policy, bit for bit, before and after."""
    task, hands = TASKS["myoHandReachRandom-v0"], []
    crossed = NerveCrossing(Ramp(0.0, 1.0, onset=Uniform(0.1, 0.3)))
    teacher = "myowarp.apps.studies.reproduce.adaptation:uncross"
    for conditions, name in (((), "baseline"), (crossed, teacher), (crossed, "baseline")):
        sim = Simulation(task, 4, conditions=conditions, device="cpu", autoreset="disabled", progress=False)
        act = acting(find_policy(name, task), sim)
        sim.reset(seeds=np.arange(4))
        for _ in range(20):
            sim.action.assign(act(sim.transition.obs.numpy().copy()))
            sim.step()
        hands.append(sim.scene.data.qpos.numpy().copy())
    np.testing.assert_array_equal(hands[1], hands[0])
    assert np.abs(hands[2] - hands[0]).max(axis=1).min() > 0.1


def test_another_policy_acts_from_the_change_on():
    """The muscles themselves say when that is; both policies see all that is observed."""
    sim = Simulation(setup(BROKEN, observe=("parameters",)), EPISODES, autoreset="disabled", graph=False)
    both = [
        Policy(str(value), act=lambda obs, value=value: np.full((EPISODES, 6), value))
        for value in (-1.0, 1.0)
    ]
    act = adaptation.Relieved("both", *both).acting(sim)
    sim.reset(seeds=np.arange(EPISODES))
    late = []
    for _ in range(HORIZON):
        action = act(sim.transition.obs.numpy().copy())
        sim.action.assign(action.astype(np.float32))
        sim.step()
        weak = sim.scene.muscles.anatomy.strength.numpy()[:, 0] == 0.0
        np.testing.assert_array_equal(action, np.where(weak[:, None], 1.0, -1.0) * np.ones(6))
        late.append(weak.mean())
    assert late[0] == 0.0 < late[35] < late[-1] == 1.0


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
    steady = [np.mean([solved[c + k, w] for w, c in enumerate(changed)]) for k in range(-5, 0)]
    np.testing.assert_allclose(found.before, np.mean(steady), atol=1e-12)  # of 0.1 s
    late = [k for k in range(HORIZON) if np.mean(changed + k < HORIZON) >= 0.5]
    falls = [np.mean([solved[c + k, w] for w, c in enumerate(changed) if c + k < HORIZON]) for k in late]
    np.testing.assert_allclose(found.drop, found.before - min(falls), atol=1e-12)
    half = found.before - 0.5 * found.drop
    back = [k for k in range(int(np.argmin(falls)), len(falls)) if falls[k] >= half]
    assert found.recovery == pytest.approx((back[0] - int(np.argmin(falls))) * dt if back else np.inf)
    if which == 0:  # an arm without muscles falls out of its pose
        assert found.before > 0.5
        assert found.drop > 0.3
        low, high = found.after_interval
        assert low < found.after < high


def test_intervals_are_those_of_scipys_bootstrap(result):
    """Of the drop between two steps, which is a mean over the episodes that both have."""
    solved, lasts = (np.random.default_rng(1).random((4, 80)) < share for share in (0.6, 2.0))
    before, drop, recovery = adaptation.fall_intervals(solved, lasts, 2, 0.02)
    whole = solved.astype(float)
    options = {"n_resamples": 4000, "method": "percentile", "rng": 1, "vectorized": True}
    expected = bootstrap((whole[:2].mean(axis=0),), np.mean, **options).confidence_interval
    np.testing.assert_allclose(before, expected, atol=0.02)

    def fall(each, axis):
        found = [whole[:, rows.astype(int)].mean(axis=1) for rows in each.reshape(-1, 80)]
        return np.array([own[:2].mean() - own[2:].min() for own in found]).reshape(each.shape[:-1])

    expected = bootstrap((np.arange(80.0),), fall, **options).confidence_interval
    np.testing.assert_allclose(drop, expected, atol=0.02)
    assert 0.0 <= recovery[0] <= recovery[1]
    for policy in result.policies:
        for low, value, high in (
            (policy.before_interval[0], policy.before, policy.before_interval[1]),
            (policy.drop_interval[0], policy.drop, policy.drop_interval[1]),
        ):
            assert low <= value <= high


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
    ("conditions", "names", "message"),
    [
        ((), ["zero"], r"^observe parameters needs conditions, which have them; got none$"),
        (
            (Sarcopenia(0.5),),
            ["zero"],
            r"^adapt needs conditions whose values change in an episode of",
        ),
        (
            (TendonTear("BRA", time=0.5),),
            ["zero"],
            r"such as 'tendon_tear\(transmission=Ramp\(1.0, 0.0, onset=0.5\)\)'",
        ),
        ((Sarcopenia(Ramp(1.0, 0.5, onset=9.0)),), ["zero"], r"of 2 episodes none had a change$"),
        ((BROKEN,), ["zero", "zero"], r"^adapt compares different policies, got 'zero' twice$"),
    ],
)
def test_what_cannot_be_compared_is_refused(conditions, names, message):
    with pytest.raises(ValueError, match=message):
        adaptation.study(setup(*conditions), policies(*names), 2)


AGENT = """
import numpy as np

tired = np.zeros(24)


def act(obs, begins):
    tired[begins] = -1.0
    tired[:] += 0.02
    return np.repeat(tired[:, None], 6, axis=1)
"""


def test_a_new_algorithm_enters_the_leaderboard_with_one_command(run, tmp_path, monkeypatch):
    """A function with a state of its own; who enters again stands there once."""
    monkeypatch.setattr(leaderboard, "EPISODES", EPISODES)
    (tmp_path / "my_agent.py").write_text(AGENT)
    board, agent = tmp_path / "board.csv", f"{tmp_path}/my_agent.py:act"
    command = ("adapt", TASK, "--cohort", CHANGING, "--output", tmp_path / "out", "--device", "cpu")
    command = (*command, "--episodes", EPISODES)
    for _ in range(2):
        options = ("--policies", "baseline", agent, "--board", board, "--overwrite")
        status, _, err = run(*command, *options)
        assert status == 0, err
    rows = leaderboard.read_board(board)
    assert [row["policy"] for row in rows] == [agent, "baseline"]
    assert float(rows[0]["gain_high"]) < 0.0 < float(rows[0]["after"])
    assert rows[1]["gain"] == rows[1]["gain_low"] == ""
    status, _, err = run(*command, "--policies", "zero", "--board", board, "--overwrite")
    assert status == 2
    assert "--board needs the first of --policies to be baseline, got zero" in err
    status, _, err = run(*command, "--horizon", 70, "--board", board, "--overwrite")
    assert status == 2
    assert "--board needs --horizon to be 100, got 70" in err
    board.write_text("policy\nzero\n")
    status, _, err = run(*command, "--board", board, "--overwrite")
    assert status == 2
    assert "must have the columns protocol, task, patients, policy" in err


def test_the_same_patients_have_one_name_from_texts_and_objects():
    text = "sarcopenia(strength=Ramp(1.0, 0.0, onset=Uniform(0.5, 0.9)))"
    assert leaderboard.patients_of(setup(text), None) == leaderboard.patients_of(setup(BROKEN), None)


def test_the_committed_leaderboard_is_by_the_protocol():
    rows = leaderboard.read_board(BOARD)
    assert {row["protocol"] for row in rows} == {leaderboard.PROTOCOL}
    groups = {}
    for row in rows:
        groups.setdefault((row["task"], row["patients"]), []).append(row)
        assert 0 < int(row["episodes"]) <= adaptation.EPISODES
        for name in leaderboard.FIGURES:
            if name != "gain" or row["policy"] != "baseline":
                low, value, high = (float(row[f"{name}{end}"]) for end in ("_low", "", "_high"))
                assert low <= value <= high, (row["policy"], name)
    for (task, patients), own in groups.items():
        TASKS[task]
        assert "baseline" in [row["policy"] for row in own], task
        table, _, digest = patients.partition(" ")
        if table.endswith(".csv"):
            content = (BOARD.parents[2] / "examples" / table).read_bytes()
            assert hashlib.sha256(content).hexdigest().startswith(digest)


def test_a_tear_of_a_table_is_a_change_that_is_seen(tmp_path):
    table = tmp_path / "torn.csv"
    table.write_text("tendon_tear,tear_time\nBRA+BIClong,0.5\n,0\nBRA,0.3..0.6\n")
    found = adaptation.study(adaptation.with_patients(setup(), table, 6), policies("zero"), 6)
    assert found.policies[0].episodes == 4  # in the second patient nothing tears

"""A search of reflexes: what a walk costs, and that a broken search goes on as if nothing had happened."""

import json
from pathlib import Path

import numpy as np
import pytest

from myowarp.apps.policies.reflex import SCALES, Delays, read_gait, unscaled
from myowarp.apps.studies import gait as study
from myowarp.apps.studies.gait import Search, Trials, Walks, search
from myowarp.definitions.setup import Setup
from myowarp.models.conditions import MotorNoise, PelvisSupport

TASK, SUPPORT = "myoLegWalk-v0", "pelvis_support(share=0.5)"
HUMAN, EXAMPLES = "myoLegWalkHuman-v0", Path(__file__).parents[2] / "examples"
ROUNDING = 1e-5
"""Of float32: forces of muscles are computed again after a reset, by other kernels."""
SHORT = Setup(task=TASK, physics="fast", horizon=30, device="cpu", seed=0)


def test_way_and_time_come_before_speed_and_effort():
    time, speed = np.array([10.0, 10.0, 8.0, 10.0, 8.0]), np.array([1.2, 1.2, 1.2, 0.9, 0.3])
    walks = Walks(time, speed, np.array([2.0, 4.0, 2.0, 2.0, 2.0]), np.zeros(5))
    cost = walks.cost(1.2, 10.0)
    assert (np.diff(cost) > 0.0).all()
    assert cost[:2] == pytest.approx([2.0 / 1.2, 4.0 / 1.2])
    share = 0.8 * (1.0 + 0.25) / 2.0
    assert cost[4] == pytest.approx(100.0 * (1.0 - share) + share**2 * (75.0 + 2.0 / 1.2))


def test_walks_are_measured_up_to_the_fall():
    trials = Trials(SHORT, 4, Delays())
    values = unscaled(np.tile(np.linspace(0.5, 2.0, 4)[:, None], (1, len(SCALES))))
    walks = trials.walk(values)
    assert (walks.time > 0.05).all()
    assert (walks.time <= trials.duration + 1e-9).all()
    assert 0.5 < walks.speed[0] < 2.0  # they start at 1.5 m/s
    assert (walks.metabolic_rate > 0.0).all()
    again = trials.walk(np.repeat(values[:1], 4, axis=0), starts=4)
    for name, value in vars(again).items():
        assert value == pytest.approx(np.full(4, vars(walks)[name][0]))


def test_who_falls_makes_room_and_nothing_else_changes():
    """Of seven gaits three walk at once, each as when all do; noise is that of the trial's seed."""
    setup = Setup.of(SHORT, horizon=90, conditions=("motor_noise",))
    values = unscaled(np.tile(np.linspace(0.4, 2.2, 7)[:, None], (1, len(SCALES))))
    few, all_at_once = (Trials(setup, number, Delays()).walk(values, starts=3) for number in (3, 7))
    assert np.ptp(few.time) > 0.1
    for name, value in vars(few).items():
        assert value == pytest.approx(vars(all_at_once)[name], rel=ROUNDING), name
        assert np.ptp(value) > 100.0 * ROUNDING * value.max()


@pytest.mark.slow
def test_the_example_walks_with_support():
    """Ten seconds with noise of three seeds, under the physics of its search; without support it falls."""
    gait = read_gait(EXAMPLES / "planar_gait.json")
    assert gait.conditions == ("pelvis_support(share=1)",)
    conditions = PelvisSupport(np.array([1.0, 1.0, 1.0, 0.0])), MotorNoise(0.05, 0.01)
    trials = Trials(Setup(task=HUMAN, physics="fast", conditions=conditions, device="cpu"), 4, gait.delays)
    walks = trials.walk(np.tile(gait.values, (4, 1)), starts=4)
    assert walks.time[:3] == pytest.approx(10.0)
    assert walks.speed[:3] == pytest.approx(1.2, abs=0.2)  # m/s, what was wanted
    assert walks.time[3] < 2.0


@pytest.fixture
def quick(monkeypatch):
    """Let candidates cost what their parameters say, without a simulation."""

    class Quick:
        duration = 1.0

        def __init__(self, setup, num_worlds, delays):
            pass

        def walk(self, values, starts=1):
            time = 1.0 / (1.0 + values.var(axis=1))
            return Walks(time, np.full(len(time), 1.2), 0.0 * time, 0.0 * time)

    monkeypatch.setattr(study, "Trials", Quick)


def test_a_broken_search_goes_on(tmp_path, quick):
    pytest.importorskip("cma")
    plan = Search(SHORT, population=6)
    console = study.Console(quiet=True)
    whole = search(plan, tmp_path / "whole", 4, console)
    search(plan, tmp_path / "broken", 1, console)
    assert search(plan, tmp_path / "broken", 4, console) == whole
    assert read_gait(tmp_path / "broken" / study.GAIT) == whole
    costs = np.load(tmp_path / "whole" / study.SEARCH)["costs"]
    assert costs.shape == (4, 6)
    assert whole.provenance["cost"] == costs.min()
    with pytest.raises(ValueError, match=r"holds a search of other settings \(speed is 1.2 there and 0.9"):
        search(Search(SHORT, population=6, speed=0.9), tmp_path / "whole", 5, console)


def test_a_search_begins_with_a_gait(tmp_path, quick):
    pytest.importorskip("cma")
    first = search(Search(SHORT, population=6), tmp_path / "first", 1, study.Console(quiet=True))
    second = Search(SHORT, population=6, begin=first)
    assert unscaled(second.middle) == pytest.approx(first.values)
    assert json.loads(json.dumps(second.plain()))["middle"].keys() == SCALES.keys()


COMMAND = ("gait", TASK, "--device", "cpu", "--horizon", "8", "--population", "4", "--output")


def test_the_command_goes_on_with_a_broken_search(tmp_path, run):
    pytest.importorskip("cma")
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    for folder, generations in ((whole, 3), (broken, 1), (broken, 3)):
        status, _, err = run(*COMMAND, folder, "--physics", "fast", "--generations", generations)
        assert status == 0, err
        assert f"Saved {folder / study.GAIT}, cost" in err
    assert read_gait(broken / study.GAIT) == read_gait(whole / study.GAIT)
    for name in ("solutions", "costs"):
        found = [np.load(folder / study.SEARCH)[name] for folder in (whole, broken)]
        assert np.array_equal(*found)
    assert np.ptp(found[0]) > 0.0
    begin = tmp_path / "on"
    words = ("--generations", "1", "--physics", "fast", "--conditions", SUPPORT)
    _, _, err = run(*COMMAND, begin, "--begin", whole / study.GAIT, *words)
    assert f", searched with {SUPPORT}\n" in err
    assert read_gait(begin / study.GAIT).conditions == (SUPPORT,)
    recorded = json.loads((begin / study.SETTINGS).read_text())
    zero, one = np.array(list(SCALES.values())).T
    middle = zero + one * np.array(list(recorded["middle"].values()))
    assert middle == pytest.approx(read_gait(whole / study.GAIT).values)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--speed", "0"], "--speed must be positive and finite, got 0"),
        (["--spread", "inf"], "--spread must be positive and finite, got inf"),
        (["--population", "3"], "--population must be at least 4, got 3"),
        (["--generations", "0"], "--generations must be at least 1, got 0"),
        (["--starts", "0"], "--starts must be at least 1, got 0"),
        (["--begin", "none.json"], "none.json"),
        (["--output", "gait.txt/out"], "gait.txt"),
    ],
)
def test_wrong_settings_are_said_in_a_sentence(tmp_path, monkeypatch, run, words, message):
    (tmp_path / "gait.txt").write_text("a file")
    monkeypatch.chdir(tmp_path)
    status, _, err = run(*COMMAND, tmp_path / "out", *words)
    assert status != 0
    assert message in err
    assert err.count("\n") < 5
    assert not (tmp_path / "out").exists()

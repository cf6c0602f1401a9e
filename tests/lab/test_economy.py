"""An episode that failed has not succeeded; rates, speed and cost of transport are of those who stay up."""

import io
import re
from functools import lru_cache
from types import SimpleNamespace

import mujoco
import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from thrown import AHEAD, HOPPER, thrown

import myowarp
from myowarp.apps.cli.eval import print_table
from myowarp.apps.policies.baselines import baseline_folder
from myowarp.apps.policies.find import find_policy
from myowarp.apps.reports.evaluation import evaluate, evaluate_policy, plan_evaluation
from myowarp.apps.reports.intervals import wilson
from myowarp.apps.rollouts.episodes import Episodes, are_one
from myowarp.apps.rollouts.rollout import roll_out
from myowarp.apps.rollouts.run import run as run_policy
from myowarp.apps.studies.cohort.job import figures as cohort_figures
from myowarp.apps.studies.cohort.run import run_cohort
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.setup import Setup
from myowarp.sim.economy import UNITS, Economy, as_text, doubt, free_root
from myowarp.sim.signals import Signals
from myowarp.sim.simulation import Simulation
from myowarp.view.browser.session import Session
from myowarp.view.browser.status import status

WORLDS, SEED = 6, 3
FALLS, LAST = 15, 20  # control steps of 0.01 s
ROUNDING = 1e-5  # of float32 sums


@pytest.fixture(autouse=True)
def task(registered):
    return thrown()


def zero(obs):
    return np.zeros((len(obs), 2), np.float32)


@lru_cache
def by_hand():
    """Step worlds one by one; returns which fell, lengths, mean rates [W/kg] and speeds [m/s]."""
    task, rows = thrown(), []
    for world in range(WORLDS):
        env = MyoWarpVectorEnv(task, 1, device="cpu", autoreset_mode="disabled")
        signals = Signals(env.sim)
        obs, _ = env.reset(seed=SEED + world)
        first, rates, ended, solved = obs[0, :2].copy(), [], False, 0
        while not ended:
            obs, _, terminated, truncated, info = env.step(zero(obs))
            ended, solved = bool(terminated[0] | truncated[0]), solved + bool(info["solved"][0])
            rates.append(float(signals.whole_body["bhargava2004_per_kg"].numpy()[0]))
        assert solved == len(rates) > 5
        assert info["success"][0] == (not terminated[0])
        way = np.linalg.norm(obs[0, :2] - first)
        rows.append((terminated[0], len(rates), np.mean(rates), way / (0.01 * len(rates))))
        env.close()
    fell, lengths, rates, speeds = map(np.array, zip(*rows, strict=True))
    assert 0 < fell.sum() < WORLDS
    assert (lengths == np.where(fell, FALLS, LAST)).all()
    return fell, rates, speeds


@pytest.fixture
def known(task):
    return by_hand()


def test_success_ends_with_failure(task, known):
    fell, *_ = known
    sim = Simulation(task, WORLDS, device="cpu", autoreset="same_step", seed=SEED)
    episodes = Episodes(WORLDS)
    run_policy(sim, zero, LAST, episodes)
    first = episodes.first()
    np.testing.assert_array_equal(first["failed"], fell)
    np.testing.assert_array_equal(first["success"], ~fell)
    assert first["success_myosuite"].all()
    summary = roll_out(sim, find_policy("zero", task), LAST)
    assert (summary.failed, summary.success_percent) == (fell.sum(), 100.0 * (~fell).sum() / WORLDS)


def test_an_evaluation_has_the_economy_of_who_does_not_fall(task, known):
    """As by hand; the root's speed is near that of the throw, as limbs move beside it."""
    fell, rates, speeds = known
    sim = Simulation(task, WORLDS, device="cpu", autoreset="same_step", seed=SEED)
    found = evaluate(sim, zero, signals=Signals(sim))
    assert (found.failed, found.success, found.success_myosuite) == (fell.sum(), (~fell).mean(), 1.0)
    assert found.intervals["success"] == wilson((~fell).sum(), WORLDS)
    assert found.intervals["success_myosuite"] == wilson(WORLDS, WORLDS)
    assert not found.one_episode
    assert found.speed == pytest.approx(speeds[~fell].mean(), rel=ROUNDING)
    assert found.speed == pytest.approx(AHEAD, rel=0.3)
    assert found.bhargava2004_per_kg == pytest.approx(rates[~fell].mean(), rel=ROUNDING)
    assert abs(rates.mean() - rates[~fell].mean()) > 100 * ROUNDING * rates.mean()
    assert found.bhargava2004_per_kg_m == pytest.approx((rates / speeds)[~fell].mean(), rel=ROUNDING)


def test_where_all_fall_there_is_no_rate(task):
    sim = Simulation(thrown((0.0,)), 2, device="cpu", autoreset="same_step", seed=SEED)
    found = evaluate(sim, zero, signals=Signals(sim))
    assert (found.failed, found.success, found.success_myosuite) == (2, 0.0, 1.0)
    assert found.speed is found.bhargava2004 is found.bhargava2004_per_kg_m is None


def test_episodes_of_a_task_that_draws_nothing_are_one(task):
    still, drawn = Setup(task=thrown((4.0,)), reset="task"), Setup(task=task, reset="task")
    same = np.full(4, 20), np.full(4, 20.0)
    assert are_one(still, *same)
    assert are_one(still, same[0], 20.0 + np.array([0.0, 1e-3, 0.0, 1e-3]))
    assert not are_one(still, same[0], np.array([20.0, 21.0, 20.0, 20.0]))
    assert not are_one(still, np.array([20, 19, 20, 20]), same[1])
    assert not are_one(drawn, *same)
    assert not are_one(Setup(task=still.task, reset="random"), *same)
    assert not are_one(still, np.full(1, 20), np.full(1, 20.0))


def test_a_cohort_counts_falls_apart(task, known):
    fell, rates, speeds = known
    table = pd.DataFrame({"patient": ["a", "b"], "strength": [1.0, 1.0]})
    result = run_cohort(table, Setup(task=task, device="cpu", seed=SEED), "zero", trials=WORLDS)
    for name in ("a", "b"):
        own = result.summary[result.summary["patient"] == name]
        np.testing.assert_array_equal(own["failed"], fell)
        np.testing.assert_array_equal(own["success"], ~fell)
        np.testing.assert_allclose(own["bhargava2004_per_kg"], np.where(fell, np.nan, rates), rtol=ROUNDING)
        np.testing.assert_allclose(own["speed"], np.where(fell, np.nan, speeds), rtol=ROUNDING)
        cost = np.where(fell, np.nan, rates / speeds)
        np.testing.assert_allclose(own["bhargava2004_per_kg_m"], cost, rtol=ROUNDING)
    units = result.settings["units"]
    assert (units["speed"], units["bhargava2004_per_kg_m"]) == ("m/s", "J/kg/m")
    with Console(record=True, width=200, file=io.StringIO()) as console:
        console.print(cohort_figures(result))
    lines = [line.strip("│ ").split("│") for line in console.export_text().splitlines()]
    shown = {cells[0].strip(): cells[1].strip() for cells in lines if len(cells) == 2}
    share = f"{100 * (~fell).mean():.1f} %"
    assert shown["successful"] == f"{share} (more than 5 solved steps, no failure)"
    assert shown["solved on the last step"].endswith(" %")
    assert not [name for name in shown if name.startswith("by ")], "all are equally strong"
    mass = f"{mujoco.MjModel.from_xml_path(str(HOPPER)).body_mass.sum():.3g}"
    assert f"metabolic rate, Bhargava 2004 [W/kg of the model, {mass} kg]" in shown
    assert shown["failed"] == f"{2 * fell.sum()} of {2 * WORLDS} episodes"
    assert float(shown["speed [m/s]"]) == pytest.approx(speeds[~fell].mean(), rel=0.01)
    assert float(shown["cost of transport, Bhargava 2004 [J/kg/m]"]) == pytest.approx(
        (rates / speeds)[~fell].mean(), rel=0.01
    )


def test_who_stands_has_no_cost_of_transport(task):
    """Divided by a speed of rounding it would be anything."""
    sim = Simulation(thrown((4.0,)), 2, device="cpu", autoreset="disabled", seed=SEED)
    signals = Signals(sim)
    sim.reset(seeds=np.array([3, 4]))
    economy, root = Economy(sim, signals), free_root(sim.scene.oracle)
    places = signals.qpos.numpy()[:, root : root + 2].copy()
    sim.step()
    signals.qpos.numpy()[:, root : root + 2] = places + np.array([[1e-4, 0.0], [0.0, 0.02]])
    economy.see(np.ones(2, dtype=bool))
    found = economy.means()
    np.testing.assert_allclose(found["speed"], [0.01, 2.0], rtol=ROUNDING)
    assert np.isnan(found["bhargava2004_per_kg_m"]).tolist() == [True, False]


def test_only_a_free_root_that_muscles_move_has_a_speed():
    from myowarp.sim.build import oracle_model

    for name, place in (("myoElbowPose1D6MFixed-v0", -1), ("myoHandObjHoldFixed-v0", -1)):
        assert free_root(oracle_model(myowarp.TASKS[name])) == place
    assert free_root(oracle_model(thrown())) == 0


@pytest.mark.parametrize(
    ("figures", "text"),
    [
        ((4.4, 1.2, 3.667), "1.20 m/s, 4.4 W/kg, 3.7 J/kg/m"),
        ((1.3, 0.01, np.nan), "0.01 m/s, 1.3 W/kg"),
        ((np.nan, np.nan, np.nan), ""),
        ((1.3,), ""),
        ((42.0, 1.4, 30.0), "1.40 m/s, 42.0 W/kg (absurd: over 20), 30.0 J/kg/m"),
    ],
)
def test_a_walk_in_words(figures, text):
    names = ("bhargava2004_per_kg", "speed", "bhargava2004_per_kg_m")
    assert as_text(dict(zip(names, figures, strict=False))) == text


@pytest.mark.parametrize("rates", [(42.0, 3.0), (3.0, 42.0), (np.nan, 42.0), (None, 42.0)])
def test_an_absurd_rate_is_said_to_be_so(rates):
    """By either law, of a walk alone; a runner at 5 m/s spends 4 J/kg/m, which is no absurd rate."""
    names = ("bhargava2004_per_kg", "umberger2010_per_kg")
    figures, walks = dict(zip(names, rates, strict=True)), {"speed": 1.4}
    assert doubt(figures | walks).startswith("absurd metabolic rate: up to 42.0 W/kg, ")
    assert not doubt(figures)
    assert not doubt(dict.fromkeys(names, 4.0 * 5.0) | walks)
    assert not doubt(dict.fromkeys(names) | walks)


def test_a_page_says_that_it_failed_and_how_it_walks(task, known):
    """Success so far is none at the end of an episode that fails; the twin's figures stand beside."""
    fell, rates, speeds = known
    for world in (int(np.flatnonzero(fell)[0]), int(np.flatnonzero(~fell)[0])):
        setup = Setup(task=task, device="cpu", seed=SEED)
        session = Session("thrown", setup, WORLDS, "zero", lambda name, sim: zero)
        live = SimpleNamespace(session=session, playing=True, back=0.0, factor=1.0, message="")
        session.show(world)
        session.beside = True
        for step in range(FALLS if fell[world] else LAST):
            assert (">success so far<" in status(live)) == (step > 5)
            session.step()
        assert (">success so far<" in status(live)) == (not fell[world])
        assert (">failed<" in status(live)) == fell[world]
    walked = f"{speeds[world]:.2f} m/s, {rates[world]:.1f} W/kg, {rates[world] / speeds[world]:.1f} J/kg/m"
    assert f"{walked} since its start · before the change {walked}" in status(live)
    session.step()
    assert session.succeeded == 1
    assert ">failed<" not in status(live)


@pytest.mark.parametrize(
    ("actions", "got"),
    [
        (np.ones((3, 6), dtype=int), "must be floating point of shape (3, 6), got int64 of shape (3, 6)"),
        (np.ones((3, 5)), "must be floating point of shape (3, 6), got float64 of shape (3, 5)"),
        (np.full((3, 6), np.nan), "must be finite, got NaN or infinity for worlds [0, 1, 2]"),
        (np.full((3, 6), 1e300), ""),
    ],
)
def test_a_page_takes_the_actions_that_an_environment_takes(actions, got):
    setup = Setup(task="myoElbowPose1D6MRandom-v0", device="cpu")
    session = Session("elbow", setup, 2, "mine", lambda name, sim: lambda obs: actions)
    if got:
        with pytest.raises(ValueError, match=f"^actions {re.escape(got)}$"):
            session.step()
    else:
        session.step()
        assert (session.sim.action.numpy() == 1.0).all()


def test_drawn_actions_are_never_one_episode(monkeypatch):
    """However little their returns differ: here by less than what counts as the same."""
    monkeypatch.setattr("myowarp.apps.rollouts.episodes.SAME_EPISODES", 1.0)
    job = plan_evaluation(baseline_folder("myoFingerReachFixed-v0"), episodes=8, device="cpu")
    _, figures = evaluate_policy(job)
    assert figures["deterministic"]["one_episode"]
    assert not figures["sampled"]["one_episode"]


def test_eval_prints_rules_units_and_one_episode(capsys, monkeypatch):
    """A unit such as m/s is no markup; without a spread there is no interval."""
    monkeypatch.setenv("COLUMNS", "200")
    names = ("success", "success_last", "success_any", "success_myosuite")
    figures = dict.fromkeys(UNITS, 1.234) | dict.fromkeys(names, 1.0)
    figures |= {"intervals": dict.fromkeys(names, (0.5, 1.0)), "return_mean": 20.0, "return_std": 1e-9}
    figures |= {"mean_activation": None, "activation_rate": None, "length_mean": 20.0, "reachable": None}
    figures |= {"body_mass": 1.49}
    figures |= {"episodes": 4, "failed": 1, "faults": 0}
    head = {"task": "thrown", "physics": "parity", "conditions": [], "seed": 0}
    one, many = figures | {"one_episode": True}, figures | {"one_episode": False}
    many["umberger2010_per_kg"], many["success_last"] = 42.0, 0.25
    print_table(head, {"deterministic": one, "sampled": many})
    said = capsys.readouterr().out
    for text in ("length [steps]", "speed [m/s]", "cost of transport, Bhargava 2004 [J/kg/m]", "failed"):
        assert text in said
    assert said.count("100 % (one episode)") == 1 + said.count("100.0 % (50.0 to 100.0)") == 4
    assert "metabolic rate, Bhargava 2004 [W/kg of the model, 1.49 kg]" in said
    passed = "sampled: 100 % succeed (more than 5 solved steps, no failure), but 25 % are at the goal"
    assert said.count(passed) == said.count("pass through") == 1
    assert "more than 5 solved steps, failed or not (MyoSuite)" in said
    assert re.search(r"return +│ 20.0 +│ 20.0 ± 0.0", said)
    assert said.count("absurd") == said.count("sampled: absurd metabolic rate: up to 42.0 W/kg") == 1
    print_table(head, {"sampled": many | {"speed": None}})
    said = capsys.readouterr().out
    assert "mean activation" in said
    assert "metabolic" not in said

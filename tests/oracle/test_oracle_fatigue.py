"""3CC-r against recorded episodes of MyoSuite 3.0.0's `myoFati...` ids (tests/data/README.md)."""

import os
from functools import lru_cache
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from reference import fatigue_3ccr

import myowarp  # noqa: F401  (registers the ids)
from myowarp.definitions.task import TASKS
from myowarp.models.conditions.fatigue_3ccr import Fatigue3CCR
from myowarp.sim.simulation import Simulation

DATA = Path(os.environ.get("MYOWARP_ORACLE", Path(__file__).parents[1] / "data/myosuite"))
RECORDED = {
    f"myo{name}": f"myoFati{name}"
    for name in ("FingerPoseFixed-v0", "ElbowPose1D6MRandom-v0", "HandPoseRandom-v0")
}

COMPARTMENTS = ("active", "resting", "fatigued")
TIME_CONSTANTS = (0.01, 0.04)  # s, of every muscle of MyoSuite
DT = 0.02  # s, control step of these ids

STEP = 1e-6  # fractions of order one over an episode in float32
DOUBLE = 1e-14  # float64 against float64
EFFECT = 10.0


@lru_cache
def recorded(key):
    """Return what was recorded of the fatigued variant of a task."""
    with np.load(DATA / f"{RECORDED[key]}.npz") as file:
        return {name: file[name] for name in file.files}


def simulation(key, num_worlds, conditions):
    return Simulation(
        TASKS[key], num_worlds, conditions=conditions, device="cpu", graph=False, progress=False
    )


def compartments(effect):
    return [getattr(effect.state, f"{name}_fraction").numpy() for name in COMPARTMENTS]


@pytest.mark.parametrize("key", RECORDED)
def test_reference_is_upstream(key):
    """The float64 reference itself, in every recorded step."""
    record = recorded(key)
    rates = [record[f"rate_{name}"] for name in ("fatigue", "recovery", "rest_factor")]
    state = [record[f"step_{name}_before"] for name in COMPARTMENTS]
    after = fatigue_3ccr.step(state, record["step_target_load"], rates, TIME_CONSTANTS, DT)
    for values, name in zip(after, COMPARTMENTS, strict=True):
        np.testing.assert_allclose(values, record[f"step_{name}"], atol=DOUBLE)


@pytest.mark.parametrize("key", RECORDED)
def test_episodes_of_commands(key):
    """Whole episodes from fresh, given and drawn states: control and compartments."""
    record = recorded(key)
    actions, starts = record["episode_action"], record["episode_start"]
    given = starts == "given"
    initial = np.where(given[:, None], record["reset_fatigued"], 0.0)
    sim = simulation(key, len(actions), Fatigue3CCR(initial=initial))
    effect = sim.shards[0].effects[0]
    fresh = starts != "drawn"
    for values, name in zip(compartments(effect), COMPARTMENTS, strict=True):
        np.testing.assert_allclose(values[fresh], record[f"reset_{name}"][fresh], atol=STEP)
    effect.state.active_fraction.assign(record["reset_active"])
    effect.state.fatigued_fraction.assign(record["reset_fatigued"])
    met = 0
    for step in range(1, actions.shape[1] + 1):
        sim.action.assign(np.nan_to_num(actions[:, step - 1]))
        sim.shards[0].launch_action()
        command = sim.scene.data.ctrl.numpy().copy()
        sim.shards[0].launch_conditions()
        ctrl = sim.scene.data.ctrl.numpy()
        for row in np.flatnonzero(record["step_step"] == step):
            world = record["step_episode"][row]
            np.testing.assert_allclose(ctrl[world], record["step_ctrl"][row], atol=STEP)
            for values, name in zip(compartments(effect), COMPARTMENTS, strict=True):
                np.testing.assert_allclose(values[world], record[f"step_{name}"][row], atol=STEP)
            assert np.abs(ctrl[world] - command[world]).max() > EFFECT * STEP
            met += 1
    assert met == len(record["step_step"]) > 60


@pytest.mark.parametrize("key", RECORDED)
def test_rates_are_upstreams(key):
    record = recorded(key)
    effect = simulation(key, 1, "fatigue_3ccr").shards[0].effects[0]
    fields = {
        "fatigue_rate": "fatigue",
        "recovery_rate": "recovery",
        "rest_recovery_factor": "rest_factor",
    }
    for name, field in fields.items():
        values = getattr(effect.params, name).start.numpy()[0]
        np.testing.assert_array_equal(values, record[f"rate_{field}"].astype(np.float32))


def test_id_shows_fatigue():
    env = gym.make_vec("MyoWarp/myoFatiElbowPose1D6MRandom-v0", num_envs=2, device="cpu", progress=False)
    env.reset(seed=0)
    for _ in range(3):
        info = env.step(np.full((2, 6), 0.9, dtype=np.float32))[4]
    assert info["fatigue"].shape == (2, 6)
    assert 1e-4 < info["fatigue"].min() < info["fatigue"].max() < 1e-2
    env.close()

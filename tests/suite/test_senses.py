"""What an environment observes besides: a history, and parameters of conditions."""

import numpy as np
import pytest

from myowarp import make_vec
from myowarp.definitions.task import TASKS
from myowarp.models.conditions import Ramp, Sarcopenia, Uniform
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import get_state, set_state

TASK, WORLDS, STEPS = "myoElbowPose1D6MRandom-v0", 5, 3
WEAK = Sarcopenia(Ramp(1.0, Uniform(0.1, 0.6), onset=Uniform(0.04, 0.2)))


def simulation(**options):
    options = {"graph": False, "progress": False, "seed": 3, "device": "cpu", "horizon": 6} | options
    return Simulation(TASK, WORLDS, **options)


@pytest.mark.parametrize("autoreset", ["same_step", "next_step"])
def test_a_history_is_what_was_observed_and_done(autoreset):
    """Beside a list kept by hand, over ends of episodes and a reset of some worlds alone."""
    sim = simulation(observe=("history=3",), autoreset=autoreset)
    sim.reset(seeds=np.arange(WORLDS))
    size, rng = simulation().transition.obs.shape[1], np.random.default_rng(0)
    past = [[] for _ in range(WORLDS)]
    for step in range(16):
        obs = sim.transition.obs.numpy().copy()
        action = rng.uniform(-1.5, 1.5, sim.action.shape).astype(np.float32)
        sim.action.assign(action)
        fresh = sim.episode.ended.numpy().copy() if autoreset == "next_step" else np.zeros(WORLDS, bool)
        sim.step()
        ended = sim.transition.terminated.numpy() | sim.transition.truncated.numpy()
        for world in range(WORLDS):
            past[world] = [np.concatenate((obs[world, :size], action[world].clip(-1, 1))), *past[world]]
            if fresh[world] or (ended[world] and autoreset == "same_step"):
                past[world] = []
        if step == 3:
            mask = np.arange(WORLDS) == 2
            sim.reset(mask=mask)
            past[2] = []
        now = sim.transition.obs.numpy()
        for world, rows in enumerate(past):
            expected = np.zeros((STEPS, size + action.shape[1]), np.float32)
            for k, row in enumerate(rows[:STEPS]):
                expected[k] = row
            np.testing.assert_array_equal(now[world, size:], expected.ravel())


def test_a_history_is_state():
    """Whoever sets a state back observes what was observed then, and what follows is the same."""
    sim = simulation(observe=("history=3",))
    sim.reset(seeds=np.arange(WORLDS))
    rng = np.random.default_rng(1)
    actions = rng.uniform(-1, 1, (8, *sim.action.shape)).astype(np.float32)

    def go(steps):
        for action in actions[steps]:
            sim.action.assign(action)
            sim.step()
        return sim.transition.obs.numpy().copy()

    then = go(slice(0, 4))
    state = get_state(sim)
    after = go(slice(4, 6))
    assert (after != then).any()
    set_state(sim, state)
    np.testing.assert_array_equal(sim.transition.obs.numpy(), then)
    np.testing.assert_array_equal(go(slice(4, 6)), after)


def test_told_parameters_are_those_that_act():
    sim = simulation(observe=("parameters",), conditions=(WEAK,), horizon=30)
    plain = simulation(conditions=(WEAK,), horizon=30)
    for each in (sim, plain):
        each.reset(seeds=np.arange(WORLDS))
    size, seen = plain.transition.obs.shape[1], []
    assert sim.columns[-1].names == tuple(f"sarcopenia strength {name}" for name in sim.scene.muscles.names)
    np.testing.assert_array_equal(sim.transition.obs.numpy()[:, size:], 1.0)
    for _ in range(15):
        sim.step()
        plain.step()
        sim.shards[0].launch_conditions()  # what the next step will have
        told = sim.transition.obs.numpy()
        np.testing.assert_array_equal(told[:, size:], sim.scene.muscles.anatomy.strength.numpy())
        np.testing.assert_array_equal(told[:, :size], plain.transition.obs.numpy())
        seen.append(told[:, size].copy())
    assert (np.array(seen) == 1.0).any(axis=0).all()
    assert (seen[-1] < 0.61).all()


def test_senses_follow_each_other_in_a_vector_environment():
    env = make_vec(TASK, WORLDS, observe=("parameters", "history=2"), conditions=(WEAK,), device="cpu")
    names = [column.name for column in env.sim.columns]
    assert names[-2:] == ["parameters", "history"]
    obs, _ = env.reset(seed=0)
    assert obs.shape == env.observation_space.shape
    env.close()


@pytest.mark.parametrize(
    ("observe", "message"),
    [
        ("memory", r"^observe must be parameters, or history=STEPS with 1 to 1000 steps, got 'memory'$"),
        ("history", r"got 'history'$"),
        ("history=0", r"got 'history=0'$"),
        ("history=2.5", r"got 'history=2\.5'$"),
        (("history=2", "history=3"), r"^observe must name each sense once, got history=2 history=3$"),
        ("parameters", r"^observe parameters needs conditions, which have them; got none$"),
    ],
)
def test_wrong_senses(observe, message):
    with pytest.raises(ValueError, match=message):
        make_vec(TASKS[TASK].env_id, 2, observe=observe, device="cpu")

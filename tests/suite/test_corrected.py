"""Rewards of key turn and baoding where we correct MyoSuite, and targets that jump.

The corrected balls are in `test_corrected_balls.py`.
"""

from dataclasses import replace
from fractions import Fraction
from functools import lru_cache

import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from configurations import configurations
from stepping import engine_alone

from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation
from myowarp.tasks.baoding import BaodingProgram
from myowarp.tasks.baoding_orbits import OrbitRanges

NUM_WORLDS = 200
HORIZON = 200  # control steps, of both families

VALUE_TOLERANCE = 1e-5  # of terms and rewards per unit of weight, float32

CORRECTED = ("myoHandBaodingFixed-v1", "myoHandBaodingRandom-v1", "myoHandBaodingSwap-v0")
FARTHEST = 0.19  # m from a target to a ball that touches the hand; measured over 4000 postures


@lru_cache
def simulation(key, num_worlds=NUM_WORLDS):
    """Return a freshly reset simulation."""
    sim = Simulation(TASKS[key], num_worlds, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.arange(num_worlds))
    return sim


def scored(sim, step=1):
    """Return reward, terms, solved and failed of the present state of all worlds."""
    sim.episode.step_count.assign(np.broadcast_to(step, sim.num_worlds).astype(np.int32))
    sim.episode.ended.zero_()
    sim.transition.fault.zero_()
    sim.transition.terms.fill_(np.nan)
    sim.shards[0].program.advance(sim.episode.step_count)
    sim.shards[0].launch_scoring()
    t = sim.transition
    terms = {term.name: column for term, column in zip(sim.terms, t.terms.numpy().T, strict=True)}
    return t.reward.numpy(), terms, t.solved.numpy(), t.terminated.numpy()


def failing_pays(living, failing):
    """Whether some episode that fails is worth more than living on, both at the worst that steps can cost.

    Args:
        living: Reward of the worst step without failure.
        failing: Reward of the best step that fails.
    """
    return any(failing + step * living >= HORIZON * living for step in range(HORIZON))


def place_tips(sim, index_error, thumb_error, angle, activation):
    """Put the tips as far off the key head as wanted, and turn the key; all (num_worlds,)."""
    data, program, rng = sim.scene.data, sim.shards[0].program, np.random.default_rng(0)
    sites, qpos = data.site_xpos.numpy(), data.qpos.numpy()
    for site, error in ((program.index_site, index_error), (program.thumb_site, thumb_error)):
        direction = rng.normal(size=(sim.num_worlds, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        sites[:, site] = sites[:, program.key_site] + (0.03 + error)[:, None] * direction
    qpos[:, 23] = angle
    sim.scene.muscles.activation.assign(np.broadcast_to(activation, sim.scene.muscles.activation.shape))


def key_states():
    """Return errors of both tips [m], angles [rad], activations that reach every branch."""
    rng = np.random.default_rng(1)
    a, b = rng.uniform(0, 0.15, (2, NUM_WORLDS))
    return a, b, rng.uniform(-7, 7, NUM_WORLDS), rng.uniform(size=(NUM_WORLDS, 39))


@pytest.mark.parametrize("variant", ["Fixed", "Random"])
def test_key_reward(variant):
    """Version 1 against NumPy; it is version 0 and 60 for every step without failure."""
    a, b, q, activation = key_states()
    sims = [simulation(f"myoHandKeyTurn{variant}-v{version}") for version in (0, 1)]
    for sim in sims:
        place_tips(sim, a, b, q, activation)
    lost = (a > 0.1) | (b > 0.1)
    effort = np.linalg.norm(activation, axis=1) / 39
    expected = q - 10 * a - 10 * b - effort + 4.0 * (q > np.pi / 2) + 4.0 * (q > np.pi)
    expected -= 25.0 * (a > 0.05) + 25.0 * (b > 0.05)
    (old, old_terms, _, _), (new, terms, _, failed) = map(scored, sims)
    np.testing.assert_allclose(old, expected, atol=76 * VALUE_TOLERANCE)
    np.testing.assert_allclose(new, expected + 60.0 * ~lost, atol=136 * VALUE_TOLERANCE)
    assert set(terms) - set(old_terms) == {"alive"}
    np.testing.assert_array_equal(terms["alive"], ~lost)
    np.testing.assert_array_equal(failed, lost)
    assert 0.2 < lost.mean() < 0.8


@pytest.mark.parametrize(("key", "goal"), [("Fixed-v0", 3.14), ("Fixed-v1", np.pi), ("Random-v1", 2 * np.pi)])
def test_key_is_solved_at(key, goal):
    sim = simulation(f"myoHandKeyTurn{key}")
    angle = np.full(NUM_WORLDS, goal + 1e-4)
    angle[::2] -= 2e-4
    place_tips(sim, 0 * angle, 0 * angle, angle, 0.0)
    np.testing.assert_array_equal(scored(sim)[2], angle > goal)


@pytest.mark.parametrize(("version", "pays"), [(0, True), (1, False)])
def test_letting_go_of_the_key(version, pays):
    """The worst living step: both tips nearly lost, full effort, a revolution the wrong way."""
    sim = simulation(f"myoHandKeyTurnRandom-v{version}")
    error, angle = np.full(NUM_WORLDS, 0.0999), np.full(NUM_WORLDS, -2 * np.pi)
    activation = np.ones((NUM_WORLDS, 39))
    best = np.arange(NUM_WORLDS) % 2 == 0  # one tip just lost, the other right, no effort, the key turned
    index_error = np.where(best, 0.1001, error)
    place_tips(sim, index_error, error * ~best, np.where(best, -angle, angle), activation * ~best[:, None])
    reward, _, _, failed = scored(sim)
    np.testing.assert_array_equal(failed, best)
    assert failing_pays(reward[~best].min(), reward[best].max()) == pays


def targets(sim, step):
    """Return where both targets are in the world, shape (num_worlds, 2, 3), and their revolutions."""
    orbits, spec, data = sim.shards[0].program.orbits, sim.scene.spec, sim.scene.data
    turns = (np.asarray(step) - 1) * spec.control_dt / orbits.period.numpy().astype(float)
    if spec.orbits.jumps:
        turns = np.floor(turns * spec.orbits.jumps + 1e-6) / spec.orbits.jumps
    first = orbits.start_angle.numpy() + 2 * np.pi * orbits.direction.numpy() * turns
    angles = np.stack([first, first - np.pi], axis=1)
    local = np.full((sim.num_worlds, 2, 3), (-0.0125, -0.07, -0.02))
    local[:, :, 0] += orbits.radii.numpy()[:, :1] * np.cos(angles)
    local[:, :, 1] += orbits.radii.numpy()[:, 1:] * np.sin(angles)
    palm = data.site_xpos.numpy()[:, sim.shards[0].program.palm_site].astype(float)
    frame = data.site_xmat.numpy()[:, sim.shards[0].program.palm_site].astype(float)
    return palm[:, None] + np.einsum("wij,wbj->wbi", frame, local), turns


def write_balls(sim, positions):
    """Put both balls somewhere, shape (num_worlds, 2, 3)."""
    qpos = sim.scene.data.qpos.numpy()
    qpos[:, 23:26], qpos[:, 30:33] = positions[:, 0], positions[:, 1]


def take_postures(sim):
    """Take random postures of the hand, and activations."""
    rng, model = np.random.default_rng(2), sim.scene.oracle
    sim.scene.data.qpos.assign(configurations(model, sim.scene.spec.start(model), NUM_WORLDS, 0))
    sim.scene.muscles.activation.assign(rng.uniform(size=(NUM_WORLDS, 39)))
    engine_alone(mjw.kinematics)(sim.scene.model, sim.scene.data)


@pytest.mark.parametrize("key", CORRECTED)
def test_baoding_reward(key):
    """Against NumPy, at the steps of a whole episode, in every branch."""
    sim, rng, step = simulation(key), np.random.default_rng(3), np.arange(1, NUM_WORLDS + 1)
    take_postures(sim)
    points, turns = targets(sim, step)
    distance = rng.choice([0.005, 0.014, 0.016, 0.1], (NUM_WORLDS, 2))
    direction = rng.normal(size=(NUM_WORLDS, 2, 3))
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    positions = points + distance[:, :, None] * direction
    low = rng.uniform(size=(NUM_WORLDS, 2)) < 0.1
    positions[low, 2] = 1.2
    distance = np.linalg.norm(points - positions, axis=2)
    write_balls(sim, positions)
    reward, terms, solved, failed = scored(sim, step)

    near, fallen = distance < 0.015, (positions[:, :, 2] < 1.25).any(axis=1)
    effort = np.linalg.norm(sim.scene.muscles.activation.numpy(), axis=1) / 39
    bonus = near.sum(axis=1) + 4 * near.all(axis=1)
    expected = {"pos_dist_1": -distance[:, 0], "pos_dist_2": -distance[:, 1], "sparse": -distance.sum(axis=1)}
    expected |= {"act_reg": -effort, "drop": -1.0 * fallen, "bonus": bonus}
    assert set(terms) == set(expected)
    for name, values in expected.items():
        np.testing.assert_allclose(terms[name], values, atol=VALUE_TOLERANCE, err_msg=name)
    total = -5 * distance.sum(axis=1) - effort + bonus - 500 * fallen
    np.testing.assert_allclose(reward, total, atol=VALUE_TOLERANCE * 512)
    begun = turns > 0 if "Swap" in key else True
    np.testing.assert_array_equal(solved, near.all(axis=1) & ~fallen & begun)
    np.testing.assert_array_equal(failed, fallen)
    assert set(bonus) == {0, 1, 6}
    assert 0 < fallen.mean() < 1
    assert 0 < solved.sum() < (near.all(axis=1) & ~fallen).sum() or "Swap" not in key


@pytest.mark.parametrize(("key", "pays"), [("Random-v0", True), ("Random-v1", False), ("Swap-v0", False)])
def test_dropping_a_ball(key, pays):
    """The worst living step: both balls at the far end of the hand, full effort."""
    sim = simulation(f"myoHandBaoding{key}")
    take_postures(sim)
    points, _ = targets(sim, 1)
    best = np.arange(NUM_WORLDS) % 2 == 0  # one ball on its target, the other just fallen, no effort
    positions = points + np.where(best, 0.0, FARTHEST)[:, None, None] * (0, 0, 1)
    positions[best, 1, 2] = 1.2499
    write_balls(sim, positions)
    activation = sim.scene.muscles.activation
    activation.assign(np.broadcast_to(~best[:, None], activation.shape))
    reward, _, _, failed = scored(sim)
    np.testing.assert_array_equal(failed, best)
    assert failing_pays(reward[~best].min(), reward[best].max()) == pays


def test_swap():
    """The balls have to hold for 100 steps; then the targets change places, once."""
    sim = simulation("myoHandBaodingSwap-v0")
    seen = []
    for step in range(1, HORIZON + 1):
        scored(sim, step)
        seen.append(sim.shards[0].program.target.numpy()[0].copy())
    before, after = np.split(np.array(seen), 2)
    offset = np.array([0.025, 0.028, 0.0]) / np.sqrt(2)
    expected = np.array([offset, -offset]) + np.array([-0.0125, -0.07, -0.02])
    np.testing.assert_allclose(before, np.broadcast_to(expected, before.shape), atol=VALUE_TOLERANCE)
    np.testing.assert_allclose(after, np.broadcast_to(expected[::-1], after.shape), atol=VALUE_TOLERANCE)


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize(("jumps", "period"), [(2, "5"), (4, "6"), (8, "6"), (2, "1.45"), (6, "2.4")])
def test_targets_jump_in_time(jumps, period, direction):
    """At every step of an episode, against exact fractions; rounding would delay jumps of the last two."""
    sim = simulation("myoHandBaodingSwap-v0")
    ranges = OrbitRanges(directions=(direction,), period=2 * (float(period),), jumps=jumps)
    program = BaodingProgram(replace(sim.scene.spec, orbits=ranges), replace(sim.scene, state={}))
    steps = np.arange(1, HORIZON + 1)
    program.sample_goal(wp.ones(NUM_WORLDS, dtype=bool))
    program.advance(wp.array(steps, dtype=int))
    done = [int((step - 1) * Fraction("0.025") * jumps / Fraction(period)) for step in steps.tolist()]
    assert max(done) >= 1
    angle = np.pi / 4 + direction * 2 * np.pi * np.array(done) / jumps
    expected = np.stack([0.025 * np.cos(angle) - 0.0125, 0.028 * np.sin(angle) - 0.07], axis=1)
    np.testing.assert_allclose(program.target.numpy()[:, 0, :2], expected, atol=VALUE_TOLERANCE)

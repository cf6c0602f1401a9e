"""What holds for everything registered, without anything being named here."""

from functools import cache

import numpy as np
import pytest
import warp as wp
from often import goals, of_each
from structs import fields, is_struct

from myowarp.definitions.body import BODIES
from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation

KEYS = sorted(TASKS)
SCENES = sorted({TASKS[key].scene_key: key for key in KEYS}.values())
NUM_STEPS = 12
HORIZON = 5  # so that resets happen within the test


def actions(num_worlds, num_actions):
    """Actions of worlds 0, 1, ...: those of a smaller batch are a prefix of those of a larger."""
    draws = [
        np.random.default_rng(world).uniform(-1, 1, (NUM_STEPS, num_actions)) for world in range(num_worlds)
    ]
    return np.stack(draws, axis=1).astype(np.float32)


def simulation(key, num_worlds, **options):
    """Return a simulation whose episodes are short."""
    settings = {"device": "cpu", "autoreset": "same_step", "horizon": HORIZON, "progress": False} | options
    sim = Simulation(TASKS[key], num_worlds, **settings)
    graphs = [graph for graph in (sim.shards[0].step_graph, sim.shards[0].reset_graph) if graph is not None]
    assert all(graph.replay for graph in graphs), "left to Warp"
    return sim


def trajectory(sim, disturb=None):
    """Return observations, rewards, endings and faults of a short run with resets."""
    sim.reset(seeds=100 + np.arange(sim.num_worlds))
    rows = {name: [] for name in ("obs", "reward", "terminated", "truncated", "fault")}
    for step, action in enumerate(actions(sim.num_worlds, sim.action.shape[1])):
        if disturb is not None:
            disturb(sim, step)
        sim.action.assign(action)
        sim.step()
        for name, values in rows.items():
            values.append(getattr(sim.transition, name).numpy().copy())
    return {name: np.stack(values) for name, values in rows.items()}


@cache
def few(key):
    """Return the trajectory of seven worlds."""
    return trajectory(simulation(key, 7))


def assert_same(first, second, worlds):
    """Assert that two runs agree bit for bit in some worlds."""
    for name, values in first.items():
        np.testing.assert_array_equal(values[:, worlds], second[name][:, worlds], err_msg=name)


@pytest.mark.parametrize("key", KEYS)
def test_spec_is_complete(key):
    spec = TASKS[key]
    assert spec.key == key
    assert spec.body in BODIES
    assert spec.doc.endswith(".")
    assert spec.horizon > 0
    assert spec.num_substeps > 0
    names = [term.name for term in spec.reward_terms()]
    assert len(set(names)) == len(names)
    assert any(term.weight for term in spec.reward_terms())


MOST_DEAD = {"relocate": 4}  # height and turn of the bin, which phase 2 draws


@cache
def walked(key):
    """Return what resets draw, the first two and both again, and which observation columns vary.

    Columns vary over random motion and episodes; all are finite.
    """
    n = 13  # no other array of a program is of this length
    sim = simulation(key, n)
    draws = []
    for seeds in (np.arange(n), None, np.arange(n), None):
        sim.reset(seeds=seeds)
        draws.append(drawn(sim))
    obs = trajectory(sim)["obs"]
    assert np.isfinite(obs).all()
    return draws, obs.reshape(-1, obs.shape[2]).std(axis=0) > 0


def alive(key):
    """Return which observation columns vary."""
    return walked(key)[1]


@pytest.mark.parametrize("key", of_each(KEYS))
def test_observation_is_alive(key):
    """No observation column is constant but where it shows a goal, alone, that other variants draw."""
    spec = TASKS[key]
    if alive(key).all():
        return
    variants = [k for k in KEYS if (TASKS[k].family, TASKS[k].body) == (spec.family, spec.body)]
    variants = [k for k in variants if len(alive(k)) == len(alive(key))]
    same = [k for k in variants if TASKS[k].version == spec.version]
    if any(draw.varies for k in same for draw in TASKS[k].draws):  # else what draws was not corrected
        variants = same
    assert np.any([alive(k) for k in variants], axis=0).all()
    num_dead = np.count_nonzero(~alive(key))
    assert num_dead <= MOST_DEAD.get(spec.family, 3), "more than one vector is constant"


@pytest.mark.parametrize("key", of_each(SCENES))
def test_world_is_independent_of_the_batch(key):
    """World i goes the same way among 7 and among 64 worlds, resets included."""
    small, large = few(key), trajectory(simulation(key, 64))
    assert small["truncated"].any()
    assert np.unique(small["obs"][0], axis=0).shape[0] == 7
    assert_same(small, large, slice(0, 7))


@pytest.mark.parametrize("key", of_each(SCENES))
def test_eager_is_the_graph(key):
    assert_same(few(key), trajectory(simulation(key, 7, graph=False)), slice(0, 7))


@pytest.mark.parametrize("key", [key for key in SCENES if "Elbow" in key or "HandReach" in key])
def test_world_is_independent_of_a_large_batch(key):
    assert_same(few(key), trajectory(simulation(key, 256)), slice(0, 7))


@pytest.mark.parametrize("autoreset", ["same_step", "next_step"])
@pytest.mark.parametrize("key", of_each(SCENES))
def test_a_broken_world_breaks_alone(key, autoreset):
    """NaN in one world's qvel: flagged once, ended, reset; the others do not notice, bit for bit."""
    broken, moment = 3, 2

    def disturb(sim, step):
        if step == moment:
            sim.scene.data.qvel.numpy()[broken] = np.nan

    sim = simulation(key, 7, autoreset=autoreset, horizon=100)
    whole, hurt = trajectory(sim), trajectory(sim, disturb)
    assert_same(whole, hurt, np.arange(7) != broken)
    flagged = np.zeros(NUM_STEPS, dtype=bool)
    flagged[moment] = True
    np.testing.assert_array_equal(hurt["fault"][:, broken] == 1, flagged)
    np.testing.assert_array_equal(hurt["terminated"][:, broken] & flagged, flagged)
    assert hurt["reward"][moment, broken] == 0
    assert np.isfinite(hurt["obs"]).all()
    assert not np.array_equal(whole["obs"][-1, broken], hurt["obs"][-1, broken])


def drawn(sim):
    """Return all that a reset can draw, one row per world: state, goals, and the model's fields."""
    data, model = sim.scene.data, sim.scene.model
    arrays = [data.qpos, data.mocap_pos, data.mocap_quat]
    arrays += [getattr(model, name) for name in sim.scene.spec.batched]
    for value in vars(sim.shards[0].program).values():
        members = fields(value).values() if is_struct(value) else [value]
        arrays += [m for m in members if isinstance(m, wp.array) and m.shape[0] == sim.num_worlds]
    return np.concatenate([array.numpy().reshape(sim.num_worlds, -1) for array in arrays], axis=1)


@pytest.mark.parametrize("key", of_each(KEYS, goals))
def test_seed_decides(key):
    """The seed of a world decides what it draws, episode after episode; random ids draw, fixed ids do not."""
    (first, second, *again), _ = walked(key)
    np.testing.assert_array_equal(again, [first, second])
    if any(name in key for name in ("Random", "Rough", "TerrainWalk-v1", "P2", "Reorient", "Relocate")):
        assert not np.array_equal(first, second)
        assert len(np.unique(first, axis=0)) == len(first)
    elif not getattr(TASKS[key], "random_start", False):
        np.testing.assert_array_equal(first, second, f"{key} draws, but has no Random in its name")
        assert len(np.unique(first, axis=0)) == 1


@pytest.mark.parametrize("key", of_each(SCENES))
def test_masked_reset_touches_only_its_worlds(key):
    sim = Simulation(TASKS[key], 6, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.arange(6))
    sim.action.assign(actions(6, sim.action.shape[1])[0])
    sim.step()
    data = sim.scene.data
    arrays = (data.qpos, data.qvel, sim.scene.muscles.activation, sim.transition.obs, sim.episode.step_count)
    before = [array.numpy().copy() for array in arrays]
    mask = np.array([False, True, False, False, True, False])
    sim.reset(mask)
    for array, old in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(array.numpy()[~mask], old[~mask])
    start = np.zeros(sim.scene.oracle.nv) + getattr(TASKS[key], "start_velocity", 0.0)
    np.testing.assert_array_equal(sim.scene.data.qvel.numpy()[mask], np.float32([start, start]))
    assert not sim.episode.step_count.numpy()[mask].any()
    assert np.abs(before[1][mask]).max() > 0

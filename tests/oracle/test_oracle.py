"""Every upstream id against values recorded from MyoSuite 3.0.0 (tests/data/README.md).

States are written in, so that observation, reward terms, done and solved are compared without physics;
physics is compared on its own, over one control step from recorded states.
"""

import json
import os
from pathlib import Path

import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from contact_oracle import KEYS, recorded_ids
from stepping import engine_alone, repeated_step

from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation

DATA = Path(os.environ.get("MYOWARP_ORACLE", Path(__file__).parents[1] / "data/myosuite"))
WALKING = ("walk", "directional", "terrain")
UPSTREAM = [key for key in recorded_ids(DATA) if key not in KEYS and TASKS[key].family not in WALKING]
"""Ids of upstream, those that were recorded; tasks with objects: test_oracle_contact.py; walking:
test_oracle_walk.py."""

NUM_WORLDS = 512
VALUE_TOLERANCE = 1e-5  # observation and reward terms, in their units; float32 against float64
EDGE = 1e-5  # distances this close to a threshold may fall on either side of it in float32
QPOS_TOLERANCE = 1e-4  # rad, median over states, one control step
ACTIVATION_TOLERANCE = 1e-6  # ten steps of float32


@pytest.fixture(scope="module", params=UPSTREAM)
def key(request):
    """Return an id; its tests come one after the other and share what follows."""
    return request.param


@pytest.fixture(scope="module")
def record(key):
    """Return what was recorded for an id, arrays by name; fails if nothing was."""
    with np.load(DATA / f"{key}.npz") as file:
        return dict(file)


@pytest.fixture(scope="module")
def sim(key):
    """Return a simulation of more worlds than there are recorded states."""
    return Simulation(TASKS[key], NUM_WORLDS, device="cpu", graph=False, progress=False)


def written(sim, record, prefix, steps):
    """Put the first worlds into the recorded states, scored and observed; return how many these are."""
    data, n = sim.scene.data, len(record[f"{prefix}_qpos"])
    rows = {"qpos": data.qpos, "qvel": data.qvel, "target": sim.shards[0].program.target}
    if sim.scene.muscles.activation.size:
        rows["act"] = sim.scene.muscles.activation
    for name, array in rows.items():
        array.numpy()[:n] = record[f"{prefix}_{name}"].reshape(n, -1)
    sim.episode.step_count.numpy()[:n] = steps
    sim.episode.ended.zero_()
    sim.transition.fault.zero_()
    everywhere = wp.ones(sim.num_worlds, dtype=bool)
    sim.transition.obs.fill_(np.nan)
    sim.transition.terms.fill_(np.nan)
    engine_alone(mjw.kinematics)(sim.scene.model, data)
    sim.shards[0].program.observe(everywhere, sim.transition.obs)
    sim.shards[0].launch_scoring()
    return n


def away_from_edges(sim, record, prefix):
    """Return the states whose distance is not within rounding of a threshold."""
    spec = TASKS[sim.scene.spec.key]
    distance = -record[f"{prefix}_sparse"]
    edges = (
        (spec.near, 1.5 * spec.near, spec.far)
        if spec.family == "pose"
        else (spec.near, 2 * spec.near, spec.far)
    )
    return np.min(np.abs(distance[:, None] - np.array(edges)), axis=1) > EDGE


@pytest.mark.parametrize("prefix", ["step", "forced"])
def test_observation_reward_and_ending(sim, record, prefix, record_property):
    n = written(sim, record, prefix, record[f"{prefix}_step"])
    names = ("obs", "terms", "reward", "solved", "terminated", "fault")
    obs, scores, rewards, solved, terminated, fault = (
        getattr(sim.transition, name).numpy()[:n] for name in names
    )
    worst = np.abs(obs - record[f"{prefix}_obs"]).max()
    record_property("observation", float(worst))
    assert worst < VALUE_TOLERANCE
    clear = away_from_edges(sim, record, prefix)
    assert clear.mean() > 0.9
    terms = {term.name: i for i, term in enumerate(sim.terms)}
    for name, column in terms.items():
        field = f"{prefix}_sparse" if name == "sparse" else f"{prefix}_reward_{name}"
        error = np.abs(scores[:, column] - record[field])
        assert error[clear].max() < VALUE_TOLERANCE, name
    reward = record[f"{prefix}_reward"]
    error = np.abs(rewards - reward)[clear]
    record_property("reward", float(error.max()))
    assert (error < VALUE_TOLERANCE * (1 + np.abs(reward[clear]))).all()
    np.testing.assert_array_equal(solved[clear], record[f"{prefix}_solved"][clear])
    np.testing.assert_array_equal(terminated[clear], record[f"{prefix}_done"][clear])
    assert not fault.any()


def test_recorded_states_reach_every_branch(record):
    """Without this the comparison above could pass on constants."""
    assert set(np.unique(record["forced_reward_bonus"])) == {0, 1, 2}
    assert set(np.unique(record["forced_solved"])) == {False, True}
    assert set(np.unique(record["forced_done"])) == {False, True}
    assert len(record["episode_length"]) >= 6


def test_task_facts(key, record):
    """Horizon, control step, sizes, order of columns and weights."""
    spec = TASKS[key]
    meta = json.loads(str(record["meta"]))
    assert spec.horizon == meta["horizon"]
    assert spec.num_substeps == meta["frame_skip"]
    assert spec.control_dt == pytest.approx(meta["dt"])
    nq, nv, num_muscles = (record[f"step_{name}"].shape[1] for name in ("qpos", "qvel", "act"))
    columns = {c.name: c.size for c in spec.columns(nq, nv, num_muscles) if c.size}
    assert columns == meta["obs"]
    assert list(columns) == list(meta["obs"])
    assert {t.name: t.weight for t in spec.reward_terms() if t.weight} == {
        k: w for k, w in meta["weights"].items() if w
    }


def test_episodes_end_like_upstream(key, record, sim):
    """Truncation: at the horizon and nowhere else; and every recorded episode ended one of both ways."""
    spec = TASKS[key]
    full = record["episode_length"] == spec.horizon
    np.testing.assert_array_equal(record["episode_truncated"], full)
    steps = np.array([1, spec.horizon - 1, spec.horizon])
    few = {name: record[name][:3] for name in record if name.startswith("reset_")}
    n = written(sim, few, "reset", steps)
    np.testing.assert_array_equal(sim.transition.truncated.numpy()[:n], steps == spec.horizon)


def test_reset_observation(key, record, sim):
    """What upstream observes after a reset, from its start state and target."""
    n = written(sim, record, "reset", 0)
    assert np.abs(sim.transition.obs.numpy()[:n] - record["reset_obs"]).max() < VALUE_TOLERANCE
    assert not record["reset_qvel"].any()
    sim.reset(seeds=np.arange(sim.num_worlds))
    assert not sim.scene.data.qvel.numpy().any()
    assert not sim.scene.muscles.activation.numpy().any()
    if all(draw.when == "goal" for draw in TASKS[key].draws):  # the start is one configuration
        qpos = sim.scene.data.qpos.numpy()[:n]
        np.testing.assert_allclose(qpos, record["reset_qpos"], atol=VALUE_TOLERANCE)


def test_targets_are_drawn_like_upstream(record, sim):
    """Bounds of the targets; the reachable points of the finger row by row."""
    sim.reset(seeds=np.arange(NUM_WORLDS))
    target = sim.shards[0].program.target.numpy()
    if "table_rows" in record:
        table = sim.shards[0].program.table.numpy()
        assert len(table) == record["table_size"]
        np.testing.assert_allclose(table[record["table_index"]], record["table_rows"], atol=VALUE_TOLERANCE)
        assert np.abs(target[:, None] - table[None]).sum(axis=2).min(axis=1).max() < VALUE_TOLERANCE
        assert len(np.unique(target, axis=0)) > 500
        return
    low, high = (
        (record[f"target_{end}"].ravel() for end in ("low", "high"))
        if "target_low" in record
        else (record["target_value"],) * 2
    )
    assert (target >= low - VALUE_TOLERANCE).all()
    assert (target <= high + VALUE_TOLERANCE).all()
    spread = high - low
    assert (target.max(axis=0) - target.min(axis=0) >= 0.97 * spread - VALUE_TOLERANCE).all()


def test_one_control_step_of_physics(key, record, record_property):
    """qpos and activation after frame_skip substeps from the same state and the same excitation."""
    sim = Simulation(TASKS[key], len(record["replay_ctrl"]), device="cpu", graph=False, progress=False)
    data = sim.scene.data
    data.qpos.assign(record["replay_qpos_before"])
    data.qvel.assign(record["replay_qvel_before"])
    if sim.scene.muscles.activation.size:
        sim.scene.muscles.activation.assign(record["replay_act_before"])
    data.ctrl.assign(record["replay_ctrl"])
    if "replay_weight" in record:
        sim.shards[0].program.weight.mass.assign(record["replay_weight"][:, None])
        sim.shards[0].program.weight.hang(wp.ones(sim.num_worlds, dtype=bool))
    moved = np.abs(record["replay_qpos_after"] - record["replay_qpos_before"])
    assert np.median(moved.max(axis=1)) > 10 * QPOS_TOLERANCE
    step = repeated_step(sim.scene, sim.shards[0].stages)
    for _ in range(sim.scene.num_substeps):
        step()
    error = np.abs(data.qpos.numpy() - record["replay_qpos_after"])
    record_property("qpos median", float(np.median(error.max(axis=1))))
    record_property("qpos worst", float(error.max()))
    assert np.median(error.max(axis=1)) < QPOS_TOLERANCE
    if sim.scene.muscles.activation.size:
        activation = sim.scene.muscles.activation.numpy()
        assert np.abs(activation - record["replay_act_after"]).max() < ACTIVATION_TOLERANCE


def test_action_map(record, sim):
    """Action to control, clipping included."""
    for action, ctrl in (("step_action", "step_ctrl"), ("clip_action", "clip_ctrl")):
        n = len(record[action])
        sim.action.numpy()[:n] = record[action]
        sim.scene.data.ctrl.fill_(np.nan)
        sim.shards[0].launch_action()
        np.testing.assert_allclose(sim.scene.data.ctrl.numpy()[:n], record[ctrl], atol=ACTIVATION_TOLERANCE)

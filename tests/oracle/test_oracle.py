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
from stepping import step

from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation

DATA = Path(os.environ.get("MYOWARP_ORACLE", Path(__file__).parents[1] / "data/myosuite"))
WALKING = ("walk", "directional", "terrain")
UPSTREAM = [key for key in recorded_ids(DATA) if key not in KEYS and TASKS[key].family not in WALKING]
"""Ids of upstream, those that were recorded; tasks with objects: test_oracle_contact.py; walking:
test_oracle_walk.py."""

VALUE_TOLERANCE = 1e-5  # observation and reward terms, in their units; float32 against float64
EDGE = 1e-5  # distances this close to a threshold may fall on either side of it in float32
QPOS_TOLERANCE = 1e-4  # rad, median over states, one control step
ACTIVATION_TOLERANCE = 1e-6  # ten steps of float32


def recorded(key):
    """Return what was recorded for an id; fails if nothing was."""
    return np.load(DATA / f"{key}.npz")


def written(key, record, prefix, steps, **options):
    """Return a simulation whose worlds are in the recorded states, scored and observed."""
    sim = Simulation(
        TASKS[key], len(record[f"{prefix}_qpos"]), device="cpu", graph=False, progress=False, **options
    )
    data = sim.scene.data
    data.qpos.assign(record[f"{prefix}_qpos"])
    data.qvel.assign(record[f"{prefix}_qvel"])
    if sim.scene.muscles.activation.size:
        sim.scene.muscles.activation.assign(record[f"{prefix}_act"])
    sim.shards[0].program.target.assign(record[f"{prefix}_target"].reshape(sim.num_worlds, -1))
    sim.episode.step_count.assign(steps.astype(np.int32))
    everywhere = wp.ones(sim.num_worlds, dtype=bool)
    sim.transition.obs.fill_(np.nan)
    sim.transition.terms.fill_(np.nan)
    mjw.kinematics(sim.scene.model, data)
    sim.shards[0].program.observe(everywhere, sim.transition.obs)
    sim.shards[0].launch_scoring()
    return sim


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


@pytest.mark.parametrize("key", UPSTREAM)
@pytest.mark.parametrize("prefix", ["step", "forced"])
def test_observation_reward_and_ending(key, prefix, record_property):
    record = recorded(key)
    steps = record[f"{prefix}_step"]
    sim = written(key, record, prefix, steps)
    transition = sim.transition
    worst = np.abs(transition.obs.numpy() - record[f"{prefix}_obs"]).max()
    record_property("observation", float(worst))
    assert worst < VALUE_TOLERANCE
    clear = away_from_edges(sim, record, prefix)
    assert clear.mean() > 0.9
    terms = {term.name: i for i, term in enumerate(sim.terms)}
    for name, column in terms.items():
        field = f"{prefix}_sparse" if name == "sparse" else f"{prefix}_reward_{name}"
        error = np.abs(transition.terms.numpy()[:, column] - record[field])
        assert error[clear].max() < VALUE_TOLERANCE, name
    reward = record[f"{prefix}_reward"]
    error = np.abs(transition.reward.numpy() - reward)[clear]
    record_property("reward", float(error.max()))
    assert (error < VALUE_TOLERANCE * (1 + np.abs(reward[clear]))).all()
    np.testing.assert_array_equal(transition.solved.numpy()[clear], record[f"{prefix}_solved"][clear])
    np.testing.assert_array_equal(transition.terminated.numpy()[clear], record[f"{prefix}_done"][clear])
    assert not transition.fault.numpy().any()


@pytest.mark.parametrize("key", UPSTREAM)
def test_recorded_states_reach_every_branch(key):
    """Without this the comparison above could pass on constants."""
    record = recorded(key)
    assert set(np.unique(record["forced_reward_bonus"])) == {0, 1, 2}
    assert set(np.unique(record["forced_solved"])) == {False, True}
    assert set(np.unique(record["forced_done"])) == {False, True}
    assert len(record["episode_length"]) >= 6


@pytest.mark.parametrize("key", UPSTREAM)
def test_task_facts(key):
    """Horizon, control step, sizes, order of columns and weights."""
    record, spec = recorded(key), TASKS[key]
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


@pytest.mark.parametrize("key", UPSTREAM)
def test_episodes_end_like_upstream(key):
    """Truncation: at the horizon and nowhere else; and every recorded episode ended one of both ways."""
    record, spec = recorded(key), TASKS[key]
    full = record["episode_length"] == spec.horizon
    np.testing.assert_array_equal(record["episode_truncated"], full)
    steps = np.array([1, spec.horizon - 1, spec.horizon])
    few = {name: record[name][:3] for name in record.files if name.startswith("reset_")}
    sim = written(key, few, "reset", steps)
    np.testing.assert_array_equal(sim.transition.truncated.numpy(), steps == spec.horizon)


@pytest.mark.parametrize("key", UPSTREAM)
def test_reset_observation(key):
    """What upstream observes after a reset, from its start state and target."""
    record = recorded(key)
    sim = written(key, record, "reset", np.zeros(len(record["reset_qpos"])))
    assert np.abs(sim.transition.obs.numpy() - record["reset_obs"]).max() < VALUE_TOLERANCE
    assert not record["reset_qvel"].any()
    sim.reset(seeds=np.arange(sim.num_worlds))
    assert not sim.scene.data.qvel.numpy().any()
    assert not sim.scene.muscles.activation.numpy().any()
    if all(draw.when == "goal" for draw in TASKS[key].draws):  # the start is one configuration
        np.testing.assert_allclose(sim.scene.data.qpos.numpy(), record["reset_qpos"], atol=VALUE_TOLERANCE)


@pytest.mark.parametrize("key", UPSTREAM)
def test_targets_are_drawn_like_upstream(key):
    """Bounds of the targets; the reachable points of the finger row by row."""
    record, spec = recorded(key), TASKS[key]
    sim = Simulation(spec, 512, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.arange(512))
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


@pytest.mark.parametrize("key", UPSTREAM)
def test_one_control_step_of_physics(key, record_property):
    """qpos and activation after frame_skip substeps from the same state and the same excitation."""
    record = recorded(key)
    states = {name.replace("_before", ""): record[name] for name in record.files}
    states["replay_target"] = np.zeros((len(record["replay_ctrl"]), 1))
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
    for _ in range(sim.scene.num_substeps):
        step(sim.scene, sim.shards[0].stages)
    error = np.abs(data.qpos.numpy() - record["replay_qpos_after"])
    record_property("qpos median", float(np.median(error.max(axis=1))))
    record_property("qpos worst", float(error.max()))
    assert np.median(error.max(axis=1)) < QPOS_TOLERANCE
    if sim.scene.muscles.activation.size:
        activation = sim.scene.muscles.activation.numpy()
        assert np.abs(activation - record["replay_act_after"]).max() < ACTIVATION_TOLERANCE


@pytest.mark.parametrize("key", UPSTREAM)
def test_action_map(key):
    """Action to control, clipping included."""
    record = recorded(key)
    for action, ctrl in (("step_action", "step_ctrl"), ("clip_action", "clip_ctrl")):
        sim = Simulation(TASKS[key], len(record[action]), device="cpu", graph=False, progress=False)
        sim.action.assign(record[action].astype(np.float32))
        sim.shards[0].launch_action()
        np.testing.assert_allclose(sim.scene.data.ctrl.numpy(), record[ctrl], atol=ACTIVATION_TOLERANCE)

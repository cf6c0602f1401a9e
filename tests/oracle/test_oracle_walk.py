"""Walking against values recorded from MyoSuite 3.0.0 (tests/data/README.md).

States are written in: observation, reward terms, done and solved need no physics. Physics is compared over
one control step from recorded states.
"""

import json
from functools import lru_cache

import mujoco
import numpy as np
import pytest
import warp as wp
from contact_oracle import recorded_ids
from data.recording import rough_heights
from stepping import forward, repeated_step
from test_oracle import DATA, QPOS_TOLERANCE, WALKING

from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation

KEYS = [key for key in recorded_ids(DATA) if TASKS[key].family in WALKING]

VALUE_TOLERANCE = 1e-5  # relative to the largest value of a block, at least of 1 in its unit; measured 3e-6
FLUNG_TOLERANCE = 3e-5
"""The same for rates and forces of muscles in written states, up to 2 m from the origin, whose joints have
velocities of 2 m/s. Some paths have 4 mm between two points, so that float32 turns them: MuJoCo C is off by
1.0e-5 where only the positions of its bodies are rounded to float32. Measured 1.2e-5 in 25 recordings."""
ROUGH = "myoLegRoughTerrainWalk-v0"


@lru_cache
def recorded(key):
    with np.load(DATA / f"{key}.npz") as file:
        record = {name: file[name] for name in file.files}
    return record, json.loads(str(record.pop("meta")))


def simulation(key, record, prefix, suffix=""):
    """Return a simulation whose worlds are in the recorded states."""
    number = len(record[f"{prefix}_qpos{suffix}"])
    sim = Simulation(TASKS[key], number, device="cpu", graph=False, progress=False)
    sim.scene.data.qpos.assign(record[f"{prefix}_qpos{suffix}"])
    sim.scene.data.qvel.assign(record[f"{prefix}_qvel{suffix}"])
    sim.scene.muscles.activation.assign(record[f"{prefix}_act{suffix}"])
    if key == ROUGH and f"{prefix}_seed" in record:
        drawn = np.array([rough_heights(seed) for seed in record[f"{prefix}_seed"]])
        sim.shards[0].program.heights.assign(drawn.reshape(number, 100, 100))
    return sim


@lru_cache
def scored(key, prefix):
    """Return a simulation whose worlds are scored and observed in the recorded states."""
    record, _ = recorded(key)
    sim = simulation(key, record, prefix)
    count = record[f"{prefix}_step"] if f"{prefix}_step" in record else np.zeros(sim.num_worlds)
    sim.episode.step_count.assign(count.astype(np.int32))
    sim.transition.obs.fill_(np.nan)
    sim.transition.terms.fill_(np.nan)
    program = sim.shards[0].program
    if f"{prefix}_heading" in record:
        program.angle.assign(np.arctan2(*record[f"{prefix}_heading"].T[::-1])[:, None])
    program.advance(sim.episode.step_count)
    program.observe(wp.ones(sim.num_worlds, dtype=bool), sim.transition.obs)
    sim.shards[0].launch_scoring()
    return sim


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("prefix", ["reset", "step", "forced"])
def test_observation(key, prefix, record_property):
    record, meta = recorded(key)
    obs, expected, first = scored(key, prefix).transition.obs.numpy(), record[f"{prefix}_obs"], 0
    assert obs.shape == expected.shape
    for name, size in meta["obs"].items():
        block = slice(first, first + size)
        scale = max(1.0, np.abs(expected[:, block]).max())
        error = np.abs(obs[:, block] - expected[:, block]).max() / scale
        record_property("observation", float(error))
        flung = prefix == "forced" and name in ("muscle_velocity", "muscle_force")
        assert error < (FLUNG_TOLERANCE if flung else VALUE_TOLERANCE), name
        spread = np.ptp(expected[:, block], axis=0).max()
        assert prefix == "reset" or name == "heading_cmd" or spread > 10 * VALUE_TOLERANCE * scale, name
        first += size


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("prefix", ["step", "forced"])
def test_reward_and_ending(key, prefix, record_property):
    record, _ = recorded(key)
    sim = scored(key, prefix)
    for column, term in enumerate(sim.terms):
        field = f"{prefix}_sparse" if term.name == "sparse" else f"{prefix}_reward_{term.name}"
        error = np.abs(sim.transition.terms.numpy()[:, column] - record[field])
        assert error.max() < VALUE_TOLERANCE, term.name
    reward = record[f"{prefix}_reward"]
    error = np.abs(sim.transition.reward.numpy() - reward)
    record_property("reward", float(error.max()))
    assert (error < VALUE_TOLERANCE * (1 + np.abs(reward))).all()
    np.testing.assert_array_equal(sim.transition.terminated.numpy(), record[f"{prefix}_done"])
    np.testing.assert_array_equal(sim.transition.solved.numpy(), record[f"{prefix}_solved"])
    if prefix == "forced":
        assert (
            set(np.unique(record["forced_done"])) == set(np.unique(record["forced_solved"])) == {False, True}
        )


@pytest.mark.parametrize("key", KEYS)
def test_start(key):
    record, _ = recorded(key)
    sim = Simulation(TASKS[key], 3, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.arange(3))
    np.testing.assert_allclose(sim.scene.data.qpos.numpy(), record["reset_qpos"][:3], atol=VALUE_TOLERANCE)
    np.testing.assert_allclose(sim.scene.data.qvel.numpy(), record["reset_qvel"][:3], atol=VALUE_TOLERANCE)
    assert (np.abs(record["reset_qvel"]).max() > 1.0) == (TASKS[key].family in ("walk", "terrain"))


@pytest.mark.parametrize("key", KEYS)
def test_task_facts(key):
    """Horizon, control step, sizes, order of columns and weights; joints, muscles."""
    (record, meta), spec = recorded(key), TASKS[key]
    assert (spec.horizon, spec.num_substeps) == (meta["horizon"], meta["frame_skip"])
    assert spec.control_dt == pytest.approx(meta["dt"])
    nq, nv, num_muscles = (record[f"step_{name}"].shape[1] for name in ("qpos", "qvel", "act"))
    columns = {c.name: c.size for c in spec.columns(nq, nv, num_muscles)}
    assert list(columns.items()) == list(meta["obs"].items())
    assert {t.name: t.weight for t in spec.reward_terms() if t.weight} == meta["weights"]


@pytest.mark.parametrize("key", KEYS)
def test_one_control_step_of_physics(key, record_property):
    record, _ = recorded(key)
    sim = simulation(key, record, "replay", "_before")
    sim.scene.data.ctrl.assign(record["replay_ctrl"])
    step = repeated_step(sim.scene, sim.shards[0].stages)
    for _ in range(sim.scene.num_substeps):
        step()
    error = np.abs(sim.scene.data.qpos.numpy() - record["replay_qpos_after"]).max(axis=1)
    record_property("qpos median", float(np.median(error)))
    record_property("qpos worst", float(error.max()))
    assert np.median(error) < QPOS_TOLERANCE
    moved = np.abs(record["replay_qpos_after"] - record["replay_qpos_before"]).max(axis=1)
    assert np.median(moved) > 10 * QPOS_TOLERANCE


GROUND = [key for key in KEYS if TASKS[key].family in ("directional", "terrain")]
FORCE_TOLERANCE = 0.02  # of the force of the ground on the root, total over states
CONVEX_TOLERANCE = 1e-4  # likewise; measured 1e-5
DEEP = 0.1  # m, below all rough ground
DEEPEST = 0.02  # m; a foot that is deeper reaches upstream's base, which has an under side of its own


@lru_cache
def force_of_the_ground(key):
    """Return the force on the root in the recorded states, and a simulation in them."""
    record, _ = recorded(key)
    sim = simulation(key, record, "replay", "_before")
    forward(sim.scene, sim.shards[0].stages)
    return sim.scene.data.qfrc_constraint.numpy()[:, :3], sim


def force_in_c(key, base=None):
    """Return the same of MuJoCo C, with another depth of the field's base; touches, and depths [m]."""
    (record, _), (_, sim) = recorded(key), force_of_the_ground(key)
    host, forces, touches, depths = sim.scene.oracle.__copy__(), [], 0, []
    if base is not None:
        host.hfield_size[0, 3] = base
    data = mujoco.MjData(host)
    for world, (qpos, qvel, act) in enumerate(
        zip(*(record[f"replay_{name}_before"] for name in ("qpos", "qvel", "act")), strict=True)
    ):
        if key == ROUGH:
            heights = sim.shards[0].program.heights.numpy()[world]
            host.hfield_data[:], host.hfield_size[0, 2] = heights.ravel(), 1.0
        data.qpos[:], data.qvel[:], data.act[:] = qpos, qvel, act
        data.qacc_warmstart[:] = 0.0
        mujoco.mj_forward(host, data)
        forces.append(data.qfrc_constraint[:3].copy())
        field = host.geom_type[data.contact.geom] == mujoco.mjtGeom.mjGEOM_HFIELD
        touches += np.count_nonzero(field.any(axis=1) & (data.contact.efc_address >= 0))
        depths.append(-data.contact.dist.min(initial=0.0))
    return np.array(forces), touches, np.array(depths)


def gap(ours, theirs):
    """Return the difference of forces as a share of all force."""
    return np.linalg.norm(ours - theirs, axis=1).sum() / np.linalg.norm(theirs, axis=1).sum()


@pytest.mark.parametrize("key", GROUND)
def test_force_of_the_ground(key, record_property):
    """What ground and floor push the root with is what they do in MuJoCo C, in the recorded states."""
    theirs, touches, _ = force_in_c(key)
    assert touches > 20
    error = gap(force_of_the_ground(key)[0], theirs)
    record_property("force", float(error))
    assert error < FORCE_TOLERANCE


def test_force_of_rough_ground_is_that_of_prisms_with_a_deep_base():
    """A quarter of the points are below upstream's base, where prisms are not convex, and MuJoCo errs.

    In the committed states it is 1 % off what it finds with a deep base; all of that is in three states.
    """
    (ours, sim), (theirs, touches, depths) = force_of_the_ground(ROUGH), force_in_c(ROUGH, DEEP)
    heights, base = sim.shards[0].program.heights.numpy(), sim.scene.oracle.hfield_size[0, 3]
    assert 0.2 < (heights < -base).mean() < 0.3
    assert touches > 20
    sure = depths < DEEPEST
    assert sure.mean() > 0.9
    assert gap(ours[sure], theirs[sure]) < CONVEX_TOLERANCE


@pytest.mark.parametrize("key", KEYS)
def test_action_map(key):
    """MyoSuite's excitations from 0 to 1 are actions from -1 to 1 here."""
    (record, _), sim = recorded(key), scored(key, "step")
    for action, ctrl in (("step_action", "step_ctrl"), ("clip_action", "clip_ctrl")):
        n = len(record[action])
        sim.action.numpy()[:n] = 2.0 * record[action] - 1.0
        sim.scene.data.ctrl.fill_(np.nan)
        sim.shards[0].launch_action()
        np.testing.assert_allclose(sim.scene.data.ctrl.numpy()[:n], record[ctrl], atol=1e-6)

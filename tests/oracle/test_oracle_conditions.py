"""MyoSuite 3.0.0's `myo{Sarc,Fati,Reaf}...` ids against recorded values (tests/data/README.md).

One control step from recorded states, so that conditions, physics and task are compared together.
"""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from contact_oracle import AIMS, has_solids, write, write_objects, write_solids
from data.recording import rough_heights
from often import often

from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation
from myowarp.tasks.variants import PREFIXES, variants

DATA = Path(os.environ.get("MYOWARP_ORACLE", Path(__file__).parents[1] / "data/myosuite"))
IDS = {env_id.removeprefix("MyoWarp/"): variant for env_id, variant in variants().items()}
RECORDED = sorted(p.stem for p in DATA.glob("*.npz") if p.stem.startswith(tuple(PREFIXES)))

CTRL = 1e-6  # excitations, activations and compartments of order one in float32
VALUE = 1e-5  # reward, median over states, one control step of physics in float32
OBSERVATION = 2e-5  # likewise; measured 1.3e-5, speeds of muscles of legs on ground
QPOS = 1e-4  # rad and m, median over states, as without a condition
EFFECT = 10.0

COMPARTMENTS = ("active", "resting", "fatigued")


def test_every_condition_is_recorded():
    """What a file stands for is an id of ours, and no condition of upstream is left out."""
    assert {IDS[name].conditions for name in RECORDED} == {(c,) for c, _ in PREFIXES.values()}


@pytest.mark.parametrize(
    "name", often(RECORDED, [name for name in RECORDED if not TASKS[IDS[name].task].large])
)
def test_control_step(name, record_property):
    """Control, activation, compartments, configuration, observation, reward and ending."""
    variant = IDS[name]
    with np.load(DATA / f"{name}.npz") as file:
        record = {field: file[field] for field in file.files}
    sim = Simulation(
        TASKS[variant.task],
        len(record["step_step"]),
        conditions=variant.conditions,
        autoreset="disabled",
        device="cpu",
        graph=False,
        progress=False,
    )
    step_like(sim, record)
    np.testing.assert_allclose(sim.scene.data.ctrl.numpy(), record["step_ctrl"], atol=CTRL)
    np.testing.assert_allclose(sim.scene.muscles.activation.numpy(), record["step_act"], atol=CTRL)
    for part in COMPARTMENTS if "step_fatigued" in record else ():
        error = np.abs(
            getattr(sim.shards[0].effects[0].state, f"{part}_fraction").numpy() - record[f"step_{part}"]
        )
        record_property("compartments", float(error.max()))
        assert error.max() < CTRL
    qpos = np.abs(sim.scene.data.qpos.numpy() - record["step_qpos"]).max(axis=1)
    observation, reward = misses(sim, record)
    for column, values in (("observation", observation), ("reward", reward), ("qpos", qpos)):
        record_property(f"{column} median", float(np.median(values)))
        record_property(f"{column} worst", float(values.max()))
    assert np.median(qpos) < QPOS
    assert np.median(observation) < OBSERVATION
    assert np.median(reward) < VALUE
    np.testing.assert_array_equal(sim.transition.terminated.numpy(), record["step_done"])
    sim.shards[0].effects = ()
    sim.scene.muscles.anatomy.strength.fill_(1.0)
    step_like(sim, record)
    assert np.median(misses(sim, record)[0]) > EFFECT * OBSERVATION


def step_like(sim, record):
    """Take a recorded control step in every world."""
    aim(sim, json.loads(str(record["meta"])), record)
    data = sim.scene.data
    data.qpos.assign(record["step_qpos_before"])
    data.qvel.assign(record["step_qvel_before"])
    sim.scene.muscles.activation.assign(record["step_act_before"])
    if "step_fatigued" in record and sim.shards[0].effects:
        for part in COMPARTMENTS:
            getattr(sim.shards[0].effects[0].state, f"{part}_fraction").assign(record[f"step_{part}_before"])
    sim.episode.step_count.assign(record["step_step"].astype(np.int32) - 1)
    sim.episode.ended.zero_()
    data.qacc_warmstart.zero_()
    action = record["step_action"]
    sim.action.assign(2.0 * action - 1.0 if sim.scene.spec.linear_excitation else action)
    sim.step()


def aim(sim, meta, record):
    """Give the worlds the goals and objects of recorded states."""
    program, model, task = sim.shards[0].program, sim.scene.model, meta["task"]
    if task in ("walk", "terrain"):
        if "step_seed" in record and "Rough" in meta["id"]:
            drawn = np.array([rough_heights(seed) for seed in record["step_seed"]])
            program.heights.assign(drawn.reshape(program.heights.shape))
    elif task in ("pose", "reach", "stand"):
        program.target.assign(record["step_target"].reshape(sim.num_worlds, -1))
        if "step_weight" in record:
            program.weight.mass.assign(record["step_weight"][:, None])
            program.weight.hang(wp.ones(sim.num_worlds, dtype=bool))
    else:
        AIMS[task](sim, record, "step")
    if has_solids(sim.scene.spec.key):
        drawn = {name.replace("step_", "reset_", 1): values for name, values in record.items()}
        write_solids(sim, drawn, np.arange(sim.num_worlds))
    elif task in ("baoding", "die"):
        write_objects(sim, meta, lambda field: record[f"step_{field}"])
    elif task == "hold" and "geom_size" in sim.scene.spec.batched:
        write(model.geom_size, sim.scene.oracle.body("object").geomadr, record["step_object_size"])


def misses(sim, record):
    """Return the errors of observation and reward in each world.

    Of the observation, they are relative to the largest value of a block, at least to 1 in its unit; of the
    reward, to its own size.
    """
    error, first = np.abs(sim.transition.obs.numpy() - record["step_obs"]), 0
    for size in json.loads(str(record["meta"]))["obs"].values():
        block = slice(first, first := first + size)
        error[:, block] /= max(1.0, np.abs(record["step_obs"][:, block]).max())
    observation = error.max(axis=1)
    reward = np.abs(sim.transition.reward.numpy() - record["step_reward"])
    return observation, reward / (1.0 + np.abs(record["step_reward"]))

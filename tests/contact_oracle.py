"""MyoSuite's recorded values of the tasks with objects, and simulations that are put into them."""

import copy
import json
import os
from functools import lru_cache
from pathlib import Path

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from data.recording import euler
from stepping import engine_alone

from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation
from myowarp.tasks.die_reorient import show_wanted
from myowarp.tasks.relocate import put_object
from myowarp.tasks.relocate_scene import put_bin
from myowarp.tasks.variants import find_variant

DATA = Path(os.environ.get("MYOWARP_ORACLE", Path(__file__).parent / "data/myosuite"))
FRESH = "MYOWARP_ORACLE" in os.environ
"""Whether the recordings are those of `make parity`, in which no draw is certain."""
ALIASES = {
    "myoHandBaodingFixed-v0": "myoChallengeBaodingP1-v1",
    "myoHandBaodingRandom-v0": "myoChallengeBaodingP2-v1",
}
"""Ids under a second name: recorded under the first."""


def recorded_ids(folder):
    """Return the ids without a condition that were recorded; each has to be there under upstream's name."""
    names = sorted(path.stem for path in folder.glob("*.npz"))
    assert names, f"no recordings in {folder}"
    return [name for name in names if not find_variant(name).conditions]


SOLIDS = {"relocate": (3, 2, 5), "reorient": (2, 3, 4)}
"""Families whose objects have a geom of every kind for each part: parts, first kind, number of kinds."""

KEYS = [key for key in recorded_ids(DATA) if TASKS[key].body == "contact_hand" or TASKS[key].family in SOLIDS]
"""Ids of upstream, those that were recorded."""

NUM_WORLDS = 200


@lru_cache
def recorded(key):
    """Return what was recorded for an id, and its description; fails if nothing was."""
    with np.load(DATA / f"{ALIASES.get(key, key)}.npz") as file:
        record = {name: file[name] for name in file.files}
    return record, json.loads(str(record.pop("meta")))


@lru_cache
def simulation(key):
    """Return the simulation that the tests of an id share."""
    return Simulation(TASKS[key], NUM_WORLDS, device="cpu", graph=False, progress=False)


def padded(rows, num_worlds=NUM_WORLDS):
    """Return rows with the last repeated, one for every world."""
    return np.concatenate([rows, np.repeat(rows[-1:], num_worlds - len(rows), axis=0)])


def write_state(sim, record, prefix, suffix="", repeat=1):
    """Put the first worlds into recorded states, all of them so many times; returns how many."""
    data = sim.scene.data

    def rows(name):
        values = record.get(f"{prefix}_{name}{suffix}")
        return None if values is None else padded(np.concatenate([values] * repeat))

    data.qpos.assign(rows("qpos"))
    data.qacc_warmstart.zero_()
    for name, array in (("qvel", data.qvel), ("act", sim.scene.muscles.activation)):
        array.zero_() if rows(name) is None else array.assign(rows(name))
    return repeat * len(record[f"{prefix}_qpos{suffix}"])


def object_ids(model, meta):
    """Return the ids of the objects' bodies, collision geoms and degrees of freedom."""
    bodies = [model.body(name).id for name in meta["object_bodies"]]
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies) & collides)
    return {"body": bodies, "geom": geoms, "dof": np.flatnonzero(np.isin(model.dof_bodyid, bodies))}


def reset_rows(record, episodes):
    """Return the rows of the reset arrays that belong to episodes."""
    return np.array([np.flatnonzero(record["reset_episode"] == episode)[0] for episode in episodes])


@lru_cache(maxsize=16)  # of one id, or two
def oracle_of(key, episode):
    """Return MuJoCo C's model of an id with the objects of a recorded episode, not to be changed."""
    record, meta = recorded(key)
    model = copy.copy(simulation(key).scene.oracle)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE  # whose tree knows nominal sizes
    ids, row = object_ids(model, meta), reset_rows(record, [episode])[0]
    ids["geom"] = geoms_there(simulation(key).scene.spec, record, row, ids["geom"])
    if has_solids(key):
        every = object_ids(model, meta)["geom"]
        model.geom_contype[every] = model.geom_conaffinity[every] = 0
        model.geom_contype[ids["geom"]] = model.geom_conaffinity[ids["geom"]] = 1
        model.geom_sameframe[every] = model.body_sameframe[ids["body"]] = 0
    for name, values in record.items():
        _, kind, field = (*name.split("_", 2), "")[:3]
        if name.startswith("reset_") and kind in ids:
            getattr(model, f"{kind}_{field}")[ids[kind]] = values[row]
    return model


def has_solids(key):
    """Return whether the objects of an id differ in kind."""
    return "geom_margin" in TASKS[key].batched


def geoms_there(spec, record, row, geoms):
    """Return which of our objects' geoms are those of a recorded reset, in its order."""
    if "geom_margin" not in spec.batched:
        return geoms
    parts, first, kinds = SOLIDS[spec.family]
    there = [geoms[kinds * part + record["reset_geom_type"][row, part] - first] for part in range(parts)]
    return np.concatenate([there, geoms[parts * kinds :]]).astype(int)


def write(array, columns, values):
    """Write some columns of a model's field."""
    host = array.numpy()
    host[:, columns] = values.reshape(host[:, columns].shape)
    array.assign(host)


def draw_relocated(program, record, rows):
    """Let a program have drawn the parts of recorded resets."""
    size = record["reset_geom_size"][rows, :3]
    place = record["reset_geom_pos"][rows, :3] / size
    turns = [euler(record["reset_geom_quat"][rows, part]) for part in range(3)]
    for part in range(3):
        getattr(program, f"kind_{part}").assign(record["reset_geom_type"][rows, part, None])
    drawn = {"part_size": size, "part_place": place, "part_turn": np.stack(turns, axis=1)}
    drawn |= {"part_friction": record["reset_geom_friction"][rows, :3]}
    drawn |= {"object_mass": record["reset_body_mass"][rows, :1]}
    for name, values in drawn.items():
        getattr(program, name).assign(values.reshape(len(rows), -1))
    program.object_place.assign(record["reset_body_pos"][rows, 0])
    program.launch(put_object, mask=wp.ones(len(rows), dtype=bool))


def draw_reoriented(program, record, rows):
    """Let a program have drawn the shapes of recorded resets."""
    table = program.table.numpy()
    kinds, sizes = record["reset_geom_type"][rows, :1], record["reset_geom_size"][rows, 0]
    wanted = np.concatenate([kinds, sizes], axis=1)
    found = np.abs(table[None] - wanted[:, None]).max(axis=2).argmin(axis=1)
    np.testing.assert_allclose(table[found], wanted, atol=1e-7)
    program.row.assign(found[:, None] + 0.5)


DRAWN_SOLIDS = {"relocate": draw_relocated, "reorient": draw_reoriented}
"""Family: writes what recorded resets have drawn of an object."""


def write_solids(sim, record, rows):
    """Give the objects the kinds, sizes and masses of recorded resets, a row for each world."""
    program = sim.shards[0].program
    DRAWN_SOLIDS[sim.scene.spec.family](program, record, rows)
    program.shape(wp.ones(len(rows), dtype=bool))


def write_objects(sim, meta, values_of):
    """Give the objects their size, mass and friction; `values_of` a field has a row for each world."""
    ids = object_ids(sim.scene.oracle, meta)
    for name in sim.scene.spec.batched:
        values = values_of(name.replace("subtreemass", "mass"))
        write(getattr(sim.scene.model, name), ids[name.split("_")[0]], values)


def aim_key(sim, record, prefix):
    """Put the key where it was."""
    places = padded(record[f"{prefix}_key_pos"], sim.num_worlds)
    write(sim.scene.model.body_pos, [sim.scene.oracle.body("key").id], places)


def aim_baoding(sim, record, prefix):
    """Give the targets their orbits and their step."""
    orbits = sim.shards[0].program.orbits
    names = {"direction": "sign", "radii": "radii", "period": "period"}
    for ours, theirs in names.items():
        getattr(orbits, ours).assign(padded(record[f"{prefix}_{theirs}"], sim.num_worlds))
    orbits.start_angle.assign(padded(record[f"{prefix}_start_angles"][:, 0], sim.num_worlds))


def aim_hold(sim, record, prefix):
    """Put the goal where it was."""
    sim.shards[0].program.goal.assign(padded(record[f"{prefix}_goal_pos"], sim.num_worlds))


def aim_pen(sim, record, prefix):
    """Turn the target pen."""
    sim.scene.data.mocap_quat.assign(padded(record[f"{prefix}_target_quat"], sim.num_worlds)[:, None])


def aim_die(sim, record, prefix):
    """Put and turn the wanted die."""
    program, n = sim.shards[0].program, sim.num_worlds
    program.goal_angles.assign(padded(euler(record[f"{prefix}_target_quat"]), n))
    program.goal_offset.assign(padded(record[f"{prefix}_target_pos"] - (-0.34, -0.535, 1.46), n))
    program.launch(show_wanted, mask=wp.ones(n, dtype=bool))


def aim_relocate(sim, record, prefix):
    """Put the bin where it was, and the object's frame."""
    program, n = sim.shards[0].program, sim.num_worlds
    everywhere = wp.ones(n, dtype=bool)
    program.goal_place.assign(padded(record[f"{prefix}_target_pos"], n))
    program.goal_angles.assign(padded(euler(record[f"{prefix}_target_quat"]), n))
    program.launch(put_bin, mask=everywhere)
    if sim.scene.spec.varied:
        program.object_place.assign(padded(record[f"{prefix}_object_origin"], n))
        program.launch(put_object, mask=everywhere)


AIMS = {"key": aim_key, "hold": aim_hold, "pen": aim_pen, "baoding": aim_baoding, "die": aim_die}
AIMS |= {"relocate": aim_relocate, "reorient": aim_pen}
"""Task: writes what the goals of recorded states were."""


def written(key, prefix, steps):
    """Return the simulation with its first worlds in recorded states, scored and observed; their number."""
    (record, meta), sim = recorded(key), simulation(key)
    count = write_state(sim, record, prefix)
    AIMS[meta["task"]](sim, record, prefix)
    sim.episode.step_count.assign(padded(steps.astype(np.int32)))
    sim.episode.ended.zero_()
    sim.transition.fault.zero_()
    sim.transition.obs.fill_(np.nan)
    sim.transition.terms.fill_(np.nan)
    engine_alone(mjw.kinematics)(sim.scene.model, sim.scene.data)
    sim.shards[0].program.advance(sim.episode.step_count)
    sim.shards[0].launch_scoring()
    sim.shards[0].program.observe(wp.ones(NUM_WORLDS, dtype=bool), sim.transition.obs)
    return sim, count


def oracle_data(key, episode, **state):
    """Return MuJoCo C's model and data of an id in a state, with the objects of a recorded episode."""
    model = oracle_of(key, episode)
    data = mujoco.MjData(model)
    for name, values in state.items():
        getattr(data, name)[:] = values
    if model.nmocap:
        record = recorded(key)[0]
        row = reset_rows(record, [episode])
        data.mocap_quat[:] = record["reset_target_quat"][row]
        if TASKS[key].family == "relocate":
            data.mocap_pos[:] = record["reset_target_pos"][row]
    return model, data


def write_episodes(key, table, suffix="", repeat=1):
    """Put the first worlds into the states of a table, with their episodes' objects; returns how many.

    Args:
        key: The id.
        table: The first word of what was recorded.
        suffix: Its last word.
        repeat: How often all states are taken.
    """
    (record, meta), sim = recorded(key), simulation(key)
    rows = np.tile(reset_rows(record, record[f"{table}_episode"]), repeat)
    if has_solids(key):
        write_solids(sim, record, padded(rows))
    else:
        write_objects(sim, meta, lambda field: padded(record[f"reset_{field}"][rows]))
    if sim.scene.oracle.nmocap:
        sim.scene.data.mocap_quat.assign(padded(record["reset_target_quat"][rows])[:, None])
        if TASKS[key].family == "relocate":
            sim.scene.data.mocap_pos.assign(padded(record["reset_target_pos"][rows])[:, None])
    return write_state(sim, record, table, suffix, repeat)

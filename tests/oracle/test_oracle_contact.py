"""The tasks with objects against values recorded from MyoSuite 3.0.0 (tests/data/README.md).

As `test_oracle.py`; recorded states are written into the first worlds of one simulation per id. Physics is
in `test_oracle_contact_physics.py`.
"""

import mujoco
import numpy as np
import pytest
from contact_oracle import (
    ALIASES,
    FRESH,
    KEYS,
    NUM_WORLDS,
    geoms_there,
    has_solids,
    object_ids,
    padded,
    recorded,
    simulation,
    write_solids,
    written,
)
from data.recording import euler

from myowarp.definitions.task import TASKS

NUM_HAND, NUM_ARM = 23, 38

VALUE_TOLERANCE = 1e-5  # observation and reward terms, in their units; float32 against float64
EDGE = 1e-5  # values this close to a threshold may fall on either side of it in float32
ACTIVATION_TOLERANCE = 1e-6


def edges(record, prefix, task):
    """Yield the quantities that are compared with thresholds, and the thresholds."""
    if task == "key":
        for tip in ("IFtip", "THtip"):
            yield -record[f"{prefix}_reward_{tip}_approach"], (0.05, 0.1)
        yield record[f"{prefix}_key_angle"], (np.pi / 2, np.pi, 3.14, 2 * np.pi)
    elif task == "hold":
        yield -record[f"{prefix}_sparse"], (0.01, 0.02, 0.3)
    elif task in ("pen", "reorient"):
        yield -record[f"{prefix}_reward_pos_align"], (0.075,)
        yield record[f"{prefix}_reward_rot_align"], (0.9, 0.95)
    elif task == "die":
        yield -record[f"{prefix}_reward_pos_dist"], (0.025, 0.05, 0.2)
        yield -record[f"{prefix}_reward_rot_dist"], (0.262,)
    elif task == "relocate":
        yield -record[f"{prefix}_reward_pos_dist"], (0.1,)
        reach = record[f"{prefix}_palm_pos"] - record[f"{prefix}_object_pos"]
        yield np.linalg.norm(reach, axis=1), (0.5,)
    else:
        for i in (1, 2):
            yield -record[f"{prefix}_reward_pos_dist_{i}"], (0.015,)
            yield record[f"{prefix}_ball{i}_pos"][:, 2], (1.25,)


def away_from_edges(record, prefix, task):
    """Return the states in which nothing is within rounding of a threshold."""
    gaps = [
        np.abs(values[:, None] - np.array(thresholds)).min(axis=1)
        for values, thresholds in edges(record, prefix, task)
    ]
    return np.min(gaps, axis=0) > EDGE


def assert_close(values, expected, message=""):
    """Assert float32 accuracy: absolute for small values, relative for large ones."""
    error = np.abs(values - expected) / np.maximum(1, np.abs(expected))
    assert error.max() < VALUE_TOLERANCE, message


def assert_observed(values, key, prefix):
    """The same of an observation; velocities and forces of muscles are compared with the largest."""
    record, meta = recorded(key)
    expected = record[f"{prefix}_obs"]
    scaled, first = expected.astype(float), 0
    for name, size in meta["obs"].items():
        block = slice(first, first + size)
        if name in MUSCLE_RATES:
            scaled[:, block] = np.abs(record["step_obs"][:, block]).max() * RATE_TOLERANCE / VALUE_TOLERANCE
        first += size
    error = np.abs(values - expected) / np.maximum(1, np.abs(scaled))
    assert error.max() < VALUE_TOLERANCE


MUSCLE_RATES = ("mvel", "mforce")  # blocks of observations [m/s, N]
RATE_TOLERANCE = 2e-5 if FRESH else VALUE_TOLERANCE
"""Theirs, of the largest of a recording. The hand is 1.5 m above the origin: MuJoCo C is off by 8e-6 where
only the positions of its bodies are rounded to float32. Measured 1.2e-5 in fresh recordings, and less than
1e-5 in the committed ones."""


def counter(record, prefix):
    """Return the steps since the reset that recorded states stand for."""
    fallback = np.ones(len(record[f"{prefix}_qpos"]))
    return record.get(f"{prefix}_counter", record.get(f"{prefix}_step", fallback))


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("prefix", ["step", "forced"])
def test_observation_reward_and_ending(key, prefix, record_property):
    record, meta = recorded(key)
    sim, n = written(key, prefix, counter(record, prefix))
    results = {k: getattr(sim.transition, k).numpy()[:n] for k in ("obs", "terms", "reward", "fault")}
    record_property("observation", float(np.abs(results["obs"] - record[f"{prefix}_obs"]).max()))
    assert_observed(results["obs"], key, prefix)
    clear = away_from_edges(record, prefix, meta["task"])
    assert clear.mean() > 0.9
    for column, term in enumerate(sim.terms):
        field = f"{prefix}_sparse" if term.name == "sparse" else f"{prefix}_reward_{term.name}"
        assert_close(results["terms"][clear, column], record[field][clear], term.name)
    weights = sum(term.weight for term in sim.terms)
    error = np.abs(results["reward"] - record[f"{prefix}_reward"])[clear]
    record_property("reward", float(error.max()))
    assert error.max() < weights * VALUE_TOLERANCE
    for ours, theirs in (("solved", "solved"), ("terminated", "done")):
        flag = getattr(sim.transition, ours).numpy()[:n]
        np.testing.assert_array_equal(flag[clear], record[f"{prefix}_{theirs}"][clear])
    assert not results["fault"].any()


@pytest.mark.parametrize("key", KEYS)
def test_recorded_states_reach_every_branch(key):
    """Without this the comparison above could pass on constants."""
    record, meta = recorded(key)
    terms = [name for name in record if name.startswith("forced_reward_")]
    assert len(terms) == len(TASKS[key].reward_terms()) - 1  # sparse has a name of its own
    for name in (*terms, "forced_sparse", "forced_solved", "forced_done"):
        everywhere = name == "forced_reward_bonus" and "Demo" in key  # which asks for no place
        assert len(np.unique(record[name])) > 1 or everywhere, name
    levels = {"key": {0, 1, 2}, "hold": {0, 1, 2}, "pen": {0, 1, 6}, "reorient": {0, 1, 6}}
    if meta["task"] in levels:
        assert set(record["forced_reward_bonus"]) == levels[meta["task"]]
    assert len(record["episode_length"]) == 8


@pytest.mark.parametrize("key", [*KEYS, *ALIASES])
def test_task_facts(key):
    """Horizon, control step, sizes, order of columns and weights; a second name changes nothing."""
    (record, meta), spec = recorded(key), TASKS[key]
    assert spec.horizon == meta["horizon"]
    assert spec.num_substeps == meta["frame_skip"]
    assert spec.physics_dt == pytest.approx(meta["timestep"])
    assert spec.control_dt == pytest.approx(meta["dt"])
    nq, nv, num_muscles = (record[f"step_{name}"].shape[1] for name in ("qpos", "qvel", "act"))
    columns = [(c.name, c.size) for c in spec.columns(nq, nv, num_muscles)]
    assert columns == list(meta["obs"].items())
    weights = {name: weight for name, weight in meta["weights"].items() if weight}
    assert {t.name: t.weight for t in spec.reward_terms() if t.weight} == weights
    if key in ALIASES:
        first = vars(TASKS[ALIASES[key]])
        assert {k for k, v in vars(spec).items() if v != first[k]} <= {"name", "version", "doc"}


@pytest.mark.parametrize("key", KEYS)
def test_episodes_end_like_upstream(key):
    """Truncation: at the horizon and nowhere else; and every recorded episode ended one of both ways."""
    record, spec = recorded(key)[0], TASKS[key]
    np.testing.assert_array_equal(record["episode_truncated"], record["episode_length"] == spec.horizon)
    steps = np.resize([1, spec.horizon - 1, spec.horizon], len(record["reset_qpos"]))
    sim, n = written(key, "reset", steps)
    np.testing.assert_array_equal(sim.transition.truncated.numpy()[:n], steps == spec.horizon)


@pytest.mark.parametrize("key", KEYS)
def test_reset(key):
    """Start state, and what upstream observes of it."""
    record, meta = recorded(key)
    sim, n = written(key, "reset", np.zeros(len(record["reset_qpos"])))
    assert_observed(sim.transition.obs.numpy()[:n], key, "reset")
    assert not record["reset_qvel"].any()
    assert not record["reset_act"].any()
    sim.reset(seeds=np.arange(NUM_WORLDS))
    assert not sim.scene.data.qvel.numpy().any()
    assert not sim.scene.muscles.activation.numpy().any()
    fixed = NUM_HAND if meta["task"] == "key" else record["reset_qpos"].shape[1]
    qpos = sim.scene.data.qpos.numpy()[:n, :fixed]
    drawn = 2 * getattr(TASKS[key], "offset", 0.0) * (meta["task"] == "relocate")
    np.testing.assert_allclose(qpos, record["reset_qpos"][:, :fixed], atol=VALUE_TOLERANCE + drawn)


@pytest.mark.parametrize("key", KEYS)
def test_action_map(key):
    """Action to control, clipping included."""
    record, sim = recorded(key)[0], simulation(key)
    for table in ("step", "clip"):
        sim.action.assign(padded(record[f"{table}_action"]))
        sim.shards[0].launch_action()
        ctrl = sim.scene.data.ctrl.numpy()[: len(record[f"{table}_ctrl"])]
        np.testing.assert_allclose(ctrl, record[f"{table}_ctrl"], atol=ACTIVATION_TOLERANCE)


FIXED = {
    "key": {"key_angle": (0, 0), "key_pos": ((-0.15, -0.55, 1.425),) * 2},
    "hold": {"goal_pos": ((-0.24, -0.52, 1.47),) * 2, "object_size": ((0.025, 0.036, 0.03),) * 2},
    "pen": {"tilt": ((0, 0), (0, 0))},
    "baoding": {
        "sign": (1, 1),
        "start_angle": (np.pi / 4, np.pi / 4),
        "period": (5, 5),
        "radii": ((0.025, 0.028),) * 2,
        "ball_mass": (0.043, 0.043),
        "ball_radius": (0.022, 0.022),
        "ball_friction": ((1, 0.005, 0.0001),) * 2,
    },
}
DRAWN = {
    "key": {
        "key_angle": (-np.pi / 2, np.pi / 2),
        "key_pos": ((-0.16, -0.56, 1.415), (-0.14, -0.54, 1.435)),
    },
    "hold": {
        "goal_pos": ((-0.265, -0.54, 1.42), (-0.205, -0.48, 1.48)),
        "object_size": ((0.02,) * 3, (0.03,) * 3),
    },
    "pen": {"tilt": ((-1, -1), (1, 1))},
    "baoding": {
        "sign": (-1, 1),
        "start_angle": (0, 2 * np.pi),
        "period": (4, 6),
        "radii": ((0.02, 0.022), (0.03, 0.032)),
        "ball_mass": (0.03, 0.3),
        "ball_radius": (0.018, 0.024),
        "ball_friction": ((0.8, 0.004, 0.00008), (1.2, 0.006, 0.00012)),
    },
}
"""What episodes draw, lowest and highest; definitions/tasks.md, section 3."""

NOMINAL_DIE = {"mass": (0.108, 0.108), "growth": (0, 0), "friction": ((1, 0.005, 0.0001),) * 2}
DICE = {
    "myoChallengeDieReorientDemo-v0": NOMINAL_DIE | {"offset": (0, 0), "turn": (3 * (-0.785,), 3 * (0.785,))},
    "myoChallengeDieReorientP1-v0": NOMINAL_DIE
    | {"offset": (3 * (-0.01,), 3 * (0.01,)), "turn": (3 * (-1.57,), 3 * (1.57,))},
    "myoChallengeDieReorientP2-v0": {
        "offset": (3 * (-0.02,), 3 * (0.02,)),
        "turn": (3 * (-3.14,), 3 * (3.14,)),
        "mass": (0.05, 0.25),
        "growth": (-0.007, 0.007),
        "friction": ((0.8, 0.004, 0.00008), (1.2, 0.006, 0.00012)),
    },
}
"""What the dice of each id draw."""


RELOCATED = {
    "myoChallengeRelocateP1-v0": {"goal": ((0, -0.35, 0.9), (0.2, -0.1, 0.9)), "turn": (3 * (0,), 3 * (0,))},
    "myoChallengeRelocateP2-v0": {
        "goal": ((0, -0.45, 0.9), (0.3, -0.1, 1.05)),
        "turn": (3 * (-0.2,), 3 * (0.2,)),
        "offset": (38 * (-0.01,), 38 * (0.01,)),
        "place": ((-0.1, -0.35, 1.0), (0.1, -0.15, 1.0)),
        "kind": (3 * (2,), 3 * (6,)),
        "size": (9 * (0.015,), 9 * (0.025,)),
        "center": (9 * (-1,), 9 * (1,)),
        "part turn": (9 * (-np.pi / 2,), 9 * (np.pi / 2,)),
        "friction": (3 * (0.8, 0.004, 0.00008), 3 * (1.2, 0.006, 0.00012)),
        "mass": (0.05, 0.2),
    },
}
REORIENTED = {"kind": (3, 6), "tilt": ((-1, -0.8), (1, 1.2))}
"""What resets of relocate and reorient draw."""


TARGET = (-0.34, -0.535, 1.46)  # m, the wanted die where nothing else is asked for
HALF_EDGE = 0.0235  # m
LEAST = 0.05  # of anything drawn, below which it is known to float32 of a place in the world


def tilt(quat):
    """Return the angles (u, v) of a rotation Rx(u) Ry(v)."""
    product = quat[:, 1] * quat[:, 2]
    np.testing.assert_allclose(quat[:, 3] * quat[:, 0], product, atol=VALUE_TOLERANCE)
    return 2 * np.arctan2(quat[:, 1:3], quat[:, :1])


def drawn_by_us(sim, meta):
    """Return what the worlds have drawn, by its name in the recordings."""
    program, ids = sim.shards[0].program, object_ids(sim.scene.oracle, meta)

    def field(name):
        return getattr(sim.scene.model, name).numpy()[:, ids[name.split("_")[0]]]

    if meta["task"] == "key":
        return {"key_angle": sim.scene.data.qpos.numpy()[:, 23], "key_pos": field("body_pos")[:, 0]}
    if meta["task"] == "hold":
        return {"goal_pos": program.goal.numpy(), "object_size": field("geom_size")[:, 0]}
    if meta["task"] == "pen":
        return {"tilt": tilt(sim.scene.data.mocap_quat.numpy()[:, 0])}
    if meta["task"] == "die":
        offset = sim.scene.data.mocap_pos.numpy()[:, 0] - TARGET
        shape = {"mass": field("body_mass")[:, 0], "growth": field("geom_size")[:, 0, 1] - HALF_EDGE}
        return shape | {
            "offset": offset,
            "turn": program.goal_angles.numpy(),
            "friction": field("geom_friction"),
        }
    if meta["task"] == "reorient":
        kinds = program.table.numpy()[program.row.numpy()[:, 0].astype(int), 0]
        return {"kind": kinds, "tilt": tilt(sim.scene.data.mocap_quat.numpy()[:, 0])}
    if meta["task"] == "relocate":
        data, arm = sim.scene.data, slice(0, NUM_ARM)
        drawn = {"goal": data.mocap_pos.numpy()[:, 0], "turn": program.goal_angles.numpy()}
        if not sim.scene.spec.varied:
            return drawn
        parts = {"size": "size", "center": "place", "part turn": "turn", "friction": "friction"}
        drawn |= {name: getattr(program, f"part_{ours}").numpy() for name, ours in parts.items()}
        drawn |= {"kind": np.hstack([getattr(program, f"kind_{part}").numpy() for part in range(3)])}
        drawn |= {"mass": field("body_mass")[:, 0], "place": field("body_pos")[:, 0]}
        return drawn | {"offset": data.qpos.numpy()[:, arm] - np.float32(sim.scene.spec.start_pose[arm])}
    balls = {"mass": field("body_mass"), "radius": field("geom_size")[:, :, 0]}
    balls["friction"] = field("geom_friction")
    orbits = {"sign": "direction", "start_angle": "start_angle", "period": "period", "radii": "radii"}
    drawn = {theirs: getattr(program.orbits, ours).numpy() for theirs, ours in orbits.items()}
    return drawn | {f"ball_{name}": values for name, values in balls.items()}


def drawn_by_upstream(record, meta):
    """Return what the recorded episodes have drawn."""
    if meta["task"] == "pen":
        return {"tilt": tilt(record["reset_target_quat"])}
    if meta["task"] == "reorient":
        return {"kind": record["reset_geom_type"][:, 0], "tilt": tilt(record["reset_target_quat"])}
    if meta["task"] == "relocate":
        return relocated_by_upstream(record, TASKS[meta["id"]])
    if meta["task"] == "die":
        growth = record["reset_geom_size"][:, 0, 1] - HALF_EDGE
        shape = {"mass": record["reset_body_mass"][:, 0], "friction": record["reset_geom_friction"]}
        wanted = {"turn": euler(record["reset_target_quat"]), "offset": record["reset_target_pos"] - TARGET}
        return shape | wanted | {"growth": growth}
    names = FIXED[meta["task"]]
    first = {"start_angle": record.get("reset_start_angles", np.zeros((1, 1)))[:, 0]}
    return {name: first[name] if name in first else record[f"reset_{name}"] for name in names}


def relocated_by_upstream(record, spec):
    """Return what recorded episodes of relocate have drawn."""
    drawn = {"goal": record["reset_target_pos"], "turn": euler(record["reset_target_quat"])}
    if not spec.varied:
        return drawn
    size, turns = record["reset_geom_size"][:, :3], record["reset_geom_quat"][:, :3]
    parts = {"size": size, "center": record["reset_geom_pos"][:, :3] / size}
    parts |= {"part turn": np.stack([euler(turns[:, part]) for part in range(3)], axis=1)}
    parts |= {"friction": record["reset_geom_friction"][:, :3], "kind": record["reset_geom_type"][:, :3]}
    drawn |= {name: values.reshape(len(values), -1) for name, values in parts.items()}
    drawn |= {"mass": record["reset_body_mass"][:, 0], "place": record["reset_body_pos"][:, 0]}
    return drawn | {"offset": record["reset_qpos"][:, :NUM_ARM] - spec.start_pose[:NUM_ARM]}


@pytest.mark.parametrize("key", KEYS)
def test_episodes_draw_like_upstream(key):
    """Bounds of everything randomised; ours fill them."""
    record, meta = recorded(key)
    random = "Random" in key or "P2" in key
    sim = simulation(key)
    sim.reset(seeds=np.arange(NUM_WORLDS))
    ours, theirs = drawn_by_us(sim, meta), drawn_by_upstream(record, meta)
    bounds = (
        (DICE | RELOCATED).get(key)
        or (REORIENTED if meta["task"] == "reorient" else None)
        or (DRAWN if random else FIXED)[meta["task"]]
    )
    assert set(ours) == set(theirs) == set(bounds)
    for name, (low, high) in bounds.items():
        low, spread = np.array(low), np.subtract(high, low)
        scale = np.maximum(np.maximum(np.abs(low), spread), LEAST)
        for values in (ours[name], theirs[name]):
            assert np.all(values >= low - VALUE_TOLERANCE * scale), name
            assert np.all(values <= high + VALUE_TOLERANCE * scale), name
        filled = ours[name].max(axis=0) - ours[name].min(axis=0)
        assert np.all(filled >= 0.95 * spread), name
        if name == "sign" and random:
            assert set(ours[name]) == set(theirs[name]) == {-1, 0, 1}


def outer(task, size):
    """Return bounding spheres and half bounding boxes: of ellipsoids and balls, or of the parts of a die."""
    if task != "die":
        return size.max(axis=-1), size
    edge, radius, length = size[..., 2] == 0, size[..., 0], size[..., 0] + size[..., 1]
    box = np.where(edge[..., None], np.stack([radius, radius, length], axis=-1), size)
    return np.where(edge, length, np.linalg.norm(size, axis=-1)), box


@pytest.mark.parametrize(
    "key", [key for key in KEYS if "geom_size" in TASKS[key].batched and not has_solids(key)]
)
def test_fields_that_follow_from_what_is_drawn(key):
    """Bounds for the broad phase and inverse weights, as upstream's recompilation gives them."""
    record, meta = recorded(key)
    sim = simulation(key)
    sim.reset(seeds=np.arange(NUM_WORLDS))
    ids, model, of_die = object_ids(sim.scene.oracle, meta), sim.scene.model, meta["task"] == "die"
    names = ["geom_size", "geom_rbound", "geom_aabb", "body_mass", "body_inertia", "body_invweight0"]
    names += ["geom_pos", "dof_invweight0"] if of_die else []
    ours = {name: getattr(model, name).numpy()[:, ids[name.split("_")[0]]] for name in names}
    theirs = {name: record[f"reset_{name}"] for name in names}
    for fields in (ours, theirs):
        size, mass = fields["geom_size"], fields["body_mass"][:, :1] if of_die else fields["body_mass"]
        radius, half = outer(meta["task"], size)
        inertia = np.maximum(6e-4 * mass, 1e-4) if of_die else np.full_like(mass, 1e-4)
        box = fields["geom_aabb"].reshape(*size.shape[:2], 2, 3)
        np.testing.assert_allclose(fields["geom_rbound"], radius, 1e-6)
        np.testing.assert_allclose(box, np.stack([0 * half, half], axis=2), 1e-6)
        objects = slice(mass.shape[1])  # the wanted die stays as it is
        expected = np.broadcast_to(inertia[..., None], (*inertia.shape, 3))
        given = np.broadcast_to(fields["body_inertia"][:, objects], expected.shape)
        np.testing.assert_allclose(given, expected, 1e-6)
        inverse = np.stack([1 / mass, 1 / inertia], axis=-1)
        np.testing.assert_allclose(fields["body_invweight0"][:, objects], inverse, 1e-6)
        if of_die:
            expected = np.repeat(inverse[:, 0], 3, axis=1)
            np.testing.assert_allclose(fields["dof_invweight0"], expected, 1e-6)
            middle = np.linalg.norm(fields["geom_pos"], axis=-1)
            np.testing.assert_allclose(middle[:, :12], np.sqrt(2) * size[:, :12, 1], 1e-6)
            assert not middle[:, 12:].any()


@pytest.mark.parametrize("key", [key for key in KEYS if has_solids(key)])
def test_fields_of_solids(key):
    """What upstream's recompilation gives for the kinds, sizes and masses that were drawn."""
    record, meta = recorded(key)
    sim, n = simulation(key), len(record["reset_qpos"])
    write_solids(sim, record, padded(np.arange(n)))
    ids, model = object_ids(sim.scene.oracle, meta), sim.scene.model

    def ours(name, world, rows):
        values = getattr(model, name).numpy()
        return values[world % len(values)][rows].astype(float)

    for row in range(n):
        geoms = geoms_there(sim.scene.spec, record, row, ids["geom"])
        every = ids["geom"][: len(ids["geom"]) - len(geoms) + SOLID_PARTS[meta["task"]]]
        hidden = np.setdiff1d(every, geoms)
        assert (ours("geom_margin", row, hidden) < -1.0).all()
        assert not ours("geom_margin", row, geoms).any()
        for name in ("geom_size", "geom_pos", "geom_rbound", "geom_friction"):
            theirs = record[f"reset_{name}"][row]
            np.testing.assert_allclose(ours(name, row, geoms), theirs, rtol=1e-5, atol=1e-7, err_msg=name)
        box = ours("geom_aabb", row, geoms).reshape(-1, 6)
        np.testing.assert_allclose(box, record["reset_geom_aabb"][row], rtol=1e-5, atol=1e-7)
        body, theirs = ids["body"][0], {name: record[f"reset_body_{name}"][row, 0] for name in BODY}
        for name in ("mass", "ipos", "invweight0"):
            mine = ours(f"body_{name}", row, body)
            np.testing.assert_allclose(mine, theirs[name], rtol=1e-5, atol=1e-7, err_msg=name)
        tensors = [
            inertia_of(ours("body_inertia", row, body), ours("body_iquat", row, body)),
            inertia_of(theirs["inertia"], theirs["iquat"]),
        ]
        assert np.abs(tensors[0] - tensors[1]).max() < 1e-5 * np.abs(tensors[1]).max()
        dofs = ours("dof_invweight0", row, ids["dof"])
        np.testing.assert_allclose(dofs, record["reset_dof_invweight0"][row], rtol=1e-5)
    if "P2" in key:
        assert np.ptp(record["reset_geom_type"][:, :3], axis=0).min() >= 3
        # The floor does not hide all.
        assert FRESH or record["reset_body_inertia"][:, 0].max() > 1.05e-4


SOLID_PARTS = {"relocate": 3, "reorient": 2}
BODY = ("mass", "ipos", "inertia", "iquat", "invweight0")


def inertia_of(moments, quat):
    """Return the tensor of principal moments in a frame, w first."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat / np.linalg.norm(quat))
    axes = matrix.reshape(3, 3)
    return axes @ np.diag(moments) @ axes.T

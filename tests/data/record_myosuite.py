"""Record oracle values of MyoSuite 3.0.0 pose and reach environments for the tests.

Runs the real environments and writes one `<id>.npz` per id: observations, reward terms and flags of
visited and of written states, physics replays, targets and model facts (`README.md` next to this
file describes the arrays). Every recording is compared with the task formulas in float64 NumPy and
the worst deviations are printed.

Recorded with myosuite 3.0.0, myo-sim 0.2.3, mujoco 4.0.0, gymnasium 1.2.3, numpy 2.4.6.
Run in an environment of its own:
    pip install myosuite==3.0.0 mujoco==4.0.0
    python tests/data/record_myosuite.py --out tests/data/myosuite
"""

import gymnasium
import mujoco
import myosuite  # noqa: F401  (registers the environments)
import numpy as np
from myosuite.utils import reach_workspace
from myosuite.utils.mujoco_geom_utils import refresh_geom_derived_fields
from recording import (
    STATE,
    clip_rows,
    common_meta,
    copies,
    largest_gap,
    main,
    names_meta,
    replay,
    result_row,
    run_episode,
    save,
    sigmoid_ctrl,
    stack,
)

# Under MuJoCo 4.0 `np.int32(3) in (mjtJoint.mjJNT_HINGE,)` is False, so that MyoSuite samples no
# joint and every FingerReachRandom target is the straight finger. Integers compare as intended and
# give the table of MuJoCo 3.11 (57279 points).
reach_workspace._JOINT_TYPES = tuple(int(kind) for kind in reach_workspace._JOINT_TYPES)

BASES = """myoFingerPose motorFingerPose myoElbowPose1D6M myoHandPose
    myoFingerReach motorFingerReach myoHandReach"""
IDS = [f"{base}{kind}-v0" for base in BASES.split() for kind in ("Fixed", "Random")]
IDS += [f"myoHandPose{pose}Fixed-v0" for pose in range(10)]
IDS += [f"myoElbowPose1D6MExo{kind}-v0" for kind in ("Fixed", "Random")]
IDS += [f"myoArmReach{kind}-v0" for kind in ("Fixed", "Random")]
TORSO_IDS = ["myoTorsoPoseFixed-v0", "myoTorsoExoPoseFixed-v0"]
IDS += TORSO_IDS
# The compiled model is stored once per body, in the file of its first id.
MODEL_IDS = {f"{base}Fixed-v0" for base in [*BASES.split()[:4], "myoElbowPose1D6MExo", "myoArmReach"]}
MODEL_IDS |= {*TORSO_IDS}
MODEL_FIELDS = """nq nv nu na ntendon qpos0 jnt_range jnt_axis jnt_pos jnt_solref jnt_solimp
    body_mass body_inertia body_ipos body_pos body_quat dof_damping dof_armature actuator_gainprm
    actuator_biasprm actuator_dynprm actuator_gear actuator_ctrlrange actuator_lengthrange
    actuator_acc0 tendon_range tendon_limited"""
META_FIELDS = "frame_skip dt far_th pose_thd target_type target_sampling reset_type"

ACTION_KINDS = ("uniform", "uniform", "uniform", "plus", "minus", "bang")
STRIDE = 6
NUM_REPLAYS = 32
NUM_TABLE_ROWS = 200
# Distances of the written states from the target, in units of the task's thresholds.
DISTANCES = {
    "thd": (0.0, 0.5, 0.99, 1.01, 1.25, 1.49, 1.51, 2.0, 4.0),
    "two_pi": (0.9, 0.99, 1.01, 1.5),
    "pi": (0.9, 0.99, 1.01, 1.5),
    "near": (0.0, 0.5, 0.99, 1.01, 1.5, 1.99, 2.01),
    "far": (0.7, 0.99, 1.01, 1.5, 3.0),
}
FORCED_STEPS = (1, 2, 3, 50)  # the far test of the reach tasks is inactive in the first step only
NEAR_PER_SITE = 0.0125  # [m]


def task_of(env):
    return "reach" if hasattr(env, "far_th") else "pose"


def thresholds(env):
    """Distances at which the terms switch [rad] or [m], from the environment's own settings."""
    if task_of(env) == "pose":
        torso = env.spec.id in TORSO_IDS
        return {"thd": env.pose_thd, **({"pi": np.pi} if torso else {"two_pi": 2.0 * np.pi})}
    num_sites = len(env.tip_sids)
    return {"near": NEAR_PER_SITE * num_sites, "far": env.far_th * num_sites}


def weight_row(env):
    """Mass and inertia of the weight that resets draw, and what they change; empty for most ids."""
    if not getattr(env, "weight_bodyname", None):
        return {}
    model, body = env.model, env.model.body(env.weight_bodyname)
    row = {"weight": body.mass[0], "weight_inertia": body.inertia.copy()}
    return row | {"dof_invweight0": model.dof_invweight0.copy()}


def put_weight(env, row):
    """Give the model the weight of a row, as the environment's reset does."""
    if "weight" in row:
        body = env.model.body(env.weight_bodyname).id
        env.model.body_mass[body] = row["weight"]
        env.model.geom_size[env.model.body_geomadr[body]][0] = 0.01 + 2.5 * row["weight"] / 100
        refresh_geom_derived_fields(env.model, env._mj_spec, (body,))


def state_row(env):
    """What the observation and the reward are functions of; reach positions are flattened."""
    row = copies(env.data, STATE) | {"time": env.data.time} | weight_row(env)
    if task_of(env) == "pose":
        return row | {"target": np.array(env.target_jnt_value, dtype=np.float64)}
    target, tip = (env.data.site_xpos[sites] for sites in (env.target_sids, env.tip_sids))
    return row | {"target": target.ravel(), "tip": tip.ravel()}


def terms_of(env):
    return (task_of(env), "bonus", "penalty", "act_reg")


def force_state(wrapped, rng, unit, factor, step):
    """Write a state at a distance from the target, then ask the environment for its values."""
    env = wrapped.unwrapped
    model, data = env.model, env.data
    wrapped.reset(seed=int(rng.integers(2**31)))
    pose = task_of(env) == "pose"
    distance = factor * thresholds(env)[unit]
    offset = rng.normal(size=len(env.target_jnt_value) if pose else 3 * len(env.tip_sids))
    offset *= distance / np.linalg.norm(offset)
    if pose:
        data.qpos[: len(offset)] = env.target_jnt_value - offset
    else:
        margin = 0.1 * np.ptp(model.jnt_range, axis=1)
        data.qpos[:] = rng.uniform(model.jnt_range[:, 0] - margin, model.jnt_range[:, 1] + margin)
        mujoco.mj_forward(model, data)
        model.site_pos[env.target_sids] = data.site_xpos[env.tip_sids] + offset.reshape(-1, 3)
    data.qvel[:] = rng.normal(size=model.nv)
    data.act[:] = rng.uniform(size=model.na)
    data.time = 0.0
    for _ in range(step * env.frame_skip):  # the same float accumulation as in mj_step
        data.time += model.opt.timestep
    result = env.forward()
    return {"step": step, "distance": distance} | result_row(state_row(env), result, terms_of(env))


def force_states(wrapped, rng):
    cases = [(unit, f) for unit in thresholds(wrapped.unwrapped) for f in DISTANCES[unit]]
    return [force_state(wrapped, rng, *case, step) for case in cases for step in FORCED_STEPS]


def target_facts(env):
    """Where targets come from: a vector, a box, or the table of reachable tip positions."""
    if task_of(env) == "pose":
        if getattr(env, "target_type", "fixed") == "fixed":
            return {"target_value": np.array(env.target_jnt_value)}
        low, high = env._target_jnt_range.T.astype(np.float64)
        return {"target_low": low, "target_high": high}
    spans = np.array(list(env.target_reach_range.values()), dtype=np.float64)
    facts = {"target_low": spans[:, 0], "target_high": spans[:, 1]}
    if env._workspace_points is not None:
        points = env._workspace_points.reshape(-1, spans[:, 0].size)
        index = np.linspace(0, len(points) - 1, NUM_TABLE_ROWS).round().astype(np.int64)
        facts |= {"table_size": np.int64(len(points))}
        facts |= {"table_index": index, "table_rows": points[index]}
    return facts


def meta_of(wrapped, env_id):
    env = wrapped.unwrapped
    fields = {name: getattr(env, name, None) for name in META_FIELDS.split()}
    own = {
        "thresholds": {key: float(value) for key, value in thresholds(env).items()},
        "tip_sites": [env.model.site(i).name for i in getattr(env, "tip_sids", ())],
    }
    if weight_row(env):
        own |= {"weight_range": env.weight_range}
    return fields | common_meta(wrapped, env_id, task_of(env)) | own | names_meta(env.model)


def expected(env, arrays, prefix):
    """Observation, reward terms and flags from the recorded state by the task formulas, float64."""
    get = {k: arrays[f"{prefix}_{k}"] for k in ("qpos", "qvel", "act", "target")}
    limit, reach = thresholds(env), task_of(env) == "reach"
    where = arrays[f"{prefix}_tip"] if reach else get["qpos"][:, : get["target"].shape[1]]
    error = get["target"] - where
    parts = [get["qpos"], get["qvel"] * env.dt, *([where] if reach else []), error, get["act"]]
    out = {"obs": np.concatenate(parts, axis=1).astype(np.float32)}
    if prefix == "reset":
        return out
    distance = np.linalg.norm(error, axis=1)
    near = limit["near" if reach else "thd"]
    wide = (2.0 if reach else 1.5) * near
    far = distance > max(limit.values())
    out["done"] = far & (arrays[f"{prefix}_step"] >= 2) if reach else far
    out["solved"] = distance < near
    out[f"reward_{task_of(env)}"] = out["sparse"] = -distance
    out["reward_bonus"] = 1.0 * (distance < wide) + (distance < near)
    out["reward_penalty"] = -1.0 * out["done"]
    out["reward_act_reg"] = -np.linalg.norm(get["act"], axis=1) / max(env.model.na, 1)
    out["reward"] = sum(w * out[f"reward_{k}"] for k, w in env.rwd_keys_wt.items() if w)
    return out


def deviations(env, arrays):
    """Worst absolute deviation of the recording from the formulas, per quantity."""
    worst = {}
    for prefix in ("reset", "step", "forced"):
        for key, value in expected(env, arrays, prefix).items():
            gap = largest_gap(arrays[f"{prefix}_{key}"], value)
            worst[key] = max(worst.get(key, 0.0), gap)
    for prefix in ("step", "clip"):
        action = arrays[f"{prefix}_action"]
        clipped = np.clip(action.astype(float), -1.0, 1.0)
        motor = clipped if env.model.na > 0 else (clipped - 1) / 2  # the exoskeleton, the motor finger
        muscle = env.model.actuator_dyntype == mujoco.mjtDyn.mjDYN_MUSCLE
        ctrl = np.where(muscle, sigmoid_ctrl(action), motor)
        worst[f"{prefix}_ctrl"] = largest_gap(arrays[f"{prefix}_ctrl"], ctrl)
    for name in STATE:  # the environment itself continues with a warm solver
        gap = largest_gap(arrays[f"replay_{name}_after"], arrays.pop(f"replay_{name}_env"))
        worst[f"replay_{name}"] = gap
    return worst


def replay_row(env, row):
    """Replay of a visited state under the model of its episode."""
    put_weight(env, row)
    return replay(env, row)[0]


def record(env_id, out, index):
    """Record one id into `<out>/<id>.npz`; returns the file size [bytes]."""
    wrapped = gymnasium.make(env_id)
    env, rng = wrapped.unwrapped, np.random.default_rng(index)
    runs, visited = [], []
    stride = STRIDE * (4 if env_id in TORSO_IDS else 1)  # 216 muscles: fewer rows
    for i, kind in enumerate(ACTION_KINDS):
        run = run_episode(wrapped, i, kind, 100 * index + i, state_row, terms_of(env), stride)
        visited += [row | weight_row(env) for row in run[3]]
        runs.append(run[:3])
    facts, resets, steps = zip(*runs, strict=True)
    chosen = np.linspace(0, len(visited) - 1, NUM_REPLAYS).round().astype(int)
    arrays = stack(facts, "episode") | stack(resets, "reset")
    arrays |= stack([row for rows in steps for row in rows], "step")
    arrays |= target_facts(env) | stack([replay_row(env, visited[i]) for i in chosen], "replay")
    arrays |= stack(force_states(wrapped, rng), "forced")
    arrays |= clip_rows(wrapped, rng)
    if env_id in MODEL_IDS:
        arrays |= {f"model_{k}": np.array(getattr(env.model, k)) for k in MODEL_FIELDS.split()}
    worst = deviations(env, arrays)
    return save(out, env_id, meta_of(wrapped, env_id), arrays, facts, worst)


if __name__ == "__main__":
    main(__doc__.splitlines()[0], IDS, record)

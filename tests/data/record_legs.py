"""Record oracle values of MyoSuite 3.0.0's leg environments for the tests, as `record_myosuite.py` does.

Recorded with myosuite 3.0.0, myo-sim 0.2.3, mujoco 4.0.0, gymnasium 1.2.3, numpy 2.4.6.
    python tests/data/record_legs.py --out tests/data/myosuite
"""

import gymnasium
import mujoco
import myosuite  # noqa: F401  (registers the environments)
import numpy as np
from record_myosuite import MODEL_FIELDS
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
    rough_heights,
    run_episode,
    save,
    sigmoid_ctrl,
    stack,
)

STAND, WALK = "myoLegStandRandom-v0", "myoLegWalk-v0"
DIRECTIONAL = [f"myoLegDirectional{name}-v0" for name in ("Forward", "Backward", "Random")]
ROUGH = "myoLegRoughTerrainWalk-v0"
TERRAIN = [ROUGH, "myoLegHillyTerrainWalk-v0", "myoLegStairTerrainWalk-v0"]
WALKING = [WALK, *TERRAIN]
IDS = [STAND, WALK, *DIRECTIONAL, *TERRAIN]
WALK_TERMS = ("vel_reward", "cyclic_hip", "ref_rot", "joint_angle_rew", "done", "act_mag")
TERMS = {STAND: ("reach", "bonus", "penalty", "act_reg")} | dict.fromkeys(WALKING, WALK_TERMS)
TERMS |= dict.fromkeys(DIRECTIONAL, ("heading", "act_reg"))
ACTION_KINDS = ("uniform", "uniform", "uniform", "plus", "minus", "bang")
STRIDE = 6
NUM_REPLAYS = 32
NEAR, FAR = 0.05, 0.44  # m
DISTANCES = (0.0, 0.5 * NEAR, 0.99 * NEAR, 1.01 * NEAR, 1.99 * NEAR, 2.01 * NEAR, 0.7 * FAR, 0.99 * FAR)
DISTANCES += (1.01 * FAR, 3.0 * FAR)
FORCED_STEPS = (1, 2, 3, 50)


def task_of(env_id):
    """Return the family of an id."""
    tasks = {STAND: "stand", WALK: "walk"} | dict.fromkeys(TERRAIN, "terrain")
    return tasks.get(env_id, "directional")


def with_terms(result):
    """Name the terms of a directional task as those of the others are named."""
    obs, reward, terminated, truncated, info = result
    rewards = info["rwd_dict"]
    tracking = rewards["heading/heading_tracking"]
    named = {"heading": tracking - rewards["done"], "act_reg": rewards["act_reg/act_reg"]}
    info["rwd_dict"] = rewards | named | {"sparse": tracking}
    return obs, reward, terminated, truncated, info


class Directional(gymnasium.Wrapper):
    """A directional task whose steps name their reward terms."""

    def __init__(self, wrapped):
        super().__init__(wrapped)
        env = wrapped.unwrapped
        env.rwd_keys_wt, env.dt = env._task_config.reward.weights, env._ctrl_dt

    def step(self, action):
        return with_terms(self.env.step(action))


def state_row(env):
    """What the observation and the reward are functions of."""
    if env.spec.id in DIRECTIONAL:
        heading = env.get_obs_dict(env._accessor)["heading_cmd"]
        return copies(env.data, STATE) | {"time": env.data.time, "heading": heading}
    if env.spec.id in WALKING:
        return copies(env.data, STATE) | {"time": env.data.time}
    target, tip = (env.data.site_xpos[sites].ravel() for sites in (env.target_sids, env.tip_sids))
    return copies(env.data, STATE) | {"time": env.data.time, "target": target, "tip": tip}


def replayed(env, row):
    """Replay a control step on the ground of its episode."""
    if env.spec.id == ROUGH:
        env.model.hfield_data[:] = rough_heights(row["seed"])
    return replay(env, row)[0]


def force_walk(wrapped, rng, lift, turn, step):
    """Write a state beside that of the start, then ask the environment for its values."""
    env = wrapped.unwrapped
    model, data = env.model, env.data
    wrapped.reset(seed=int(rng.integers(2**31)))
    limited = model.jnt_limited.astype(bool)
    data.qpos[model.jnt_qposadr[limited]] = rng.uniform(*model.jnt_range[limited].T)
    data.qpos[:3] += (*rng.normal(size=2), lift)
    angle = np.array((np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)))
    mujoco.mju_mulQuat(data.qpos[3:7], angle, data.qpos[3:7].copy())
    data.qpos[3:7] += 0.02 * rng.normal(size=4)
    data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
    data.qvel[:] = rng.normal(size=model.nv)
    data.qvel[:2] = 0.3 * rng.normal(size=2) + 1.2 * state_row(env).get("heading", np.array((0.0, -1.0)))
    data.act[:] = rng.uniform(size=model.na)
    env.steps = step
    result = with_terms(env.forward()) if env.spec.id in DIRECTIONAL else env.forward()
    return {"step": step} | result_row(state_row(env), result, TERMS[env.spec.id])


def force_states(wrapped, rng):
    """Rows of written states."""
    if wrapped.unwrapped.spec.id == STAND:
        return [force_state(wrapped, rng, d, step) for d in DISTANCES for step in FORCED_STEPS]
    cases = [(lift, turn) for lift in (-0.3, -0.1, 0.0, 0.1) for turn in (-1.2, -0.5, 0.0, 0.7, 1.0)]
    return [force_walk(wrapped, rng, *case, step) for case in cases for step in (1, 37, 150)]


def force_state(wrapped, rng, distance, step):
    """Write a state at a distance from the target, then ask the environment for its values."""
    env = wrapped.unwrapped
    model, data = env.model, env.data
    wrapped.reset(seed=int(rng.integers(2**31)))
    hinges = model.jnt_qposadr[model.jnt_limited.astype(bool)]
    data.qpos[hinges] = rng.uniform(*model.jnt_range[model.jnt_limited.astype(bool)].T)
    data.qpos[:3] += 0.1 * rng.normal(size=3)
    data.qpos[3:7] += 0.2 * rng.normal(size=4)
    data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
    mujoco.mj_forward(model, data)
    offset = rng.normal(size=3)
    model.site_pos[env.target_sids] = data.site_xpos[env.tip_sids] + distance * offset / np.linalg.norm(
        offset
    )
    data.qvel[:] = rng.normal(size=model.nv)
    data.act[:] = rng.uniform(size=model.na)
    data.time = 0.0
    for _ in range(step * env.frame_skip):  # the same float accumulation as in mj_step
        data.time += model.opt.timestep
    result = env.forward()
    return {"step": step, "distance": distance} | result_row(state_row(env), result, TERMS[STAND])


def expected(env, arrays, prefix):
    """Observation, reward terms and flags from the recorded state by the task's formulas, float64."""
    qpos, qvel, act, target, tip = (arrays[f"{prefix}_{k}"] for k in (*STATE, "target", "tip"))
    error, rate = target - tip, qvel * env.dt
    out = {"obs": np.concatenate([qpos, rate, tip, error, act], axis=1).astype(np.float32)}
    if prefix == "reset":
        return out
    distance = np.linalg.norm(error, axis=1)
    out["done"] = (distance > FAR) & (arrays[f"{prefix}_step"] >= 2)
    out["solved"] = distance < NEAR
    out["sparse"] = -distance
    out["reward_reach"] = 10 - distance - 10 * np.linalg.norm(rate, axis=1)
    out["reward_bonus"] = 1.0 * (distance < 2 * NEAR) + (distance < NEAR)
    out["reward_penalty"] = -1.0 * out["done"]
    out["reward_act_reg"] = -100 * np.linalg.norm(act, axis=1) / env.model.na
    out["reward"] = sum(w * out[f"reward_{k}"] for k, w in env.rwd_keys_wt.items())
    return out


def deviations(env, arrays):
    """Worst absolute deviation of the recording from the formulas, per quantity."""
    worst = {}
    for prefix in ("reset", "step", "forced") if env.spec.id == STAND else ():
        for key, value in expected(env, arrays, prefix).items():
            worst[key] = max(worst.get(key, 0.0), largest_gap(arrays[f"{prefix}_{key}"], value))
    for prefix in ("step", "clip"):
        action = arrays[f"{prefix}_action"]
        ctrl = sigmoid_ctrl(action) if env.spec.id == STAND else np.clip(action, 0.0, 1.0)
        worst[f"{prefix}_ctrl"] = largest_gap(arrays[f"{prefix}_ctrl"], ctrl)
    for name in STATE:  # the environment itself continues with a warm solver
        gap = largest_gap(arrays[f"replay_{name}_after"], arrays.pop(f"replay_{name}_env"))
        worst[f"replay_{name}"] = gap
    return worst


def record(env_id, out, index):
    """Record one id into `<out>/<id>.npz`; returns the file size [bytes]."""
    wrapped = gymnasium.make(env_id)
    wrapped = Directional(wrapped) if env_id in DIRECTIONAL else wrapped
    env, rng = wrapped.unwrapped, np.random.default_rng(index)
    runs, visited = [], []
    for i, kind in enumerate(ACTION_KINDS):
        seed = 100 * index + i
        run = run_episode(wrapped, i, kind, seed, state_row, TERMS[env_id], STRIDE)
        assert env_id != ROUGH or np.array_equal(env.model.hfield_data, rough_heights(seed))
        visited += [row | {"seed": seed} for row in run[3]]
        runs.append(run[:3])
    facts, resets, steps = zip(*runs, strict=True)
    chosen = np.linspace(0, len(visited) - 1, NUM_REPLAYS).round().astype(int)
    arrays = stack(facts, "episode") | stack(resets, "reset")
    arrays |= stack([row for rows in steps for row in rows], "step")
    arrays |= stack([replayed(env, visited[i]) for i in chosen], "replay")
    arrays |= stack(force_states(wrapped, rng), "forced")
    arrays |= clip_rows(wrapped, rng)
    if env_id == STAND:
        arrays |= {f"model_{k}": np.array(getattr(env.model, k)) for k in MODEL_FIELDS.split()}
    worst = deviations(env, arrays)
    meta = common_meta(wrapped, env_id, task_of(env_id)) | names_meta(env.model)
    meta |= {"frame_skip": env.frame_skip, "dt": env.dt}
    if env_id == STAND:
        meta |= {"tip_sites": [env.model.site(i).name for i in env.tip_sids]}
        span = np.array(list(env.target_reach_range.values()), dtype=float)[0] + arrays["reset_tip"][0]
        arrays |= {"target_low": span[0], "target_high": span[1]}
    return save(out, env_id, meta, arrays, facts, worst)


if __name__ == "__main__":
    main(__doc__.splitlines()[0], IDS, record)

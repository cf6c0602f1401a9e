"""What the recorders of MyoSuite values share: episodes, replays, rows of arrays, files.

A task is handed over as `state_row(env)`, the quantities that the observation and the reward are
functions of, and the names of its reward terms.
"""

import argparse
import json
from importlib.metadata import version
from pathlib import Path

import mujoco
import numpy as np

PACKAGES = ("myosuite", "mujoco", "myo-sim", "gymnasium", "numpy")
STATE = ("qpos", "qvel", "act")
FORCES = ("actuator_force", "actuator_length", "actuator_velocity", "qfrc_actuator")
FORCES += ("qfrc_passive", "qacc")

DIVERGED = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)
FIRST_STEPS = 3  # recorded whatever the stride
NUM_CLIPS, CLIP_SCALE = 4, 3.0  # steps with actions in [-3, 3], beyond the action space


def copies(data, names, suffix=""):
    return {f"{name}{suffix}": getattr(data, name).copy() for name in names}


def stack(rows, prefix):
    return {f"{prefix}_{k}": np.stack([np.asarray(row[k]) for row in rows]) for k in rows[0]}


def result_row(state, result, terms):
    """State row plus observation, reward terms and flags of a Gymnasium 5-tuple."""
    obs, reward, _, _, info = result
    rewards = info["rwd_dict"]
    row = state | {"obs": obs.copy(), "reward": reward}
    row |= {f"reward_{k}": float(rewards[k]) for k in terms}
    row["sparse"] = float(rewards["sparse"])
    return row | {"solved": bool(rewards["solved"]), "done": bool(rewards["done"])}


def draw_action(kind, rng, nu, last=None):
    """Action of an episode of the given kind; `last` is the one before, None in the first step."""
    if kind == "steady" and last is not None:
        return last
    if kind in ("uniform", "steady"):
        return rng.uniform(-1.0, 1.0, nu).astype(np.float32)
    if kind == "weak":
        return rng.uniform(-1.0, -0.2, nu).astype(np.float32)
    if kind == "bang":
        return rng.choice(np.float32([-1.0, 1.0]), nu)
    return np.full(nu, 1.0 if kind == "plus" else -1.0, dtype=np.float32)


def run_episode(wrapped, index, kind, seed, state_row, terms, stride):
    """One episode: (episode facts, reset row, sampled step rows, physics row of every step)."""
    env, rng = wrapped.unwrapped, np.random.default_rng(seed)
    obs, _ = wrapped.reset(seed=seed)
    reset = state_row(env) | {"obs": obs.copy(), "episode": index}
    steps, physics, step, ended, action = [], [], 0, False, None
    while not ended:
        step += 1
        action = draw_action(kind, rng, env.model.nu, action)
        before = copies(env.data, STATE, "_before")
        result = wrapped.step(action)
        if any(env.data.warning[int(kind)].number for kind in DIVERGED):  # and MuJoCo has reset
            step, terminated, truncated = step - 1, False, False
            break
        terminated, truncated = result[2:4]
        ended = terminated or truncated
        ctrl = env.data.ctrl.copy()
        physics.append(before | {"ctrl": ctrl} | copies(env.data, STATE, "_env"))
        if step <= FIRST_STEPS or step % stride == 0 or ended:
            row = {"episode": index, "step": step, "action": action, "ctrl": ctrl}
            steps.append(row | result_row(state_row(env), result, terms))
    facts = {"length": step, "terminated": terminated, "truncated": truncated, "kind": kind}
    facts |= {"seed": seed, "unstable": bool(env._check_mj_instability_termination())}
    return facts, reset, steps, physics


def clip_row(wrapped, rng):
    """Action beyond the action space and the ctrl it leads to."""
    nu = wrapped.unwrapped.model.nu
    action = rng.uniform(-CLIP_SCALE, CLIP_SCALE, nu).astype(np.float32)
    wrapped.step(action)
    return {"action": action, "ctrl": wrapped.unwrapped.data.ctrl.copy()}


def clip_rows(wrapped, rng):
    return stack([clip_row(wrapped, rng) for _ in range(NUM_CLIPS)], "clip")


def replay(env, row):
    """frame_skip x mj_step of the environment's model from a fresh MjData (cold solver start).

    Returns the row and the MjData of the state before.
    """
    before, after = mujoco.MjData(env.model), mujoco.MjData(env.model)
    for data in (before, after):
        data.ctrl[:] = row["ctrl"]
        for name in STATE:
            getattr(data, name)[:] = row[f"{name}_before"]
    mujoco.mj_forward(env.model, before)
    mujoco.mj_step(env.model, after, env.frame_skip)
    return row | copies(before, FORCES) | copies(after, STATE, "_after"), before


def common_meta(wrapped, env_id, task):
    env = wrapped.unwrapped
    obs = env.get_obs_dict(env._accessor)
    return {
        "id": env_id,
        "task": task,
        "versions": {name: version(name) for name in PACKAGES},
        "horizon": wrapped.get_wrapper_attr("_max_episode_steps"),
        "timestep": env.model.opt.timestep,
        "obs": {key: int(np.size(obs[key])) for key in getattr(env, "obs_keys", obs)},
        "weights": {key: float(value) for key, value in env.rwd_keys_wt.items()},
        "action_dim": int(env.model.nu),
    }


def names_meta(model):
    return {
        "joints": [model.joint(i).name for i in range(model.njnt)],
        "actuators": [model.actuator(i).name for i in range(model.nu)],
        "tendons": [model.tendon(i).name for i in range(model.ntendon)],
        "bodies": [model.body(i).name for i in range(model.nbody)],
    }


def largest_gap(a, b):
    return np.abs(np.asarray(a, dtype=float) - np.asarray(b, dtype=float)).max(initial=0.0)


def sigmoid_ctrl(action):
    """Muscle excitation of an action."""
    return 1 / (1 + np.exp(-5 * (np.clip(action.astype(float), -1.0, 1.0) - 0.5)))


def rough_heights(seed):
    """Heights of MyoSuite's rough ground after a reset with a seed [m], its generator's first draws."""
    drawn = np.random.default_rng(int(seed)).uniform(-0.5, 0.5, 10_000)
    return (0.08 * (drawn - drawn.min()) / (drawn.max() - drawn.min()) - 0.02).astype(np.float32)


def euler(quats):
    """Return the angles of Rx Ry Rz of quaternions, shape (n, 3)."""
    matrices = np.zeros((len(quats), 9))
    for matrix, quat in zip(matrices, quats, strict=True):
        mujoco.mju_quat2Mat(matrix, quat)
    m = matrices.reshape(-1, 3, 3)
    first, last = np.arctan2(-m[:, 1, 2], m[:, 2, 2]), np.arctan2(-m[:, 0, 1], m[:, 0, 0])
    return np.stack([first, np.arcsin(np.clip(m[:, 0, 2], -1.0, 1.0)), last], axis=1)


def save(out, env_id, meta, arrays, facts, worst):
    """Write `<out>/<id>.npz` and print the summary line; returns the file size [bytes]."""
    path = out / f"{env_id}.npz"
    np.savez_compressed(path, meta=json.dumps(meta), **arrays)
    size = path.stat().st_size
    ends = [f"{f['length']}{'T' if f['terminated'] else ''}" for f in facts]
    worst = {key: f"{value:.1e}" for key, value in worst.items()}
    print(f"{env_id}: {size / 1e3:.0f} kB, episodes {' '.join(ends)}, worst {worst}", flush=True)
    return size


def main(description, ids, record):
    """Command line of a recorder: `record(env_id, out, index)` for the wanted ids."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--ids", nargs="*", default=ids)
    parser.add_argument("--shift", type=int, default=0, help="shifts all seeds: other states, same format")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    total = sum(record(env_id, args.out, ids.index(env_id) + args.shift) for env_id in args.ids)
    print(f"total {total / 1e6:.2f} MB")

"""Record oracle values of MyoSuite 3.0.0 environments whose muscles fatigue (`myoFati...`, 3CC-r).

Runs the real environments, from fresh, given and drawn states of fatigue, and writes one `<id>.npz` per id:
actions, target loads, compartments, controls, states, observations and rewards (`README.md` next to this
file describes the arrays).

Recorded with myosuite 3.0.0, myo-sim 0.2.3, mujoco 4.0.0, gymnasium 1.2.3, numpy 2.4.6.
Run in an environment of its own:
    pip install myosuite==3.0.0 mujoco==4.0.0
    python tests/data/record_fatigue.py --out tests/data/myosuite
"""

import gymnasium
import numpy as np
from myosuite.envs.wrappers import FatigueWrapper  # importing myosuite registers the environments
from recording import (
    FIRST_STEPS,
    STATE,
    common_meta,
    copies,
    draw_action,
    largest_gap,
    main,
    names_meta,
    result_row,
    save,
    stack,
)

IDS = ["myoFatiFingerPoseFixed-v0", "myoFatiElbowPose1D6MRandom-v0", "myoFatiHandPoseRandom-v0"]
EPISODES = (("uniform", "fresh"), ("plus", "fresh"), ("bang", "given"), ("weak", "drawn"))  # actions, start
TERMS = ("pose", "bonus", "penalty", "act_reg")
STRIDE = 6


def wrapper_of(env):
    """The wrapper that holds the start of fatigue."""
    while not isinstance(env, FatigueWrapper):
        env = env.env
    return env


def compartments(env, suffix=""):
    model = env.muscle_fatigue
    parts = {"active": model._MA, "resting": model._MR, "fatigued": model._MF}
    return {f"{name}{suffix}": np.array(values) for name, values in parts.items()}


def run_episode(wrapped, kind, start, seed):
    """One episode: (episode facts with every action, start row, sampled step rows)."""
    env, rng = wrapped.unwrapped, np.random.default_rng(seed)
    fatigue, model = wrapper_of(wrapped), env.model
    fatigue.fatigue_reset_random = start == "drawn"
    given = rng.uniform(0.0, 0.9, model.nu)
    # MyoSuite keeps the array that it is given and changes it in place.
    fatigue.fatigue_reset_vec = given.copy() if start == "given" else None
    obs, _ = wrapped.reset(seed=seed)
    reset = compartments(env) | copies(env.data, STATE) | {"obs": obs.copy()}
    actions = np.full((wrapped.get_wrapper_attr("_max_episode_steps"), model.nu), np.nan, dtype=np.float32)
    rows, step, ended = [], 0, False
    while not ended:
        step += 1
        action = actions[step - 1] = draw_action(kind, rng, model.nu)
        before = copies(env.data, STATE, "_before") | compartments(env, "_before")
        result = wrapped.step(action)
        ended = result[2] or result[3]
        if step <= FIRST_STEPS or step % STRIDE == 0 or ended:
            row = before | compartments(env) | copies(env.data, STATE) | {"step": step, "action": action}
            row |= {"target_load": env.muscle_fatigue.TL.copy(), "ctrl": env.data.ctrl.copy()}
            row |= {"target": np.array(env.target_jnt_value, dtype=np.float64)}
            rows.append(result_row(row, result, TERMS))
    facts = {"length": step, "terminated": result[2], "kind": kind, "start": start, "seed": seed}
    return facts | {"action": actions}, reset, rows


def deviations(arrays):
    """What has to agree by definition: the compartments' sum, and control and active fraction."""
    total = sum(arrays[f"step_{name}"] for name in ("active", "resting", "fatigued"))
    return {"sum": largest_gap(total, 1.0), "ctrl": largest_gap(arrays["step_ctrl"], arrays["step_active"])}


def record(env_id, out, index):
    """Record one id into `<out>/<id>.npz`; returns the file size [bytes]."""
    wrapped = gymnasium.make(env_id)
    env = wrapped.unwrapped
    runs = [run_episode(wrapped, *kinds, 100 * index + i) for i, kinds in enumerate(EPISODES)]
    facts, resets, steps = zip(*runs, strict=True)
    arrays = stack(facts, "episode") | stack(resets, "reset")
    for i, rows in enumerate(steps):
        for row in rows:
            row["episode"] = i
    arrays |= stack([row for rows in steps for row in rows], "step")
    model = env.muscle_fatigue
    arrays |= {"rate_fatigue": model._F, "rate_recovery": model._R, "rate_rest_factor": model._r}
    meta = common_meta(wrapped, env_id, "pose") | {"frame_skip": env.frame_skip, "dt": env.dt}
    return save(out, env_id, meta | names_meta(env.model), arrays, facts, deviations(arrays))


if __name__ == "__main__":
    main(__doc__.splitlines()[0], IDS, record)

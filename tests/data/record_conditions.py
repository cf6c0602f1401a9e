"""Record oracle values of MyoSuite 3.0.0 environments with a muscle condition (`myo{Sarc,Fati,Reaf}...`).

Runs the real environments and writes one `<id>.npz` per id: control steps with the state before, action,
control, state after, observation and reward (`README.md` next to this file describes the arrays). The ids of
`record_fatigue.py` are left to it.

Recorded with myosuite 3.0.0, myo-sim 0.2.3, mujoco 4.0.0, gymnasium 1.2.3, numpy 2.4.6.
Run in an environment of its own; without --ids every id is recorded:
    pip install myosuite==3.0.0 mujoco==4.0.0
    python tests/data/record_conditions.py --out tests/data/myosuite --ids myoSarcHandPoseRandom-v0
"""

import gymnasium
import mujoco
import numpy as np
import record_contact
import record_fatigue
import record_legs
import record_myosuite
from contact_model import object_fields
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
    sigmoid_ctrl,
    stack,
)

PREFIXES = {"myoSarc": "myo", "myoFati": "myo", "myoReaf": "myoHand"}  # beginning of the names that have it
IDS = [
    env_id.replace("myo", prefix, 1)
    for env_id in (*record_myosuite.IDS, *record_contact.IDS)
    for prefix, beginning in PREFIXES.items()
    if env_id.startswith(beginning)
]
IDS += [
    env_id.replace("myo", prefix, 1)
    for env_id in (record_legs.STAND, *record_legs.WALKING)
    for prefix in ("myoSarc", "myoFati")
]
IDS = [env_id for env_id in IDS if env_id not in record_fatigue.IDS]

ACTION_KINDS = ("uniform", "bang")
VARIED = (
    "baoding",
    "die",
    "relocate",
    "reorient",
)  # tasks whose episodes may change size, mass and friction of their objects
STRIDE = 4
NUM_ROWS = 16


def description(env, env_id):
    """What observation and reward are functions of, the reward terms, and the task's name."""
    prefix = next(prefix for prefix in PREFIXES if env_id.startswith(prefix))
    healthy = env_id.replace(prefix, "myo")
    if healthy in record_legs.WALKING:
        return lambda env: copies(env.data, STATE), record_legs.WALK_TERMS, record_legs.task_of(healthy)
    if healthy == record_legs.STAND:
        return record_myosuite.state_row, record_legs.TERMS[healthy], record_legs.task_of(healthy)
    family = record_contact.FAMILIES.get(healthy)
    if family is None:
        return record_myosuite.state_row, record_myosuite.terms_of(env), record_myosuite.task_of(env)

    def state(env):
        row = copies(env.data, STATE) | family.state(env)
        return row | (object_fields(env.model, family.objects) if family.name in VARIED else {})

    return state, family.terms, family.name


def units(env, suffix=""):
    """Compartments of the motor units; none without fatigue."""
    return record_fatigue.compartments(env, suffix) if hasattr(env, "muscle_fatigue") else {}


def run_episode(wrapped, kind, seed, state_row, terms):
    """One episode: (episode facts, sampled control steps)."""
    env, rng = wrapped.unwrapped, np.random.default_rng(seed)
    wrapped.reset(seed=seed)
    rows, step, ended = [], 0, False
    while not ended:
        step += 1
        action = draw_action(kind, rng, env.model.nu)
        before = copies(env.data, STATE, "_before") | units(env, "_before")
        result = wrapped.step(action)
        ended = result[2] or result[3]
        if step <= FIRST_STEPS or step % STRIDE == 0 or ended:
            row = before | {"step": step, "action": action, "ctrl": env.data.ctrl.copy()} | units(env)
            row |= {"seed": seed}
            rows.append(row | result_row(state_row(env), result, terms))
    return {"length": step, "terminated": result[2], "kind": kind, "seed": seed}, rows


def expected_ctrl(env, env_id, arrays, actuators):
    """Controls of muscles from actions or from compartments; those of motors as they are."""
    muscle = env.model.actuator_dyntype == mujoco.mjtDyn.mjDYN_MUSCLE
    ctrl = arrays["step_ctrl"].copy()
    fatigued = env_id.startswith("myoFati")
    action = arrays["step_action"]
    walks = env_id.replace("myoSarc", "myo") in record_legs.WALKING
    asked = np.clip(action, 0.0, 1.0) if walks else sigmoid_ctrl(action)
    ctrl[:, muscle] = arrays["step_active"] if fatigued else asked[:, muscle]
    if env_id.startswith("myoReaf"):
        eip, epl = (next(i for i, name in enumerate(actuators) if name.startswith(m)) for m in ("EIP", "EPL"))
        ctrl[:, epl], ctrl[:, eip] = ctrl[:, eip], 0.0
    return ctrl


def record(env_id, out, index):
    """Record one id into `<out>/<id>.npz`; returns the file size [bytes]."""
    wrapped = gymnasium.make(env_id)
    env = wrapped.unwrapped
    record_contact.watch_period(env)
    state_row, terms, task = description(env, env_id)
    runs = [
        run_episode(wrapped, kind, 30000 + 100 * index + i, state_row, terms)
        for i, kind in enumerate(ACTION_KINDS)
    ]
    facts = [fact for fact, _ in runs]
    rows = [row for _, steps in runs for row in steps]
    chosen = np.linspace(0, len(rows) - 1, min(NUM_ROWS, len(rows))).round().astype(int)
    arrays = stack(facts, "episode") | stack([rows[i] for i in chosen], "step")
    meta = common_meta(wrapped, env_id, task) | names_meta(env.model)
    if task in VARIED:
        family = next(family for family in record_contact.FAMILIES.values() if family.name == task)
        meta |= {"object_bodies": list(family.objects)}
    ctrl = expected_ctrl(env, env_id, arrays, meta["actuators"])
    return save(out, env_id, meta, arrays, facts, {"ctrl": largest_gap(arrays["step_ctrl"], ctrl)})


if __name__ == "__main__":
    main(__doc__.splitlines()[0], IDS, record)

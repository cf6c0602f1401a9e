"""Record oracle values of MyoSuite 3.0.0 hands whose command for EIP goes to EPL (`myoReafHand...`).

Runs the real environments and writes one `<id>.npz` per id: control steps with the state before, action,
control, state after, observation and reward (`README.md` next to this file describes the arrays).

Recorded with myosuite 3.0.0, myo-sim 0.2.3, mujoco 4.0.0, gymnasium 1.2.3, numpy 2.4.6.
Run in an environment of its own:
    pip install myosuite==3.0.0 mujoco==4.0.0
    python tests/data/record_reafferentation.py --out tests/data/myosuite
"""

import gymnasium
import numpy as np
import record_contact
import record_myosuite
from recording import (
    STATE,
    common_meta,
    copies,
    largest_gap,
    main,
    names_meta,
    run_episode,
    save,
    sigmoid_ctrl,
    stack,
)

TASKS = ("HandPose", "HandReach", "HandKeyTurn", "HandObjHold", "HandPenTwirl")
IDS = [f"myoReaf{task}{kind}-v0" for task in TASKS for kind in ("Fixed", "Random")]

ACTION_KINDS = ("uniform", "bang")
STRIDE = 4
NUM_ROWS = 16


def description(env, env_id):
    """What observation and reward are functions of, the reward terms, and the task's name."""
    family = record_contact.FAMILIES.get(env_id.replace("myoReaf", "myo"))
    if family is None:
        return record_myosuite.state_row, record_myosuite.terms_of(env), record_myosuite.task_of(env)
    return lambda env: copies(env.data, STATE) | family.state(env), family.terms, family.name


def redirected(ctrl, actuators):
    """Controls with EIP's at EPL and none at EIP."""
    eip, epl = (next(i for i, name in enumerate(actuators) if name.startswith(m)) for m in ("EIP", "EPL"))
    ctrl = ctrl.copy()
    ctrl[:, epl], ctrl[:, eip] = ctrl[:, eip], 0.0
    return ctrl


def record(env_id, out, index):
    """Record one id into `<out>/<id>.npz`; returns the file size [bytes]."""
    wrapped = gymnasium.make(env_id)
    state_row, terms, task = description(wrapped.unwrapped, env_id)
    facts, rows = [], []
    for i, kind in enumerate(ACTION_KINDS):
        seed = 30000 + 100 * index + i
        fact, _, steps, physics = run_episode(wrapped, i, kind, seed, state_row, terms, STRIDE)
        facts.append(fact)
        for row in steps:
            before = {k: v for k, v in physics[row["step"] - 1].items() if k.endswith("_before")}
            rows.append(before | row)
    chosen = np.linspace(0, len(rows) - 1, min(NUM_ROWS, len(rows))).round().astype(int)
    arrays = stack(facts, "episode") | stack([rows[i] for i in chosen], "step")
    meta = common_meta(wrapped, env_id, task) | names_meta(wrapped.unwrapped.model)
    ctrl = redirected(sigmoid_ctrl(arrays["step_action"]), meta["actuators"])
    return save(out, env_id, meta, arrays, facts, {"ctrl": largest_gap(arrays["step_ctrl"], ctrl)})


if __name__ == "__main__":
    main(__doc__.splitlines()[0], IDS, record)

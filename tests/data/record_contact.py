"""Record oracle values of the contact environments of MyoSuite 3.0.0 for the tests.

Key turn, object hold, pen twirl, baoding balls, dice, objects to relocate and to reorient, written like
the files of `record_myosuite.py` plus rollouts, tables of contacts and the randomised quantities
(`README.md` next to this file describes the arrays). Every recording is compared with the task formulas
in float64 NumPy and the worst deviations are printed. Recorded with the same versions and run in the same
way:
    python tests/data/record_contact.py --out tests/data/myosuite
"""

import gymnasium
import mujoco
import myosuite  # noqa: F401  (registers the environments)
import numpy as np
from contact_model import contact_counts, model_arrays, model_meta, object_fields, object_geoms
from contact_tasks import Baoding, Die, KeyTurn, ObjHold, PenTwirl, Relocate, Reorient
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

FAMILIES = {
    "myoHandKeyTurnFixed-v0": KeyTurn(),
    "myoHandKeyTurnRandom-v0": KeyTurn(),
    "myoHandObjHoldFixed-v0": ObjHold(),
    "myoHandObjHoldRandom-v0": ObjHold(),
    "myoHandPenTwirlFixed-v0": PenTwirl(),
    "myoHandPenTwirlRandom-v0": PenTwirl(),
    "myoChallengeBaodingP1-v1": Baoding(),
    "myoChallengeBaodingP2-v1": Baoding(),
    "myoChallengeDieReorientDemo-v0": Die(),
    "myoChallengeDieReorientP1-v0": Die(),
    "myoChallengeDieReorientP2-v0": Die(),
    "myoChallengeRelocateP1-v0": Relocate(),
    "myoChallengeRelocateP2-v0": Relocate(),
    **{f"myoHandReorient{shapes}-v0": Reorient() for shapes in ("8", "100", "ID", "OOD")},
}
IDS = list(FAMILIES)
RANDOMISED = {env_id for env_id in IDS if any(name in env_id for name in ("Random", "P2", "HandReorient"))}

ACTION_KINDS = ("uniform", "uniform", "weak", "weak", "steady", "minus", "plus", "bang")
STRIDE = 10
NUM_RESETS = 16  # resets without an episode
REPLAYS_PER_EPISODE = 5
ROLLOUT_SUBSTEPS = 20
POSES_PER_EPISODE = 25
MARGIN_SHIFTS = (-1e-5, 1e-5, 0.0)  # [m] a count that changes under them depends on rounding


def watch_period(env):
    """Keep the period of the targets, which the baoding environment does not store."""
    create = getattr(env, "create_goal_trajectory", None)
    if create is None:
        return

    def watched(time_step, time_period):
        env.recorded_period = time_period
        return create(time_step=time_step, time_period=time_period)

    env.create_goal_trajectory = watched


class Recorder:
    def __init__(self, env_id, index):
        self.env_id, self.index, self.family = env_id, index, FAMILIES[env_id]
        self.wrapped = gymnasium.make(env_id)
        self.env, self.rng = self.wrapped.unwrapped, np.random.default_rng(1000 + index)
        watch_period(self.env)
        self.tables = {name: [] for name in ("replay", "rollout", "contact", "pair")}
        self.objects = object_geoms(self.env.model, self.family.objects)

    def state(self, env):
        """What observation and reward are functions of, and the number of contacts."""
        row = copies(env.data, STATE) | {"time": env.data.time, "ncon": env.data.ncon}
        return row | self.family.state(env)

    def reset_row(self, row):
        """A reset row carries the model fields that the reset may have changed."""
        return row | object_fields(self.env.model, self.family.objects)

    def episode(self, index, kind):
        """Episode, then replays, rollout and contacts under the episode's randomised model."""
        seed = 10000 + 100 * self.index + index
        terms = self.family.terms
        run = run_episode(self.wrapped, index, kind, seed, self.state, terms, STRIDE)
        facts, reset, steps, physics = run
        chosen = np.linspace(0, len(physics) - 1, REPLAYS_PER_EPISODE).round().astype(int)
        for i in chosen:
            row, before = replay(self.env, physics[i])
            counts = {"episode": index, "step": i + 1, "ncon": before.ncon, "nefc": before.nefc}
            self.tables["replay"].append(row | counts | {"ncon_object": self.touching(before)})
        self.tables["rollout"].append(self.rollout(index, reset))
        for _ in range(POSES_PER_EPISODE):
            self.contacts(index)
        return facts, self.reset_row(reset), steps

    def touching(self, data):
        """Number of contacts that involve an object."""
        return int(np.isin(data.contact.geom, self.objects).any(axis=1).sum())

    def rollout(self, index, reset):
        """Substeps from the reset state: constant controls in even episodes, else new ones."""
        model, data = self.env.model, mujoco.MjData(self.env.model)
        data.qpos[:] = reset["qpos"]
        low, high = ((0.0, 0.2), (0.0, 1.0))[index // 2 % 2]
        ctrl = self.rng.uniform(low, high, (ROLLOUT_SUBSTEPS, model.nu)).astype(np.float32)
        if index % 2 == 0:
            ctrl[:] = ctrl[0]
        counts = []
        for values in ctrl:
            data.ctrl[:] = values
            mujoco.mj_step(model, data)
            counts.append((data.ncon, data.nefc, self.touching(data)))
        most = dict(zip(("ncon_max", "nefc_max", "ncon_object_max"), np.max(counts, axis=0), strict=True))
        row = {"episode": index, "qpos_before": reset["qpos"], "ctrl": ctrl}
        return row | copies(data, STATE, "_after") | most

    def contacts(self, index):
        """Contacts of a random hand with the object next to the palm, or of a hand at the key."""
        env, number = self.env, len(self.tables["contact"])
        self.family.place(env, self.rng)
        qpos = env.data.qpos.copy()
        (low, high, count), data = contact_counts(env.model, qpos, MARGIN_SHIFTS)
        row = {"episode": index, "qpos": qpos, "ncon": count, "ncon_low": low, "ncon_high": high}
        row |= {"ncon_object": self.touching(data), "nefc": data.nefc}
        self.tables["contact"].append(row)
        for geoms, dist in zip(data.contact.geom, data.contact.dist, strict=True):
            pair = {"row": np.int16(number), "geoms": geoms.astype(np.int16)}
            self.tables["pair"].append(pair | {"dist": np.float32(dist)})

    def forced(self):
        for facts in self.family.forced(self.wrapped, self.rng):
            result = self.env.forward()
            step = {"step": getattr(self.env, "counter", 1)}  # no term depends on it but the targets
            yield step | facts | result_row(self.state(self.env), result, self.family.terms)

    def resets(self):
        for i in range(NUM_RESETS):
            obs, _ = self.wrapped.reset(seed=20000 + 100 * self.index + i)
            yield self.reset_row(self.state(self.env) | {"obs": obs.copy(), "episode": -1})

    def meta(self):
        env, names = self.env, ("frame_skip", "dt", "goal_th", "drop_th", "proximity_th")
        meta = {name: getattr(env, name, None) for name in names}
        meta["dt"] = env._ctrl_dt if meta["dt"] is None else meta["dt"]
        meta |= common_meta(self.wrapped, self.env_id, self.family.name) | names_meta(env.model)
        objects = [env.model.geom(i).name for i in self.objects]
        meta |= {"object_bodies": self.family.objects, "object_geoms": objects}
        return meta | model_meta(env.model)

    def deviations(self, arrays):
        """Worst absolute deviation of the recording from the formulas, per quantity."""
        worst = {}
        for prefix in ("reset", "step", "forced"):
            rows = {k.removeprefix(f"{prefix}_"): v for k, v in arrays.items() if k.startswith(f"{prefix}_")}
            expected = self.family.expected(rows, self.env)
            expected["obs"] = expected["obs"].astype(np.float32)
            if "reward" in rows:
                weights = self.env.rwd_keys_wt.items()
                expected["reward"] = sum(w * expected[f"reward_{k}"] for k, w in weights)
            for key in expected.keys() & rows.keys():
                worst[key] = max(worst.get(key, 0.0), largest_gap(rows[key], expected[key]))
        for prefix in ("step", "clip"):
            ctrl = sigmoid_ctrl(arrays[f"{prefix}_action"])
            worst[f"{prefix}_ctrl"] = largest_gap(arrays[f"{prefix}_ctrl"], ctrl)
        for name in STATE:  # the environment itself continues with a warm solver
            own = arrays.pop(f"replay_{name}_env")
            worst[f"replay_{name}"] = largest_gap(arrays[f"replay_{name}_after"], own)
        return dict(sorted(worst.items()))

    def summary(self, arrays):
        """Print how often every branch was met."""
        branches = ("bonus", "penalty", "drop")
        keys = [f"{p}_reward_{b}" for p in ("step", "forced") for b in branches]
        keys += [f"{p}_{flag}" for p in ("step", "forced") for flag in ("solved", "done")]
        for key in (key for key in keys if key in arrays):
            values, counts = np.unique(arrays[key].astype(float), return_counts=True)
            print(" ", key, dict(zip(values.tolist(), counts.tolist(), strict=True)))
        for key in ("replay_ncon", "replay_ncon_object", "forced_ncon", "contact_ncon_object"):
            print(" ", key, f"{np.mean(arrays[key] > 0):.2f} with, up to {arrays[key].max()}")
        sure = arrays["contact_ncon_low"] == arrays["contact_ncon_high"]
        print(f"  contact counts independent of rounding: {np.mean(sure):.2f}")


def record(env_id, out, index):
    """Record one id into `<out>/<id>.npz`; returns the file size [bytes]."""
    recorder = Recorder(env_id, index)
    arrays = {} if env_id in RANDOMISED else model_arrays(recorder.env.model)
    runs = [recorder.episode(i, kind) for i, kind in enumerate(ACTION_KINDS)]
    facts, resets, steps = zip(*runs, strict=True)
    arrays |= stack(facts, "episode") | stack([*resets, *recorder.resets()], "reset")
    arrays |= stack([row for rows in steps for row in rows], "step")
    for name, rows in recorder.tables.items():
        arrays |= stack(rows, name)
    arrays |= stack(list(recorder.forced()), "forced")
    arrays |= clip_rows(recorder.wrapped, recorder.rng)
    worst = recorder.deviations(arrays)
    size = save(out, env_id, recorder.meta(), arrays, facts, worst)
    recorder.summary(arrays)
    return size


if __name__ == "__main__":
    main(__doc__.splitlines()[0], IDS, record)

"""The worlds of a learner: what `--bonus` adds in training alone, and where episodes start."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from elbows import learner_env

from myowarp.apps.policies.find import acting, find_policy
from myowarp.apps.train import bonus, starts
from myowarp.apps.train.plan import plan
from myowarp.apps.train.run import manifest_of, start
from myowarp.apps.train.selection import Selection
from myowarp.apps.train.worlds import Worlds
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS

ELBOW, FINGER, LEGS = "myoElbowPose1D6MRandom-v0", "myoFingerReachFixed-v0", "myoLegWalk-v0"
WORLDS, HORIZON = 6, 40
FLOAT32 = 1e-6


def holding(worlds, std=0.3):
    """Return a controller that solves many of the episodes, with noise."""
    policy = acting(find_policy("hold", worlds.env.sim.scene.spec), worlds.env.sim)
    rng = np.random.default_rng(0)

    def act():
        action = policy(worlds.obs.numpy().copy())
        return torch.from_numpy((action + std * rng.normal(size=action.shape)).clip(-1, 1)).float()

    return act


def test_a_bonus_is_paid_in_training_and_counted_nowhere():
    """Of the same steps: the learner's reward has the weighted sums besides, returns of episodes have not."""
    weights = {"solved": 4.0, "success": 0.5, "pose": -2.0}
    plain, paid = (Worlds(learner_env(WORLDS, HORIZON), weights=of) for of in ({}, weights))
    act, infos, step = holding(plain), [], paid.env.step

    def noted(action):
        result = step(action)
        infos.append({name: result[-1][name].clone() for name in ("solved", "success", "terms/pose")})
        return result

    paid.env.step, more = noted, []
    for _ in range(2 * HORIZON + 3):
        action = act()
        one, other = plain.step(action), paid.step(action)
        seen = infos[-1]
        wanted = 4.0 * seen["solved"] + 0.5 * seen["success"] - 2.0 * seen["terms/pose"]
        np.testing.assert_allclose(other.reward, one.reward + wanted, rtol=10 * FLOAT32)
        np.testing.assert_array_equal(other.obs, one.obs)
        more.append(wanted.numpy())
    assert np.array(more).max() > 4.0
    episodes = [worlds.tally.take() for worlds in (plain, paid)]
    assert len(episodes[0]) == 2 * WORLDS
    np.testing.assert_array_equal(*episodes)


def tips_away(env, data, arrays, world):
    """Return the distance between targets and tips."""
    spec, model = env.sim.scene.spec, env.sim.scene.oracle
    data.qpos[:] = arrays["data.qpos"][world]
    mujoco.mj_kinematics(model, data)
    tips = np.array([data.site(name).xpos for name in spec.tips])
    return np.linalg.norm(arrays["task.target"][world] - tips.ravel())


def angles_away(env, data, arrays, world):
    """Return the norm of the differences of angles; all joints of the elbow have a target."""
    return np.linalg.norm(arrays["task.target"][world] - arrays["data.qpos"][world])


@pytest.mark.parametrize(("task", "away"), [(FINGER, tips_away), (ELBOW, angles_away)])
def test_precision_is_one_at_the_target_and_nothing_beyond_what_counts(task, away):
    """max(0, 1 - error / near), by positions that MuJoCo C computes where tips reach."""
    setup = Setup(task=task, device="cpu", seed=0)
    how = {"autoreset_mode": "disabled", "output": "torch", "copy": False, "progress": False}
    env = MyoWarpVectorEnv(setup, 2, **how)
    spec, seen = env.sim.scene.spec, []
    obs, _ = env.reset(seed=0)
    act, data = acting(find_policy("muscle-control", spec), env.sim), mujoco.MjData(env.sim.scene.oracle)
    for _ in range(80):
        obs, *_, info = env.step(torch.from_numpy(act(obs.numpy().copy())).float())
        arrays = env.get_state().arrays
        for world in range(2):
            expected = max(0.0, 1.0 - away(env, data, arrays, world) / spec.near)
            seen.append(bonus.value("precision", info, spec)[world].item())
            assert seen[-1] == pytest.approx(expected, abs=1e-4)
    assert min(seen) == 0.0
    assert max(seen) > 0.5


@pytest.mark.parametrize(
    ("task", "terms", "sentence"),
    [
        (
            LEGS,
            ["precision=1"],
            "term of --bonus 'precision' unknown; available: solved, success, vel_reward, ",
        ),
        (
            FINGER,
            ["pose=1"],
            "term of --bonus 'pose' unknown; available: solved, success, precision, reach, ",
        ),
        (ELBOW, ["solved"], "--bonus must be NAME=WEIGHT with a number, such as solved=4, got 'solved'"),
        (ELBOW, ["solved=x"], "--bonus must be NAME=WEIGHT with a number, such as solved=4, got 'solved=x'"),
        (ELBOW, ["solved=nan"], "--bonus must be NAME=WEIGHT with a number, such as solved=4, got 'solved=n"),
        (ELBOW, ["solved=1e999"], "--bonus must be NAME=WEIGHT with a number, such as solved=4, got 'solved"),
        (ELBOW, ["solved=4", "solved=2"], "--bonus has 'solved' twice; give it one weight"),
        (ELBOW, [4], "--bonus must be texts, got 4"),
    ],
)
def test_a_bonus_that_nothing_is_known_of_is_refused(task, terms, sentence, tmp_path):
    with pytest.raises(ValueError, match=f"^{sentence}"):
        plan(task, output=tmp_path / "run", bonus=terms)
    assert not (tmp_path / "run").exists()


def test_every_term_of_a_task_can_be_weighed():
    for task, exact in ((ELBOW, True), (FINGER, True), (LEGS, False)):
        spec = TASKS[task]
        terms = {term.name for term in spec.reward_terms()}
        assert terms | {"solved", "success"} <= set(bonus.names(spec))
        assert ("precision" in bonus.names(spec)) == exact


class Watched:
    """A `Backplay` whose calls are noted: states of all worlds before restarts, and what was placed."""

    def __init__(self, worlds, monkeypatch):
        self.worlds, self.backplay = worlds, worlds.backplay
        self.steps, self.placed, self.restarts = [], [], 0
        see, place = self.backplay.see, self.backplay.place

        def noted_see(env, success, ended):
            arrays = {name: array.copy() for name, array in env.get_state().arrays.items()}
            self.steps.append((arrays, success.copy(), ended.copy()))
            see(env, success, ended)

        def noted_place(env, ended):
            self.restarts += int(ended.sum())
            before = {name: array.copy() for name, array in env.get_state().arrays.items()}
            obs = place(env, ended)
            after = env.get_state().arrays
            moved = np.flatnonzero((after["task.target"] != before["task.target"]).any(axis=1))
            assert ended[moved].all()
            self.placed += [(world, {n: a[world].copy() for n, a in after.items()}) for world in moved]
            if obs is not None:
                np.testing.assert_array_equal(obs, env.sim.transition.obs.numpy())
            return obs

        monkeypatch.setattr(self.backplay, "see", noted_see)
        monkeypatch.setattr(self.backplay, "place", noted_place)

    def kept(self):
        """Return the kept states, by name."""
        return {
            name.removeprefix(starts.KEEPS): rows
            for name, rows in self.backplay.arrays().items()
            if name != starts.COUNTS
        }


def noted_of(backplay):
    """Return what is noted, by the names of a state."""
    return {name.removeprefix(starts.NOTES): rows for name, rows in backplay.notes.items()}


def key_of(arrays, *row):
    """Return what tells a state from all others."""
    return tuple(np.concatenate([arrays[n][row].ravel() for n in ("data.qpos", "data.qvel", "task.target")]))


def test_states_are_kept_on_the_way_of_a_success_from_before_it(monkeypatch):
    torch.manual_seed(0)
    worlds = Worlds(learner_env(WORLDS, HORIZON), start_share=0.5)
    watched, act = Watched(worlds, monkeypatch), holding(worlds, 0.6)
    for _ in range(8 * HORIZON):
        worlds.step(act())
    # Which steps lie on the way of a success, by episodes of each world.
    good, begin = set(), np.zeros(WORLDS, int)
    for number, (_, success, ended) in enumerate(watched.steps):
        for world in np.flatnonzero(ended):
            if success[world]:
                for at in range(begin[world], number + 1):
                    arrays, done, _ = watched.steps[at]
                    if (at + 1 - begin[world]) % starts.EVERY == 0 and not done[world]:
                        good.add(key_of(arrays, world))
            begin[world] = number + 1
    kept = watched.kept()
    assert {key_of(kept, row) for row in range(watched.backplay.filled)} == good
    assert len(good) > 10
    assert (kept["episode.solved_count"] <= 5).all()
    assert not kept["episode.ended"].any()
    assert not [name for name in kept if name.startswith("keys.")]
    # About half of the episodes started in one of them, goal, pose and all; their random numbers are new.
    assert 0.25 < len(watched.placed) / watched.restarts < 0.65
    rows = {key_of(kept, row): row for row in range(watched.backplay.filled)}
    for world, state in watched.placed:
        row = rows[key_of(state)]
        for name, array in kept.items():
            np.testing.assert_array_equal(state[name], array[row], err_msg=name)
        assert state["keys.seed"] == worlds.env.get_state().arrays["keys.seed"][world]


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_all_or_no_episodes_start_on_the_way_of_a_success(share, monkeypatch):
    worlds = Worlds(learner_env(WORLDS, HORIZON), start_share=share)
    if not share:
        assert worlds.backplay is None
        assert not [name for name in worlds.arrays() | worlds.rows() if name.startswith(("starts", "notes"))]
        return
    watched, act = Watched(worlds, monkeypatch), holding(worlds)
    while not watched.backplay.filled:
        worlds.step(act())
    before, placed = watched.restarts, len(watched.placed)
    for _ in range(2 * HORIZON):
        worlds.step(act())
    assert watched.restarts - before == len(watched.placed) - placed > 0


def test_the_oldest_states_go(monkeypatch):
    monkeypatch.setattr(starts, "KEPT", 8)
    worlds = Worlds(learner_env(WORLDS, HORIZON), start_share=0.3)
    watched, act, newest = Watched(worlds, monkeypatch), holding(worlds, 0.6), []
    keep = worlds.backplay.keep

    def noted(world):
        notes = worlds.backplay.notes[starts.NUMBER][world]
        newest.extend(key_of(noted_of(worlds.backplay), world, note) for note in range(notes))
        keep(world)

    monkeypatch.setattr(worlds.backplay, "keep", noted)
    for _ in range(16 * HORIZON):
        worlds.step(act())
    assert len(newest) > 16
    assert watched.backplay.filled == 8
    assert {key_of(watched.kept(), row) for row in range(8)} == set(newest[-8:])


def test_a_copy_has_come_the_way_of_the_world_that_it_is_a_copy_of():
    """What is kept of it after a success lies on that way; and where all worlds begin anew, on none."""
    worlds = Worlds(learner_env(WORLDS, HORIZON), start_share=0.01)
    states, rng = [], np.random.default_rng(0)
    for number in range(1, 36):
        if number == 25:
            worlds.copy(torch.tensor([4, 4, 4, 4, 5, 5]))
        worlds.step(torch.from_numpy(rng.uniform(-1.0, 0.2, (WORLDS, 6))).float())
        states.append({name: array.copy() for name, array in worlds.env.get_state().arrays.items()})
    backplay = worlds.backplay
    for world, source in enumerate([4, 4, 4, 4, 5, 5]):
        number = backplay.notes[starts.NUMBER][world]
        notes = [key_of(noted_of(backplay), world, note) for note in range(number)]
        way = [(9, source), (19, source), (29, world)]  # a row of `states` is a step further
        wanted = [key_of(states[at], of) for at, of in way if states[at]["episode.solved_count"][of] <= 5]
        assert notes == wanted
    assert backplay.notes[starts.NUMBER].sum() >= 2 * WORLDS
    worlds.restart()
    assert not backplay.notes[starts.NUMBER].any()
    assert not backplay.notes[starts.LENGTH].any()


def test_states_on_the_way_go_on_from_a_checkpoint(monkeypatch):
    one, other = (Worlds(learner_env(WORLDS, HORIZON), start_share=0.5) for _ in range(2))
    act = holding(one)
    for _ in range(3 * HORIZON + 7):
        one.step(act())
    clock = {"simulation": 0.0, "learner": 0.0, "total": 0.0, "cpu": 0.0}
    other.restore(
        {name: array.copy() for name, array in (one.rows() | one.arrays()).items()}, one.steps, clock
    )
    assert one.backplay.filled > 0
    for _ in range(2 * HORIZON):
        action = act()
        for worlds in (one, other):
            torch.manual_seed(one.steps if worlds is one else other.steps)
            worlds.step(action)
        np.testing.assert_array_equal(one.obs, other.obs)
    for before, after in ((one.rows(), other.rows()), (one.arrays(), other.arrays())):
        assert before.keys() == after.keys()
        for name, array in before.items():
            np.testing.assert_array_equal(array, after[name], err_msg=name)


def test_a_checkpoint_does_not_read_a_models_file_again(tmp_path):
    """It took seconds at every checkpoint, and ended the run where the file had gone."""
    model = tmp_path / "arm.osim"
    model.write_bytes((Path(__file__).parents[2] / "examples/arm.osim").read_bytes())
    small = {"num_worlds": 2, "samples": 48, "minibatches": 1, "selections": 0, "device": "cpu"}
    job = plan(Setup(task=model), algorithm="ppo", output=tmp_path / "run", **small)
    run = start(job)
    before = manifest_of(job, run, Selection(job))
    model.unlink()
    assert manifest_of(job, run, Selection(job)) == before
    assert before["model"]
    run.env.close()

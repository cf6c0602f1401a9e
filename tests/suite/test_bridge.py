"""The Gymnasium environments: their interface, their episodes against Gymnasium's own, what they return."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
import warp as wp
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from often import of_each

from myowarp.bridge_gym import NO_HORIZON, MyoWarpEnv, MyoWarpVectorEnv
from myowarp.definitions.task import TASKS

SCENES = sorted({TASKS[key].scene_key: key for key in TASKS}.values())
ELBOW = "MyoWarp/myoElbowPose1D6MRandom-v0"
STILL_ELBOW = "MyoWarp/myoElbowPose1D6MFixed-v0"
HAND = "MyoWarp/myoHandReachFixed-v0"  # fails early, at step 18 at rest
SEEDS = [11, 5, 900]
NUM_EPISODES = 3
FAST_DIFFERENCE = (1e-6, 0.05)  # rad after ten control steps; other than parity, and close to it
INFO_KEYS = {"success", "solved", "fault"}

pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")


@pytest.fixture(scope="module")
def singles():
    """Three worlds of a task as plain environments, made once; resetting with a seed makes them as new."""
    made = {}

    def get(env_id):
        if env_id not in made:
            made[env_id] = [gym.make(env_id, max_episode_steps=NO_HORIZON, device="cpu") for _ in SEEDS]
        return [env.unwrapped for env in made[env_id]]

    return get


@pytest.fixture(scope="module")
def elbow():
    """Three elbows; every test begins by seeding them."""
    return make()


def make(env_id=ELBOW, num_envs=3, **options):
    return gym.make_vec(env_id, num_envs=num_envs, device="cpu", **options)


def draw_actions(env, num_steps, seed=0):
    draws = np.random.default_rng(seed).uniform(-1, 1, (num_steps, *env.action_space.shape))
    draws[:, 0] = 0.0  # a world at rest ends at another step than the others
    return draws.astype(np.float32)


def qpos(env):
    return env.unwrapped.sim.scene.data.qpos.numpy().copy()


def play(env, actions, mask_resets=False):
    """Return what every reset and step gave."""
    rows = [env.reset(seed=list(SEEDS))]
    for action in actions:
        obs, reward, terminated, truncated, info = env.step(action)
        rows.append((obs, reward.astype(np.float32), terminated, truncated, info))
        ended = terminated | truncated
        if mask_resets and ended.any():
            rows.append(env.reset(options={"reset_mask": ended}))
    return rows


def assert_info_agrees(ours, theirs):
    """Assert that Gymnasium's entries are ours, and that what only we have is masked out in every world."""
    for key, value in theirs.items():
        if key.startswith("_"):
            np.testing.assert_array_equal(ours[key], value, err_msg=key)
            continue
        belongs = theirs[f"_{key}"]
        if isinstance(value, dict):
            assert_info_agrees(ours[key], value)
            continue
        values = np.stack(list(value[belongs])) if value.dtype == object else value[belongs]
        np.testing.assert_array_equal(ours[key][belongs], values, err_msg=key)
    for key in ours.keys() - theirs.keys():
        mask = ours[key] if key.startswith("_") else ours[f"_{key}"]
        assert not mask.any(), key


@pytest.mark.parametrize("key", of_each(SCENES))
def test_gymnasium_accepts_every_scene(key):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", ".*is out of date")
        warnings.filterwarnings("ignore", ".*Box observation space m.*imum value is -?infinity")
        env = gym.make(TASKS[key].env_id, device="cpu")
        assert isinstance(env.unwrapped, MyoWarpEnv)
        check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("key", sorted(TASKS))
def test_every_task_is_registered(key):
    """The modules imported above did this; nothing registers by hand."""
    task, spec = TASKS[key], gym.spec(f"MyoWarp/{key}")
    assert spec.max_episode_steps == task.horizon
    assert spec.kwargs == {"task": key, "reset": "task", "conditions": ()}
    assert gym.envs.registration.load_env_creator(spec.entry_point) is MyoWarpEnv
    assert gym.envs.registration.load_env_creator(spec.vector_entry_point) is MyoWarpVectorEnv


def test_spaces_and_metadata(elbow):
    assert elbow.spec.id == ELBOW
    assert elbow.num_envs == 3
    assert elbow.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert "rgb_array" in elbow.metadata["render_modes"]
    assert elbow.metadata["render_fps"] == 50
    assert elbow.muscle_names == ("TRIlong", "TRIlat", "TRImed", "BIClong", "BICshort", "BRA")
    for space, single, size in (
        (elbow.observation_space, elbow.single_observation_space, 9),
        (elbow.action_space, elbow.single_action_space, 6),
    ):
        assert single.shape == (size,)
        assert space.shape == (3, size)
        assert space.dtype == single.dtype == np.float32
    assert (elbow.single_action_space.low == -1).all()
    assert (elbow.single_action_space.high == 1).all()
    obs, info = elbow.reset(seed=0)
    assert info == {}
    assert obs in elbow.observation_space
    obs, reward, terminated, truncated, info = elbow.step(elbow.action_space.sample())
    assert obs in elbow.observation_space
    assert [a.dtype for a in (obs, reward, terminated, truncated)] == [np.float32, np.float32, bool, bool]
    terms = {f"terms/{term.name}" for term in elbow.sim.terms}
    assert len(terms) > 1
    assert info.keys() == {mark + key for key in INFO_KEYS | terms for mark in ("", "_")}
    assert all(value.shape == (3,) for value in info.values())
    weighted = sum(term.weight * info[f"terms/{term.name}"] for term in elbow.sim.terms)
    np.testing.assert_allclose(reward, weighted, rtol=1e-6)


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize(("env_id", "horizon", "num_steps"), [(ELBOW, 4, 20), (HAND, 14, 64)])
def test_autoreset_is_gymnasiums(singles, env_id, horizon, num_steps, mode):
    """Bit for bit what SyncVectorEnv makes of our single environments."""
    limited = [gym.wrappers.TimeLimit(env, horizon) for env in singles(env_id)]
    theirs = SyncVectorEnv([lambda env=env: env for env in limited], autoreset_mode=mode)
    ours = make(env_id, autoreset_mode=mode, max_episode_steps=horizon)
    actions, disabled = draw_actions(ours, num_steps), mode == AutoresetMode.DISABLED
    expected, got = play(theirs, actions, disabled), play(ours, actions, disabled)
    assert ours.metadata == theirs.metadata
    for mine, other in zip(got, expected, strict=True):
        for value, reference in zip(mine[:-1], other[:-1], strict=True):
            np.testing.assert_array_equal(value, reference)
            assert value.dtype == reference.dtype
        assert_info_agrees(mine[-1], other[-1])
    steps = [row for row in expected if len(row) == 5]
    terminated, truncated = np.stack([row[2] for row in steps]), np.stack([row[3] for row in steps])
    assert ((terminated | truncated).sum(axis=0) >= NUM_EPISODES).all()
    assert truncated.any()
    assert terminated.any() == (env_id == HAND)
    assert any("final_obs" in row[-1] for row in steps) == (mode == AutoresetMode.SAME_STEP)
    assert any(not row[-1]["_solved"].all() for row in got if len(row) == 5) == (not disabled)


@pytest.mark.parametrize("worlds", [[True, False, True], [True, True, True]])
def test_reset_comes_before_a_pending_autoreset(singles, worlds):
    """A world that ended and was reset by hand steps at once; the others lose a step to their reset."""
    limited = [gym.wrappers.TimeLimit(env, 4) for env in singles(ELBOW)]
    theirs, ours = SyncVectorEnv([lambda env=env: env for env in limited]), make(max_episode_steps=4)
    actions = draw_actions(ours, 7)
    for env in (theirs, ours):
        assert play(env, actions[:4])[-1][3].all()
    obs, expected = (env.reset(options={"reset_mask": np.array(worlds)})[0] for env in (ours, theirs))
    np.testing.assert_array_equal(obs, expected)
    stepped = []
    for action in actions[4:]:
        (*got, info), (*expected, their_info) = ours.step(action), theirs.step(action)
        for value, reference in zip(got, expected, strict=True):
            np.testing.assert_array_equal(value, reference.astype(value.dtype))
        assert_info_agrees(info, their_info)
        stepped.append(info["_solved"].tolist())
    assert stepped == [worlds, 3 * [True], 3 * [True]]


@pytest.mark.parametrize("seed", [7, [30, 2, 30]])
def test_world_of_a_seed_is_the_single_environment(elbow, singles, seed):
    obs, _ = elbow.reset(seed=seed)
    for world, env in enumerate(singles(ELBOW)):
        expected, _ = env.reset(seed=7 + world if seed == 7 else seed[world])
        np.testing.assert_array_equal(obs[world], expected)
    assert np.array_equal(obs[0], obs[2]) == (seed != 7)
    assert not np.array_equal(obs[0], obs[1])


@pytest.mark.parametrize("seed", [np.int64(7), np.array([7, 8, 9]), [np.uint8(7), 8, np.int32(9)]])
def test_numpy_integers_are_seeds(elbow, seed):
    obs, _ = elbow.reset(seed=seed)
    np.testing.assert_array_equal(obs, elbow.reset(seed=7)[0])


def test_reset_without_seed_goes_on(elbow):
    first, second, third = (elbow.reset(seed=seed)[0] for seed in (4, None, None))
    assert not np.array_equal(first, second)
    assert not np.array_equal(second, third)
    np.testing.assert_array_equal(elbow.reset(seed=4)[0], first)
    np.testing.assert_array_equal(elbow.reset()[0], second)
    assert not np.array_equal(make().reset()[0], make().reset()[0]), "no fresh entropy"


def test_none_in_a_list_of_seeds_goes_on(elbow):
    elbow.reset(seed=4)
    goes_on = elbow.reset()[0]
    elbow.reset(seed=4)
    obs, _ = elbow.reset(seed=[50, None, 60])
    np.testing.assert_array_equal(obs[1], goes_on[1])
    np.testing.assert_array_equal(obs[0], elbow.reset(seed=50)[0][0])
    np.testing.assert_array_equal(obs[2], elbow.reset(seed=60)[0][0])


@pytest.mark.parametrize("seed", [None, 80, [80, None, 82]])
def test_partial_reset_leaves_the_others(elbow, seed):
    """Also what follows: the untouched world goes on as if nothing had happened."""
    actions, mask = draw_actions(elbow, 6), np.array([True, False, True])
    elbow.reset(seed=4)
    before = [elbow.step(action)[0] for action in actions][2]
    elbow.reset(seed=4)
    for action in actions[:3]:
        elbow.step(action)
    state = qpos(elbow)
    options = {"reset_mask": mask}
    obs, _ = elbow.reset(seed=seed, options=options)
    assert set(options) == {"reset_mask"}
    np.testing.assert_array_equal(obs[~mask], before[~mask])
    np.testing.assert_array_equal(qpos(elbow)[~mask], state[~mask])
    assert (obs[mask] != before[mask]).any(axis=1).all()
    after = [elbow.step(action)[0] for action in actions[3:]][-1]
    elbow.reset(seed=4)
    undisturbed = [elbow.step(action)[0] for action in actions][-1]
    np.testing.assert_array_equal(after[~mask], undisturbed[~mask])
    assert (after[mask] != undisturbed[mask]).any(axis=1).all()
    if seed is not None:
        np.testing.assert_array_equal(obs[0], elbow.reset(seed=80)[0][0])


def test_numpy_results_are_copies(elbow):
    first, _ = elbow.reset(seed=0)
    kept = first.copy()
    action = draw_actions(elbow, 2)
    step = elbow.step(action[0])
    arrays = [*step[:4], *(step[4][key] for key in step[4] if not key.startswith("_"))]
    copies = [array.copy() for array in arrays]
    elbow.step(action[1])
    np.testing.assert_array_equal(first, kept)
    for array, copy in zip(arrays, copies, strict=True):
        np.testing.assert_array_equal(array, copy)
    first[:] = np.nan
    assert np.isfinite(elbow.sim.transition.obs.numpy()).all()


def pointer(array):
    """Return the address of the first element of an array of any library."""
    if isinstance(array, np.ndarray):
        return array.ctypes.data
    return array.ptr if isinstance(array, wp.array) else array.data_ptr()


def host(array):
    return np.array(array if isinstance(array, np.ndarray) else array.numpy())


def check_output(output, kind):
    """Views lie in the memory of the simulation and are overwritten; copies are neither."""
    results = []
    for copy in (False, True):
        env = make(output=output, copy=copy, autoreset_mode="same_step", max_episode_steps=2)
        actions = draw_actions(env, 2)
        obs, _ = env.reset(seed=0)
        old = host(obs)
        transition = env.sim.transition
        obs, reward, terminated, truncated, info = env.step(actions[0])
        returned = {"obs": obs, "reward": reward, "terminated": terminated, "truncated": truncated}
        returned |= {name: info[name] for name in INFO_KEYS}
        for name, array in returned.items():
            assert isinstance(array, kind)
            shared = pointer(array) == pointer(getattr(transition, name))
            assert shared != copy, name
        terms = info["terms/bonus"]
        assert isinstance(terms, kind)
        column = [term.name for term in env.sim.terms].index("bonus")
        assert (pointer(terms) == transition.terms.ptr + 4 * column) != copy
        values = host(obs)
        assert not np.array_equal(values, old)
        final = env.step(actions[1])[4]["final_obs"]
        assert isinstance(final, kind)
        assert (pointer(final) == env.sim.final.obs.ptr) != copy
        assert np.array_equal(host(obs), values) == copy
        results.append(values)
    np.testing.assert_array_equal(*results)


def test_warp_output():
    check_output("warp", wp.array)
    assert make(output="warp").copy is False


def test_numpy_views():
    check_output("numpy", np.ndarray)
    assert make().copy is True


def test_torch_output():
    torch = pytest.importorskip("torch")
    check_output("torch", torch.Tensor)
    env = make(output="torch")
    actions = draw_actions(env, 1)[0]
    actions[1] = np.array([1, -1, 1, 1, -1, 1])
    env.reset(seed=0)
    expected = env.step(actions)[0].clone()
    same = torch.from_numpy(actions)
    huge = same.double().where(same.abs() < 1, 1e300 * same.double())  # inf in float32
    for given in (same, same.double().requires_grad_(), huge):
        env.reset(seed=0)
        assert torch.equal(env.step(given)[0], expected)
    env.reset(seed=0)
    assert not torch.equal(env.step(torch.zeros(3, 6))[0], expected)


def test_actions_of_every_kind_are_the_same(elbow):
    """Warp arrays, other floating types, lists and values to be clipped; the caller's array is left alone."""
    actions = draw_actions(elbow, 1)[0]
    actions[1] = np.array([1, -1, 1, 1, -1, 1])
    elbow.reset(seed=0)
    expected = elbow.step(actions)[0]
    wide = actions.copy()
    wide[1] *= 3.0
    kept = wide.copy()
    fortran = np.asfortranarray(actions)
    huge = np.where(np.abs(actions) == 1, 1e300 * actions.astype(np.float64), actions)  # inf in float32
    kinds = (
        wp.array(actions, dtype=float),
        actions.astype(np.float64),
        actions.tolist(),
        wide,
        huge,
        fortran,
    )
    for given in kinds:
        elbow.reset(seed=0)
        np.testing.assert_array_equal(elbow.step(given)[0], expected)
    np.testing.assert_array_equal(wide, kept)
    elbow.reset(seed=0)
    assert not np.array_equal(elbow.step(np.zeros((3, 6), np.float32))[0], expected)


def first_truncation(env, num_steps):
    env.reset(seed=0)
    for step in range(1, num_steps + 1):
        truncated = env.step(np.zeros(env.action_space.shape, np.float32))[3]
        if np.all(truncated):
            return step
        assert not np.any(truncated)
    return None


@pytest.mark.parametrize("maker", [gym.make, gym.make_vec])
@pytest.mark.parametrize(("given", "expected"), [({}, 100), ({"max_episode_steps": 3}, 3)])
def test_horizon(maker, given, expected):
    assert first_truncation(maker(ELBOW, device="cpu", **given), 110) == expected


def test_no_horizon():
    assert first_truncation(gym.make(ELBOW, device="cpu", max_episode_steps=-1), 110) is None


@pytest.mark.parametrize("option", ["num_envs", "max_episode_steps"])
def test_numpy_integers_are_sizes(option):
    env = MyoWarpVectorEnv("myoElbowPose1D6MRandom-v0", device="cpu", **{option: np.int64(2)})
    assert env.num_envs == (2 if option == "num_envs" else 1)
    assert first_truncation(env, 110) == (2 if option == "max_episode_steps" else 100)


def test_success_after_more_than_five_solved_steps():
    """World 0 is held at its target: a success from the sixth step to the end, then counted anew."""
    env = make(STILL_ELBOW, num_envs=2, max_episode_steps=8, autoreset_mode="same_step")
    env.reset(seed=0)
    infos = []
    for _ in range(9):
        env.sim.scene.data.qpos.numpy()[0] = env.sim.shards[0].program.target.numpy()[0]
        env.sim.scene.data.qvel.zero_()
        infos.append(env.step(np.full((2, 6), -1.0, np.float32))[4])
    finals = [info["final_info"] for info in infos if "final_info" in info]
    assert [info["solved"][0] for info in infos] == 7 * [True] + [False, True]
    assert [info["success"][0] for info in infos] == 5 * [False] + 2 * [True] + 2 * [False]
    assert not any(info["success"][1] for info in infos)
    assert [final["success"].tolist() for final in finals] == [[True, False]]


def test_fast_is_nearly_parity():
    ends = []
    for physics in ("parity", "fast"):
        env = make(STILL_ELBOW, physics=physics)
        play(env, draw_actions(env, 10))
        ends.append(qpos(env))
    assert FAST_DIFFERENCE[0] < np.abs(ends[1] - ends[0]).max() < FAST_DIFFERENCE[1]

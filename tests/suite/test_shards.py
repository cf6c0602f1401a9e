"""Worlds over threads: the split never shows in the numbers; what ends, fails or is refused."""

import re
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
import warp as wp
from gymnasium.error import ResetNeeded

from myowarp.definitions.parameter import Parameter
from myowarp.definitions.task import TASKS
from myowarp.definitions.worlds import Worlds
from myowarp.kernels.episode import Transition
from myowarp.models.conditions import Fatigue3CCR, Load, MotorNoise, Ramp, Sarcopenia, Uniform
from myowarp.models.conditions.reafferentation import check_apart
from myowarp.sim import simulation as module
from myowarp.sim.build import RESULT_FIELDS, STATE_FIELDS
from myowarp.sim.signals import Signals
from myowarp.sim.simulation import Simulation
from myowarp.view.drawing.snapshot import snapshot

ELBOW = "myoElbowPose1D6MRandom-v0"
FAMILIES = sorted({(TASKS[key].family, TASKS[key].body): key for key in TASKS if "Random" in key}.values())
NUM_WORLDS = 7
NUM_STEPS = 300  # fifty episodes, and every kind of reset six times
HORIZON = 6

pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")


def patients(num_worlds=NUM_WORLDS):
    """Parameters of every kind: one per world, drawn for a life or an episode, for each muscle, changing."""
    strength = np.linspace(0.3, 1.0, num_worlds)
    return (
        Sarcopenia(Ramp(strength, Uniform(0.2, 0.4, per="life"), onset=0.1, duration=0.5, of="life")),
        Fatigue3CCR(initial=Uniform(0.0, 0.5, each=True), observe=True),
        MotorNoise(constant=np.arange(num_worlds) / 100),
        Load(Uniform(0.0, 1.0)),
    )


def settings(**options):
    return {"device": "cpu", "autoreset": "same_step", "horizon": HORIZON, "progress": False} | options


def build(key=ELBOW, num_shards=1, num_worlds=NUM_WORLDS, **options):
    return Simulation(TASKS[key], num_worlds, shards=num_shards, **settings(**options))


def everything(sim):
    """Return copies of all that can be seen of a simulation from outside."""
    seen = {f"transition.{name}": getattr(sim.transition, name) for name in Transition.vars}
    seen |= {f"final.{name}": getattr(sim.final, name) for name in Transition.vars}
    seen |= {f"info.{name}": array for name, array in sim.info.items()}
    seen |= {name: getattr(sim.scene.data, name) for name in (*STATE_FIELDS, *RESULT_FIELDS)}
    seen |= {"episode": sim.scene.keys.episode, "activation": sim.scene.muscles.activation}
    seen |= {"step_count": sim.episode.step_count, "live": sim.masks.live}
    return {name: array.numpy().copy() for name, array in seen.items()}


def trajectory(sim, num_steps):
    """Yield all that is seen, step after step; some worlds are seeded anew or reset on the way."""
    n, rng = sim.num_worlds, np.random.default_rng(0)
    sim.reset(seeds=11 * np.arange(n))
    for step in range(num_steps):
        if step % 50 == 20:
            sim.reset(np.arange(n) % 3 == 1, np.arange(n) + step)
        if step % 50 == 30:
            sim.reset(np.arange(n) % 2 == 1)
        sim.action.assign(rng.uniform(-1, 1, sim.action.shape).astype(np.float32))
        sim.step()
        yield everything(sim)


def assert_same(whole, split):
    """Assert that two trajectories are equal bit for bit, and that episodes ended."""
    ended = 0
    for expected, got in zip(whole, split, strict=True):
        for name, values in expected.items():
            np.testing.assert_array_equal(got[name], values, err_msg=name)
        ended += np.count_nonzero(expected["transition.truncated"] | expected["transition.terminated"])
    assert ended > 0


@pytest.fixture(scope="module")
def whole():
    return list(trajectory(build(num_worlds=13, conditions=patients(13)), NUM_STEPS))


@pytest.mark.parametrize("num_shards", [2, 3, 5])
def test_the_split_does_not_show(whole, num_shards):
    """Over many steps with resets, an odd number of worlds, patients of their own."""
    split = build(num_shards=num_shards, num_worlds=13, conditions=patients(13))
    sizes = [part.num_worlds for part in split.shards]
    assert len(sizes) == num_shards
    assert sum(sizes) == 13
    assert max(sizes) - min(sizes) == 1
    assert_same(whole, trajectory(split, NUM_STEPS))
    split.close()


@pytest.mark.slow
@pytest.mark.parametrize("autoreset", ["same_step", "next_step", "disabled"])
@pytest.mark.parametrize("key", FAMILIES)
def test_the_split_does_not_show_in_any_family(key, autoreset):
    options = {"autoreset": autoreset, "reset": "random" if autoreset == "next_step" else "task"}
    assert_same(*(trajectory(build(key, num_shards, **options), 60) for num_shards in (1, 3)))


def test_no_code_in_common():
    """Two threads in the same tile kernel overwrite each other's scratch memory."""
    split = build(num_shards=3)
    Signals(split)  # captures every step anew, one after the other
    codes = [
        graph.recorded.module_execs for part in split.shards for graph in (part.step_graph, part.reset_graph)
    ]
    assert all(codes)
    assert len(set().union(*codes)) == sum(len(code) for code in codes)


def test_signals():
    whole, split = build(conditions="fatigue_3ccr"), build(num_shards=2, conditions="fatigue_3ccr")
    expected, got = Signals(whole), Signals(split)
    for sim in (whole, split):
        for _ in trajectory(sim, 15):
            pass
    assert got.muscles.force.numpy().max() > 1
    for name in ("force", "length", "power"):
        first, second = (getattr(signals.muscles, name).numpy() for signals in (expected, got))
        np.testing.assert_array_equal(second, first)
    np.testing.assert_array_equal(got.info["fatigue"].numpy(), expected.info["fatigue"].numpy())
    np.testing.assert_array_equal(got.joint_angles, expected.joint_angles)
    np.testing.assert_array_equal(got.valid.numpy(), expected.valid.numpy())


def test_state_is_that_of_the_parts():
    """What is written into the state of all worlds is what the parts go on from."""
    whole, split = build(), build(num_shards=3)
    for sim in (whole, split):
        sim.reset(seeds=np.arange(NUM_WORLDS))
        sim.scene.data.qpos.assign(np.linspace(0.1, 1.0, NUM_WORLDS)[:, None])
        sim.step()
    np.testing.assert_array_equal(split.scene.data.qpos.numpy(), whole.scene.data.qpos.numpy())
    assert np.ptp(split.scene.data.qpos.numpy()) > 0.5
    assert split.scene.data.contact is None
    assert split.scene.num_worlds == split.scene.data.nworld == NUM_WORLDS


def test_look():
    key = "myoHandObjHoldRandom-v0"
    looks = []
    for num_shards in (1, 2):
        sim = build(key, num_shards, 3)
        sim.reset(seeds=np.arange(3))
        looks.append([snapshot(sim, world) for world in range(3)])
    for expected, got in zip(*looks, strict=True):
        np.testing.assert_array_equal(got.qpos, expected.qpos)
        for name in ("goals", "shape"):
            first, second = getattr(expected, name), getattr(got, name)
            assert first.keys() == second.keys() != set()
            assert all(np.array_equal(first[k], second[k]) for k in first)
    assert not np.array_equal(*(next(iter(look.goals.values())) for look in looks[0][:2]))


def make(num_shards, **options):
    return gym.make_vec(
        f"MyoWarp/{ELBOW}",
        num_envs=NUM_WORLDS,
        device="cpu",
        shards=num_shards,
        conditions="fatigue_3ccr",
        max_episode_steps=HORIZON,
        **options,
    )


def flat(values, prefix=""):
    """Return nested dictionaries of arrays as one."""
    out = {}
    for key, value in values.items():
        out |= flat(value, f"{prefix}{key}/") if isinstance(value, dict) else {prefix + key: value}
    return out


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_bridge(mode):
    """Results, info and final values are those of the whole, with seeds and masks of resets."""
    runs = []
    for num_shards in (1, 3):
        env, rows = make(num_shards, autoreset_mode=mode), []
        rows.append(flat({"obs": env.reset(seed=[5, None, 7, 8, 9, None, 11])[0][[0, 2, 3, 4, 6]]}))
        env.reset(seed=3)
        rng = np.random.default_rng(0)
        for step in range(HORIZON * 3):
            action = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
            obs, reward, terminated, truncated, info = env.step(action)
            rows.append(
                flat({"obs": obs, "reward": reward, "end": terminated, "cut": truncated, "info": info})
            )
            if step == 2:
                mask = np.arange(NUM_WORLDS) > 4
                rows.append({"obs": env.reset(seed=2, options={"reset_mask": mask})[0]})
            if mode == "Disabled" and (terminated | truncated).any():
                with pytest.raises(ResetNeeded):
                    env.step(action)
                rows.append({"obs": env.reset(options={"reset_mask": terminated | truncated})[0]})
        runs.append(rows)
        env.close()
    assert any(row["cut"].any() for row in runs[0] if "cut" in row)
    for expected, got in zip(*runs, strict=True):
        assert got.keys() == expected.keys()
        for name, values in expected.items():
            np.testing.assert_array_equal(got[name], values, err_msg=name)


@pytest.mark.parametrize("output", ["numpy", "warp", "torch"])
def test_outputs_are_views_of_one_array(output):
    if output == "torch":
        pytest.importorskip("torch")
    env = make(3, output=output, copy=False)
    first, _ = env.reset(seed=0)
    before = np.array(first.numpy() if output == "warp" else first)
    second, *_ = env.step(env.action_space.sample())
    after = np.asarray(first.numpy() if output == "warp" else first)
    assert after.shape == (NUM_WORLDS, *env.single_observation_space.shape)
    assert not np.array_equal(before, after), "the step overwrites what was returned before"
    np.testing.assert_array_equal(after, second.numpy() if output == "warp" else second)
    env.close()


def test_default_number(monkeypatch):
    """One for each core, none with too few worlds."""
    monkeypatch.setattr(module, "num_cores", lambda: 3)
    least = module.LEAST_WORLDS
    number = {n: len(build(num_shards=None, num_worlds=n).shards) for n in (1, 2 * least - 1, 2 * least, 99)}
    assert number == {1: 1, 2 * least - 1: 1, 2 * least: 2, 99: 3}


@pytest.mark.parametrize("shards", [0, -1, True, 1.5, "2", NUM_WORLDS + 1])
def test_bad_number(shards):
    message = f"shards must be an integer from 1 to the number of worlds, {NUM_WORLDS}, got {shards!r}"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        make(shards)


def test_not_for_one_environment():
    with pytest.raises(ValueError, match=r"^option 'shards' is for make_vec; a single environment has none$"):
        gym.make(f"MyoWarp/{ELBOW}", shards=2)


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_values_per_world_count_all_worlds(rows):
    """A part's own number of worlds is none of the user's business."""
    message = f"sarcopenia strength must be one number or of shape (4,) or (4, 6), got shape ({rows},)"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        build(num_shards=2, num_worlds=4, conditions=Sarcopenia(np.full(rows, 0.5)))


def test_worlds_are_named_as_among_all():
    one = np.array([0.0, 0.0, 0.0, 1.0])
    scene = SimpleNamespace(worlds=Worlds.all(4).split(2)[1], control_dt=0.02, parameters=[])
    both = [Parameter("affected", one, scene, (), neutral=0.0) for _ in range(2)]
    with pytest.raises(ValueError, match=r"^world 3 cannot have both"):
        check_apart(*both)


def test_a_simulation_of_its_own_beside_others():
    """Two simulations in two threads, without shards: neither runs the other's code."""
    both = [build("myoHandReachRandom-v0", num_worlds=2) for _ in range(2)]
    assert (
        not both[0].shards[0].step_graph.recorded.module_execs
        & both[1].shards[0].step_graph.recorded.module_execs
    )
    assert wp.get_device().is_cpu or not wp.is_cuda_available()

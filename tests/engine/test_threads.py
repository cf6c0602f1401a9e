"""Environments that are built, stepped and measured in several threads at once: the numbers of one thread."""

import os
import threading
from concurrent.futures import ThreadPoolExecutor

import gymnasium as gym
import numpy as np
import pytest
import warp as wp

import myowarp  # noqa: F401  (registers the ids)
from myowarp.definitions.task import TASKS
from myowarp.engine.replaced import replaced
from myowarp.process import BUILD_LOCK
from myowarp.sim.signals import Signals
from myowarp.sim.simulation import Simulation

TASK = "myoElbowPose1D6MRandom-v0"
NUM_WORLDS, NUM_STEPS, NUM_THREADS = 8, 8, 6
GIVE_UP = 300.0  # s


def play(sim, seed, num_steps=NUM_STEPS):
    """Return what a simulation shows in some steps after a seeded reset."""
    sim.reset(seeds=seed + np.arange(NUM_WORLDS))
    rng, seen = np.random.default_rng(seed), [sim.transition.obs.numpy().copy()]
    for _ in range(num_steps):
        sim.action.numpy()[:] = rng.uniform(-1.0, 1.0, sim.action.shape)
        sim.step()
        seen.append(sim.transition.obs.numpy().copy())
    return np.stack(seen)


def build(**options):
    return Simulation(
        TASKS[TASK], NUM_WORLDS, **{"device": "cpu", "shards": None, "progress": False} | options
    )


def build_and_play(seed):
    """Build one of four kinds, each of which patches or captures something of its own, and play."""
    kinds = ({"shards": 1}, {"shards": 2}, {"shards": 1, "graph": False}, {"reset": "random"})
    sim = build(**kinds[seed % len(kinds)])
    signals = Signals(sim) if seed % 2 else None
    seen = play(sim, seed)
    return seen if signals is None else np.append(seen, signals.muscles.force.numpy())


@pytest.mark.slow
def test_built_at_once_as_built_in_turn():
    seeds = range(2 * NUM_THREADS)
    expected = [build_and_play(seed) for seed in seeds]
    assert not np.array_equal(expected[0], expected[4]), "seeds make no difference"
    with ThreadPoolExecutor(NUM_THREADS) as pool:
        found = list(pool.map(build_and_play, seeds))
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(build_and_play(0), expected[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [{"shards": 1}, {"shards": 2}, {"shards": 1, "graph": False}],
)
def test_stepped_while_another_thread_builds(options):
    """Its first step, too, which starts the threads of the parts."""
    expected = play(build(**options), seed=5)
    sim, stop, steps = build(**options), threading.Event(), []

    def build_more():
        while not stop.is_set():
            build(shards=1)
            steps.append(1)

    builder = threading.Thread(target=build_more)
    builder.start()
    try:
        for _ in range(2):
            np.testing.assert_array_equal(play(sim, seed=5), expected)
            before = len(steps)
            while len(steps) == before and builder.is_alive():
                np.testing.assert_array_equal(play(sim, seed=5, num_steps=2), expected[:3])
    finally:
        stop.set()
        builder.join(GIVE_UP)
    assert len(steps) >= 2


def test_launches_of_other_threads_are_their_own():
    """What is replaced in one thread stays in the others, and BUILD_LOCK is free again afterwards."""

    def launch_elsewhere():
        with ThreadPoolExecutor(1) as pool:
            return pool.submit(lambda: wp.is_cpu_available()).result(GIVE_UP)

    usual = wp.is_cpu_available
    with replaced(wp, "is_cpu_available", lambda: "mine"):
        assert wp.is_cpu_available() == "mine"
        assert launch_elsewhere() is True
    assert wp.is_cpu_available is usual
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(BUILD_LOCK.acquire, blocking=False).result(GIVE_UP)
        pool.submit(BUILD_LOCK.release).result(GIVE_UP)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_child_of_a_process_that_builds(tmp_path):
    """Forked while another thread builds, it can build: it inherits no half construction."""
    expected, started, out = play(build(), seed=1), threading.Event(), tmp_path / "seen.npy"

    def build_in_thread():
        started.set()
        for _ in range(3):
            build()

    builder = threading.Thread(target=build_in_thread)
    builder.start()
    started.wait()
    child = os.fork()
    if not child:
        status = 1
        try:
            np.save(out, play(build(), seed=1))
            status = 0
        finally:
            os._exit(status)
    builder.join(GIVE_UP)
    assert os.waitpid(child, 0)[1] == 0
    np.testing.assert_array_equal(np.load(out), expected)


def test_environments_in_threads():
    """The bridge, as a user would do it."""

    def first(seed):
        env = gym.make_vec(f"MyoWarp/{TASK}", num_envs=3, device="cpu", progress=False)
        return env.reset(seed=seed)[0]

    expected = [first(seed) for seed in range(3)]
    with ThreadPoolExecutor(3) as pool:
        np.testing.assert_array_equal(list(pool.map(first, range(3))), expected)

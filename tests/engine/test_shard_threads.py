"""Threads of shards: what fails, is interrupted or ends."""

import gc
import logging
import os
import re
import signal
import subprocess
import sys
import threading
import time
from functools import partial

import gymnasium as gym
import numpy as np
import pytest

from myowarp.definitions.task import TASKS
from myowarp.engine import graph
from myowarp.process import warn_once
from myowarp.sim.simulation import Simulation

ELBOW = "myoElbowPose1D6MRandom-v0"
NUM_WORLDS = 7
DEADLINE = 30.0  # s, until a failure is known on busy cores; a part that is waited for never ends

pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")


def build(num_shards):
    options = {"device": "cpu", "horizon": 10**6, "progress": False}
    return Simulation(TASKS[ELBOW], NUM_WORLDS, shards=num_shards, **options)


@pytest.fixture
def alone():
    """No thread is left of an earlier test."""
    gc.collect()
    assert wait_for_none()


def wait_for_none():
    for thread in own_threads():
        thread.join(DEADLINE)
    return not own_threads()


def own_threads():
    return [thread for thread in threading.enumerate() if thread.name.startswith("myowarp")]


@pytest.mark.parametrize(("part", "worlds"), [(0, "0 to 1"), (1, "2 to 3")])
@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
def test_death_of_a_part(alone, monkeypatch, part, worlds, error):
    """It is reported at once, with its worlds; no thread is left, and no later step pretends.

    Only launches that are not replayed can fail: what is replayed runs no Python.
    """
    split = build(3)
    split.step()
    assert own_threads()

    def die():
        raise error("now")

    monkeypatch.setattr(split.shards[part], "step_graph", None)
    monkeypatch.setattr(split.shards[part], "launch_action", die)
    begin = time.monotonic()
    with pytest.raises(error) as caught:
        split.step()
    assert time.monotonic() - begin < DEADLINE
    assert wait_for_none()
    message = f"worlds {worlds} stopped ({error.__name__}: now); make a new simulation"
    assert caught.value.__notes__ == [message]
    monkeypatch.undo()
    for act in (split.step, split.reset):
        with pytest.raises(RuntimeError, match=f"^{re.escape(message)}$"):
            act()


def test_bad_seeds_harm_nothing(alone):
    split = build(3)
    split.step()
    with pytest.raises(ValueError, match="invalid literal"):
        split.reset(seeds=NUM_WORLDS * ["a"])
    split.reset(seeds=np.arange(NUM_WORLDS))
    split.step()
    assert np.all(steps_made(split) == 1)


def steps_made(split):
    """Return how many control steps each world has made since all were reset."""
    return split.episode.step_count.numpy()


def test_interruption(alone):
    """Ctrl-C breaks off between steps: all parts have made the same, and the next step goes on."""
    split = build(3)
    split.reset()
    returned = []

    def step_for_long():
        end = time.monotonic() + 60.0
        while time.monotonic() < end:
            split.step()
            returned.append(1)

    # A shell lets what it starts in the background ignore Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        step_for_long()
    timer.join()
    signal.signal(signal.SIGINT, before)
    made = steps_made(split)[0]
    assert np.all(steps_made(split) == made)
    assert 0 < len(returned) <= made <= len(returned) + 1
    split.step()
    assert np.all(steps_made(split) == made + 1)


def test_signals_that_step_and_close(alone):
    """Whatever a signal's handler does comes before a step or after it."""
    split = build(3)
    handled = []

    def handle(*_):
        handled.append(len(handled))
        split.step()
        if handled[-1] % 3 == 0:
            split.close()
        signal.setitimer(signal.ITIMER_REAL, 0.0017)  # not earlier: handlers would pile up on a slow machine

    before = signal.signal(signal.SIGALRM, handle)
    signal.setitimer(signal.ITIMER_REAL, 0.001)
    for _ in range(1000):
        split.step()
        split.reset()
    signal.signal(signal.SIGALRM, signal.SIG_IGN)
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)
    assert len(handled) > 10
    assert np.ptp(steps_made(split)) == 0


def test_step_while_an_exception_is_handled(alone):
    """What the caller is handling is no failure of a part."""
    split = build(2)
    try:
        raise ValueError("of the caller")
    except ValueError:
        split.step()
        split.reset()
    split.step()


@pytest.mark.parametrize("closing", [False, True])
def test_steps_from_two_threads(alone, closing):
    """One waits for the other: each step is made, by every part and once; also while threads are ended."""
    split = build(3)
    split.reset()

    def work():
        for _ in range(200):
            split.step()

    threads = [threading.Thread(target=work, daemon=True) for _ in range(1 if closing else 2)]
    for thread in threads:
        thread.start()
    while closing and threads[0].is_alive():
        split.close()
        time.sleep(0.001)
    for thread in threads:
        thread.join(60.0)
    assert np.all(steps_made(split) == 200 * len(threads))


def test_threads_end(alone):
    """With `close`, and with the last reference."""
    env = gym.make_vec(f"MyoWarp/{ELBOW}", NUM_WORLDS, device="cpu", shards=2, progress=False)
    env.reset(seed=0)
    assert own_threads()
    env.close()
    assert wait_for_none()
    split = build(2)
    split.step()
    assert own_threads()
    split.close()
    split.close()
    assert wait_for_none()
    split.step()
    assert own_threads()
    del split
    assert wait_for_none()


SCRIPT = f"""
import gymnasium, myowarp, os, threading, time
env, busy = (
    gymnasium.make_vec("MyoWarp/{ELBOW}", 4, device="cpu", shards=2, progress=False) for _ in range(2)
)
env.reset(seed=0)
env.step(env.action_space.sample())

def work():
    while True:
        busy.reset()
        busy.step(busy.action_space.sample())

threading.Thread(target=work, daemon=True).start()
time.sleep(0.1)
pid = os.fork()
env.step(env.action_space.sample())
if pid:
    assert os.waitpid(pid, 0)[1] == 0
    print("stepped")
else:
    busy.close()
    busy.reset()
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_exit_and_fork():
    """Neither the end of the interpreter nor a forked process waits for threads for ever."""
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", SCRIPT], capture_output=True, timeout=600)
    assert done.returncode == 0, done.stderr.decode()
    assert done.stdout.decode().endswith("stepped\n")


def together(barrier, launch):
    barrier.wait()
    launch()


def test_parts_act_at_the_same_time_where_warp_replays(monkeypatch, caplog):
    """Without our replay, in threads of Python: said once, with the same numbers."""
    ends, seen = [], []
    for replayed in (True, False):
        graph._warp_recording.cache_clear()
        warn_once.cache_clear()
        if not replayed:
            monkeypatch.setattr(graph, "RECORDERS", (*graph.RECORDERS, "wp_is_no_more"))
        with caplog.at_level(logging.WARNING, logger="myowarp"):
            sim = Simulation(TASKS[ELBOW], 8, shards=2, device="cpu", progress=False)
            assert all((part.step_graph.replay is not None) == replayed for part in sim.shards)
            if not replayed:
                both = threading.Barrier(2, timeout=300)
                for part in sim.shards:
                    launch = part.step_graph.launch
                    monkeypatch.setattr(part.step_graph, "launch", partial(together, both, launch))
            sim.reset(seeds=np.arange(8))
            for value in (0.5, -0.5, 1.0):
                sim.action.fill_(value)
                sim.step()
        seen.append(len(caplog.records))
        ends.append(sim.transition.obs.numpy().copy())
        sim.close()
    graph._warp_recording.cache_clear()
    np.testing.assert_array_equal(*ends)
    assert seen == [0, 1]

"""Threads of shards: what fails, is interrupted or ends."""

import gc
import os
import re
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from myowarp.shards import simulate
from myowarp.spec import TASKS

ELBOW = "myoElbowPose1D6MRandom-v0"
NUM_WORLDS = 7
DEADLINE = 1.0  # s, until a failure is known

pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")


def build(num_shards):
    return simulate(TASKS[ELBOW], NUM_WORLDS, shards=num_shards, device="cpu", progress=False)


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
def test_death_of_a_part(alone, monkeypatch, part, worlds):
    """It is reported at once, with its worlds; no thread is left, and no later step pretends."""
    split = build(3)
    split.step()
    assert own_threads()
    monkeypatch.setattr(split.parts[part], "step", lambda: 1 / 0)
    begin = time.monotonic()
    message = f"worlds {worlds} stopped (ZeroDivisionError: division by zero)"
    with pytest.raises(RuntimeError, match=f"^{re.escape(message)}$") as caught:
        split.step()
    assert time.monotonic() - begin < DEADLINE
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    assert not own_threads()
    monkeypatch.undo()
    for act in (split.step, split.reset):
        with pytest.raises(RuntimeError, match=f"^{re.escape(message)}$"):
            act()


def test_interruption(alone, monkeypatch):
    """Ctrl-C in the part that the caller steps is no failure of it: the next step goes on."""
    split = build(2)

    def interrupted():
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(split.parts[0], "step", interrupted)
        with pytest.raises(KeyboardInterrupt):
            split.step()
    split.step()


def test_step_while_an_exception_is_handled(alone):
    """What the caller is handling is no failure of a part."""
    split = build(2)
    try:
        raise ValueError("of the caller")
    except ValueError:
        split.step()
        split.reset()
    split.step()


@pytest.mark.parametrize("interrupted", [0, 1])
def test_interrupted_waiting(alone, monkeypatch, interrupted):
    """Ctrl-C while another part is waited for: the next step waits for it, and says if one has failed."""
    split = build(3)
    split.step()

    def interrupt():
        raise KeyboardInterrupt

    def step_interrupted():
        with monkeypatch.context() as patch:
            patch.setattr(split._threads[interrupted], "_errors", SimpleNamespace(get=interrupt))
            with pytest.raises(KeyboardInterrupt):
                split.step()

    before = split.scene.data.time.numpy().copy()
    step_interrupted()
    split.step()
    control_dt = split.scene.control_dt
    np.testing.assert_allclose(split.scene.data.time.numpy() - before, 2.0 * control_dt, rtol=1e-5)
    tried = threading.Event()

    def fail():
        tried.set()
        return 1 / 0

    with monkeypatch.context() as patch:
        patch.setattr(split.parts[1], "step", fail)
        step_interrupted()
        assert tried.wait(DEADLINE)
    with pytest.raises(RuntimeError, match="division by zero"):
        split.step()


def test_threads_end(alone):
    """With `close`, and with the last reference."""
    env = gym.make_vec(f"MyoWarp/{ELBOW}", NUM_WORLDS, device="cpu", shards=2, progress=False)
    env.reset(seed=0)
    assert own_threads()
    env.close()
    assert not own_threads()
    split = build(2)
    split.step()
    assert own_threads()
    del split
    assert wait_for_none()


SCRIPT = f"""
import gymnasium, myowarp, os
env = gymnasium.make_vec("MyoWarp/{ELBOW}", 4, device="cpu", shards=2, progress=False)
env.reset(seed=0)
env.step(env.action_space.sample())
pid = os.fork()
env.step(env.action_space.sample())
if pid:
    assert os.waitpid(pid, 0)[1] == 0
    print("stepped")
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_exit_and_fork():
    """Neither the end of the interpreter nor a forked process waits for threads for ever."""
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", SCRIPT], capture_output=True, timeout=120)
    assert done.returncode == 0, done.stderr.decode()
    assert done.stdout.decode().endswith("stepped\n")

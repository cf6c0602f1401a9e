"""Launches exchanged: the engine's kernels, each from a module of its own, do what they did."""

import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from often import often

from myowarp.definitions.task import TASKS
from myowarp.engine.compile import recorded
from myowarp.engine.patch import engine_kernels_alone, exchanged
from myowarp.sim.simulation import Simulation

KEYS = ("myoElbowPose1D6MFixed-v0", "myoHandObjHoldFixed-v0")
NUM_WORLDS = 3


def simulation(key):
    return Simulation(TASKS[key], NUM_WORLDS, device="cpu", stages=(), graph=False, progress=False)


@pytest.mark.slow  # compiles modules of the engine whole
@pytest.mark.parametrize("key", KEYS)
def test_state_is_that_of_the_engine(key):
    """Bit for bit, over steps in which muscles pull."""
    sim = simulation(key)
    start = sim.scene.data.qpos.numpy().copy()
    ends = []
    for alone in (True, False):
        sim.reset(seeds=np.arange(NUM_WORLDS))
        sim.scene.muscles.activation.fill_(0.3)
        for _ in range(20):
            if alone:
                with engine_kernels_alone():
                    mjw.step(sim.scene.model, sim.scene.data)
            else:
                mjw.step(sim.scene.model, sim.scene.data)
        ends.append(sim.scene.data.qpos.numpy().copy())
    np.testing.assert_array_equal(*ends)
    assert np.abs(ends[0] - start).max() > 0.01


@pytest.mark.parametrize("key", often(KEYS, KEYS[:1]))
def test_only_what_is_launched_is_compiled(key):
    modules = simulation(key).shards[0]._modules
    assert modules
    shared = [m.name for m in modules if m.name.startswith("mujoco_warp.") and len(m.kernels) > 1]
    assert not shared


def test_nothing_is_launched_for_none():
    array = wp.zeros(1, dtype=float, device="cpu")
    seen = []
    with exchanged(seen.append):
        wp.launch(fill_one, dim=1, outputs=[array], device="cpu")
    assert seen == [fill_one]
    assert array.numpy()[0] == 0.0
    wp.launch(fill_one, dim=1, outputs=[array], device="cpu")
    assert array.numpy()[0] == 1.0


@pytest.mark.parametrize("dim", [0, (2, 0)])
def test_launches_without_threads_are_left_out(dim):
    """Neither launched nor compiled; Warp itself makes nothing of them."""
    array, seen = wp.zeros(1, dtype=float, device="cpu"), []
    for size in (dim, 1):
        with exchanged(seen.append):
            wp.launch(fill_one, dim=size, outputs=[array], device="cpu")
            wp.launch(fill_one, size, outputs=[array], device="cpu")
    assert seen == 2 * [fill_one]
    with recorded() as found:
        wp.launch(fill_one, dim=dim, outputs=[array], device="cpu")
        wp.launch(fill_one, dim=1, outputs=[array], device="cpu")
    assert [module for module, _ in found] == [fill_one.module]


@wp.kernel(enable_backward=False)
def fill_one(
    # Out:
    out: wp.array[float],
):
    """out = 1."""
    out[0] = 1.0

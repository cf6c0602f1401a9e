"""What a control step is on CUDA, without a GPU: its launches on the CPU, its graph's nodes, its memory."""

import re
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
import pytest
import warp as wp

from benchmarks.cuda_step import CASES, CUDA_STAGES, Listing, counts, cuda_shard, engine_nodes, step_nodes
from benchmarks.gpu_cases import random_actions, trajectory
from myowarp.definitions.task import TASKS
from myowarp.engine.arena import Arena
from myowarp.engine.stages.muscle_path import MusclePaths
from myowarp.sim import memory
from myowarp.sim.build import compile_scene
from myowarp.sim.simulation import Simulation

CPU = wp.get_device("cpu")
HAND, KEY, WALK = "myoHandPoseRandom-v0", "myoHandKeyTurnFixed-v0", "myoLegWalk-v0"
STEPS, EXPECTED = 5, 0.01  # control steps, and rad at least that something moves meanwhile
ROUNDING = 1e-4  # rad after them: float32 sums in another order, grown by the dynamics; 1e-5 were seen
NODES = dict(zip(CASES, (59, 73, 59, 71), strict=True))
"""Of a physics step at most, beside the solver's iterations; of the hand 132 with what is left out."""


@cache
def nodes_of(task, physics):
    shard = cuda_shard(task, physics)
    return step_nodes(shard), engine_nodes(shard)


def cuda_simulation(task, **options):
    """Return a simulation that launches on the CPU what it would launch on CUDA."""
    options = {"physics": "fast", "device": "cpu", "progress": False} | options
    return Simulation(TASKS[task], 3, stages=CUDA_STAGES, muscle="mujoco_readable", **options)


def qpos_of(sim):
    return trajectory(sim, random_actions(sim, STEPS))["qpos"]


@pytest.mark.parametrize("task", [HAND, pytest.param(KEY, marks=pytest.mark.slow)])
def test_launches_of_cuda_make_the_steps_of_lanes(task):
    sim = cuda_simulation(task)
    assert [type(stage).__name__ for stage in sim.shards[0].stages] == ["MusclePath"]
    lanes = Simulation(TASKS[task], 3, physics="fast", device="cpu", progress=False)
    got, expected = qpos_of(sim), qpos_of(lanes)
    assert np.ptp(expected, axis=0).max() > EXPECTED
    np.testing.assert_allclose(got, expected, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize(
    "case", [CASES[0], *(pytest.param(case, marks=pytest.mark.slow) for case in CASES[1:])]
)
def test_nodes_of_a_physics_step(case):
    """The engine's own step has its allocations, each with a node that frees."""
    ours, engine = map(counts, nodes_of(*case))
    assert ours["physics_step_kernel"] + ours["physics_step_memory"] <= NODES[case]
    assert not any(number for name, number in ours.items() if name.endswith("allocation"))
    assert ours["iteration_kernel"] == 10 <= engine["iteration_kernel"]
    assert engine["physics_step_allocation"] > 30


def test_what_nobody_reads_is_not_launched():
    ours, engine = ([node.name for node in nodes] for nodes in nodes_of(HAND, "parity"))
    for name in ("_site_local_to_global", "_friction_dof", "_qfrc_actuator_gravcomp_limits"):
        assert name in engine
        assert name not in ours


def test_layout_of_moments_is_written_once_a_control_step(monkeypatch):
    written = []
    monkeypatch.setattr(MusclePaths, "write_layout", lambda self: written.append(self))
    shard = cuda_shard(HAND, "parity")
    written.clear()
    step_nodes(shard)
    assert len(written) == 2  # once to find out what is allocated, once to capture


@pytest.mark.slow
def test_bodies_are_moved_twice_beside_the_physics_steps():
    """For score and observation, and once more after resets."""
    nodes, _ = nodes_of(WALK, "fast")
    assert sum(node.name == "_kinematics_branch" and node.depth == 0 for node in nodes) == 2


@pytest.mark.filterwarnings(r"ignore:\s*CUDA version")
def test_memory_that_a_step_allocates_is_asked_for(monkeypatch):
    """Of the key turn four times what the engine's arrays take: room for pairs of convex bodies."""
    monkeypatch.setattr(memory, "available_memory", lambda device: 10**9)

    def most_worlds():
        with pytest.raises(ValueError, match="worlds need at least") as caught:
            compile_scene(TASKS[KEY], 100_000, device="cpu")
        return int(re.search(r"use at most ([\d,]+) worlds$", str(caught.value))[1].replace(",", ""))

    on_cpu = most_worlds()
    with Listing().patched():
        on_cuda = most_worlds()
    assert on_cuda < on_cpu / 3


def test_steps_from_an_arena_have_the_same_bits():
    """It gives the blocks again, full of what was there before, where Warp would give others."""
    sim = cuda_simulation(HAND, graph=False)
    expected = qpos_of(sim)
    shard = sim.shards[0]
    plain, arena = shard.launch_physics, Arena(shard.launch_physics, CPU)
    assert len(arena.blocks) > 20
    for block in arena.blocks:
        block.fill_(255)  # NaN

    def launch():
        with arena.used():
            plain()

    shard.launch_physics = launch
    np.testing.assert_array_equal(qpos_of(sim), expected)


def test_launches_that_allocate_otherwise_than_before():
    sizes = [3]
    arena = Arena(lambda: [wp.empty(size, dtype=float, device=CPU) for size in sizes], CPU)
    with arena.used():
        first = wp.empty(3, dtype=float, device=CPU)
        assert first.ptr == arena.blocks[0].ptr
        with pytest.raises(RuntimeError, match="the physics step allocates 20 bytes where it allocated"):
            wp.empty(5, dtype=float, device=CPU)
    with arena.used():
        again = wp.empty(3, dtype=float, device=CPU)
    assert again.ptr == first.ptr


def test_another_thread_allocates_as_ever_while_an_arena_is_used():
    """It would else take a block that launches are captured with, or refuse what it asks for."""

    def allocate():
        return wp.empty(7, dtype=float, device=CPU)

    arena = Arena(allocate, CPU)
    with arena.used(), ThreadPoolExecutor(1) as pool:
        theirs, mine = pool.submit(allocate).result(), allocate()
    assert mine.ptr == arena.blocks[0].ptr
    assert theirs.ptr != mine.ptr

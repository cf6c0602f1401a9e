"""A physics step as one launch: its bits on the CPU, what it refuses, and what it needs of a GPU."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.cuda_step import WHOLE, cuda_shard, step_nodes
from benchmarks.gpu_cases import random_actions, trajectory
from myowarp.definitions.task import TASKS
from myowarp.sim.build import compile_scene, stepped_of
from myowarp.sim.simulation import Simulation
from myowarp.sim.whole_step import STRIDE, WholeStep

ELBOW, HAND, KEY = "myoElbowPose1D6MRandom-v0", "myoHandPoseRandom-v0", "myoHandKeyTurnFixed-v0"
WORLDS, STEPS, EXPECTED = STRIDE + 3, 3, 0.01  # worlds of two warps; control steps; rad that something moves


def simulation(task, **options):
    return Simulation(TASKS[task], WORLDS, device="cpu", physics="fast", progress=False, **options)


@pytest.mark.slow  # compiles eight seconds for a stage that acts on request alone
@pytest.mark.parametrize("task", [ELBOW, HAND])
def test_bits_of_lanes(task):
    """A world in a thread, beside 31 others in memory, computes what a lane does."""
    whole, lanes = simulation(task, stages=(WholeStep,)), simulation(task)
    assert [type(stage) for stage in whole.shards[0].stages] == [WholeStep]
    actions = random_actions(lanes, STEPS)
    got, expected = trajectory(whole, actions), trajectory(lanes, actions)
    assert np.ptp(expected["qpos"], axis=0).max() > EXPECTED
    np.testing.assert_array_equal(got["qpos"], expected["qpos"])
    np.testing.assert_array_equal(whole.scene.data.qvel.numpy(), lanes.scene.data.qvel.numpy())
    np.testing.assert_array_equal(whole.scene.muscles.tension.numpy(), lanes.scene.muscles.tension.numpy())


def test_what_it_refuses():
    elbow, key = (stepped_of(compile_scene(TASKS[task], 2, device="cpu")) for task in (ELBOW, KEY))
    assert WholeStep.obstacle(elbow) is None
    assert WholeStep.obstacle(key) == "contacts are looked for"
    assert WholeStep.obstacle(replace(elbow, muscles=None)) == "the muscles are not MuJoCo's"
    elbow.muscles.individualize()
    assert WholeStep.obstacle(elbow) == "conditions act"


def test_a_physics_step_is_one_kernel():
    nodes = [node for node in step_nodes(cuda_shard(*WHOLE, stages=(WholeStep,))) if node.depth == 1]
    assert [node.name for node in nodes if node.kind == "kernel"] == ["step_worlds", "count_down"]
    assert {node.kind for node in nodes} == {"kernel"}

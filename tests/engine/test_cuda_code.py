"""Machine code of what a step launches on CUDA: made without a GPU, and what it needs is in a table."""

import json
from pathlib import Path

import pytest
import warp as wp

from benchmarks.cubin import Need
from benchmarks.cuda_step import ARCHITECTURE, CASES, WHOLE, compile_nodes, cuda_shard, step_nodes
from myowarp.sim.whole_step import WholeStep

HAND, PARITY = CASES[0]
TABLE = json.loads((Path(__file__).parents[1] / "data" / "cuda_kernels.json").read_text())
"""Of `python -m benchmarks.cuda_step --compile FOLDER --output tests/data/cuda_kernels.json`."""
SLACK = 1.1  # of another patch release of the compiler
OURS = {"muscle_path", "mujoco_muscle", "apply_action", "publish_observation"}
MOST = Need(registers=128, stack=64, instructions=6_000)  # of a kernel of ours; the engine's CCD has 19,768

pytestmark = pytest.mark.skipif(
    ARCHITECTURE not in wp.get_cuda_supported_archs(), reason="this build of Warp has no CUDA compiler"
)


def is_small(need):
    return all(value <= most for value, most in zip(need, MOST, strict=True))


def assert_small(nodes, found):
    for node in nodes:
        if node.kernel is not None and node.kernel.func.__module__.startswith("myowarp."):
            assert is_small(found[node.name]), (node.name, found[node.name])


def assert_as_in_table(found):
    for name, need in found.items():
        assert name in TABLE, f"{name} is new: write the table anew"
        for field, value, known in zip(Need._fields, need, TABLE[name], strict=True):
            assert value <= SLACK * known, f"{name}: {value} {field}, {known} in the table"


@pytest.mark.slow
def test_kernels_of_ours_in_a_step_of_the_hand(tmp_path):
    nodes = [node for node in step_nodes(cuda_shard(HAND, PARITY)) if node.name in OURS]
    found = compile_nodes(nodes, tmp_path)
    assert found.keys() >= OURS
    assert_small(nodes, found)
    assert_as_in_table(found)
    assert len(list(tmp_path.glob(f"*/*.sm{ARCHITECTURE}.cubin"))) == len(OURS)


@pytest.mark.slow
@pytest.mark.parametrize(("task", "physics"), CASES)
def test_all_kernels_of_a_step(task, physics, tmp_path):
    """The engine's, too."""
    nodes = step_nodes(cuda_shard(task, physics))
    found = compile_nodes(nodes, tmp_path)
    assert found.keys() >= {node.name for node in nodes if node.kernel is not None}
    assert_small(nodes, found)
    assert_as_in_table(found)


@pytest.mark.slow
def test_a_physics_step_in_one_kernel(tmp_path):
    """It is no small one: the code of all stages, and a stack; but one for each physics step."""
    nodes = step_nodes(cuda_shard(*WHOLE, stages=(WholeStep,)))
    found = compile_nodes([node for node in nodes if node.name == "step_worlds"], tmp_path)
    assert found.keys() == {"step_worlds"}
    assert_as_in_table(found)

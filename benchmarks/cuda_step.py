"""Launches of a control step on CUDA, listed and compiled on a machine without a GPU.

    python -m benchmarks.cuda_step                                    graph nodes of four tasks
    python -m benchmarks.cuda_step -t myoHandPoseRandom-v0 --list     each launch
    python -m benchmarks.cuda_step --compile FOLDER                   machine code, and what each kernel needs

For a while the CPU device says that it is a CUDA device; launches are then only noted. Folders and files of
machine code get the names that Warp looks for on such a device, so that FOLDER can be its cache there.
"""

import contextlib
import json
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial, wraps
from pathlib import Path
from typing import Annotated, Any
from unittest import mock

import mujoco_warp as mjw
import tyro
import warp as wp

from benchmarks.cubin import Need, needs
from myowarp.definitions.task import TASKS
from myowarp.engine.arena import Arena
from myowarp.engine.compile import BLOCK_DIM
from myowarp.engine.idle import idle_kernels
from myowarp.engine.patch import is_empty
from myowarp.engine.stage import STAGES, Stage, load
from myowarp.engine.step import Step
from myowarp.process import BUILD_LOCK
from myowarp.sim import shard as shard_module
from myowarp.sim.build import compile_scene
from myowarp.sim.whole_step import WholeStep

ARCHITECTURE, MULTIPROCESSORS = 90, 132  # an H100
WORLDS = 64  # of what is listed; nothing of it depends on their number
CASES = (
    ("myoHandPoseRandom-v0", "parity"),
    ("myoHandKeyTurnRandom-v0", "parity"),
    ("myoElbowPose1D6MRandom-v0", "parity"),
    ("myoLegWalk-v0", "fast"),
)
"""Tasks and presets that a GPU is measured with."""
WHOLE = CASES[0]
"""The one of them whose physics step can be one launch."""

CUDA_STAGES = tuple(name for name in STAGES if (kind := load(name)) is not None and kind.ON_CUDA)


@dataclass(frozen=True)
class Node:
    """A node of the graph of a control step.

    Attributes:
        kind: "kernel", "memory" (set or copied), or "allocation", which a second node frees.
        depth: In how many loops it is: 0 beside the physics steps, 1 in them, 2 in the solver's iterations.
        kernel: What is launched.
        block: Its threads a block.
    """

    kind: str
    depth: int
    kernel: wp.Kernel | None = None
    block: int = 0

    @property
    def name(self) -> str:
        """The kernel's name, without what tells its variants apart."""
        return "" if self.kernel is None else self.kernel.key.split("__locals__")[0]


class Listing:
    """Lists what is launched while the CPU device passes for a CUDA device."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._depth = 0

    @contextlib.contextmanager
    def patched(self) -> Iterator[None]:
        """Replace what launches, allocates and tells devices apart, in the block."""
        device = wp.get_device("cpu")
        patches = [
            (wp, "launch", self._launch),
            (wp, "launch_tiled", self._launch),
            (wp, "capture_while", self._loop),
            (wp, "capture_if", self._either),
            (wp, "copy", self._memory),
            (wp, "get_suggested_block_size", lambda *args, **kwargs: (BLOCK_DIM, 4 * MULTIPROCESSORS)),
            (wp.array, "zero_", self._memory),
            (wp.array, "fill_", self._memory),
            (wp.array, "_init_new", self._allocation(wp.array._init_new)),
            (type(device), "is_cpu", False),
            (type(device), "is_cuda", True),
            (type(device), "sm_count", MULTIPROCESSORS),
            (type(device), "get_allocator", lambda device, pinned=False: device.default_allocator),
            (device, "context_guard", contextlib.nullcontext()),
        ]
        with BUILD_LOCK, contextlib.ExitStack() as stack:
            for owner, name, value in patches:
                stack.enter_context(mock.patch.object(owner, name, value, create=not hasattr(owner, name)))
            yield

    def of(self, launches: Callable[[], None]) -> list[Node]:
        """Return the nodes that are launched."""
        self.nodes = []
        with self.patched():
            launches()
        return self.nodes

    def of_graph(self, launches: Callable[[], None]) -> list[Node]:
        """Return the nodes of a graph of ours: what is allocated lies in an arena."""
        with self.patched():
            arena = Arena(launches, wp.get_device("cpu"))
            self.nodes = []
            with arena.used():
                launches()
        return self.nodes

    def _launch(self, kernel: wp.Kernel, *args: Any, **kwargs: Any) -> None:
        if not is_empty(kernel, *args, **kwargs):
            self.nodes.append(Node("kernel", self._depth, kernel, kwargs.get("block_dim") or BLOCK_DIM))

    def _loop(self, condition: wp.array, while_body: Callable[..., None], **kwargs: Any) -> None:
        self._depth += 1
        while_body(**kwargs)
        self._depth -= 1

    def _either(self, condition: wp.array, on_true: Any = None, on_false: Any = None, **kwargs: Any) -> None:
        for branch in (on_true, on_false):
            if callable(branch):
                branch(**kwargs)

    def _memory(self, *args: Any, **kwargs: Any) -> None:
        self.nodes.append(Node("memory", self._depth))

    def _allocation(self, stock: Callable[..., None]) -> Callable[..., None]:
        @wraps(stock)
        def allocate(array: wp.array, *args: Any, **kwargs: Any) -> None:
            stock(array, *args, **kwargs)
            if array.ptr and not isinstance(array._allocator, Arena):
                self.nodes.append(Node("allocation", self._depth))

        return allocate


class Unlaunched(shard_module.Shard):
    """A shard whose step is listed, not made."""

    def reset(self, *args: Any, **kwargs: Any) -> None:
        """Do nothing."""


def _trusted(
    step: Step, kinds: Iterable[str | type[Stage]], *args: Any
) -> tuple[tuple[Stage, ...], frozenset[str]]:
    return step.stages(kinds), idle_kernels(step.stepped)


def cuda_shard(
    task: str, physics: str, stages: Iterable[str | type[Stage]] = CUDA_STAGES
) -> shard_module.Shard:
    """Return the worlds of a task with what they launch on CUDA, if all of it proves to be right there."""
    with (
        mock.patch.object(shard_module, "choose_stages", _trusted),
        mock.patch.object(shard_module, "compile_kernels", return_value=()),
    ):
        scene = compile_scene(TASKS[task], WORLDS, device="cpu", physics=physics)
        shard = Unlaunched(scene, autoreset="next_step", graph=False, stages=stages, progress=False)
    if hasattr(shard.physics_step, "in_lanes"):
        shard.physics_step.in_lanes = False
    return shard


def step_nodes(shard: shard_module.Shard) -> list[Node]:
    """Return the nodes of a control step's graph."""
    return Listing().of_graph(shard._launch_step)


def other_nodes(shard: shard_module.Shard) -> list[Node]:
    """Return what else is launched: resets, and what verifies the stages."""

    def launches() -> None:
        for number in range(len(shard.stages) + 1):
            shard.physics_step.launches(shard.stages[:number])()
        shard._launch_asked_reset()

    return Listing().of(launches)


def engine_nodes(shard: shard_module.Shard) -> list[Node]:
    """Return the nodes of a physics step of mujoco-warp alone, with MuJoCo's muscles, in a loop."""
    scene, countdown = shard.scene, wp.zeros(1, dtype=int, device="cpu")
    sizes = {"nconmax": scene.capacity.contacts, "njmax": scene.capacity.rows}
    with wp.ScopedDevice("cpu"):
        model, data = mjw.put_model(scene.oracle), mjw.make_data(scene.oracle, nworld=WORLDS, **sizes)
    model.opt.warn_overflow = False
    return Listing().of(lambda: wp.capture_while(countdown, partial(mjw.step, model, data)))


def counts(nodes: list[Node]) -> dict[str, int]:
    """Return how many nodes there are, by where and what; a solver's iteration is counted once."""
    places = ("control_step", "physics_step", "iteration")
    return {
        f"{place}_{kind}": sum((node.depth, node.kind) == (depth, kind) for node in nodes)
        for depth, place in enumerate(places)
        for kind in ("kernel", "memory", "allocation")
    }


def compile_nodes(nodes: list[Node], folder: Path) -> dict[str, Need]:
    """Compile the kernels of nodes for ARCHITECTURE, each for its block, on all cores, unless it is there.

    Returns:
        What each kernel needs, by name: the most of all its variants.
    """
    wanted = {(node.kernel.module, node.block) for node in nodes if node.kernel is not None}
    found_as = f"*.sm{ARCHITECTURE}.cubin"

    def compiled(module: wp.Module, block: int) -> dict[str, Need]:
        options = module.resolve_options(wp.config, block_dim=block)
        into = folder / module.get_module_identifier(block)
        if not list(into.glob(found_as)):  # its name is of what it holds
            module._compile(None, into, output_arch=ARCHITECTURE, use_ptx=False, options=options)
        return needs(next(into.glob(found_as)))

    found: dict[str, Need] = {}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for each in pool.map(lambda one: compiled(*one), sorted(wanted, key=lambda one: one[0].name)):
            for name, need in each.items():
                found[name] = need.or_more(found.get(name, need))
    return dict(sorted(found.items()))


@dataclass(frozen=True)
class Options:
    """Count and compile what a control step launches on CUDA, without a GPU."""

    tasks: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-t"])] = tuple(task for task, _ in CASES)
    """Task names with version."""
    list: bool = False
    """Whether to print each launch."""
    compile: Path | None = None
    """Folder for machine code."""
    complete: bool = False
    """Whether to compile what resets, verifies stages and is raced, too: all that Warp's cache needs."""
    output: Path | None = None
    """JSON file for what each kernel needs."""


def main() -> None:
    """Print counts; compile where that is asked for."""
    options, found = tyro.cli(Options, prog="python -m benchmarks.cuda_step"), dict[str, Need]()
    for task, physics in CASES:
        if task not in options.tasks:
            continue
        shard = cuda_shard(task, physics)
        nodes = step_nodes(shard)
        print(task, physics, json.dumps(counts(nodes)), flush=True)
        for node in nodes if options.list else ():
            print(4 * node.depth * " ", node.kind, node.name, node.block or "")
        if options.compile is not None:
            more = other_nodes(shard) + engine_nodes(shard) if options.complete else []
            if (task, physics) == WHOLE:
                more += step_nodes(cuda_shard(task, physics, stages=(WholeStep,)))
            for name, need in compile_nodes(nodes + more, options.compile).items():
                found[name] = need.or_more(found.get(name, need))
    if options.output is not None:
        rows = ",\n".join(f" {json.dumps(name)}: {json.dumps(need)}" for name, need in sorted(found.items()))
        options.output.write_text(f"{{\n{rows}\n}}\n")


if __name__ == "__main__":
    main()

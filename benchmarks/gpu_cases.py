"""Cases of `benchmarks.gpu`: agreement with the CPU, rates, time of every kernel, training.

The engine's own rate is that of mujoco-warp's stock step on the same slim model with MuJoCo's built-in
muscles, from the same states, a physics step as one graph; it has nothing else of an environment. The rate of
the cores is that of the environment on all CPU cores of the same machine.
"""

import csv
import functools
import gc
import importlib.util
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from unittest import mock

import mujoco_warp as mjw
import numpy as np
import tyro
import warp as wp

from benchmarks.cuda_step import CASES
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import TASKS
from myowarp.disk import in_place
from myowarp.engine.compile import compile_kernels, quiet
from myowarp.process import BUILD_LOCK
from myowarp.sim import shard
from myowarp.sim.build import resolve_device
from myowarp.sim.simulation import Simulation
from myowarp.sim.whole_step import WholeStep

CONTROLS = 8  # sets of random controls of the engine, used in turn
WARMUP = 5  # control steps
BANDWIDTH_BYTES = 2**28
GATES = {5: 1e-4, 20: 1e-3}
"""Most that a position may differ from the CPU's after so many control steps [rad, m]."""


@dataclass(frozen=True)
class Options:
    """Measure MyoWarp on a GPU."""

    output: Path = Path("out/gpu.json")
    """JSON file to write."""
    device: str = "cuda:0"
    """Warp device; "cpu" is a dry run."""
    tasks: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-t"])] = tuple(task for task, _ in CASES)
    """Task names with version."""
    sizes: tuple[int, ...] = (1024, 4096, 8192, 32768)
    """Numbers of worlds, ascending."""
    seconds: float = 0.5
    """Rough duration of one measurement."""
    rounds: int = 3
    """Rounds; the median counts."""
    checked_worlds: int = 64
    """Worlds that are compared between runs and devices."""
    checked_steps: int = 20
    """Control steps that are compared."""
    references: Path | None = None
    """The CPU's results, as `--record` writes them; without them, the CPU computes now."""
    record: Path | None = None
    """Write that file, and measure nothing."""
    unrolled: bool = False
    """Whether graphs hold each physics step of a control step, should their loop fail on a device."""
    training: float = 120.0
    """Seconds of training, together; 0: none."""
    budget: float = 540.0
    """Seconds for everything; what does not fit is left out."""


@dataclass(frozen=True)
class Case:
    """Measurement of one process: a key of `KINDS`, a task, a physics preset and a number of worlds."""

    kind: str
    task: str = ""
    physics: str = "parity"
    num_worlds: int = 0

    def __str__(self) -> str:
        worlds = f", {self.num_worlds} worlds" if self.num_worlds else ""
        return f"{self.kind} of {self.task}, {self.physics}{worlds}" if self.task else self.kind


def used_memory(device: wp.Device) -> int:
    """Return bytes in use on the device by everybody, or on the CPU by this process."""
    if device.is_cuda:
        wp.synchronize_device(device)
        return device.total_memory - device.free_memory
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def seconds_of(step: Callable[[], object], steps: int, device: wp.Device) -> float:
    """Return wall seconds of one step."""
    wp.synchronize_device(device)
    begin = time.perf_counter()
    for _ in range(steps):
        step()
    wp.synchronize_device(device)
    return (time.perf_counter() - begin) / steps


class Engine:
    """mujoco-warp alone: physics steps of the slim model with its own muscles, a graph each."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.turn = scene, 0
        worlds, capacity, device = scene.num_worlds, scene.capacity, scene.device
        low, high = scene.oracle.actuator_ctrlrange.T
        actions = np.random.default_rng(0).uniform(-1, 1, (CONTROLS, worlds, scene.oracle.nu))
        controls = np.clip(1.0 / (1.0 + np.exp(-5.0 * (actions - 0.5))), low, high)
        with quiet(), wp.ScopedDevice(device):
            self.model = mjw.put_model(scene.oracle)
            self.model.opt.warn_overflow = False
            sizes = {"nconmax": capacity.contacts, "njmax": capacity.rows}
            self.data = mjw.make_data(scene.oracle, nworld=worlds, **sizes)
            self.controls = [wp.array(part, dtype=float) for part in controls]
            compile_kernels(self.launch, device, show=False)
            with wp.ScopedCapture(force_module_load=False) as capture:
                self.launch()
        self.graph = capture.graph

    def launch(self) -> None:
        """Launch a physics step."""
        mjw.step(self.model, self.data)

    def start(self) -> None:
        """Take over the states of the environment."""
        for name in ("qpos", "qvel", "qacc_warmstart"):
            wp.copy(getattr(self.data, name), getattr(self.scene.data, name))
        if self.model.na:
            wp.copy(self.data.act, self.scene.muscles.activation)

    def step(self) -> None:
        """Make a control step under the next controls."""
        self.turn = (self.turn + 1) % CONTROLS
        wp.copy(self.data.ctrl, self.controls[self.turn])
        for _ in range(self.scene.num_substeps):
            wp.capture_launch(self.graph)


class Environment:
    """The vector environment as a learner on the device uses it: torch in and out, where torch is there."""

    def __init__(self, case: Case, device: wp.Device) -> None:
        self.device, output = device, "warp"
        if importlib.util.find_spec("torch") is not None:
            import torch

            output = "torch" if device.is_cpu or torch.cuda.is_available() else "warp"
        self.env = MyoWarpVectorEnv(
            case.task,
            case.num_worlds,
            device=device.alias,
            physics=case.physics,
            output=output,
            progress=False,
        )
        self.sim = self.env.sim
        self.env.reset(seed=0)
        shape = self.sim.action.shape
        if output == "torch":
            where = wp.device_to_torch(device)
            self.draw = lambda: torch.rand(shape, device=where) * 2.0 - 1.0
        else:
            actions = np.random.default_rng(0).uniform(-1, 1, shape)
            fixed = wp.array(actions, dtype=float, device=device)
            self.draw = lambda: fixed

    def step(self) -> None:
        """Make a control step under random actions."""
        self.env.step(self.draw())

    def footprint(self, steps: int) -> dict[str, object]:
        """Return what steps allocate on the device and read back from it; nothing, after the capture."""
        stock, reads = wp.array.numpy, 0

        def read(array: wp.array) -> np.ndarray:
            nonlocal reads
            reads += 1
            return stock(array)

        pooled = self.device.is_cuda and wp.is_mempool_enabled(self.device)
        pool = functools.partial(wp.get_mempool_used_mem_current, self.device) if pooled else lambda: 0
        before, pool_before = used_memory(self.device), pool()
        with mock.patch.object(wp.array, "numpy", read):
            for _ in range(steps):
                self.step()
        return {
            "steps": steps,
            "memory_growth_bytes": used_memory(self.device) - before,
            "pool_growth_bytes": pool() - pool_before,
            "host_reads": reads,  # on the CPU they are views
        }


@contextmanager
def timed(owner: Any, name: str, seconds: dict[str, float], key: str) -> Iterator[None]:
    """Add up in `seconds[key]` what calls of a function take in the block."""
    stock = getattr(owner, name)

    def call(*args: Any, **kwargs: Any) -> Any:
        begin = time.perf_counter()
        try:
            return stock(*args, **kwargs)
        finally:
            seconds[key] = round(seconds.get(key, 0.0) + time.perf_counter() - begin, 3)

    with mock.patch.object(owner, name, call):
        yield


def rates(case: Case, options: Options) -> Iterator[dict[str, Any]]:
    """Yield rates of environment and engine in turns, memory and times of start-up."""
    device, start = resolve_device(options.device), dict[str, float]()
    before, begin = used_memory(device), time.perf_counter()
    with (
        timed(shard.Shard, "_choose_kernels", start, "kernels"),
        timed(shard.Shard, "_capture", start, "capture"),
    ):
        env = Environment(case, device)
    seconds_of(env.step, 1, device)
    start["until_first_step"] = round(time.perf_counter() - begin, 3)
    memory = used_memory(device) - before
    engine = Engine(env.sim.scene)
    engine.start()
    contestants = {"environment": env.step, "engine": engine.step}
    steps = {}
    for name, step in contestants.items():
        seconds_of(step, WARMUP, device)
        steps[name] = max(2, round(options.seconds / seconds_of(step, 2, device)))
    rates: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(options.rounds):
        for name, step in contestants.items():
            rates[name].append(case.num_worlds / seconds_of(step, steps[name], device))
    ratios = [ours / bare for ours, bare in zip(*rates.values(), strict=True)]
    yield {
        "env_steps_per_s": round(statistics.median(rates["environment"]), 1),
        "engine_steps_per_s": round(statistics.median(rates["engine"]), 1),
        "ratio_to_engine": round(statistics.median(ratios), 3),
        "ratio_spread": [round(min(ratios), 3), round(max(ratios), 3)],
        "output": env.env.output,
        "start_seconds": start,
        "memory_bytes": memory,
        "memory_bytes_per_world": round(memory / case.num_worlds),
        "footprint": env.footprint(steps=20),
        "stages": sorted(type(stage).__name__ for stage in env.sim.shards[0].stages),
        "idle_kernels": len(env.sim.shards[0].idle_kernels),
    }


def cores(case: Case, options: Options) -> Iterator[dict[str, Any]]:
    """Yield the rate of the environment on all CPU cores of this machine."""
    device = wp.get_device("cpu")
    env = Environment(case, device)
    seconds_of(env.step, WARMUP, device)
    steps = max(2, round(options.seconds / seconds_of(env.step, 2, device)))
    found = [case.num_worlds / seconds_of(env.step, steps, device) for _ in range(options.rounds)]
    yield {
        "env_steps_per_s": round(statistics.median(found), 1),
        "shards": len(env.sim.shards),
        "output": env.env.output,
    }


def unroll() -> None:
    """Have graphs hold each physics step of a control step in this process."""

    def unrolled(launches: Callable[[], None], times: int, countdown: wp.array) -> None:
        for _ in range(times):
            launches()

    shard.repeat = unrolled


def trajectory(sim: Simulation, actions: np.ndarray) -> dict[str, np.ndarray]:
    """Return observation, reward and configuration after each step, (num_steps, num_worlds, ...)."""
    sim.reset(seeds=np.arange(sim.num_worlds))
    arrays = {"obs": sim.transition.obs, "reward": sim.transition.reward, "qpos": sim.scene.data.qpos}
    steps = []
    for action in actions:
        sim.action.assign(action)
        sim.step()
        steps.append({name: array.numpy().copy() for name, array in arrays.items()})
    return {name: np.array([step[name] for step in steps]) for name in arrays}


def random_actions(sim: Simulation, steps: int) -> np.ndarray:
    """Return uniform actions in [-1, 1], shape (num_steps, num_worlds, num_actions)."""
    return np.random.default_rng(0).uniform(-1, 1, (steps, *sim.action.shape)).astype(np.float32)


def differences(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return by array the largest difference of the worst and of the median world, after some steps."""
    report: dict[str, Any] = {}
    for name, values in first.items():
        worlds = np.abs(values - second[name]).reshape(*values.shape[:2], -1).max(axis=2)
        report[name] = {
            f"after_{step}": {
                "worst": float(worlds[step - 1].max()),
                "median": float(np.median(worlds[step - 1])),
            }
            for step in sorted({1, max(1, len(worlds) // 4), len(worlds)})
        }
    return report


def simulation(case: Case, device: str, **options: Any) -> Simulation:
    """Return the worlds of a case."""
    return Simulation(
        TASKS[case.task], case.num_worlds, device=device, physics=case.physics, progress=False, **options
    )


def walk(sim: Simulation, options: Options) -> dict[str, np.ndarray]:
    """Return the trajectory of random actions, the same in every simulation."""
    return trajectory(sim, random_actions(sim, options.checked_steps))


def record(cases: Iterable[Case], options: Options, path: Path) -> None:
    """Write what the CPU makes of cases, by case and array."""
    kept = {}
    for case in cases:
        for name, values in walk(simulation(case, "cpu"), options).items():
            kept[f"{case}|{name}"] = values
    with in_place(path) as scratch, scratch.open("wb") as file:
        np.savez_compressed(file, **kept)


def agreement(case: Case, options: Options) -> Iterator[dict[str, Any]]:
    """Yield how far the device's worlds are from the CPU's, same seeds and actions, and from a second run."""
    sim = simulation(case, options.device)
    mine, again = walk(sim, options), walk(sim, options)
    if options.references is None:
        theirs = walk(simulation(case, "cpu"), options)
    else:
        with np.load(options.references) as kept:
            theirs = {name: kept[f"{case}|{name}"] for name in mine}
    apart = np.abs(mine["qpos"] - theirs["qpos"]).reshape(len(mine["qpos"]), -1).max(axis=1)
    yield {
        "agrees": {step: bool(apart[step - 1] <= most) for step, most in GATES.items() if step <= len(apart)},
        "moved": float(np.ptp(mine["qpos"], axis=0).max()),
        "difference_to_cpu": differences(mine, theirs),
        "same_bits_twice": all(np.array_equal(mine[name], again[name]) for name in mine),
        "stages": sorted(type(stage).__name__ for stage in sim.shards[0].stages),
        "idle_kernels": len(sim.shards[0].idle_kernels),
    }


def whole_step(case: Case, options: Options) -> Iterator[dict[str, Any]]:
    """Yield rates with one launch a physics step and with the default's, and how far they get apart."""
    found: dict[str, tuple[float, np.ndarray]] = {}
    for name, stages in (("stages", None), ("whole_step", (WholeStep,))):
        sim = simulation(case, options.device, stages=stages)
        qpos = trajectory(sim, random_actions(sim, min(GATES)))["qpos"]
        steps = max(2, round(options.seconds / seconds_of(sim.step, 2, sim.scene.device)))
        found[name] = case.num_worlds / seconds_of(sim.step, steps, sim.scene.device), qpos
        if name == "whole_step" and [type(stage).__name__ for stage in sim.shards[0].stages] != ["WholeStep"]:
            raise RuntimeError("the physics step in one launch is not the engine's on this device")
        del sim
        gc.collect()
    (one, first), (other, second) = found.values()
    yield {
        "stages_steps_per_s": round(one, 1),
        "whole_step_steps_per_s": round(other, 1),
        "ratio_to_stages": round(other / one, 3),
        "apart": float(np.abs(first - second).max()),
    }


def repeats(case: Case, options: Options) -> Iterator[dict[str, Any]]:
    """Yield whether two runs with `deterministic=True` have the same bits, and how fast they are."""
    sim = simulation(case, options.device, deterministic=True)
    first, second = walk(sim, options), walk(sim, options)
    steps = max(2, round(0.3 * options.seconds / seconds_of(sim.step, 2, sim.scene.device)))
    yield {
        "same_bits": all(np.array_equal(first[name], second[name]) for name in first),
        "difference": differences(first, second),
        "env_steps_per_s": round(sim.num_worlds / seconds_of(sim.step, steps, sim.scene.device), 1),
    }


def bandwidth(case: Case, options: Options) -> Iterator[dict[str, Any]]:
    """Yield how fast memory is copied, reads and writes counted [TB/s]."""
    device = resolve_device(options.device)
    source, target = (wp.zeros(BANDWIDTH_BYTES, dtype=wp.uint8, device=device) for _ in range(2))
    seconds_of(lambda: wp.copy(target, source), 2, device)
    yield {"tb_per_s": 2 * BANDWIDTH_BYTES / seconds_of(lambda: wp.copy(target, source), 10, device) / 1e12}


def kernels(case: Case, options: Options) -> Iterator[dict[str, Any]]:
    """Yield milliseconds of each kernel of a physics step, launched one by one, the longest first."""
    steps = 3
    sim = simulation(case, options.device)
    for _ in range(WARMUP):
        sim.step()
    device, (first, *_) = sim.scene.device, sim.shards
    with BUILD_LOCK, quiet(), wp.ScopedDevice(device):
        first.launch_physics()
        wp.synchronize_device(device)
        wp.timing_begin(cuda_filter=wp.TIMING_ALL)
        for _ in range(steps):
            first.launch_physics()
        results = wp.timing_end()
    found: dict[str, list[float]] = {}
    for result in results:
        name = result.name.removeprefix("forward kernel ").split("__locals__")[0]
        found.setdefault(name, []).append(result.elapsed)
    table = [(round(sum(ms) / steps, 4), len(ms) // steps, name) for name, ms in found.items()]
    data = first.scene.data
    yield {
        "physics_step_ms": round(sum(ms for ms, *_ in table), 4),
        "kernels": sorted(table, reverse=True),
        "solver_iterations": _mean_and_most(data.solver_niter),
        "rows": _mean_and_most(data.nefc),
    }


def _mean_and_most(numbers: wp.array) -> tuple[float, int]:
    return round(float(numbers.numpy().mean()), 2), int(numbers.numpy().max())


def training(case: Case, options: Options) -> Iterator[dict[str, Any]]:
    """Yield what is known of a training when its seconds are over: the last row of `progress.csv`."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder, "run")
        arguments = ("train", case.task, "--num-worlds", str(case.num_worlds), "--output", str(run))
        command = sys.executable, "-m", "myowarp", *arguments, "--device", options.device
        done = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        begin = time.perf_counter()
        try:
            _, said = done.communicate(timeout=options.training / 2)
        except subprocess.TimeoutExpired:
            done.send_signal(signal.SIGINT)
            _, said = done.communicate()
        rows = []
        if (table := run / "progress.csv").exists():
            with table.open(newline="") as file:
                rows = list(csv.DictReader(file))
        last = rows[-1] if rows else {"said": said[-400:]}
        yield {"seconds": round(time.perf_counter() - begin, 1), "iterations": len(rows), "last": last}


def first_line(error: BaseException) -> str:
    """Return what went wrong in a line."""
    return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"

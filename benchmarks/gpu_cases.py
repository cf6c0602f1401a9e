"""What `benchmarks.gpu` measures of a task: rates beside the engine's, agreement with the CPU, repeatability.

The engine's own rate is that of mujoco-warp's stock step on the same slim model with MuJoCo's built-in
muscles, from the same states, a control step as one graph; it has nothing else of an environment.
"""

import functools
import gc
import importlib.util
import os
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from unittest import mock

import mujoco_warp as mjw
import numpy as np
import tyro
import warp as wp

from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import TASKS
from myowarp.engine.compile import compile_kernels, quiet, recorded
from myowarp.engine.repeat import repeat
from myowarp.sim.build import resolve_device
from myowarp.sim.shard import Shard
from myowarp.sim.simulation import Simulation

CONTROLS = 8  # sets of random controls of the engine, used in turn
WARMUP = 5  # control steps
HAND = "myoHandPoseRandom-v0"


@dataclass(frozen=True)
class Options:
    """Measure MyoWarp on a GPU."""

    output: Path = Path("out/gpu.json")
    """JSON file to write."""
    device: str = "cuda:0"
    """Warp device; "cpu" is a dry run."""
    tasks: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-t"])] = (HAND, "myoHandKeyTurnRandom-v0")
    """Task names with version."""
    sizes: tuple[int, ...] = (1024, 4096, 8192, 32768)
    """Numbers of worlds, ascending."""
    seconds: float = 1.0
    """Rough duration of one measurement."""
    rounds: int = 3
    """Rounds; the median counts."""
    checked_worlds: int = 256
    """Worlds that are compared between runs and devices."""
    checked_steps: int = 20
    """Control steps that are compared."""
    budget: float = 420.0
    """Seconds for everything; what does not fit is left out."""
    tests: str = ""
    """What the tests said, for the JSON."""


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
    """mujoco-warp alone: control steps of the slim model with its own muscles, a graph each."""

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
            self.countdown = wp.zeros(1, dtype=int)
            compile_kernels(self.launch, device, show=False)
            with wp.ScopedCapture(force_module_load=False) as capture:
                self.launch()
        self.graph = capture.graph

    def step_physics(self) -> None:
        """Launch a physics step."""
        mjw.step(self.model, self.data)

    def launch(self) -> None:
        """Launch a control step."""
        repeat(self.step_physics, self.scene.num_substeps, self.countdown)

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
        wp.capture_launch(self.graph)


class Environment:
    """The vector environment as a learner on the device uses it: torch in and out, where torch is there."""

    def __init__(self, task: str, physics: str, num_worlds: int, device: wp.Device) -> None:
        self.device, output = device, "warp"
        if importlib.util.find_spec("torch") is not None:
            import torch

            output = "torch" if device.is_cpu or torch.cuda.is_available() else "warp"
        self.env = MyoWarpVectorEnv(
            task,
            num_worlds,
            device=device.alias,
            shards=1 if device.is_cpu else None,
            physics=physics,
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

    def launches(self, engine: Engine) -> dict[str, int]:
        """Return kernel launches of a control step; what the solver's loop repeats counts once."""

        def unrolled(launches: Callable[[], None], times: int, _: wp.array) -> None:
            for _ in range(times):
                launches()

        counts = {}
        with quiet(), wp.ScopedDevice(self.device), mock.patch("myowarp.sim.shard.repeat", unrolled):
            with recorded() as found:
                self.sim.shards[0]._launch_step()
            counts["environment"] = len(found)
            with recorded() as found:
                engine.step_physics()
            counts["engine"] = self.sim.scene.num_substeps * len(found)
        return counts


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


def measure_size(task: str, physics: str, num_worlds: int, options: Options) -> dict[str, Any]:
    """Return rates of environment and engine in turns, memory, launches and times of start-up."""
    device, start = resolve_device(options.device), dict[str, float]()
    before, begin = used_memory(device), time.perf_counter()
    with (
        timed(Shard, "_choose_kernels", start, "kernels"),
        timed(Shard, "_capture", start, "capture"),
    ):
        env = Environment(task, physics, num_worlds, device)
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
            rates[name].append(num_worlds / seconds_of(step, steps[name], device))
    ratios = [ours / bare for ours, bare in zip(*rates.values(), strict=True)]
    return {
        "num_worlds": num_worlds,
        "env_steps_per_s": round(statistics.median(rates["environment"]), 1),
        "engine_steps_per_s": round(statistics.median(rates["engine"]), 1),
        "ratio_to_engine": round(statistics.median(ratios), 3),
        "ratio_spread": [round(min(ratios), 3), round(max(ratios), 3)],
        "output": env.env.output,
        "start_seconds": start,
        "memory_bytes": memory,
        "memory_bytes_per_world": round(memory / num_worlds),
        "footprint": env.footprint(steps=20),
        "launches": env.launches(engine),
        "stages": sorted(type(stage).__name__ for stage in env.sim.shards[0].stages),
        "idle_kernels": len(env.sim.shards[0]._idle),
    }


def rates(task: str, physics: str, options: Options) -> Iterator[dict[str, Any]]:
    """Yield a row for each number of worlds, up to the first that does not fit."""
    for num_worlds in options.sizes:
        try:
            yield measure_size(task, physics, num_worlds, options)
        except (RuntimeError, MemoryError) as error:  # Warp raises the first where memory is short
            yield {"num_worlds": num_worlds, "failed": first_line(error)}
            return


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


def agreement(task: str, physics: str, options: Options) -> Iterator[dict[str, Any]]:
    """Yield how far the device's worlds are from the CPU's, same seeds and actions."""
    found = []
    for device in ("cpu", options.device):
        sim = Simulation(TASKS[task], options.checked_worlds, device=device, physics=physics, progress=False)
        found.append(trajectory(sim, random_actions(sim, options.checked_steps)))
    yield {"num_worlds": options.checked_worlds, "difference_to_cpu": differences(*found)}


def repeats(task: str, physics: str, options: Options) -> Iterator[dict[str, Any]]:
    """Yield whether two runs have the same bits, without and with `deterministic=True`."""
    for deterministic in (False, True):
        sim = Simulation(
            TASKS[task],
            options.checked_worlds,
            device=options.device,
            physics=physics,
            deterministic=deterministic,
            progress=False,
        )
        actions = random_actions(sim, options.checked_steps)
        first, second = trajectory(sim, actions), trajectory(sim, actions)
        steps = max(2, round(0.3 * options.seconds / seconds_of(sim.step, 2, sim.scene.device)))
        yield {
            "num_worlds": options.checked_worlds,
            "deterministic": deterministic,
            "same_bits": all(np.array_equal(first[name], second[name]) for name in first),
            "difference": differences(first, second),
            "env_steps_per_s": round(sim.num_worlds / seconds_of(sim.step, steps, sim.scene.device), 1),
        }


def first_line(error: BaseException) -> str:
    """Return what went wrong in a line."""
    return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"

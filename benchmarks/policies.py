"""Effect of a policy on the same cores on the steps after it.

    python -m benchmarks.policies --output out/policies.json

The threads of NumPy's OpenBLAS and of torch's OpenMP go on looking for work after a product, on cores that
the next step could use. Environment variables stop that; they are read when the library loads, so that every
measurement is a process of its own. The policy has two hidden layers of 256. Torch is measured where it is
installed.
"""

import importlib.util
import itertools
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from benchmarks.__main__ import PACKAGES
from benchmarks.machine import disturbances, least_disturbed, processor, timed_here
from benchmarks.rivals import FAMILIES
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.task import PHYSICS
from myowarp.process import num_cores
from myowarp.progress import progress_bar

QUIETED = {"numpy": {"OPENBLAS_NUM_THREADS": "1"}, "torch": {"OMP_WAIT_POLICY": "PASSIVE"}}
WIDTH = 256  # of a hidden layer
WARMUP = 100  # steps

Policy = Callable[[np.ndarray], np.ndarray]


@dataclass
class Options:
    """Measure steps after a policy on the same cores."""

    output: Path = Path("out/policies.json")
    """JSON file to write."""
    families: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-f"])] = (
        "elbow pose",
        "finger pose",
        "hand pose",
    )
    """Families of `benchmarks.rivals`."""
    num_worlds: int = 64
    """Worlds stepped together."""
    seconds: float = 1.0
    """Least time of one measurement [s]."""
    rounds: int = 3
    """Rounds; the median counts."""
    only: tuple[str, str, str] | None = None
    """Library, task and physics to measure in this process."""


def numpy_policy(num_obs: int, num_actions: int) -> Policy:
    """Return a policy of NumPy's."""
    rng, sizes = np.random.default_rng(0), (num_obs, WIDTH, WIDTH, num_actions)
    first, second, last = (
        rng.normal(0.0, rows**-0.5, (rows, columns)).astype(np.float32)
        for rows, columns in itertools.pairwise(sizes)
    )
    return lambda obs: np.tanh(np.maximum(np.maximum(obs @ first, 0.0) @ second, 0.0) @ last)


def torch_policy(num_obs: int, num_actions: int) -> Policy:
    """Return a policy of torch's."""
    import torch
    from torch import nn

    torch.set_grad_enabled(False)
    hidden = nn.Linear(num_obs, WIDTH), nn.ReLU(), nn.Linear(WIDTH, WIDTH), nn.ReLU()
    network = nn.Sequential(*hidden, nn.Linear(WIDTH, num_actions), nn.Tanh())
    return lambda obs: network(torch.from_numpy(obs)).numpy()


POLICIES = {"numpy": numpy_policy, "torch": torch_policy}


def measure(library: str, task: str, physics: str, options: Options) -> dict[str, float]:
    """Return the time of a step and of the policy before it [us], and how many cores others used."""
    env = MyoWarpVectorEnv(task, options.num_worlds, device="cpu", physics=physics, progress=False)
    policy = POLICIES[library](env.single_observation_space.shape[0], env.single_action_space.shape[0])
    obs = env.reset(seed=0)[0]

    def run(least_steps: int, seconds: float) -> tuple[float, float]:
        nonlocal obs
        end = time.perf_counter() + seconds
        deciding = stepping = 0.0
        steps = 0
        while steps < least_steps or time.perf_counter() < end:
            begin = time.perf_counter()
            actions = policy(obs)
            decided = time.perf_counter()
            obs = env.step(actions)[0]
            deciding, stepping = deciding + decided - begin, stepping + time.perf_counter() - decided
            steps += 1
        return 1e6 * deciding / steps, 1e6 * stepping / steps

    run(WARMUP, 0.0)
    (policy_us, step_us), others = least_disturbed(timed_here(lambda: run(1, options.seconds)))
    env.close()
    return {"policy_us": policy_us, "step_us": step_us, "others": others}


def in_own_process(options: Options, quieted: dict[str, str], *only: str) -> dict[str, float]:
    """Measure in a new process."""
    command = [sys.executable, "-m", "benchmarks.policies", "--seconds", str(options.seconds)]
    command += ["--num-worlds", str(options.num_worlds), "--only", *only]
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("OMP_", "OPENBLAS_", "MKL_"))}
    done = subprocess.run(command, env=environment | quieted, capture_output=True, text=True, check=False)
    if done.returncode:
        *_, reason = f"exit code {done.returncode}", *done.stderr.strip().splitlines()
        raise RuntimeError(f"measuring {', '.join(only)} failed: {reason}")
    return json.loads(done.stdout.splitlines()[-1])


def compare(library: str, task: str, physics: str, options: Options) -> tuple[dict[str, Any], list[float]]:
    """Return medians as the library comes and quieted, which take turns, and how many cores others used."""
    ways = {"as_it_comes": {}, "quieted": QUIETED[library]}
    samples: dict[str, list[dict[str, float]]] = {way: [] for way in ways}
    for _ in range(options.rounds):
        for way, variables in ways.items():
            samples[way].append(in_own_process(options, variables, library, task, physics))
    row: dict[str, Any] = {"variables": QUIETED[library]}
    for way, found in samples.items():
        medians = {key: statistics.median(one[key] for one in found) for key in ("policy_us", "step_us")}
        row[way] = {key: round(value, 1) for key, value in medians.items()}
    row["step_ratio"] = round(row["as_it_comes"]["step_us"] / row["quieted"]["step_us"], 2)
    return row, [one["others"] for found in samples.values() for one in found]


def main() -> None:
    """Measure, print a table, write the JSON."""
    options = tyro.cli(Options, prog="python -m benchmarks.policies")
    if options.only is not None:
        print(json.dumps(measure(*options.only, options)))
        return
    options.output.parent.mkdir(parents=True, exist_ok=True)
    libraries = [name for name in POLICIES if importlib.util.find_spec(name)]
    cases = [(name, family, how) for name in libraries for family in options.families for how in PHYSICS]
    rows: list[dict[str, Any]] = []
    others: list[float] = []
    with progress_bar("Stepping", "cases") as bar:
        for library, family, physics in bar.track(cases):
            row, busy = compare(library, FAMILIES[family], physics, options)
            rows.append({"library": library, "family": family, "physics": physics} | row)
            others += busy
    report = {
        "processor": processor(),
        "cores": num_cores(),
        "num_worlds": options.num_worlds,
        "rounds": options.rounds,
        "versions": {name: version(name) for name in (*PACKAGES, *libraries)},
        "cores_busy_with_others": disturbances(others),
        "rows": rows,
    }
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    table = Table("policy", "family", "physics", "step, as it comes [us]", "quieted [us]", "ratio")
    for row in rows:
        figures = row["as_it_comes"]["step_us"], row["quieted"]["step_us"], row["step_ratio"]
        table.add_row(row["library"], row["family"], row["physics"], *map(str, figures))
    Console().print(table)


if __name__ == "__main__":
    main()

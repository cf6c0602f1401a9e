"""MyoWarp on a GPU in one call: speed beside the bare engine, parity with the CPU, repeatability, memory.

    benchmarks/gpu.sh                                  on a bare machine
    python -m benchmarks.gpu --output out/gpu.json     in an environment with MyoWarp
    python -m benchmarks.gpu --device cpu --sizes 16 64

Every case (`gpu_cases.py`) runs in a process of its own, so that one which crashes, hangs or needs more
memory than there is takes no other with it. The JSON is written after each answer; what the time budget
leaves out is named there.
"""

import json
import multiprocessing
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import tyro
import warp as wp
from rich.console import Console
from rich.table import Table

from benchmarks.__main__ import PACKAGES
from benchmarks.gpu_cases import HAND, Options, agreement, first_line, rates, repeats
from benchmarks.machine import processor
from myowarp.definitions.task import TASKS
from myowarp.disk import in_place
from myowarp.engine.compile import quiet
from myowarp.progress import progress_bar
from myowarp.sim.build import resolve_device

ENGINE_SHARE = 0.9  # of the engine's rate that the environment is to keep
HAND_WORLDS, HAND_RATE = 8192, 150_000.0  # environment steps/s that the hand is to reach with so many worlds

KINDS = {"rates": rates, "agreement": agreement, "repeats": repeats}
ORDER = (
    ("rates", "parity"),
    ("agreement", "parity"),
    ("rates", "fast"),
    ("repeats", "parity"),
    ("agreement", "fast"),
    ("repeats", "fast"),
)
"""What is measured, the most telling first, in case that time runs out."""


@dataclass(frozen=True)
class Case:
    """What one process measures: a key of `KINDS`, a task and a physics preset."""

    kind: str
    task: str
    physics: str

    def __str__(self) -> str:
        return f"{self.kind} of {self.task}, {self.physics}"


def serve(case: Case, options: Options, answers: Any) -> None:
    """Measure a case and send its rows; the main function of a process."""
    try:
        for row in KINDS[case.kind](case.task, case.physics, options):
            answers.send(row)
    except (RuntimeError, MemoryError, ValueError) as error:
        answers.send({"failed": first_line(error)})
    answers.close()


def measure(case: Case, options: Options, deadline: float) -> Iterator[dict[str, Any]]:
    """Yield the rows of a case, measured in another process, which ends at the deadline."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=serve, args=(case, options, sender), daemon=True)
    process.start()
    sender.close()
    while True:
        if not receiver.poll(max(0.0, deadline - time.monotonic())):
            process.kill()
            yield {"stopped": "the time budget is used up"}
            break
        try:
            yield receiver.recv()
        except EOFError:
            break
    process.join()
    if process.exitcode and time.monotonic() < deadline:
        yield {"failed": f"the process ended with exit code {process.exitcode}"}


def installed(package: str) -> str | None:
    """Return the version of a package, None where there is none."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def facts(options: Options) -> dict[str, Any]:
    """Return where the figures are from."""
    with quiet():
        device = resolve_device(options.device)
    about: dict[str, Any] = {"alias": device.alias, "name": device.name}
    if device.is_cuda:
        about |= {
            "compute_capability": device.arch,
            "memory_bytes": device.total_memory,
            "driver": wp.get_cuda_driver_version(),
            "toolkit": wp.get_cuda_toolkit_version(),
            "mempool": wp.is_mempool_enabled(device),
        }
    return {
        "dry_run_on_cpu": device.is_cpu,
        "device": about,
        "processor": processor(),
        "cores": len(os.sched_getaffinity(0)),
        "load_before": round(os.getloadavg()[0], 2),
        "versions": {name: installed(name) for name in (*PACKAGES, "torch")},
        "budget_seconds": options.budget,
        "seconds_per_measurement": options.seconds,
        "rounds": options.rounds,
        "sizes": options.sizes,
        "tests": options.tests,
    }


def goals(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return what a GPU is to reach and what was reached; None where it was not measured."""
    rows = [
        (entry, row)
        for entry in entries
        for row in entry["rows"]
        if entry["kind"] == "rates" and row.get("num_worlds") == HAND_WORLDS and "failed" not in row
    ]
    shares = [row["ratio_to_engine"] for _, row in rows]
    hand = [row["env_steps_per_s"] for entry, row in rows if entry["task"] == HAND]
    return [
        {
            "goal": f"share of the engine's rate with {HAND_WORLDS} worlds, least of all cases",
            "required": ENGINE_SHARE,
            "got": min(shares, default=None),
        },
        {
            "goal": f"env steps/s of {HAND} with {HAND_WORLDS} worlds, best preset",
            "required": HAND_RATE,
            "got": max(hand, default=None),
        },
    ]


def run(options: Options) -> dict[str, Any]:
    """Measure case by case, the JSON always up to date; returns what it holds."""
    begin = time.monotonic()
    deadline = begin + options.budget
    cases = [Case(kind, task, physics) for kind, physics in ORDER for task in options.tasks]
    report: dict[str, Any] = {**facts(options), "seconds": 0.0, "goals": [], "left_out": [], "cases": []}
    options.output.parent.mkdir(parents=True, exist_ok=True)

    def write() -> None:
        report["seconds"] = round(time.monotonic() - begin, 1)
        report["goals"] = goals(report["cases"])
        with in_place(options.output) as scratch:
            scratch.write_text(json.dumps(report, indent=1) + "\n")

    with progress_bar("GPU", "cases, now {task.fields[now]}", Console(stderr=True)) as bar:
        task = bar.add_task("", total=len(cases), now="")
        for case in cases:
            bar.update(task, now=str(case))
            if time.monotonic() >= deadline:
                report["left_out"].append(str(case))
            else:
                started = time.monotonic()
                entry: dict[str, Any] = {**vars(case), "seconds": 0.0, "rows": []}
                report["cases"].append(entry)
                for row in measure(case, options, deadline):
                    entry["rows"].append(row)
                    entry["seconds"] = round(time.monotonic() - started, 1)
                    write()
            bar.advance(task)
    write()
    return report


def print_tables(report: dict[str, Any], console: Console) -> None:
    """Print rates, and everything that went wrong."""
    table = Table("task", "preset", "worlds", "env steps/s", "engine steps/s", "ratio", "kB per world")
    for entry in report["cases"]:
        for row in entry["rows"]:
            if what := row.get("failed") or row.get("stopped"):
                console.print(
                    f"[yellow]{entry['kind']} of {entry['task']}, {entry['physics']}: {what}[/yellow]"
                )
            elif entry["kind"] == "rates":
                numbers = (row["num_worlds"], row["env_steps_per_s"], row["engine_steps_per_s"])
                cells = (f"{number:,.0f}" for number in numbers)
                memory = f"{row['memory_bytes_per_world'] / 1e3:.1f}"
                table.add_row(
                    entry["task"], entry["physics"], *cells, f"{row['ratio_to_engine']:.2f}", memory
                )
    console.print(table)
    for name in report["left_out"]:
        console.print(f"[yellow]left out: {name}[/yellow]")


def main() -> None:
    """Measure, write the JSON, print tables."""
    options = tyro.cli(Options, prog="python -m benchmarks.gpu")
    for task in options.tasks:
        TASKS[task]
    print_tables(run(options), Console())


if __name__ == "__main__":
    main()

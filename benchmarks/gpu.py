"""MyoWarp on a GPU in one call: agreement with the CPU, speed beside the bare engine and this machine's CPU.

    make gpu-kit && make gpu-run                       on a machine without internet, from one that has it
    python -m benchmarks.gpu --output out/gpu.json     in an environment with MyoWarp
    python -m benchmarks.gpu --device cpu --sizes 16

Every case (`gpu_cases.py`) runs in a process of its own, so that one which crashes, hangs or needs more
memory than there is takes no other with it. The JSON is written after each answer; what the time budget
leaves out is named there.
"""

import json
import multiprocessing
import os
import time
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import tyro
import warp as wp
from rich.console import Console
from rich.table import Table

from benchmarks.__main__ import PACKAGES
from benchmarks.cuda_step import CASES, WHOLE
from benchmarks.gpu_cases import (
    Case,
    Options,
    agreement,
    bandwidth,
    cores,
    first_line,
    kernels,
    rates,
    record,
    repeats,
    training,
    unroll,
    whole_step,
)
from benchmarks.machine import processor
from myowarp.definitions.task import TASKS
from myowarp.disk import in_place
from myowarp.engine.compile import quiet
from myowarp.progress import progress_bar
from myowarp.sim.build import resolve_device

TIMES = 2.0  # the rate of the engine on the free hand, and of the cores elsewhere, that is to be reached
HAND, KEY, WALK = "myoHandPoseRandom-v0", "myoHandKeyTurnRandom-v0", "myoLegWalk-v0"
CORES_WORLDS = 1024  # at which all cores of a CPU are as fast as they get
TRAINED = {"myoHandKeyTurnFixed-v0": 1024, WALK: 4096}
"""Tasks to train, with numbers of worlds."""

KINDS = {
    "bandwidth": bandwidth,
    "agreement": agreement,
    "rates": rates,
    "cores": cores,
    "kernels": kernels,
    "whole_step": whole_step,
    "repeats": repeats,
    "training": training,
}


def plan(options: Options) -> list[Case]:
    """Return what is measured, the most telling first, in case that time runs out."""
    asked = [(task, physics) for task, physics in CASES if task in options.tasks]
    least, most = options.sizes[0], options.sizes[-2:][0]
    cases = [Case("bandwidth"), *(Case("agreement", *one, options.checked_worlds) for one in asked)]
    cases += [Case("rates", *one, number) for number in options.sizes for one in asked]
    cases += [Case("cores", *one, min(CORES_WORLDS, most)) for one in asked]
    cases += [Case("kernels", *one, most) for one in asked]
    cases += [Case("whole_step", *WHOLE, number) for number in options.sizes if WHOLE in asked]
    cases += [Case("repeats", *one, options.checked_worlds) for one in asked]
    if options.training > 0.0:
        worlds = {task: number if len(options.sizes) > 1 else least for task, number in TRAINED.items()}
        cases += [Case("training", task, num_worlds=number) for task, number in worlds.items()]
    return cases


def serve(case: Case, options: Options, answers: Any) -> None:
    """Measure a case and send its rows; the main function of a process."""
    if options.unrolled:
        unroll()
    try:
        for row in KINDS[case.kind](case, options):
            answers.send(row)
    except (RuntimeError, MemoryError, ValueError) as error:
        answers.send({"failed": first_line(error)})
    answers.close()


def measure(case: Case, options: Options, deadline: float) -> Iterator[dict[str, Any]]:
    """Yield the rows of a case, measured in another process, which ends at the deadline."""
    # Forked from a process that has imported all, and has not started CUDA: seconds saved in each case.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["benchmarks.gpu_cases"])
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
    }


def goals(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return what a GPU is to reach, and what it reached at its best size; None: not measured."""

    def rates_of(kind: str, task: str, name: str) -> list[float]:
        chosen = (entry for entry in entries if (entry["kind"], entry["task"]) == (kind, task))
        return [row[name] for entry in chosen for row in entry["rows"] if name in row]

    found = [
        {
            "goal": f"times the engine's rate of {HAND}",
            "required": TIMES,
            "got": max(rates_of("rates", HAND, "ratio_to_engine"), default=None),
        }
    ]
    for task in (KEY, WALK):
        ours, theirs = (rates_of(kind, task, "env_steps_per_s") for kind in ("rates", "cores"))
        ratio = round(max(ours) / max(theirs), 3) if ours and theirs else None
        found.append({"goal": f"times the rate of {task} on all cores", "required": TIMES, "got": ratio})
    return found


def run(options: Options) -> dict[str, Any]:
    """Measure case by case, the JSON always up to date; returns what it holds."""
    begin = time.monotonic()
    deadline = begin + options.budget
    cases, failed = plan(options), set[tuple[str, str]]()
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
            if time.monotonic() >= deadline or (case.kind, case.task) in failed:  # a larger size fails, too
                report["left_out"].append(str(case))
            else:
                started = time.monotonic()
                entry: dict[str, Any] = {**vars(case), "seconds": 0.0, "rows": []}
                report["cases"].append(entry)
                for row in measure(case, options, deadline):
                    entry["rows"].append(row)
                    if "failed" in row:
                        failed.add((case.kind, case.task))
                    entry["seconds"] = round(time.monotonic() - started, 1)
                    write()
            bar.advance(task)
    write()
    return report


def print_tables(report: dict[str, Any], console: Console) -> None:
    """Print rates, goals, and everything that went wrong."""
    table = Table("task", "preset", "worlds", "env steps/s", "engine steps/s", "ratio")
    for entry in report["cases"]:
        name = str(Case(*(entry[field] for field in ("kind", "task", "physics", "num_worlds"))))
        for row in entry["rows"]:
            if what := row.get("failed") or row.get("stopped"):
                console.print(f"[yellow]{name}: {what}[/yellow]")
            elif not all(row.get("agrees", {}).values()):
                console.print(f"[red]{name}: it does not agree with the CPU[/red]")
            elif entry["kind"] == "rates":
                numbers = (entry["num_worlds"], row["env_steps_per_s"], row["engine_steps_per_s"])
                cells = (f"{number:,.0f}" for number in numbers)
                table.add_row(entry["task"], entry["physics"], *cells, f"{row['ratio_to_engine']:.2f}")
    console.print(table)
    for goal in report["goals"]:
        console.print(f"{goal['goal']}: {goal['got']}, required {goal['required']}")
    for name in report["left_out"]:
        console.print(f"[yellow]left out: {name}[/yellow]")


def main() -> None:
    """Measure, write the JSON, print tables; or record what the CPU makes of the tasks."""
    options = tyro.cli(Options, prog="python -m benchmarks.gpu")
    for task in options.tasks:
        TASKS[task]
    if options.record is not None:
        record([case for case in plan(options) if case.kind == "agreement"], options, options.record)
        return
    print_tables(run(options), Console())


if __name__ == "__main__":
    main()

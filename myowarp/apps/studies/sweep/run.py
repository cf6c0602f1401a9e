"""The work of `myowarp sweep`: send missing runs of a study over a cluster, and gather their results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live

from myowarp.apps.policies.baselines import baseline_folder, baseline_tasks
from myowarp.apps.studies.cluster import connected, each
from myowarp.apps.studies.sweep import report, work
from myowarp.apps.studies.sweep.study import Run, read_study
from myowarp.definitions.setup import OPTIONS
from myowarp.definitions.task import TASKS
from myowarp.disk import check_folder, locked, make_folder
from myowarp.extras import check_installed
from myowarp.process import num_cores
from myowarp.tasks.outside import find_task


def run(study: Path, output: Path, address: str | None, cpus: int, gpus: float, dry: bool) -> None:
    """Do what is missing of a study, or say how much that is.

    Raises:
        ValueError: The study is impossible or there is no such cluster; nothing was started.
        ImportError: A package is not installed.
        RuntimeError: Runs failed; all others are done.
        OSError: The output cannot be written.
    """
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    check_folder(output)
    runs = read_study(study, output)
    results = {run.name: found for run in runs if (found := work.finished(run, output)) is not None}
    if dry:
        for line in forecast(runs, results, cpus):
            print(line)
        return
    check_installed("a sweep", "ray", "ray")
    make_folder(output)
    output = output.resolve()
    failures: dict[str, str] = {}
    with locked(output / work.LOCK, wait=False):
        missing = [run for run in runs if run.name not in results]
        console.print(f"{len(runs)} runs, {len(runs) - len(missing)} done before, into {output}")
        if missing:
            with (
                connected(address, output),
                Live(console=console, auto_refresh=False, transient=True) as live,
            ):
                pieces = [(run.name, (run, output)) for run in missing]
                for name, result, why in each(work.do, pieces, folder=output, cpus=cpus, gpus=gpus):
                    if why:
                        failures[name] = why
                    else:
                        results[name] = result
                    if console.is_terminal:
                        live.update(report.live_table(runs, results, failures), refresh=True)
                    else:
                        console.print(
                            f"{len(results)} of {len(runs)} done: {name}{' failed: ' if why else ''}{why}"
                        )
        paths = report.write(output, runs, results)
    Console(highlight=False).print(report.final_table(report.summary(runs, results)))
    for path in paths:
        console.print(f"Saved {path}")
    if failures:
        name, why = next(iter(failures.items()))
        raise RuntimeError(
            f"{len(failures)} of {len(runs)} runs failed, such as {name!r}: {why}; the same command tries "
            "them again"
        )


def forecast(runs: list[Run], results: dict[str, dict[str, Any]], cpus: int) -> list[str]:
    """Return how many runs there are, and how long those that are missing take.

    A run takes as long as finished runs of its task in this folder; else, for training, as many samples as it
    may take at the rate at which the baseline of the task was trained.
    """
    missing = [run for run in runs if run.name not in results]
    known = {run.name: _seconds(run, runs, results) for run in missing}
    hours = sum(seconds for seconds in known.values() if seconds is not None) / 3600.0
    at_once = max(1, num_cores() // cpus)
    lines = [f"{len(runs)} runs: {len(runs) - len(missing)} done, {len(missing)} to do"]
    if hours:
        lines.append(
            f"At most {hours:.2g} h one by one, {hours / at_once:.2g} h {at_once} at once (this machine)"
        )
    if unknown := sorted({run.task for run in missing if known[run.name] is None}):
        lines.append(f"Not known how long: {', '.join(unknown)}; no run of these is done")
    return lines


def _seconds(run: Run, runs: list[Run], results: dict[str, dict[str, Any]]) -> float | None:
    """Return how long a run takes; None where nothing like it was done."""
    done = [
        results[other.name]["seconds"] for other in runs if other.task == run.task and other.name in results
    ]
    if done:
        return sum(done) / len(done)
    if run.kind != "train":
        return None
    from myowarp.apps.policies.checkpoint import MANIFEST
    from myowarp.apps.train.settings import choose, preset_algorithm

    spec = TASKS[find_task(run.task).task]
    if spec.key not in baseline_tasks():
        return None
    manifest = json.loads((baseline_folder(spec.key) / MANIFEST).read_text())
    options = {n: value for n, value in run.options.items() if n != "algorithm" and n not in OPTIONS}
    algorithm = run.options.get("algorithm") or preset_algorithm(spec.name)
    settings = choose(spec.name, algorithm, options)
    return float(settings.samples * manifest["clock"]["total"] / manifest["samples"])

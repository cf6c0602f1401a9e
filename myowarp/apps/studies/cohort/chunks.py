"""A cohort in chunks of patients over a Ray cluster: a partitioned Parquet dataset, each patient once.

    out/cohort/settings.json             what the results depend on
    out/cohort/results/part-00000.parquet
    out/cohort/summary/part-00000.parquet    written last: its chunk is done

A patient's rows are those of the same cohort in one process, bit for bit: they depend on the patient and on
the seed alone. No process holds the results of more than one chunk.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console

from myowarp.apps.studies.cluster import connected, each
from myowarp.apps.studies.cohort.plan import plan_cohort
from myowarp.apps.studies.cohort.run import run_plan
from myowarp.apps.studies.parts import LOCK, RESULTS, SUMMARY, agree, part, remove_damaged
from myowarp.definitions.setup import DEFAULTS
from myowarp.disk import check_folder, files_digest, in_place, locked, make_folder
from myowarp.extras import check_installed
from myowarp.progress import progress_bar
from myowarp.sim.patient_table import PATIENT, Population

TEXTS = {"patient": "string", "fault": "string"}  # columns that would have another type in each part


def run(
    table: Path, output: Path, console: Console, address: str | None, chunk: int, cpus: int, **settings: Any
) -> None:
    """Do what is missing of a cohort, chunk by chunk.

    Args:
        table: Patient table.
        output: Folder of the dataset, which every node must see.
        console: Where progress is shown.
        address: Head of a cluster; None: this machine alone.
        chunk: Patients that are simulated together.
        cpus: Cores of each chunk.
        **settings: As in `myowarp.apps.studies.cohort.run.run_cohort`.

    Raises:
        ValueError: An argument is wrong, or the folder holds another cohort; nothing was started.
        ImportError: A package is not installed.
        RuntimeError: Chunks failed; all others are done.
        OSError: The output cannot be written.
    """
    check_folder(output)
    population = plan_cohort(table, **settings).population
    check_installed("a cohort in chunks", "ray", "ray")
    total = len(population.patients)
    starts = range(0, total, chunk)
    for folder in (RESULTS, SUMMARY):
        make_folder(output / folder)
    output = output.resolve()
    with locked(output / LOCK, wait=False):
        rest = {name: value for name, value in settings.items() if name != "what"}
        recorded = {"task": str(settings["what"].task), **settings["what"].over(DEFAULTS).plain(), **rest}
        agree(
            output, "cohort", {"table": files_digest([table]), "patients": total, "chunk": chunk, **recorded}
        )
        own = (population.patients[begin : begin + chunk] for begin in starts)
        keys = ({PATIENT: [name for name in names for _ in range(settings["trials"])]} for names in own)
        if damaged := remove_damaged(output, keys):
            console.print(f"{damaged} damaged chunks in {output} are simulated again", style="yellow")
        missing = [i for i in range(len(starts)) if not part(output, SUMMARY, i).exists()]
        failures: dict[str, str] = {}
        if missing:
            with connected(address, output), progress_bar("Simulating", "chunks", console) as bar:
                task = bar.add_task("", total=len(starts), completed=len(starts) - len(missing))
                pieces = _pieces(population, chunk, missing, output, settings)
                for name, _, why in each(simulate, pieces, folder=output, cpus=cpus):
                    if why:
                        failures[name] = why
                    else:
                        bar.advance(task)
    if failures:
        name, why = next(iter(failures.items()))
        failed = f"{len(failures)} of {len(starts)} chunks failed, such as {name}: {why}"
        raise RuntimeError(f"{failed}; the same command does them again")
    rows = _rows(output, total * settings["trials"])
    console.print(
        f"Saved {rows:,} rows of {total:,} patients in {output / SUMMARY}, samples in {output / RESULTS}"
    )


def _pieces(
    population: Population, chunk: int, missing: list[int], output: Path, settings: dict[str, Any]
) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Yield the chunks that are missing, one at a time."""
    for index in missing:
        own = slice(index * chunk, (index + 1) * chunk)
        columns: dict[str, list[Any]] = {PATIENT: list(population.patients[own])}
        for name, entries in population.entries.items():
            columns[name] = ["+".join(e) if isinstance(e, tuple) else e for e in entries[own]]
        yield f"chunk {index}", (columns, output, index, settings)


def simulate(columns: dict[str, list[Any]], output: Path, index: int, settings: dict[str, Any]) -> None:
    """Simulate a chunk and write its parts; on a node."""
    import pandas as pd

    if part(output, SUMMARY, index).exists():
        return
    result = run_plan(plan_cohort(pd.DataFrame(columns), **settings), Console(quiet=True))
    for folder, frame in ((RESULTS, result.samples), (SUMMARY, result.summary)):
        texts = {name: kind for name, kind in TEXTS.items() if name in frame}
        with in_place(part(output, folder, index)) as scratch:
            frame.astype(texts).to_parquet(scratch, index=False)


def _rows(output: Path, expected: int) -> int:
    """Return the number of rows of the summary.

    Raises:
        RuntimeError: There are more or fewer than patients and trials.
    """
    from pyarrow import dataset

    rows = int(dataset.dataset(output / SUMMARY).count_rows())
    if rows != expected:
        raise RuntimeError(
            f"dataset {str(output / SUMMARY)!r} must have {expected} rows, got {rows}; delete it"
        )
    return rows

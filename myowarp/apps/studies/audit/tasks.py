"""Many audits: which ids, what is written on the way, and the table at the end."""

import dataclasses
import importlib.util
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Column, Table

from myowarp.apps.studies.audit.figures import FIGURES, Figure, changes, findings
from myowarp.apps.studies.audit.measure import Audit, audit
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.disk import in_place, plain
from myowarp.extras import to_install
from myowarp.progress import progress_bar
from myowarp.tasks.paper import grid
from myowarp.tasks.setups import complete

GUTTER = 2  # characters between columns: a line and a space
NO_PAGE = f"No page: it needs matplotlib; run {to_install('plot')}"


@dataclass(frozen=True)
class Job:
    """An id to audit.

    Attributes:
        id: Gymnasium id.
        setup: What it stands for.
    """

    id: str
    setup: Setup


FILES = "audit.json", "index.html"
QUANTILES = (0, 5, 25, 50, 75, 95, 100)  # %, of returns, in the JSON
"""Files that `audit_all` writes into a folder."""


def find_jobs(names: Iterable[str], paper: bool, setup: Setup = Setup()) -> list[Job]:
    """Return what to audit, versions of a task side by side.

    Args:
        names: Ids with or without "MyoWarp/"; none: every task in `TASKS`.
        paper: Every id of the paper's grid instead.
        setup: What all have in common.

    Raises:
        ValueError: An id is unknown, names came with `paper`, or an id cannot have what all shall have.
    """
    names = list(dict.fromkeys(name.removeprefix("MyoWarp/") for name in names))
    if paper and names:
        raise ValueError(f"--paper audits the whole grid; leave it or {names[0]!r} away")
    if paper:
        names = [row.id.removeprefix("MyoWarp/") for row in grid()]
    chosen = []
    for name in names or TASKS:
        whole = complete(dataclasses.replace(setup, task=name))
        chosen.append(Job(whole.spec.env_id if ":" in name else f"MyoWarp/{name}", whole))
    if paper:
        return chosen
    first = {name: i for i, name in reversed(list(enumerate(job.setup.spec.name for job in chosen)))}
    return sorted(chosen, key=lambda job: (first[job.setup.spec.name], job.setup.spec.version))


def audit_all(
    jobs: list[Job],
    folder: Path,
    console: Console,
    measure: Callable[..., Audit] = audit,
    **options: object,
) -> list[Audit]:
    """Audit ids one after the other; after each the folder holds all audits so far.

    Args:
        jobs: What to audit.
        folder: Where `audit.json` and, with matplotlib, `index.html` go; it exists.
        console: Where the progress bar is drawn.
        measure: What measures one task.
        options: What else `measure` takes.

    Returns:
        The audits, in order.

    Raises:
        OSError: A file cannot be written.
        ValueError: As `audit` raises.
    """
    page = None
    if importlib.util.find_spec("matplotlib") is None:
        console.print(NO_PAGE, style="yellow", markup=False)
    else:
        from myowarp.apps.studies.audit.page import Page

        page = Page()
    done: list[Audit] = []
    with progress_bar("Auditing", "ids  {task.fields[stage]}", console) as bar:
        task = bar.add_task("", total=len(jobs), stage="")
        for index, job in enumerate(jobs):

            def tick(share: float, stage: str, index: int = index, job: Job = job) -> None:
                where = f"{job.id.removeprefix('MyoWarp/')}: {stage}"
                bar.update(task, completed=index + share, stage=where)

            found = measure(job.setup, tick=tick, **options)
            done.append(found if job.id == found.id else found.named(job.id))
            with in_place(folder / "audit.json") as scratch:
                scratch.write_text(as_json(done))
            if page is not None:
                page.add(done[-1])
                with in_place(folder / "index.html") as scratch:
                    scratch.write_text(page.html(), encoding="utf-8")
        bar.update(task, completed=len(jobs), stage="done")
    files = "audit.json" if page is None else "audit.json and index.html"
    console.print(f"Saved {files} in {folder}", markup=False)
    return done


def upstreams(audits: Iterable[Audit]) -> dict[str, Audit]:
    """Return the audits of upstream's versions by id."""
    return {found.id: found for found in audits if not found.corrected}


def as_json(audits: list[Audit]) -> str:
    """Return audits as JSON, a line an id: their fields, findings, and what differs from upstream's version.

    Returns of episodes become `QUANTILES` of them, `failures` the steps in which one failed, and columns the
    ranges of their blocks. A number that is not finite becomes null.
    """
    known = upstreams(audits)
    rows = []
    for found in audits:
        changed = {
            figure.head: [there, here] for figure, there, here in changes(found, known.get(found.upstream))
        }
        extra = {"corrected": found.corrected, "findings": findings(found), "changed": changed}
        rows.append(json.dumps(plain(_shorter(dataclasses.asdict(found)) | extra), allow_nan=False))
    return '{"audits": [\n' + ",\n".join(rows) + "\n]}\n"


def _shorter(row: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of an audit with summaries in place of long lists."""
    scores = {}
    for policy, score in row["scores"].items():
        returns = np.percentile(score["returns"], QUANTILES).tolist() if score["returns"] else []
        failures = {step: count for step, count in enumerate(score["failures"], 1) if count}
        scores[policy] = score | {
            "returns": dict(zip(QUANTILES, returns, strict=False)),
            "failures": failures,
        }
    blocks: dict[str, dict[str, Any]] = {}
    for column in row["columns"]:
        block = blocks.setdefault(
            column["name"].rpartition("[")[0], {"unit": column["unit"], "low": [], "high": []}
        )
        for end in ("low", "high"):
            block[end].append(float(f"{column[end]:.4g}"))
    return row | {"scores": scores, "columns": blocks}


def print_table(audits: list[Audit], console: Console) -> None:
    """Print a row for each id, versions of a task together; in parts where one line has no room for all."""
    known = upstreams(audits)
    ids = [found.id.removeprefix("MyoWarp/") for found in audits]
    parts: list[dict[str, list[str]]] = []
    room = 0
    for figure in FIGURES:
        head = figure.head.replace(", %", " %").replace(" ", "\n")
        texts = [figure.text(found) for found in audits]
        width = max(map(len, [*head.split("\n"), *texts])) + GUTTER
        if width > room:
            parts.append({})
            room = console.width - max(map(len, ids)) - GUTTER - 1
        room -= width
        parts[-1][head] = [_styled(figure, found, known.get(found.upstream)) for found in audits]
    for part in parts:
        table = Table(Column("MyoWarp/...", no_wrap=True), padding=(0, 0, 0, 1))
        for head in part:
            table.add_column(head, justify="right", no_wrap=True)
        for index, found in enumerate(audits):
            last = index + 1 == len(audits) or audits[index + 1].name != found.name
            table.add_row(ids[index], *(cells[index] for cells in part.values()), end_section=last)
        console.print(table)
    console.print("red: a finding; bold: a corrected version differs from the one with MyoSuite's semantics")


def _styled(figure: Figure, found: Audit, upstream: Audit | None) -> str:
    """Return a cell of the table."""
    differs = any(other is figure for other, _, _ in changes(found, upstream))
    style = " ".join(name for name, on in (("bold", differs), ("red", figure.is_bad(found))) if on)
    text = figure.text(found)
    return f"[{style}]{text}[/]" if style else text

"""The command `myowarp tasks`: every id, with what the task asks for."""

import dataclasses
import json
import sys
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.progress import track

from myowarp.definitions.registry import check_choice
from myowarp.definitions.task import TASKS
from myowarp.tasks.paper import grid
from myowarp.tasks.variants import PREFIXES, variants

UNBROKEN = 10_000
"""Width of a line that goes to a file or to another command: ids and sentences stay whole."""


@dataclass
class Tasks:
    """List the tasks with their sizes.

    Versions of a task have one name; a later version corrects the one before, and `myowarp describe ID` says
    what and why.
    """

    family: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """Only this family, such as pose or reach."""
    paper: bool = False
    """List the grid of the MyoSuite paper instead: task, reset and condition of each id."""
    json: bool = False
    """Print JSON instead of text."""

    def __call__(self) -> None:
        """Print the list."""
        if self.family is not None:
            families = sorted({TASKS[key].family for key in TASKS})
            check_choice("family", self.family, families)
        rows = [dataclasses.asdict(cell) for cell in grid()] if self.paper else list(_rows(self.family))
        if self.json:
            print(json.dumps(rows, indent=1))
            return
        width = Console().width if sys.stdout.isatty() else UNBROKEN
        print("\n".join(_of_paper(rows) if self.paper else _of_tasks(rows, width)))


def _rows(family: str | None) -> Iterable[dict[str, Any]]:
    """Return what is said of each task."""
    from myowarp.sim.build import sizes_of

    chosen = [TASKS[key] for key in TASKS if family in (None, TASKS[key].family)]
    sizes: dict[tuple[Any, ...], tuple[int, ...]] = {}
    for spec in track(chosen, "Building bodies", console=Console(stderr=True), transient=True):
        if spec.scene_key not in sizes:
            sizes[spec.scene_key] = sizes_of(spec)
        nq, nv, na, nu = sizes[spec.scene_key]
        yield {
            "id": spec.env_id,
            "family": spec.family,
            "body": spec.body,
            "obs": sum(column.size for column in spec.columns(nq, nv, na)),
            "act": nu,
            "muscles": na,
            "horizon": spec.horizon,
            "control_dt": spec.control_dt,
            "summary": spec.summary,
            "doc": spec.doc,
        }


def _of_tasks(rows: list[dict[str, Any]], width: int) -> Iterable[str]:
    """Return the list as lines: tasks of the same sizes under a heading that has them, versions together."""
    yield (
        f"{len(rows)} tasks; {len(variants())} ids with variants (below) and the paper's grid (--paper)\n"
        "In Gymnasium, ids begin with MyoWarp/"
    )
    names = [row["id"].removeprefix("MyoWarp/") for row in rows]
    first = {name.rpartition("-v")[0]: i for i, name in reversed(list(enumerate(names)))}
    listed = sorted(
        zip(names, rows, strict=True),
        key=lambda pair: (pair[1]["family"], first[pair[0].rpartition("-v")[0]], pair[0]),
    )
    indent = max(map(len, names)) + 4
    sizes = ("family", "body", "obs", "act", "horizon", "control_dt")
    for size, group in groupby(listed, lambda pair: [pair[1][key] for key in sizes]):
        family, body, obs, act, horizon, control_dt = size
        yield ""
        heading = f"{family}, {body}: {obs} observations, {act} actions, {horizon} steps of {control_dt:g} s"
        yield from textwrap.wrap(heading, width, subsequent_indent="  ")
        before = summary = ""
        for name, row in group:
            text = row["summary"]
            if before.rpartition("-v")[0] == name.rpartition("-v")[0]:
                text = "The same, corrected." if text == summary else f"Corrected: {text}"
            yield from textwrap.wrap(
                f"  {name}".ljust(indent) + text,
                width,
                subsequent_indent=" " * indent,
                break_on_hyphens=False,
            )
            before, summary = name, row["summary"]
    yield ""
    for prefix, (condition, beginning) in PREFIXES.items():
        varied = prefix + beginning.removeprefix("myo")
        yield f"{varied}...: every {beginning}... with the condition {condition}"


def _of_paper(rows: list[dict[str, Any]]) -> Iterable[str]:
    """Return the paper's grid as lines."""
    yield f"{len(rows)} tasks; their ids in Gymnasium begin with MyoWarp/"
    table = [
        (row["id"].removeprefix("MyoWarp/"), row["task"], row["reset"], row["condition"])
        for row in [{"id": "id", "task": "task", "reset": "reset", "condition": "condition"}, *rows]
    ]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for line in table:
        yield " ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()

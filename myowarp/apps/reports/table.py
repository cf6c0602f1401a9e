"""Tables: numbers as people read them; Markdown, CSV, the terminal."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Column, Table

from myowarp.disk import in_place


def number(value: float | None) -> str:
    """Return a number as a table shows it, with three digits."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def markdown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (heads, ("---",) * len(heads), *rows))


def terminal(heads: Sequence[str | Column], rows: Iterable[Sequence[str]]) -> Table:
    """Return a table for the terminal; without heads it has no line for them."""
    table = Table(*heads, show_header=bool(heads))
    for row in rows:
        table.add_row(*map(escape, row))  # rich would take [m/s] for a tag
    return table


def save_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows with all names that occur in them as columns, whole or not at all.

    Raises:
        OSError: The file cannot be written.
    """
    names = list(dict.fromkeys(name for row in rows for name in row))
    with in_place(path) as scratch, scratch.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, names, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def read_numbers(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a CSV that have numbers; cells without one are NaN.

    Raises:
        OSError: It cannot be read.
    """
    with path.open(encoding="utf-8-sig", newline="") as file:
        rows = list(csv.DictReader(file, restval=""))
    names = [name for name in rows[0] if name is not None] if rows else []
    columns = {name: np.array([_value(row[name]) for row in rows]) for name in names}
    return {name: values for name, values in columns.items() if not np.isnan(values).all()}


def _value(cell: Any) -> float:
    """Return a cell as a number, NaN if it is none."""
    try:
        return float(cell)
    except (TypeError, ValueError):
        return math.nan

"""Patient tables: read, and checked entry by entry before anything is simulated."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from myowarp.definitions.condition import resolve
from myowarp.definitions.muscle import muscle_names
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TaskSpec
from myowarp.disk import csv_rows
from myowarp.extras import check_installed
from myowarp.process import warn_once
from myowarp.sim.build import oracle_model
from myowarp.sim.patient_columns import COLUMNS, EXCLUSIVE, TornMuscles, acting_from, conditions_of, is_course

if TYPE_CHECKING:
    import pandas as pd

PATIENT = "patient"
"""Column of the patients' names; without it they are called 1, 2, 3..."""

TABLES = (".csv", ".parquet")
INVISIBLE = ("Cc", "Cf", "Cs", "Zl", "Zp")  # categories of Unicode: they change how other text is shown
JOINERS = "\u200c\u200d"  # of Persian and Indic names


@dataclass(frozen=True)
class Population:
    """A checked patient table.

    Attributes:
        patients: Names, all different.
        entries: Entries of all patients by column name, in the table's order: numbers, or names of muscles.
    """

    patients: tuple[str, ...]
    entries: dict[str, list[Any]]

    def each(self, worlds: int, flag: str) -> int:
        """Return how many of some worlds each patient has.

        Raises:
            ValueError: They cannot be divided; the message names the flag that says how many there are.
        """
        each, rest = divmod(worlds, number := len(self.patients))
        if rest:
            raise ValueError(f"{flag} must be a multiple of the {number} patients of --cohort, got {worlds}")
        return each

    def joined(self, setup: Setup, each: int) -> Setup:
        """Return a setup with the patients' conditions beside its own, for so many worlds of each.

        Raises:
            ValueError: The body cannot have a condition, or two exclude each other.
        """
        patients = conditions_of(self.entries, setup.spec, each)
        conditions = (*(setup.conditions or ()), *patients)
        resolve(conditions, setup.spec)
        self._say_late((setup.horizon or setup.spec.horizon) * setup.spec.control_dt)
        return replace(setup, conditions=conditions)

    def _say_late(self, end: float) -> None:
        """Say which entries change nothing, as they act only after the end of an episode [s]."""
        for name, entries in self.entries.items():
            late = [i for i, begin in enumerate(acting_from(self.entries, name)) if begin >= end]
            if late:
                warn_once(
                    f"cohort column {name!r} changes nothing in {len(late)} of {len(entries)} patients: an "
                    f"episode ends at {end:g} s, {_row(late[0], self.patients)} has {entries[late[0]]}"
                )


def population_of(table: str | Path | pd.DataFrame, spec: TaskSpec) -> Population:
    """Return the patients of a table, checked against the muscles of a task.

    Raises:
        ValueError: An entry is wrong, or the body has no muscles.
        ImportError: Parquet without pandas and pyarrow.
    """
    model = oracle_model(spec)
    if not model.na:
        raise ValueError(f"a cohort is about muscles; the body of task {spec.key!r} has none")
    return read_population(table, tuple(muscle_names(model)))


def read_population(table: str | Path | pd.DataFrame, muscles: Sequence[str]) -> Population:
    """Read and check a patient table.

    Args:
        table: A .csv file (comma, semicolon or tab; names of columns in the first line), a .parquet file, or
            a DataFrame; one row per patient.
        muscles: Names of the body's muscles.

    Raises:
        ValueError: The file cannot be read, is empty, or has an unknown column or a wrong entry; the message
            names row and column.
        ImportError: Parquet without pandas and pyarrow.
    """
    source = Path(table) if isinstance(table, (str, Path)) else None
    header, rows = _frame(table) if source is None else read_table(source)
    where = f"cohort table {str(source)!r}" if source is not None else "cohort table"
    if not rows:
        raise ValueError(f"{where} has no rows; it needs one for every patient")
    _check_header(header)
    patients = _patients(header, rows)
    entries: dict[str, list[Any]] = {}
    for index, name in enumerate(header):
        if name != PATIENT:
            cells = [row[index] for row in rows]
            if (owner := COLUMNS[name].of) in header:
                owners = [row[header.index(owner)] for row in rows]
                pairs = zip(cells, owners, strict=True)
                cells = [0.0 if _is_missing(cell) and _is_missing(own) else cell for cell, own in pairs]
            entries[name] = [_entry(name, cell, i, patients, muscles) for i, cell in enumerate(cells)]
    for one, other in EXCLUSIVE:
        if one in entries and other in entries:
            for i, both in enumerate(zip(entries[one], entries[other], strict=True)):
                if all(both):
                    raise ValueError(
                        f"cohort {_row(i, patients)} has both {one} and {other}; set one of them to 0"
                    )
    return Population(patients, entries)


def read_table(path: Path, what: str = "cohort") -> tuple[list[str], list[list[Any]]]:
    """Return header and rows of a .csv (comma, semicolon or tab) or .parquet file.

    Args:
        path: The file.
        what: Of what it is the table, for messages.

    Raises:
        ValueError: It cannot be read.
        ImportError: Parquet without pandas and pyarrow.
    """
    if path.suffix.lower() not in TABLES:
        raise ValueError(f"{what} table {str(path)!r} must end in {' or '.join(TABLES)}")
    if not path.is_file():
        raise ValueError(f"{what} table {str(path)!r} does not exist")
    if path.suffix.lower() == ".csv":
        return _csv(path, what)
    for package in ("pandas", "pyarrow"):
        check_installed(repr(str(path)), package, "cohort")
    import pandas as pd
    import pyarrow as pa

    try:
        return _frame(pd.read_parquet(path))
    except pa.ArrowException as error:
        raise ValueError(f"{what} table {str(path)!r} is no Parquet file ({error})") from error


def _csv(path: Path, what: str) -> tuple[list[str], list[list[Any]]]:
    """Return header and rows of a CSV file."""
    lines = csv_rows(path, f"{what} table {str(path)!r}")
    if not lines:
        return [], []
    header = [name.strip() for name in lines[0]]
    for i, line in enumerate(lines[1:]):
        if len(line) != len(header):
            raise ValueError(
                f"{what} row {i + 1} has {len(line)} entries for {len(header)} columns: {line!r}"
            )
    return header, lines[1:]


def _frame(table: Any) -> tuple[list[str], list[list[Any]]]:
    """Return header and rows of a DataFrame."""
    if not hasattr(table, "itertuples"):
        raise ValueError(f"a cohort table is a path or a DataFrame, got {type(table).__name__}")
    if PATIENT in table.index.names and PATIENT not in table.columns:
        table = table.reset_index()
    return [str(name) for name in table.columns], [list(row) for row in table.itertuples(index=False)]


def _check_header(header: Sequence[str]) -> None:
    """Raise for columns that are unknown or there twice."""
    for i, name in enumerate(header):
        if name != PATIENT:
            COLUMNS[name]
        if name in header[:i]:
            raise ValueError(f"cohort column {name!r} is there twice; leave one out")


def _patients(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> tuple[str, ...]:
    """Return the patients' names."""
    if PATIENT not in header:
        return tuple(str(i + 1) for i in range(len(rows)))
    index = header.index(PATIENT)
    found: dict[str, int] = {}
    for i, row in enumerate(rows):
        name = "" if _is_missing(row[index]) else str(row[index]).strip()
        if not name:
            raise ValueError(f"cohort row {i + 1}, column 'patient': needs a name, got nothing")
        if any(unicodedata.category(c) in INVISIBLE and c not in JOINERS for c in name):
            raise ValueError(f"cohort row {i + 1}, column 'patient': a name is printable text, got {name!r}")
        if name in found:
            raise ValueError(
                f"cohort rows {found[name] + 1} and {i + 1} are both patient {name!r}; names differ"
            )
        found[name] = i
    return tuple(found)


def _is_missing(cell: Any) -> bool:
    """Whether an entry is empty, None or NaN."""
    if isinstance(cell, str):
        return not cell.strip()
    return cell is None or str(cell) in ("nan", "<NA>", "NaT")


def _row(i: int, patients: Sequence[str]) -> str:
    """Return how messages call a row."""
    return f"row {i + 1} (patient {patients[i]!r})"


def _entry(name: str, cell: Any, i: int, patients: Sequence[str], muscles: Sequence[str]) -> Any:
    """Return a checked entry."""
    column = COLUMNS[name]
    missing = _is_missing(cell)
    where = f"cohort {_row(i, patients)}, column {name!r}"
    try:
        if missing and not isinstance(column, TornMuscles):
            raise ValueError
        return column.parse("" if missing else cell, muscles)
    except (ValueError, TypeError) as error:
        why = f" ({error})" if isinstance(column, TornMuscles) and str(error) else ""
        got = "nothing" if missing else repr(cell.item() if hasattr(cell, "item") else cell)
        needs = column.course_expected() if is_course(cell) else column.expected()
        raise ValueError(f"{where}: needs {needs}, got {got}{why}") from None

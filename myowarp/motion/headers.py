"""Headers of OpenSim's tables over time: lines before `endheader`, as OpenSim 4.6 reads them.

A line is a word, blanks or `=`, and a value. Before version 1 a `.mot` file is in degrees, as SIMM's was;
else `inDegrees` says so by `yes` or `y`. What a header says in other words is kept beside (see `units`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

NOTE = re.compile(r"angles are in (degrees|radians)", re.IGNORECASE)
UNITS = {
    **dict.fromkeys(("yes", "y", "true", "1"), "degrees"),
    **dict.fromkeys(("no", "n", "false", "0"), "radians"),
}


@dataclass(frozen=True)
class Header:
    """The part of a file before its rows.

    Attributes:
        labels: Names of the columns, without `time`.
        in_degrees: As in `Storage`.
        unit: As in `Storage`.
        rows: How many it says it has, in its own words; empty: it does not say.
        columns: The same, with `time`.
        counts: Whether OpenSim goes by these counts.
        title: What it calls itself.
    """

    labels: tuple[str, ...]
    in_degrees: bool = False
    unit: str = ""
    rows: str = ""
    columns: str = ""
    counts: bool = True
    title: str = ""


def pair_of(line: str) -> tuple[str, str]:
    """Return the word that a line begins with, and its value."""
    line = line.strip()
    key = re.split(r"[\s=]", line, maxsplit=1)[0]
    return key, line[len(key) :].lstrip(" \t=")


def whole_number(text: str) -> int | None:
    """Return the whole number that a text begins with, as C reads it; None: with none."""
    found = re.match(r"[+-]?\d+", text)
    return int(found[0]) if found else None


def header_of(lines: Sequence[str], labels: Sequence[str], simm: bool) -> Header:
    """Return what the lines before `endheader` say.

    Args:
        lines: The lines.
        labels: Names of the columns, without `time`.
        simm: Whether angles are in degrees before version 1.
    """
    version, rows, columns, degrees, unit, note = 0, "", "", False, "", ""
    for line in lines:
        key, value = pair_of(line)
        if key == "version":
            version = whole_number(value) or 0
        elif key in ("nRows", "nr", "datarows"):
            rows = value
        elif key in ("nColumns", "nc", "datacolumns"):
            columns = value
        elif key == "inDegrees":
            degrees = value.lower() in ("yes", "y")
        elif line.strip() == "Angles are in degrees." and not version:
            degrees = True
        if line.strip().lower().startswith("indegrees"):
            word = line.strip()[len("inDegrees") :].lstrip(" \t=:").rstrip(" \t,;")
            unit = UNITS.get(word.lower(), word)
        elif found := NOTE.match(line.strip()):
            note = found[1].lower()
    title = lines[0].strip() if lines else ""
    degrees = degrees or (simm and version < 1)
    return Header(tuple(labels), degrees, unit or note, rows, columns, version < 2, title)

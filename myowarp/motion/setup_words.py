"""Words of OpenSim's set-up files: those that stand for nothing, times without an end, files, bodies."""

from __future__ import annotations

import re
from pathlib import Path, PureWindowsPath

import numpy as np

from myowarp.osim.document.read.element import Element

UNSET = ("", "Unassigned")
BODY = re.compile(r"/?(?:bodyset/)?([^/]+)")

Span = tuple[float, float]
"""First and last time [s], of which either may be infinite."""


def stated(element: Element, *tags: str) -> str:
    """Return the text of a child, empty where it stands for nothing."""
    text = element.string(*tags)
    return "" if text in UNSET else text


def files_of(element: Element, tag: str) -> list[Path]:
    """Return the files that a child names, beside the set-up file.

    A path of Windows is taken as such where there is no file of its name.
    """
    return [_beside(element.source.parent, name) for name in stated(element, tag).split()]


def file_of(element: Element, *tags: str) -> Path | None:
    """Return the first file that children name, beside the set-up file; None: they name none."""
    name = next(filter(None, (stated(element, tag) for tag in tags)), "")
    return _beside(element.source.parent, name) if name else None


def _beside(folder: Path, name: str) -> Path:
    path = folder / name
    return path if "\\" not in name or path.exists() else folder / PureWindowsPath(name).as_posix()


def body_of(name: str) -> str:
    """Return the name of a body or of ground, which OpenSim 4 may write as a path."""
    found = BODY.fullmatch(name)
    return found[1] if found else name


def span_of(element: Element, default: Span) -> Span:
    """Return a range of times.

    Raises:
        ValueError: It is not two numbers, or they are not in order.
    """
    if not stated(element, "time_range"):
        return default
    found = element.need("time_range")
    times = found.parsed(finite=False)
    if len(times) != 2 or np.isnan(times).any():
        raise found.error(f"must be two times, got {found.text.strip()[:60]!r}")
    return in_order(found, float(times[0]), float(times[1]))


def in_order(element: Element, begin: float, end: float) -> Span:
    """Return a range of times.

    Raises:
        ValueError: It ends before it begins.
    """
    if begin > end:
        raise element.error(f"must have a first time that is not after the last, got {begin:g} and {end:g}")
    return begin, end

"""Curves of a recorded motion for a paper: a panel for each quantity, left beside right, over its cycle."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.reports import panel
from myowarp.apps.reports.motion import PARTS, root_mean_square
from myowarp.definitions.registry import check_choice
from myowarp.motion.storage import Storage, read_storage

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH, HEIGHT, COLUMNS = 7.2, 1.45, 4
"""Of two columns of a journal, 183 mm, and of a row of panels [in]; panels beside each other."""
MOST = 12
"""Quantities that are shown where none were chosen."""
GRAVITY = 9.80665  # m/s^2
UNITS = {part.file: part.unit for part in PARTS}
SIDES = {"r": ("right", panel.COLORS[0]), "l": ("left", panel.COLORS[1]), "": ("", panel.INK)}
SIDED = re.compile(r"(.+)_([rl])(_moment|_force)?")
Span = tuple[float, float]


def side_of(label: str) -> tuple[str, str]:
    """Return the quantity of a column and its side: r, l or "", by its name as in OpenSim's models."""
    found = SIDED.fullmatch(label)
    return (found[1] + (found[3] or ""), found[2]) if found else (label, "")


def scaled(file: str, label: str, mass: float | None) -> tuple[float, str]:
    """Return the factor on a column, and its unit.

    Args:
        file: Name of a table of `myowarp motion`.
        label: Of the column.
        mass: That forces are divided by the weight of, and moments and powers by [kg]; None: nothing is.

    Raises:
        ValueError: The table has neither forces nor moments nor powers.
    """
    unit = UNITS.get(file, "")
    if unit == "N m, N":
        unit = "N" if label.endswith("_force") else "N m"
    if mass is None:
        return 1.0, unit
    factors = {"N": (1.0 / (mass * GRAVITY), "BW"), "N m": (1.0 / mass, "N m/kg"), "W": (1.0 / mass, "W/kg")}
    if unit not in factors:
        raise ValueError(
            f"--mass is of tables of forces, moments and powers by `myowarp motion`, got {file!r}"
        )
    return factors[unit]


def curves(
    path: Path,
    chosen: Sequence[str] = (),
    cycles: Mapping[str, Span] | None = None,
    mass: float | None = None,
) -> Figure:
    """Return a figure of a table, a panel for each quantity.

    Args:
        path: The table, .sto or .mot.
        chosen: Quantities, names of columns without their side; empty: the greatest.
        cycles: First and last time [s] by side, r, l or "" for all others, drawn from 0 to 100 %; None: all
            is drawn over time.
        mass: Of the person [kg], see `scaled`.

    Raises:
        ValueError: The table has no such quantity or time.
        OSError: It cannot be read.
    """
    table = read_storage(path, gaps=True)
    size: dict[str, float] = {}
    for label, own in zip(table.labels, root_mean_square(table.values), strict=True):
        name = side_of(label)[0]
        size[name] = max(size.get(name, 0.0), float(own))
    for name in chosen:
        check_choice("quantity", name, tuple(size))
    shown = list(dict.fromkeys(chosen)) or sorted(size, key=lambda name: -size[name])[:MOST]
    rows, across = -(-len(shown) // COLUMNS), min(COLUMNS, len(shown))
    figure = panel.blank(WIDTH, 0.6 + HEIGHT * rows)
    panels = figure.subplots(rows, across, sharex=True, squeeze=False).ravel()
    for axes in panels[len(shown) :]:
        axes.set_visible(False)
    for axes, name in zip(panels, shown, strict=False):
        for label, values in zip(table.labels, table.values.T, strict=True):
            of, side = side_of(label)
            if of == name:
                factor, unit = scaled(path.name, label, mass)
                within, x = _window(table, side, cycles)
                words, color = SIDES[side]
                axes.plot(x, factor * values[within], label=words, color=color, linewidth=1.0)
                axes.set_ylabel(f"[{unit}]" if unit else "")
        axes.set_title(name, fontsize="medium")
        axes.margins(x=0.0)
    for axes in panels[max(0, len(shown) - across) : len(shown)]:  # the lowest of each column
        axes.tick_params(labelbottom=True)
    lines = {line.get_label(): line for axes in panels for line in axes.lines if line.get_label()[0] != "_"}
    if lines:
        figure.legend(lines.values(), lines, loc="outside upper right", ncols=2)
    figure.supxlabel("Time [s]" if cycles is None else "Cycle [%]", fontsize="medium")
    left = len(size) - len(shown)
    figure.suptitle(
        path.name + (f", the {len(shown)} greatest of {len(size)}" if left and not chosen else "")
    )
    return figure


def _window(table: Storage, side: str, cycles: Mapping[str, Span] | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of a side's cycle, and where they are on the axis."""
    time = table.time
    if cycles is None:
        return np.ones(len(time), dtype=bool), time
    start, end = cycles.get(side, cycles[""])
    if not time[0] <= start < end <= time[-1]:
        raise ValueError(
            f"a cycle must be two times, one after the other, within {time[0]:g} and {time[-1]:g} s, got "
            f"{start:g} and {end:g}"
        )
    within = (time >= start) & (time <= end)
    if within.sum() < 2:
        raise ValueError(f"a cycle needs two rows or more, got {within.sum()} from {start:g} to {end:g} s")
    return within, 100.0 * (time[within] - start) / (end - start)

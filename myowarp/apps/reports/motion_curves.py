"""Curves of a recorded motion for a paper: left beside right over a cycle, muscles in groups."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from myowarp.apps.reports import panel
from myowarp.apps.reports.motion import (
    GRAVITY,
    PARTS,
    REACTION,
    SIDES,
    name_sides,
    resultants,
    root_mean_square,
    unit_of,
)
from myowarp.definitions.registry import check_choice
from myowarp.inks import INKS
from myowarp.motion.gait import side_of
from myowarp.motion.storage import Storage, read_storage
from myowarp.osim.document.read.model import read_groups, read_model

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from myowarp.osim.document.model import Model

WIDTH = 7.2
"""Of two columns of a journal, 183 mm [in]."""
SINGLE, GROUPED = (4, 1.45), (3, 1.75)
"""Panels beside each other and height of a row [in]: of a quantity each, and of groups with their legends."""
MOST = 12
"""Panels that are shown where none were chosen."""
GROUP_SIDE = re.compile(r"^(?:[RrLl]|right|left)_|_[rl]$")
UNITS = {part.file: part.unit for part in PARTS}
Span = tuple[float, float]


class Column(NamedTuple):
    """A column of a table, or the resultant of three: its quantity and side, by `side_of`, and unit."""

    name: str
    side: str
    unit: str
    values: np.ndarray
    component: bool = False
    """Of a joint reaction."""


def scaled(unit: str, mass: float | None) -> tuple[float, str]:
    """Return the factor on a column, and its unit.

    Args:
        unit: That of the table.
        mass: That forces are divided by the weight of, and moments and powers by [kg]; None: nothing is.

    Raises:
        ValueError: It is the unit of neither forces nor moments nor powers.
    """
    if mass is None:
        return 1.0, unit
    factors = {"N": (1.0 / (mass * GRAVITY), "BW"), "N m": (1.0 / mass, "N m/kg"), "W": (1.0 / mass, "W/kg")}
    if unit not in factors:
        raise ValueError(
            f"--mass is for forces [N], moments [N m] and powers [W] of `myowarp motion` or OpenSim, got a "
            f"column with the unit {unit!r}"
        )
    return factors[unit]


def curves(
    path: Path,
    chosen: Sequence[str] = (),
    cycles: Mapping[str, Span] | None = None,
    mass: float | None = None,
    osim: Path | None = None,
) -> Figure:
    """Return a figure of a table, a panel for each quantity or group of quantities.

    Of joint reactions the resultant forces are drawn, and components that are chosen.

    Args:
        path: The table, .sto or .mot.
        chosen: Quantities, names of columns without their side, or groups "NAME=quantity,quantity"; empty:
            the groups of the model that are in the table, or else the greatest quantities.
        cycles: First and last time [s] by side, r, l or "" for all others, drawn from 0 to 100 %; None: all
            is drawn over time.
        mass: Of the person [kg], see `scaled`.
        osim: The model, which tells groups of muscles and units of coordinates.

    Raises:
        ValueError: The table has no such quantity or time.
        OSError: A file cannot be read.
    """
    table = read_storage(path, gaps=True)
    found = columns_of(path, table, None if osim is None else read_model(osim))
    size: dict[str, float] = {}
    for column in found:
        own = float(root_mean_square(column.values[:, None])[0])
        size[column.name] = max(size.get(column.name, 0.0), own)
    main = {column.name for column in found if not column.component}
    greatest = sorted(main, key=lambda name: -size[name])
    groups = {} if osim is None else groups_of(osim, size)
    panels = _panels(chosen, groups or {name: [name] for name in greatest}, size)
    grouped = any(names != [title] for title, names in panels.items())
    most_across, height = GROUPED if grouped else SINGLE
    across = min(most_across, len(panels))
    figure, grid = panel.grid(len(panels), across, WIDTH, height, 0.6, sharex=True)
    for axes, (title, names) in zip(grid, panels.items(), strict=True):
        kept = sorted(names, key=lambda name: -size[name])[: len(INKS)]
        colors = {} if names == [title] else dict(zip(kept, INKS, strict=False))
        for column in (column for column in found if column.name in kept):
            factor, unit = scaled(column.unit, mass)
            within, x = _window(table.time, column.side, cycles)
            _, color, dash = SIDES[column.side]
            color = colors.get(column.name, panel.INK if grouped else color)
            axes.plot(x, factor * column.values[within], dash, color=color, linewidth=1.0)
            axes.set_ylabel(f"[{unit}]" if unit else "")
        left = f", {len(kept)} of {len(names)}" if len(kept) < len(names) else ""
        axes.set_title(title + left, fontsize="medium")
        axes.margins(x=0.0)
        if colors:
            _legend(axes, colors)
    for axes in grid[-across:]:  # the lowest of each column
        axes.tick_params(labelbottom=True)
    name_sides(figure, table.labels, panel.INK if grouped else None)
    figure.supxlabel("Time [s]" if cycles is None else "Cycle [%]", fontsize="medium")
    all_of = f"{len(groups)} groups" if groups else f"{len(greatest)}, the greatest"
    cut = not chosen and len(panels) < len(groups or greatest)
    figure.suptitle(path.name + (f", {len(panels)} of {all_of}" if cut else ""))
    return figure


def columns_of(path: Path, table: Storage, model: Model | None) -> list[Column]:
    """Return the columns of a table, and the resultants of joint reactions."""
    joints = resultants(table)
    own, known = list[Column](), UNITS.get(path.name, "")
    for label, values in zip(table.labels, table.values.T, strict=True):
        unit = unit_of(known, label, model, table.in_degrees)
        own.append(Column(*side_of(label), unit, values, bool(REACTION.fullmatch(label))))
    return own + [
        Column(*side_of(label), "N", values)
        for label, values in zip(joints.labels, joints.values.T, strict=True)
    ]


def groups_of(osim: Path, known: Iterable[str]) -> dict[str, list[str]]:
    """Return the quantities of a model's groups that are known, by the groups' names without their side."""
    known = set(known)
    found: dict[str, list[str]] = {}
    for name, members in read_groups(osim).items():
        if here := [side_of(member)[0] for member in members if side_of(member)[0] in known]:
            title = GROUP_SIDE.sub("", name)
            found[title] = list(dict.fromkeys([*found.get(title, ()), *here]))
    return found


def _panels(
    chosen: Sequence[str], default: Mapping[str, list[str]], size: Mapping[str, float]
) -> dict[str, list[str]]:
    """Return the quantities of each panel, by its title."""
    if not chosen:
        return dict(list(default.items())[:MOST])
    panels = {}
    for word in chosen:
        title, _, members = word.rpartition("=")
        panels[title or members] = members.split(",") if title else [members]
    for name in (name for names in panels.values() for name in names):
        check_choice("quantity", name, tuple(size))
    return panels


def _legend(axes: Axes, colors: Mapping[str, str]) -> None:
    """Name the quantities of a group beside its panel."""
    from matplotlib.lines import Line2D

    lines = [Line2D([], [], color=color, linewidth=1.5) for color in colors.values()]
    look: dict[str, Any] = {
        "fontsize": "x-small",
        "handlelength": 0.9,
        "handletextpad": 0.4,
        "borderaxespad": 0.2,
    }
    axes.legend(lines, list(colors), loc="upper left", bbox_to_anchor=(1.0, 1.0), **look)


def _window(time: np.ndarray, side: str, cycles: Mapping[str, Span] | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of a side's cycle, and where they are on the axis."""
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

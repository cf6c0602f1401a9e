"""A score of a walk as tables, a figure and a page: what is least human first."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.apps.reports import panel
from myowarp.apps.reports.motion import SIDES, TEMPLATE, name_sides
from myowarp.apps.reports.table import number
from myowarp.apps.reports.walk_measures import Measured, Reference
from myowarp.apps.reports.walk_score import CURVE_UNITS, Row, Score
from myowarp.disk import in_place
from myowarp.motion.gait import PERCENT, side_of
from myowarp.motion.strides import JOINTS, MUSCLES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEADS = ("measure", "value", "95 %", "unit", "reference", "error", "95 %", "r")
BRIEF = ("measure", "value", "ref.", "error", "95 %", "r")
PANELS = [f"{joint}_{kind}" for kind in ("angle", "moment") for joint in JOINTS] + ["ground_force", *MUSCLES]
ACROSS, WIDTH, HEIGHT, DPI = 3, 9.0, 1.55, 130
MOST_LOST = 0.05
"""Share of the weight by which the forces on the feet may miss it, unsaid."""
LEFT_OUT = (
    "The metabolic rate is that of the muscles of the model after Bhargava 2004 and 1.2 W/kg at rest; arms, "
    "and a trunk without muscles, cost nothing."
)


def title_of(name: str) -> str:
    """Return what a measure is called."""
    own, side = side_of(name)
    words = own.replace("_", " ")
    return f"{words}, {SIDES[side][0]}" if side else words


def cells(row: Row) -> tuple[str, ...]:
    """Return a measure as the cells of a table."""
    return (
        title_of(row.name),
        number(row.value),
        span(row.interval),
        row.unit,
        number(row.reference),
        number(row.error),
        span(row.error_interval),
        number(row.correlation),
    )


def brief(row: Row) -> tuple[str, ...]:
    """Return a measure as the cells of a table for a terminal, `BRIEF`."""
    own, side = side_of(row.name)
    name = f"{own.replace('_', ' ')} {side}".rstrip() + (f" [{row.unit}]" if row.unit else "")
    within = row.error_interval
    return (
        name,
        number(row.value),
        number(row.reference),
        "-" if row.error is None else f"{row.error:.2f}",
        "" if within is None else f"{within[0]:.2f} to {within[1]:.2f}",
        "" if row.correlation is None else f"{row.correlation:.2f}",
    )


def span(interval: tuple[float, float] | None) -> str:
    """Return an interval as text."""
    return "" if interval is None else f"{number(interval[0])} to {number(interval[1])}"


def findings(walk: Measured, found: Score, reference: Reference) -> list[tuple[str, bool]]:
    """Return what is to be said of a score, in sentences, and whether each is bad."""
    groups = ", ".join(
        f"{name} {number(error)}" for name, error in sorted(found.groups.items(), key=lambda pair: -pair[1])
    )
    said = [(f"Score {number(found.total)}; 0 is {reference.name}. Mean errors: {groups}.", False)]
    upright = walk.episodes - walk.falls
    strides, episodes = (
        f"{n} {word}{'s' * (n > 1)}" for n, word in ((walk.strides, "stride"), (upright, "episode"))
    )
    over = f"{strides} of {episodes} without a fall"
    few = "" if len(walk.values["speed"]) > 1 else "; one has no interval"
    said.append((f"{over}; intervals are over {walk.over}{few}.", False))
    if walk.falls:
        each = f"one in {walk.steps / walk.falls:.3g} steps"
        said.append((f"{walk.falls} of {walk.episodes} episodes ended with a fall, {each}.", True))
    if "weight" in walk.values and abs(borne := float(walk.values["weight"].mean()) - 1.0) > MOST_LOST:
        text = f"The feet bear {100.0 * (1.0 + borne):.3g} % of the weight over a stride"
        said.append((f"{text}: forces on one foot are missing, or they are not those of the motion.", True))
    if "metabolic_rate" in walk.values:
        said.append((LEFT_OUT, False))
    return said + [(f"Reference: {source}.", False) for source in reference.sources]


def page(walk: Measured, found: Score, reference: Reference, png: bytes) -> str:
    """Return the page, with a picture."""
    picture = base64.b64encode(png).decode()
    heads = "".join(f"<th>{head}</th>" for head in HEADS)
    rows = "".join(
        f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in cells(row))}</tr>" for row in found.rows
    )
    drawn = f'<h2>Over the gait cycle</h2><img alt="curves" src="data:image/png;base64,{picture}">'
    table = f"<h2>Measures, the worst first</h2><table><tr>{heads}</tr>{rows}</table>"
    said = findings(walk, found, reference)
    bullets = "".join(f"<li{' class=bad' * bad}>{escape(text)}</li>" for text, bad in said)
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        title=escape(f"How human is {walk.name}?"), findings=bullets, sections=drawn + table
    )


def write_page(folder: Path, walk: Measured, found: Score, reference: Reference) -> None:
    """Write `score.html` and `score.png` into a folder.

    Raises:
        OSError: A file cannot be written.
        ImportError: matplotlib is not installed.
    """
    png = panel.picture(figure(walk, reference), "png", DPI)
    with in_place(folder / "score.html") as scratch:
        scratch.write_text(page(walk, found, reference, png), encoding="utf-8")
    with in_place(folder / "score.png") as scratch:
        scratch.write_bytes(png)


def figure(walk: Measured, reference: Reference) -> Figure:
    """Return a figure with a panel for each curve over the gait cycle, both sides on the reference."""
    shown = [name for name in PANELS if any(side_of(own)[0] == name for own in walk.curves)]
    with panel.style(8.0):
        drawn, grid = panel.grid(len(shown), ACROSS, WIDTH, HEIGHT, 0.8, sharex=True)
        for axes, name in zip(grid, shown, strict=True):
            _draw(axes, name, walk, reference)
        for axes in grid[-ACROSS:]:
            axes.tick_params(labelbottom=True)
        name_sides(drawn, walk.curves)
        drawn.supxlabel("Gait cycle [%]", fontsize="medium")
        drawn.suptitle(f"{walk.name} on {reference.name} (grey)", fontsize="medium", x=0.01, ha="left")
        return drawn


def _draw(axes: Axes, name: str, walk: Measured, reference: Reference) -> None:
    """Draw a curve of both sides: means and their spread."""
    sides: Sequence[str] = [f"{name}_{side}" for side in "rl"]
    for own in dict.fromkeys(own if own in reference.curves else name for own in sides):
        if own in reference.curves:
            mean, spread = reference.curves[own]
            panel.band(axes, PERCENT, (mean - spread, mean, mean + spread), color="#888888", linewidth=1.0)
    for own in sides:
        on = reference.of(own, reference.active)
        if on is not None:
            edge: Any = {"transform": axes.get_xaxis_transform(), "color": "#888888", "linewidth": 0}
            axes.fill_between(PERCENT, 0.0, 1.0, where=on, alpha=0.15, **edge)
        if own in walk.curves:
            rows = walk.curves[own]
            _, color, dash = SIDES[side_of(own)[1]]
            mean, spread = rows.mean(axis=0), rows.std(axis=0)
            lines = np.array((mean - spread, mean, mean + spread))
            panel.band(axes, PERCENT, lines, dash, color=color, alpha=0.15, linewidth=1.2)
    unit = next((unit for part, unit in CURVE_UNITS.items() if part in name), "")
    axes.set_title(title_of(name), fontsize="medium")
    axes.set_ylabel(f"[{unit}]" if unit else "")
    axes.margins(x=0.0)
    if name in MUSCLES:
        axes.set_ylim(bottom=0.0)

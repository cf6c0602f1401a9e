"""A page on a recorded motion: what does not fit, then angles, moments and muscles, the worst of each first.

It is drawn from the tables of `myowarp motion` that a folder has. Limits, beyond which a line is red, are
those that OpenSim's users are advised to keep: markers 20 mm root mean square and 40 mm at most.

Source: Hicks et al. (2015), doi:10.1115/1.4029304, and the best practices of OpenSim's documentation.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Literal

import numpy as np

from myowarp.apps.reports import panel
from myowarp.apps.reports.table import number
from myowarp.inks import BLUE, VERMILION
from myowarp.motion.gait import side_of
from myowarp.motion.storage import Storage, read_storage
from myowarp.motion.strides import GRAVITY
from myowarp.motion.units import Angles
from myowarp.osim.document.kinematics import floating
from myowarp.osim.document.model import Model
from myowarp.process import listed
from myowarp.progress import patient_bar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKER_RMS, MARKER_MOST = 20.0, 40.0
"""[mm]."""
NOTHING = 1e-3
"""[N m, N] below which nothing is missing."""
FULL = 0.999
"""Activation from which a muscle is fully active."""
LISTED, DRAWN, COLUMNS, DPI = 12, 24, 6, 110
PATIENCE = 2.0  # s without a word
REACTION = re.compile(r"(?P<joint>.+)_on_.+_in_.+_(?P<kind>[fmp])[xyz]")
"""Labels of joint reactions, as OpenSim writes them."""
SIDES: dict[str, tuple[str, str, Literal["-", "--"]]] = {
    "r": ("right", BLUE, "-"),
    "l": ("left", VERMILION, "--"),
    "": ("", panel.INK, "-"),
}
"""Word, color and form of a side's lines."""
TEMPLATE = Path(__file__).with_suffix(".html")


@dataclass(frozen=True)
class Part:
    """A table of a folder, as the page shows it."""

    file: str
    title: str
    unit: str
    note: str = ""
    scale: float = 1.0
    open: bool = True
    zero: bool = True


MARKERS = Part(
    "marker_errors.sto",
    "Marker errors",
    "mm",
    "Distance between the model's marker and the recorded one.",
    1e3,
)
MISSING = Part(
    "missing.sto", "What muscles cannot hold", "N m, N", "Moment that neither muscles nor reserves give."
)
MOMENTS = Part("moments.sto", "Joint moments", "N m, N")
ROOT = replace(
    MOMENTS,
    title="Residuals at the root",
    note="What would have to hold the model in space. With all external loads it is what loads, masses and "
    "motion do not agree on; without them it is the weight, too.",
)
ACTIVATIONS = Part("activations.sto", "Activations", "1")
REACTIONS = Part(
    "joint_reactions.sto",
    "Joint reactions",
    "N",
    "Size of the force of each joint on its child, muscles included; the table has components and moments.",
)
RESERVES = Part("reserves.sto", "Reserves", "N m, N", "What reserves, and motors of the model, had to add.")
PARTS = (
    RESERVES,
    Part("ik.mot", "Joint angles", "°, m"),
    MOMENTS,
    Part(
        "passive_moments.sto",
        "Moments of springs and ligaments",
        "N m, N",
        "What springs, limits, bushings and ligaments of the model give; joint moments are what is left.",
    ),
    Part("actuators.sto", "Motors of the model", "N m or N", "Moment or force of each, by its name."),
    REACTIONS,
    ACTIVATIONS,
    Part("forces.sto", "Muscle forces", "N"),
    Part("powers.sto", "Muscle powers", "W", "Shortening is positive.", open=False),
    Part(
        "metabolic_powers.sto",
        "Metabolic powers",
        "W",
        "Heat and work of fibers after Bhargava 2004, without the rate at rest.",
        open=False,
    ),
    Part("lengths.sto", "Lengths of muscle and tendon", "m", open=False, zero=False),
    Part("velocities.sto", "Velocities of muscle and tendon", "m/s", "Lengthening is positive.", open=False),
    Part("moment_arms.sto", "Moment arms", "m", "Muscle.coordinate.", open=False),
    Part("active_forces.sto", "Active forces at full activation", "N", open=False),
    Part("passive_forces.sto", "Passive forces", "N", open=False),
    Part("full_powers.sto", "Powers at full activation", "W", "Shortening is positive.", open=False),
)


def page(folder: Path, model: Model, motion: Path | None = None) -> str:
    """Return the page of a folder.

    Args:
        folder: Where steps of `myowarp motion` wrote.
        model: The model they were for.
        motion: Joint angles, where they are not in the folder.

    Raises:
        ValueError: The folder has no table of a step, or a table is none.
        OSError: A file cannot be read.
        ImportError: matplotlib is not installed.
    """
    tables = {part.file: read_storage(folder / part.file, gaps=True) for part in (MARKERS, MISSING, *PARTS)
              if (folder / part.file).exists()}  # fmt: skip
    if motion is not None:
        tables["ik.mot"] = angles_of(motion, read_storage(motion), model)
    if not tables:
        raise ValueError(
            f"{str(folder)!r} has no table of a motion; write one with myowarp motion kinematics, dynamics, "
            f"analyze or forces, with the same --output"
        )
    findings, sections = [], []
    if REACTIONS.file in tables:
        tables[REACTIONS.file] = resultants(tables[REACTIONS.file])
        findings += _bearing(tables[REACTIONS.file], model)
    root = [f"{name}_{kind}" for name in floating(model) for kind in ("moment", "force")]
    if MISSING.file in tables:
        findings += _holding(without(tables[MISSING.file], root))
    if ACTIVATIONS.file in tables:
        findings += _full(tables[ACTIVATIONS.file])
    if MARKERS.file in tables:
        findings.append(_fitting(tables[MARKERS.file]))
    if said := said_in(folder / MOMENTS.file):
        findings.append((f"{MOMENTS.file}: {said}.", True))
    shown = [(part, tables[part.file]) for part in (MISSING, MARKERS) if part.file in tables]
    if MOMENTS.file in tables and (held := among(tables[MOMENTS.file], root)).labels:
        shown.append((ROOT, held))
        findings.append(_residual(held))
        tables[MOMENTS.file] = without(tables[MOMENTS.file], root)
    shown += [(part, tables[part.file]) for part in PARTS if part.file in tables]
    with patient_bar("Drawing", "tables", len(shown), patience=PATIENCE) as advance:
        for part, table in shown:
            if part.file in (MISSING.file, RESERVES.file):
                acting = np.abs(table.values).max(axis=0, initial=0.0) > NOTHING
                on = {label for label, acts in zip(table.labels, acting, strict=True) if acts}
                table = among(table, on - set(root) if MOMENTS.file in tables else on)
            if table.labels:
                units = [unit_of(part.unit, label, model) for label in table.labels]
                sections.append(_section(part, table, units))
            advance(1)
    bullets = "".join(f"<li{' class=bad' if bad else ''}>{escape(text)}</li>" for text, bad in findings)
    title = escape(f"A motion of {model.name}")
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        title=title, findings=bullets, sections="".join(sections)
    )


def angles_of(path: Path, table: Storage, model: Model) -> Storage:
    """Return the coordinates of a recording, angles in degrees.

    Raises:
        ValueError: The unit of its angles is in doubt.
    """
    found = Angles(path, model).of(table, model.coordinates)
    columns = [np.degrees(x) if model.coordinates[name].rotational else x for name, x in found.items()]
    values = np.stack(columns, axis=1) if columns else np.empty((len(table.time), 0))
    return Storage(tuple(found), table.time, values, in_degrees=True)


def said_in(path: Path) -> str:
    """Return what the title of a table says behind what it holds, "" where it says no more."""
    if not path.exists():
        return ""
    with path.open(encoding="utf-8") as file:
        return file.readline().strip().partition("; ")[2]


def among(table: Storage, labels: Sequence[str] | set[str]) -> Storage:
    """Return the columns with these labels, in their order in the table."""
    kept = [number for number, label in enumerate(table.labels) if label in labels]
    return Storage(tuple(table.labels[k] for k in kept), table.time, table.values[:, kept], table.in_degrees)


def without(table: Storage, labels: Sequence[str]) -> Storage:
    """Return the columns that have none of these labels."""
    return among(table, set(table.labels) - set(labels))


def name_sides(figure: Figure, labels: Iterable[str], ink: str | None = None) -> None:
    """Say above a figure which lines are right and left, where there are any; `ink` replaces their colors."""
    from matplotlib.lines import Line2D

    there = {side_of(label)[1] for label in labels}
    named = [SIDES[side] for side in "rl" if side in there]
    if named:
        lines = [Line2D([], [], color=ink or color, linestyle=form) for _, color, form in named]
        figure.legend(lines, [words for words, _, _ in named], loc="outside upper right", ncols=2)


def resultants(table: Storage) -> Storage:
    """Return the size of each joint's force [N], of a table of joint reactions; of others no column."""
    parts: dict[tuple[str, str], list[int]] = {}
    for k, label in enumerate(table.labels):
        if (found := REACTION.fullmatch(label)) and found["kind"] == "f":
            parts.setdefault((found["joint"], label[: -len("_fx")]), []).append(k)
    joints = [joint for joint, _ in parts]
    labels = tuple(joint if joints.count(joint) == 1 else name for joint, name in parts)
    sizes = [np.linalg.norm(table.values[:, own], axis=1) for own in parts.values()]
    values = np.stack(sizes, axis=1) if sizes else np.empty((len(table.time), 0))
    return Storage(labels, table.time, values)


def root_mean_square(values: np.ndarray) -> np.ndarray:
    """Return the root mean square over frames of what is there, 0 where nothing is."""
    seen = np.isfinite(values)
    squares = np.where(seen, values, 0.0) ** 2
    return np.sqrt(squares.sum(axis=0) / np.maximum(seen.sum(axis=0), 1))


def worst(table: Storage) -> np.ndarray:
    """Return the numbers of the columns, the greatest root mean square first."""
    return np.argsort(-root_mean_square(table.values), kind="stable")


def _peak(table: Storage) -> tuple[str, float, float]:
    """Return label, value and time of the greatest entry."""
    row, column = np.unravel_index(int(np.abs(table.values).argmax()), table.values.shape)
    return table.labels[column], float(table.values[row, column]), float(table.time[row])


def _holding(missing: Storage) -> list[tuple[str, bool]]:
    frames = int((np.abs(missing.values).max(axis=1, initial=0.0) > NOTHING).sum())
    if not frames:
        return [(f"Muscles and reserves hold all {len(missing.time)} frames.", False)]
    label, value, time = _peak(missing)
    text = f"Muscles cannot hold {frames} of {len(missing.time)} frames: {label} lacks {number(abs(value))} "
    return [(f"{text}{'N' if label.endswith('_force') else 'N m'} at {time:.3g} s.", True)]


def _full(activations: Storage) -> list[tuple[str, bool]]:
    count = (activations.values >= FULL).sum(axis=0)
    named = [f"{activations.labels[k]} ({count[k]})" for k in np.argsort(-count, kind="stable") if count[k]]
    if not named:
        return []
    return [(f"Fully active, in frames of {len(activations.time)}: {listed(named, LISTED)}.", True)]


def _bearing(reactions: Storage, model: Model) -> list[tuple[str, bool]]:
    if not reactions.labels:
        return []
    label, value, time = _peak(reactions)
    weight = GRAVITY * model.mass
    share = (
        f", {value / weight:.2g} times the weight of the model ({number(weight)} N)" if weight > 0.0 else ""
    )
    return [(f"The greatest joint reaction is {label}: {number(value)} N at {time:.3g} s{share}.", False)]


def _fitting(errors: Storage) -> tuple[str, bool]:
    rms, most = 1e3 * root_mean_square(errors.values), 1e3 * np.nanmax(errors.values, axis=0, initial=0.0)
    whole, k = 1e3 * float(root_mean_square(errors.values.ravel())), int(rms.argmax())
    text = f"Markers are {number(whole)} mm off (root mean square); the worst is {errors.labels[k]}: "
    bad = bool(rms.max() > MARKER_RMS or most.max() > MARKER_MOST)
    return f"{text}{number(rms[k])} mm, {number(most[k])} mm at most.", bad


def _residual(root: Storage) -> tuple[str, bool]:
    label, value, time = _peak(root)
    unit = "N" if label.endswith("_force") else "N m"
    return f"The greatest residual at the root is {label}: {number(value)} {unit} at {time:.3g} s.", False


def unit_of(unit: str, label: str, model: Model | None, in_degrees: bool = True) -> str:
    """Return the unit of a column, "" where nothing tells it.

    Args:
        unit: That of the table, with one of forces behind that of moments, or of places behind that of
            angles; "" where it is not known.
        label: Of the column.
        model: The model, whose coordinates may be in a table of angles.
        in_degrees: Whether their angles are in degrees.
    """
    turn, _, shift = unit.partition(", ")
    if model is not None and label in model.coordinates and turn in ("", "°"):
        return ("°" if in_degrees else "rad") if model.coordinates[label].rotational else "m"
    if found := REACTION.fullmatch(label):
        return {"f": "N", "m": "N m", "p": "m"}[found["kind"]]
    if turn == "°":
        return shift if re.search(r"_t[xyz]$", label) else turn
    if turn and not shift:
        return turn
    return {"_moment": "N m", "_force": "N"}.get(label[label.rfind("_") :], turn)


def _section(part: Part, table: Storage, units: Sequence[str]) -> str:
    """Return a table with the worst lines, and a plot of each column."""
    values = part.scale * table.values
    order, mean = worst(table), root_mean_square(part.scale * table.values)
    rows = []
    for k in order[:LISTED]:
        at = int(np.nan_to_num(np.abs(values[:, k])).argmax())
        bad = part is MARKERS and (mean[k] > MARKER_RMS or values[at, k] > MARKER_MOST)
        cells = (number(mean[k]), number(values[at, k]), units[k], f"{table.time[at]:.3g}")
        rows.append(
            f"<tr{' class=bad' if bad else ''}><td>{escape(table.labels[k])}</td>"
            + "".join(f"<td>{cell}</td>" for cell in cells)
        )
    left = len(order) - len(rows)
    heads = "".join(f"<th>{head}</th>" for head in ("", "rms", "greatest", "unit", "at [s]"))
    picture = base64.b64encode(draw(part, table)).decode()
    note = f'<p class="note">{escape(part.note)}</p>' if part.note else ""
    panels = {side_of(label)[0] for label in table.labels}
    drawn = f"the first {DRAWN} are drawn" if len(panels) > DRAWN else "all are drawn"
    rest = f'<p class="note">{left} more are in {escape(part.file)}; {drawn}.</p>' if left else ""
    inner = (
        f"{note}<table><tr>{heads}</tr>{''.join(rows)}</table>{rest}"
        f'<img alt="{escape(part.title)} over time" src="data:image/png;base64,{picture}">'
    )
    if part.open:
        return f"<h2>{escape(part.title)}</h2>{inner}"
    return f"<h2>{escape(part.title)}</h2><details><summary>Show</summary>{inner}</details>"


def draw(part: Part, table: Storage, form: str = "png") -> bytes:
    """Return a picture with a panel for each quantity over time, left beside right, the worst first."""
    quantities: dict[str, list[int]] = {}
    for k in worst(table):
        quantities.setdefault(side_of(table.labels[k])[0], []).append(k)
    shown = list(quantities.items())[:DRAWN]
    with panel.style(7.5, **{"axes.titleweight": "bold"}):
        figure, panels = panel.grid(len(shown), COLUMNS, 13.0, 1.35, 0.5, sharex=True)
        for axes, (name, columns) in zip(panels, shown, strict=True):
            for k in columns:
                _, color, dash = SIDES[side_of(table.labels[k])[1]]
                axes.plot(table.time, part.scale * table.values[:, k], dash, color=color, linewidth=1.2)
            axes.set_title(name)
            axes.margins(x=0)
            if part is ACTIVATIONS:
                axes.set_ylim(0.0, 1.03)
            elif part.zero:
                axes.axhline(0.0, color=panel.INK, linewidth=0.5, alpha=0.5)
        name_sides(figure, table.labels)
        figure.supxlabel("time [s]")
        figure.supylabel(f"[{part.unit}]")
        return panel.picture(figure, form, DPI)

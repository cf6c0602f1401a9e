"""The part of the page about dynamics: figures of what steps a model, and their plots."""

from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from myowarp.osim.convert.check.dynamics import DURATION, QUANTITIES, Dynamics
from myowarp.osim.convert.check.gates import COORDINATES, ENGINES
from myowarp.osim.convert.report.charts import Line, chart, colors, legible

HEADS = {
    "inertia": "mass matrix",
    "response": "unit force at rest",
    "gravity": "gravity at rest",
    "acceleration": "acceleration",
    "torque": "inverse dynamics",
}
"""Quantities of `check.dynamics`, for people."""
FLOOR = 1e-8
"""Least error that a plot shows."""
DARKEST = 0.05
"""Error with the strongest color."""
SHOWN = 3
"""Coordinates whose forces in the smooth motion are drawn: those with the greatest errors of model.xml."""


def percent(share: float | None) -> str:
    """Return a share in percent for people."""
    if share is None:
        return "no number"
    return f"{100 * share:.0f} %" if share >= 1 else f"{100 * share:.2g} %"


def engines_table(report: Mapping[str, Any]) -> str:
    """Return what each engine makes of the model, in one row each; the greatest errors name a coordinate."""
    found = report["dynamics"]
    if not found["engines"]:
        return "<p>Accelerations are not compared: the document determines none.</p>"
    rows = []
    for engine in found["engines"].values():
        states = engine["accelerations"]
        cells = [percent(states["median"]), percent(states["worst"])]
        for quantity in QUANTITIES:
            worst = max(engine["coordinates"], key=lambda row: _size(row[quantity]["worst"]))
            value = percent(worst[quantity]["worst"])
            cells.append(f'{value} <span class="note">{escape(worst["coordinate"])}</span>')
        rows.append(
            f"<tr><td>{escape(engine['name'])}</td>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
        )
    heads = "".join(f"<th>{escape(head)}, worst</th>" for head in HEADS.values())
    counts, apart = found["samples"], found["reference_from_own_equations"]
    said = (
        f"Reference: {escape(found['reference'])}. {counts['states']} random states over the full ranges "
        f"with velocities, gravity and forces; {counts['rest']} poses at rest; {counts['motion']} times of a "
        f"smooth motion; {100 * found['undetermined']:.2g} % left out, where the document determines no "
        "accelerations. Muscles, springs, limits and contacts are off."
    )
    if apart["worst"]:
        said += (
            f" The reference's accelerations differ from the document's equations of motion by "
            f"{percent(apart['median'])} (median) and {percent(apart['worst'])} (worst)."
        )
    head = f"<tr><th></th><th>states, median</th><th>states, worst</th>{heads}</tr>"
    return f'<p>{said}</p><div class="wide"><table>{head}{"".join(rows)}</table></div>'


def _size(share: float | None) -> float:
    """Return a share, infinite where it has no number."""
    return np.inf if share is None else share


def dynamics_section(report: Mapping[str, Any], dynamics: Dynamics) -> str:
    """Return plots, and the errors of every coordinate."""
    if dynamics.samples is None:
        return ""
    legend = "".join(f'<span class="{key}-key">{escape(name)}</span>' for key, name in ENGINES.items())
    intro = (
        "<p>Left: error of the accelerations, as a share, in all states, the least first, as power of ten. "
        "Right: forces that a smooth motion needs; OpenSim's, and what the model would need.</p>"
        f'<p class="legend">{legend}</p>'
    )
    share = np.linspace(0, 100, len(dynamics.samples.states[0].values))
    lines = [
        Line(share, np.log10(np.clip(np.sort(engine.states), FLOOR, 1e3)), key)
        for key, engine in dynamics.engines.items()
    ]
    charts = [chart("error, log10", "% of states", lines)]
    motion, names = dynamics.samples.motion[0], list(dynamics.coordinates)
    errors = dynamics.engines["xml"].errors["torque"].max(axis=0)
    time = np.linspace(0, DURATION, len(motion.forces))
    for place in np.argsort(-errors)[:SHOWN]:
        unit = "N m" if dynamics.coordinates[names[place]] else "N"
        drawn = [Line(time, motion.forces[:, place], "reference")]
        for key, engine in dynamics.engines.items():
            drawn.append(
                Line(time, np.where(np.isfinite(engine.forces), engine.forces, np.nan)[:, place], key)
            )
        charts.append(chart(f"{names[place]} [{unit}]", "s", drawn))
    tables = "".join(_table(report, key) for key in report["dynamics"]["engines"])
    return f'<h2>Dynamics</h2>{intro}<div class="wide">{"".join(charts)}</div>{tables}'


def _table(report: Mapping[str, Any], key: str) -> str:
    """Return the errors of every coordinate in an engine, mean and worst, in percent."""
    engine = report["dynamics"]["engines"][key]
    rows = []
    for row in engine["coordinates"]:
        cells = []
        for quantity in QUANTITIES:
            for figure in ("mean", "worst"):
                value = row[quantity][figure]
                gate = COORDINATES.get(key, {}).get(quantity)
                strongest = DARKEST if gate is None else gate / 100
                color = colors(np.array(0.8 * min(_size(value), 1e9) / strongest), signed=False)
                shown = "–" if value is None else f"{100 * value:.2g}"
                cells.append(f'<td style="{legible(color)}">{shown}</td>')
        rows.append(f"<tr><td>{escape(row['coordinate'])}</td>{''.join(cells)}</tr>")
    heads = "".join(f'<th colspan="2">{escape(head)}</th>' for head in HEADS.values())
    below = "<th>mean</th><th>worst</th>" * len(HEADS)
    table = f"<table><tr><th></th>{heads}</tr><tr><th></th>{below}</tr>{''.join(rows)}</table>"
    return f'<h3>{escape(engine["name"])} [%]</h3><div class="wide">{table}</div>'

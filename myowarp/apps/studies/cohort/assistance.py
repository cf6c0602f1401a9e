"""Strength × assistance: how patients with exoskeletons fare, and what a newton metre saves them.

Three heat maps over the entries `strength` and `exo_assistance` of a cohort, by entry or by quarters of the
patients: the outcome, the effort, and the effort saved per newton metre of the exoskeleton,

    saved = (effort without assistance - effort) / |mean torque|,

effort being the mean activation of all muscles over the episode, at the same strength. Values are medians
over the patients of a cell.
"""

from __future__ import annotations

import json
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.apps.reports.panel import INK, blank, ink_on
from myowarp.apps.studies.cohort.plot import PALE, Groups, group_patients, label, outcome
from myowarp.inks import BETTER, WORSE

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AXES = ("strength", "exo_assistance")
EFFORT, TORQUE = "mean_activation", "mean_exo_torque"
LEAST_TORQUE = 1e-3
"""N m: with less, nothing is said of what a newton metre saves."""
CAPTION = (
    "Medians over the patients of a cell, n episodes. Effort: mean activation of all muscles over the "
    "episode. Saved: effort without assistance minus effort with it, at the same strength, in percentage "
    "points, divided by the exoskeleton's mean torque. "
    "Orange: the darker, the worse; blue: the darker, the better."
)
HOLD = " `hold` has no integral part: part of each error is its own."


def read_summary(folder: Path) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Return summary and settings of a cohort that `myowarp cohort` has written into a folder.

    Raises:
        ValueError: It is no such folder.
        OSError: A file cannot be read.
    """
    import pandas as pd

    whole, parts, settings = folder / "summary.csv", folder / "summary", folder / "settings.json"
    if not settings.exists() or not (whole.exists() or parts.is_dir()):
        raise ValueError(f"plot assistance needs a folder that `myowarp cohort` wrote, got {str(folder)!r}")
    table = pd.read_csv(whole) if whole.exists() else pd.read_parquet(parts)
    return table, json.loads(settings.read_text())


def crosses(summary: pd.DataFrame) -> bool:
    """Return whether patients differ in strength and in assistance, some of them without any."""
    return (
        all(name in summary and summary[name].nunique() > 1 for name in AXES)
        and TORQUE in summary
        and bool((summary["exo_assistance"] == 0.0).any())
    )


def assistance_map(summary: pd.DataFrame, settings: dict[str, Any]) -> Figure:
    """Return the heat maps.

    Args:
        summary: A row per patient and trial, as `CohortResult.summary`.
        settings: As `CohortResult.settings`.

    Raises:
        ValueError: Strength or assistance does not vary, or nobody is without assistance.
    """
    if not crosses(summary):
        raise ValueError(
            "plot assistance needs a cohort with several entries of strength and of exo_assistance, 0 among "
            f"the latter, and a column {TORQUE}; got columns {', '.join(summary)}"
        )
    strength, assistance = (group_patients(summary[name]) for name in AXES)
    key, name, factor = outcome(summary, settings)
    cells = {column: medians(summary[column], strength, assistance) for column in (key, EFFORT, TORQUE)}
    count = np.array([[(s & a).sum() for a in assistance.members] for s in strength.members])
    effort = 100.0 * cells[EFFORT]
    figure = blank(4.6 * 3, 0.62 * len(strength.labels) + 2.6)
    panels = figure.subplots(1, 3, sharey=True)
    low = medians(summary["exo_assistance"], strength, assistance)
    shown = (
        (name, factor * cells[key], "{:.1f}", BETTER if key == "return" else WORSE),
        ("Effort [% of full activation]", effort, "{:.1f}", WORSE),
        ("Effort saved [points per N m]", saved(effort, cells[TORQUE], low), "{:.2f}", BETTER),
    )
    for axes, (title, values, form, colors) in zip(panels, shown, strict=True):
        _draw(axes, title, values, count, form, colors)
        axes.set_xticks(range(len(assistance.labels)), assistance.labels)
        axes.set_yticks(range(len(strength.labels)), strength.labels)
        axes.set_xlabel(label("exo_assistance"))
    panels[0].set_ylabel(label("strength"))
    others = [c for c in settings["columns"] if c not in AXES and c in summary and summary[c].nunique() > 1]
    varied = f" Patients of a cell differ in {', '.join(others)}, too." if others else ""
    fixed = HOLD if settings["policy"] == "hold" else ""
    task = settings["task"].removeprefix("MyoWarp/")
    figure.suptitle(f"{len(summary):,} episodes, {task}, policy {settings['policy']!r}", color=INK)
    figure.supxlabel(
        textwrap.fill(CAPTION + fixed + varied, 170), x=0.01, ha="left", fontsize=8.5, color=PALE
    )
    return figure


def medians(values: pd.Series, rows: Groups, columns: Groups) -> np.ndarray:
    """Return the median of each cell, shape (num_rows, num_columns), NaN where nobody is."""
    found = np.full((len(rows.labels), len(columns.labels)), np.nan)
    for i, row in enumerate(rows.members):
        for j, column in enumerate(columns.members):
            if (own := values[row & column]).notna().any():
                found[i, j] = own.median()
    return found


def saved(effort: np.ndarray, torque: np.ndarray, assistance: np.ndarray) -> np.ndarray:
    """Return (effort without assistance - effort) / |torque|, NaN where there is no torque.

    Args:
        effort: Of each cell, shape (num_strengths, num_assistances).
        torque: Mean torque of the exoskeleton [N m], same shape.
        assistance: Same shape; without assistance is where it is 0.
    """
    without = np.where(assistance == 0.0, effort, np.nan)
    base = np.array([row[~np.isnan(row)][0] if (~np.isnan(row)).any() else np.nan for row in without])
    strong = np.abs(torque) > LEAST_TORQUE
    size = np.where(strong, np.abs(torque), 1.0)
    return np.where(strong & (assistance != 0.0), (base[:, None] - effort) / size, np.nan)


def _draw(
    axes: Axes, title: str, values: np.ndarray, count: np.ndarray, form: str, colors: tuple[str, ...]
) -> None:
    """Draw a heat map with its numbers, in colors from low to high."""
    from matplotlib.colors import LinearSegmentedColormap

    scale = LinearSegmentedColormap.from_list(title, colors)
    present = values[~np.isnan(values)] if (~np.isnan(values)).any() else np.zeros(1)
    low, high = float(present.min()), float(present.max())
    image = axes.imshow(
        values, cmap=scale.with_extremes(bad="#eeeeee"), vmin=low, vmax=high, aspect="auto", origin="lower"
    )
    axes.figure.colorbar(image, ax=axes, fraction=0.05, pad=0.02).outline.set_visible(False)
    axes.set_title(title, color=INK)
    axes.grid(visible=False)
    for (i, j), value in np.ndenumerate(values):
        known = not np.isnan(value)
        text = f"{form.format(value) if known else '–'}\nn = {count[i, j]}"
        ink = ink_on(image.to_rgba(value)) if known else INK
        axes.text(j, i, text, ha="center", va="center", fontsize=8, color=ink)

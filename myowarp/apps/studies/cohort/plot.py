"""A picture of a cohort: what each varied column does to the outcome, and when.

One column of panels for every column of the table that varies. From top to bottom: the share of successful
episodes by quarters of the patients, the outcome of every patient, and the tracking error over time, again by
quarters. Columns with few different entries are shown by entry.
"""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.apps.reports.panel import INK, band, blank, quarters, save, style
from myowarp.apps.studies.cohort.run import CohortResult
from myowarp.inks import INKS, shades
from myowarp.sim.patient_columns import COLUMNS

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_PANELS = 6
FEW = 6  # different entries that are shown one by one
SHOWN_AS = {"rad": ("°", 180.0 / np.pi), "m": ("mm", 1000.0)}
PALE = "#666666"
PADS = "figure.constrained_layout."
LOOK = {"axes.grid": False, PADS + "h_pad": 0.08, PADS + "w_pad": 0.06}
CAPTION = (
    "Top: share of successful episodes (more than 5 solved steps, no failure), n patients. "
    "Middle: each dot is a patient; median and quartiles of ten groups of patients, or of each entry. "
    "Bottom: median and quartiles of the groups at the top, over time."
)


@dataclass(frozen=True)
class Groups:
    """Patients by their entries in one column.

    Attributes:
        labels: Name of each group.
        members: Whether a patient belongs to a group, shape (num_groups, num_patients).
        exact: Whether all members of a group have the same entry.
        colors: Color of each group.
    """

    labels: list[str]
    members: np.ndarray
    exact: bool
    colors: tuple[str, ...]


def group_patients(entries: pd.Series) -> Groups:
    """Return the quarters of the patients by a column, or one group for each of few different entries.

    An entry that a quarter of all patients share, such as no load, is a group of its own.
    """
    values = sorted(entries.unique())
    numeric = entries.dtype.kind in "iuf"
    if not numeric:
        common = list(entries.value_counts().index[:FEW])
        values = [value for value in values if value in common]
    if len(values) <= FEW:
        labels = [f"{value:g}" if numeric else value or "none" for value in values]
        colors = shades(len(values)) if numeric else INKS[: len(values)]
        return Groups(labels, np.array([entries == value for value in values]), True, colors)
    counts = entries.value_counts()
    tied = [value for value in counts.index if counts[value] >= 0.25 * len(entries)]
    rest = ~entries.isin(tied)
    shares = np.linspace(0.0, 1.0, 5 - len(tied))[1:-1]
    part = np.searchsorted(np.quantile(entries[rest], shares), entries, side="right")
    members = [entries == value for value in tied] + [rest & (part == p) for p in np.unique(part[rest])]
    members.sort(key=lambda member: entries[member].min())
    digits = max(0, 1 - math.floor(math.log10(np.ptp(np.quantile(entries[rest], (0.25, 0.75))) or 1.0)))
    ends = [(entries[member].min(), entries[member].max()) for member in members]
    labels = [f"{low:.{digits}f}–{high:.{digits}f}" if low < high else f"{low:g}" for low, high in ends]
    return Groups(labels, np.array(members), False, shades(len(members)))


def draw_cohort(result: CohortResult, path: Path) -> None:
    """Draw a cohort to a .png.

    Raises:
        ImportError: matplotlib is not installed.
        OSError: The file cannot be written.
    """
    with style(10.0, **LOOK):
        save(_drawn(result), path, dpi=130)


def _drawn(result: CohortResult) -> Figure:
    """Return the figure of a cohort."""
    summary = _by_patient(result)
    varied = [name for name in result.settings["columns"] if summary[name].nunique() > 1]
    names = varied[:MAX_PANELS] or [""]
    left_out = f" Not shown: {', '.join(varied[MAX_PANELS:])}." if varied[MAX_PANELS:] else ""
    width = max(1.2 + 3.3 * len(names), 5.5)  # inches
    figure = blank(width, 9.2)
    rows = figure.subplots(3, len(names), squeeze=False, sharey="row", height_ratios=(0.7, 1.15, 1.15))
    for name, axes in zip(names, rows.T, strict=True):
        groups = group_patients(summary[name] if name else 0.0 * summary["success"])
        axes[0].set_title(label(name), loc="center", color=INK, pad=10)
        _draw_success(axes[0], summary, groups)
        _draw_outcome(axes[1], summary, name, groups, result)
        _draw_course(axes[2], summary, groups, result)
    for ax in rows[:, 1:].flat:
        ax.set_ylabel("")
    title = textwrap.fill(_title(result, summary), int(width / 0.12))
    caption = textwrap.fill(CAPTION + left_out, int(width / 0.075))
    figure.suptitle(title, fontsize=13, color=INK)
    figure.supxlabel(caption, x=0.01, ha="left", fontsize=8.5, color=PALE)
    return figure


def _by_patient(result: CohortResult) -> pd.DataFrame:
    """Return one row a patient: means over the trials."""
    judged = ["success", "success_last", outcome(result.summary, result.settings)[0]]
    grouped = result.summary.groupby("patient", sort=False, observed=True)
    entries = grouped[result.settings["columns"]].first()
    return entries.join(grouped[judged].mean())


def outcome(summary: pd.DataFrame, settings: dict[str, Any]) -> tuple[str, str, float]:
    """Return the column that is the outcome, its axis label, and the factor to the unit shown."""
    if "final_error" not in summary:
        return "return", "Return", 1.0
    unit, factor = SHOWN_AS.get(settings["units"]["final_error"], ("", 1.0))
    return "final_error", f"Error in the last quarter [{unit}]", factor


def label(name: str) -> str:
    """Return the axis label of a column, "" for none."""
    if not name:
        return ""
    column = COLUMNS[name]
    return f"{column.label} [{column.unit}]" if column.unit else column.label


def _title(result: CohortResult, summary: pd.DataFrame) -> str:
    """Return what was run, and how it went."""
    settings = result.settings
    duration = settings["steps"] * settings["control_dt"]
    trials = "" if settings["trials"] == 1 else f"{settings['trials']} trials of "
    return (
        f"{len(summary):,} patients, {settings['task'].removeprefix('MyoWarp/')}, {trials}{duration:g} s, "
        f"policy {settings['policy']!r}: {100 * summary['success_last'].mean():.0f} % solved on the last "
        f"step, {100 * summary['success'].mean():.0f} % successful"
    )


def _draw_success(ax: Axes, summary: pd.DataFrame, groups: Groups) -> None:
    """Bars: share of successful episodes by group."""
    share = [100.0 * summary["success"][member].mean() for member in groups.members]
    ax.bar(np.arange(len(share)), share, color=groups.colors, width=0.72)
    for i, value in enumerate(share):
        ax.annotate(f"{value:.0f}", (i, value), (0, 2), textcoords="offset points", ha="center", fontsize=9)
    numbered = [f"{label}\nn = {m.sum()}" for label, m in zip(groups.labels, groups.members, strict=True)]
    ax.set_xticks(np.arange(len(share)), numbered)
    ax.tick_params(axis="x", labelsize=7.5, length=0)
    ax.set(ylim=(0, 112), ylabel="Successful [%]", yticks=[0, 50, 100])


def _draw_outcome(ax: Axes, summary: pd.DataFrame, name: str, groups: Groups, result: CohortResult) -> None:
    """Points: every patient; line: median; band: the middle half."""
    key, name_of_outcome, factor = outcome(result.summary, result.settings)
    values = factor * summary[key].to_numpy()
    group = groups.members.argmax(axis=0)
    shown = groups.members.any(axis=0)
    if groups.exact:
        members, centers = groups.members, np.arange(len(groups.labels), dtype=float)
        scatter = (0.6180339887 * np.arange(len(group))) % 1.0 - 0.5  # even, and as unlike chance as can be
        x = group + 0.5 * scatter
    else:
        x = summary[name].to_numpy(dtype=float)
        tenth = np.searchsorted(np.quantile(x, np.linspace(0.1, 0.9, 9)), x, side="right")
        members = np.array([tenth == t for t in range(10) if (tenth == t).any()])
        centers = np.array([np.median(x[member]) for member in members])
    ax.scatter(
        x[shown], values[shown], s=8, c=np.array(groups.colors)[group[shown]], alpha=0.45, linewidths=0
    )
    low, middle, high = edges = np.array([quarters(values[member]) for member in members]).T
    if groups.exact:
        spans = (middle - low, high - middle)
        ax.errorbar(centers, middle, spans, fmt="_", ms=30, mew=2.2, color=INK, capsize=5, elinewidth=1.6)
        ax.set_xticks(centers, groups.labels)
        ax.set_xlim(-0.6, len(centers) - 0.4)
    else:
        band(ax, centers, edges, color=INK, alpha=0.13, linewidth=2.2)
    ax.set(xlabel=label(name), ylabel=name_of_outcome, ylim=(min(0.0, 1.05 * values.min()), None))


def _draw_course(ax: Axes, summary: pd.DataFrame, groups: Groups, result: CohortResult) -> None:
    """Lines: median over time by group; bands: the middle half."""
    samples = result.samples
    key = "tracking_error" if "tracking_error" in samples else "reward"
    unit, factor = SHOWN_AS.get(result.settings["units"].get(key, ""), ("", 1.0))
    wide = samples.pivot_table(index="time", columns=["patient", "trial"], values=key, observed=True)
    patient = wide.columns.get_level_values("patient")
    for color, group, member in zip(groups.colors, groups.labels, groups.members, strict=True):
        chosen = factor * wide.loc[:, patient.isin(summary.index[member])]
        edges = chosen.quantile((0.25, 0.5, 0.75), axis=1)
        band(ax, wide.index, edges, color=color, linewidth=2.0, label=group)
    ax.set(xlabel="Time [s]", ylabel=f"Tracking error [{unit}]" if key == "tracking_error" else "Reward")
    ax.set(ylim=(0.0 if key == "tracking_error" else None, None), xlim=(0.0, wide.index.max()))
    if len(groups.labels) > 1:
        columns = 2 if max(map(len, groups.labels)) > 8 else len(groups.labels)
        ax.legend(
            fontsize=8,
            loc="lower center",
            bbox_to_anchor=(0.5, 0.99),
            ncols=columns,
            handlelength=1.4,
            columnspacing=1.2,
        )

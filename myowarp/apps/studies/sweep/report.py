"""Output of a study: a live table, then runs.csv, table.csv and study.png with intervals."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from myowarp.apps.reports import panel, table
from myowarp.apps.reports.result import Merit
from myowarp.apps.studies.sweep.study import Run
from myowarp.inks import BLUE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RUNS, TABLE, PLOT = "runs.csv", "table.csv", "study.png"
ROW, WIDTH = 0.32, 3.4  # inches of a cell, of a panel
Results = Mapping[str, Mapping[str, Any]]


def measures(result: Mapping[str, Any]) -> dict[str, tuple[float, float, float]]:
    """Return what a run measured by name: the value and its 95 % interval, NaN where there is none."""
    figures, none = result["figures"], (math.nan, math.nan)
    found: dict[str, tuple[float, float, float]] = {}
    for merit in figures.get("merits", ()):
        name = ", ".join(filter(None, (merit["quantity"], merit["condition"])))
        label = Merit(name, merit["unit"], "", ()).label
        ours, low, high = (math.nan if merit[k] is None else merit[k] for k in ("ours", "low", "high"))
        found[label] = ours, low, high
    for mode in ("deterministic", "sampled"):
        if mode in figures:
            same = figures[mode].get("one_episode")  # which older results do not say
            low, high = none if same else figures[mode]["intervals"]["success"]
            found[f"success, {mode} [%]"] = 100 * figures[mode]["success"], 100 * low, 100 * high
            found[f"return, {mode}"] = figures[mode]["return_mean"], *none
    if "training" in figures:
        found["samples [M]"] = figures["training"]["samples"] / 1e6, *none
    return found


def cells(runs: Iterable[Run]) -> dict[str, list[Run]]:
    """Return the runs that differ in their seeds alone, by what they share; in words where others differ."""
    runs = list(runs)
    axes = list(dict.fromkeys(axis for run in runs for axis in run.cell))
    varied = [axis for axis in axes if len({run.cell.get(axis) for run in runs}) > 1] or ["task"]
    found: dict[str, list[Run]] = {}
    for run in runs:
        words = [run.cell[axis] if axis == "task" else f"{axis} {run.cell[axis]}" for axis in varied]
        found.setdefault(", ".join(words), []).append(run)
    return found


def summary(runs: Iterable[Run], results: Results) -> list[dict[str, Any]]:
    """Return a row for each cell and measure: the mean over seeds with its 95 % interval.

    The interval is Student's over the seeds; with one seed, that of its run (Wilson's of a success).
    """
    rows = []
    for cell, members in cells(runs).items():
        done = [measures(results[run.name]) for run in members if run.name in results]
        for name in dict.fromkeys(name for one in done for name in one):
            values = [one[name] for one in done if name in one]
            merit = Merit(name, "", "", [value[0] for value in values])
            low, high = merit.interval if len(values) > 1 else values[0][1:]
            row = {"cell": cell, "measure": name, "mean": merit.mean, "low": low, "high": high}
            rows.append(row | {"n": len(values)})
    return rows


def live_table(runs: Iterable[Run], results: Results, failures: Mapping[str, str]) -> Table:
    """Return how far each cell is."""
    first, lines = {row["cell"]: row for row in reversed(summary(runs, results))}, []
    for cell, members in cells(runs).items():
        done = sum(run.name in results for run in members)
        failed = sum(run.name in failures for run in members)
        text = f"{first[cell]['mean']:.4g} {first[cell]['measure']}" if cell in first else ""
        lines.append((cell, str(done), str(failed), str(len(members) - done - failed), text))
    return table.terminal(("", "done", "failed", "left", "mean of the first measure"), lines)


def final_table(rows: Iterable[Mapping[str, Any]]) -> Table:
    """Return means with intervals, a row for each cell and measure."""
    lines = [
        (
            *(row["cell"], row["measure"], f"{row['mean']:.4g}"),
            "" if math.isnan(row["low"]) else f"{row['low']:.4g} to {row['high']:.4g}",
            str(row["n"]),
        )
        for row in rows
    ]
    return table.terminal(("", "", "mean", "95 % interval", "seeds"), lines)


def write(output: Path, runs: list[Run], results: Results) -> list[Path]:
    """Write runs.csv, table.csv and, with matplotlib, study.png; return their paths.

    Raises:
        OSError: They cannot be written.
    """
    done = [run for run in runs if run.name in results]
    each = []
    for run in done:
        result = results[run.name]
        values = {name: value[0] for name, value in measures(result).items()}
        head = {"run": run.name, **run.cell, "seed": run.seed, "seconds": round(result["seconds"], 1)}
        each.append(head | values)
    rows = summary(runs, results)
    for name, lines in ((RUNS, each), (TABLE, rows)):
        table.save_csv(output / name, lines)
    if importlib.util.find_spec("matplotlib") is None or not rows:
        return [output / RUNS, output / TABLE]
    with panel.style(10.0):
        panel.save(_drawn(rows), output / PLOT)
    return [output / RUNS, output / TABLE, output / PLOT]


def _drawn(rows: list[dict[str, Any]]) -> Figure:
    """Return a figure with a panel for each measure: a point with its interval for each cell."""
    names = list(dict.fromkeys(row["measure"] for row in rows))
    places = {cell: i for i, cell in enumerate(dict.fromkeys(row["cell"] for row in rows))}
    columns = min(3, len(names))
    lines = math.ceil(len(names) / columns)
    figure = panel.blank(WIDTH * columns + 2.0, lines * (1.0 + ROW * len(places)))
    panels = figure.subplots(lines, columns, sharey=True, squeeze=False).ravel()
    for axes, name in zip(panels, names, strict=False):
        for row in rows:
            if row["measure"] == name:
                place, span = places[row["cell"]], (row["low"], row["high"])
                axes.plot(span, (place, place), color=BLUE, linewidth=3, alpha=0.4)
                axes.plot(row["mean"], place, "o", color=BLUE, markersize=5)
        axes.set(xlabel=name, yticks=list(places.values()), yticklabels=list(places))
        axes.grid(visible=False, axis="y")
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    panels[0].invert_yaxis()
    figure.suptitle("Mean over seeds and its 95 % interval", fontsize="medium")
    return figure

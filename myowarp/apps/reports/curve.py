"""The curve of a training: return and success over samples, of its `progress.csv`."""

import importlib.util
from pathlib import Path

import numpy as np

from myowarp.apps.reports import panel
from myowarp.apps.reports.evaluation import SUCCESSES
from myowarp.apps.reports.table import read_numbers

CSV, CURVE = "progress.csv", "curve.png"
SELECTED = "means under parity (selection)"


def draw_curve(folder: Path, title: str) -> Path | None:
    """Draw the curve into the run's folder; None without matplotlib or episodes."""
    if importlib.util.find_spec("matplotlib") is None:
        return None
    columns = read_numbers(folder / CSV)
    if "return" not in columns:
        return None
    known = np.isfinite(columns["return"])
    samples = columns["samples"][known] / 1e6
    with panel.style(10.0):
        figure = panel.blank(8.0, 3.2)
        left, right = figure.subplots(1, 2)
        left.plot(samples, columns["return"][known])
        left.set(xlabel="samples [million]", ylabel="return")
        for name, rule in SUCCESSES.items():
            right.plot(samples, 100.0 * columns[name][known], label=rule)
        chosen = columns.get("selection_success", np.full(len(known), np.nan))[known]
        if np.isfinite(chosen).any():
            right.plot(samples, 100.0 * chosen, "k", drawstyle="steps-post", label=SELECTED)
        right.set(xlabel="samples [million]", ylabel="success [%]", ylim=(-2, 102))
        right.legend(fontsize="small")
        figure.suptitle(title, fontsize="medium")
        panel.save(figure, folder / CURVE, dpi=150)
    return folder / CURVE

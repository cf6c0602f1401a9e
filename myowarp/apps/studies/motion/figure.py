"""A picture of the muscle forces of a trial, with intervals over draws: the strongest muscles first."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from myowarp.apps.reports.panel import band, grid, save, style
from myowarp.inks import BLUE

SHOWN, COLUMNS = 24, 6


def draw_forces(
    path: Path, trial: str, muscles: Sequence[str], time: np.ndarray, lines: Sequence[np.ndarray]
) -> None:
    """Draw forces over time, where matplotlib is installed.

    Args:
        path: A .png file.
        trial: Name, for the title.
        muscles: Names.
        time: [s], shape (frames,).
        lines: Forces of the trial as it is [N], shape (frames, muscles), and both ends of intervals.

    Raises:
        OSError: The file cannot be written.
    """
    if importlib.util.find_spec("matplotlib") is None:
        return
    chosen = np.argsort(-lines[0].max(axis=0), kind="stable")[:SHOWN]
    columns = min(COLUMNS, len(chosen))
    with style():
        figure, panels = grid(len(chosen), columns, 2.4 * columns, 1.7, 0.5, sharex=True)
        for axes, k in zip(panels, chosen, strict=True):
            middle, low, high = (lines[n if len(lines) > 1 else 0][:, k] for n in (0, 1, 2))
            band(axes, time, (low, middle, high), color=BLUE, linewidth=1.4)
            axes.set_title(muscles[k])
            axes.set_ylim(0.0, None)
        for axes in panels[(len(chosen) - 1) // columns * columns :]:
            axes.set_xlabel("Time [s]")
        for axes in panels[::columns]:
            axes.set_ylabel("Force [N]")
        note = "; band: 90 % of the draws" if len(lines) > 1 else ""
        figure.suptitle(f"{trial}: forces of the strongest muscles{note}", x=0.01, ha="left")
        save(figure, path)

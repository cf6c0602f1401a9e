"""A picture of activations over electromyograms: the least alike first."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from myowarp.apps.reports.panel import grid, save, style
from myowarp.inks import BLUE, ORANGE
from myowarp.motion.emg import Comparison

COLUMNS = 4


def draw_emg(path: Path, compared: Comparison) -> None:
    """Draw envelopes, later by the delay of each muscle, and activations, where matplotlib is installed.

    Raises:
        OSError: The file cannot be written.
    """
    if importlib.util.find_spec("matplotlib") is None:
        return
    envelope, activation, found = compared.envelope, compared.activation, compared.found
    columns = min(COLUMNS, len(found))
    with style():
        figure, panels = grid(len(found), columns, 2.8 * columns, 1.8, 0.5, sharex=True, sharey=True)
        for place, (axes, one) in enumerate(zip(panels, found, strict=True)):
            emg = envelope.values[:, envelope.labels.index(one.muscle)]
            axes.fill_between(envelope.time + one.delay, emg, color=ORANGE, alpha=0.35, linewidth=0)
            axes.plot(activation.time, activation.values[:, activation.labels.index(one.muscle)], color=BLUE)
            axes.set_title(f"{one.muscle}: r {one.correlation:.2f}, {1e3 * one.delay:.0f} ms later")
            axes.set_xlim(activation.time[0], activation.time[-1])
            axes.set_ylim(0.0, 1.02)
            axes.tick_params(labelbottom=place + columns >= len(found))  # below it, the column has no panel
        figure.supxlabel("Time [s]")
        figure.supylabel("Activation; envelope over its maximum [1]")
        title = "Activation (line) over the envelope of the electromyogram, moved by the delay with the "
        title += "highest correlation r; the least alike first"
        figure.suptitle(title, x=0.01, ha="left", fontsize=9)
        save(figure, path)

"""Figures and their panels: one style, and the marks that studies share."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from myowarp.disk import in_place
from myowarp.inks import INKS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK = "#222222"
EVEN_LUMINANCE = 0.213  # on which white and INK have the same contrast
LINES = {"color": 2 * INKS, "linestyle": len(INKS) * ("-",) + len(INKS) * ("--",)}
"""Of lines in one panel: no two look alike."""
DPI = 110
TICK = r"\mathdefault"
"""Matplotlib's command before powers of ten on axes."""


@contextmanager
def style(size: float = 8.5, **settings: Any) -> Iterator[None]:
    """Draw and save in the house's style.

    Args:
        size: Size of the font [pt]; titles have one more.
        settings: Settings of matplotlib's that differ.

    Raises:
        ImportError: matplotlib is not installed.
    """
    import matplotlib

    common: Any = {
        "font.size": size,
        "axes.titlesize": size + 1.0,
        "axes.titlelocation": "left",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.alpha": 0.25,
        "legend.frameon": False,
        "pdf.fonttype": 42,
        "svg.fonttype": "none",
        "svg.hashsalt": "myowarp",
    }
    with matplotlib.rc_context(common | settings):
        yield


def ink_on(color: ArrayLike) -> str:
    """Return the colour of words on such a cell, white or `INK`: relative luminance of WCAG 2.1."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in np.asarray(color)[:3]]
    return "white" if np.dot((0.2126, 0.7152, 0.0722), linear) < EVEN_LUMINANCE else INK


def blank(width: float, height: float) -> Figure:
    """Return an empty figure of a size in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def grid(
    count: int, across: int, width: float, height: float, head: float, **shared: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure with so many panels, and these.

    Args:
        count: Of panels.
        across: Panels beside each other.
        width: Of the figure [in].
        height: Of a row [in].
        head: Above all rows [in].
        shared: What else `Figure.subplots` takes.
    """
    rows = -(-count // across)
    figure = blank(width, head + height * rows)
    panels = list(figure.subplots(rows, across, squeeze=False, **shared).flat)
    for axes in panels[count:]:
        axes.set_visible(False)
    return figure, panels[:count]


def picture(figure: Figure, form: str, dpi: float = DPI) -> bytes:
    """Return a figure in a format of matplotlib's, such as png, svg or pdf; no date is in it."""
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        if "$" in text.get_text() and TICK not in text.get_text():  # a name of a model's, no formula
            text.set_parse_math(False)
    date = {"svg": "Date", "pdf": "CreationDate"}.get(form)
    buffer = io.BytesIO()
    figure.savefig(buffer, format=form, dpi=dpi, metadata=date and {date: None})
    return buffer.getvalue()


def save(figure: Figure, path: Path, dpi: float = DPI) -> None:
    """Write a figure in the format of the path's suffix, whole or not at all.

    Raises:
        OSError: The file cannot be written.
    """
    with in_place(path) as scratch:
        scratch.write_bytes(picture(figure, path.suffix[1:].lower(), dpi))


def extent(values: ArrayLike) -> np.ndarray:
    """Return least, mean and greatest value over the first axis."""
    values = np.asarray(values)
    return np.array((values.min(axis=0), values.mean(axis=0), values.max(axis=0)))


def quarters(values: ArrayLike) -> np.ndarray:
    """Return lower quartile, median and upper quartile over the first axis."""
    return np.quantile(np.asarray(values), (0.25, 0.5, 0.75), axis=0)


def band(
    axes: Axes,
    x: ArrayLike,
    lines: ArrayLike,
    form: str = "-",
    *,
    color: str,
    alpha: float = 0.2,
    **line: Any,
) -> None:
    """Draw a line within a band.

    Args:
        axes: The panel.
        x: Where, shape (n,).
        lines: Lower edge, line and upper edge, as `extent` returns them, shape (3, n).
        form: Format of the line.
        color: Of both.
        alpha: Opacity of the band.
        line: What else `Axes.plot` takes.
    """
    low, middle, high = np.asarray(lines)
    axes.fill_between(x, low, high, color=color, alpha=alpha, linewidth=0)
    axes.plot(x, middle, form, color=color, **line)


def bars(axes: Axes, places: ArrayLike, values: np.ndarray, width: float, **bar: Any) -> None:
    """Draw the mean over seeds as bars and every seed as a dot.

    Args:
        axes: The panel.
        places: Middles of the bars, shape (n,).
        values: Of seeds, shape (seeds, n).
        width: Of a bar.
        bar: What else `Axes.bar` takes.
    """
    axes.bar(places, values.mean(axis=0), width, **bar)
    axes.plot(np.tile(places, len(values)), values.ravel(), "k.", markersize=4)

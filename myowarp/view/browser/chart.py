"""Curves over time as small pictures side by side, as SVG for the page and as PNG for a file."""

from __future__ import annotations

import html
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from PIL import Image, ImageDraw, ImageFont

INK, GRID, BORDER = "#1f2937", "#e5e7eb", "#9ca3af"
LEFT, RIGHT, TOP, BOTTOM = 52, 8, 20, 20
"""px around a curve's area."""
CHARACTER = 6
"""px of a character, about."""
LINE = 13
"""px of a line of text in the legend."""
SHARPNESS = 2
"""Pixels of a PNG for one of the page."""
FONT = 11
STEPS = (1.0, 2.0, 5.0, 10.0)
"""First figures of the distances between ticks."""


@dataclass(frozen=True)
class Curve:
    """A line.

    Attributes:
        label: What it is.
        values: Its values, shape (num_times,); NaN where there is none.
        color: Its colour, `#rrggbb`.
        dash: Pixels drawn and left out by turns; () for a full line.
    """

    label: str
    values: np.ndarray
    color: str
    dash: tuple[int, ...] = ()


@dataclass(frozen=True)
class Chart:
    """Curves with one axis.

    Attributes:
        title: Quantity and unit.
        along: Where the values are: times [s], or a coordinate; shape (num_times,).
        curves: The curves.
        borders: Places in `along` where an episode begins; curves are not joined across them.
        axis: What `along` is.
        now: Where in `along` a line marks what is shown; None: nowhere.
    """

    title: str
    along: np.ndarray
    curves: Sequence[Curve]
    borders: Sequence[float] = ()
    axis: str = "time / s"
    now: float | None = None


class Pen(Protocol):
    """A drawing surface; places are px from the upper left."""

    def line(self, points: np.ndarray, color: str, width: float, dash: tuple[int, ...]) -> None:
        """Draw a line through points (n, 2)."""

    def text(self, x: float, y: float, text: str, color: str, anchor: str) -> None:
        """Write with the baseline at a point; the anchor is start, middle or end."""


def as_svg(charts: Sequence[Chart], width: int, height: int) -> str:
    """Return charts side by side as an SVG element."""
    pen = _SvgPen()
    _draw(charts, pen, width, height)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="100%" '
        f'font-family="sans-serif" font-size="{FONT}">{"".join(pen.parts)}</svg>'
    )


def as_png(charts: Sequence[Chart], width: int, height: int) -> bytes:
    """Return charts side by side as a PNG."""
    picture = Image.new("RGB", (SHARPNESS * width, SHARPNESS * height), "white")
    _draw(charts, _PicturePen(ImageDraw.Draw(picture)), width, height)
    file = io.BytesIO()
    picture.save(file, "PNG")
    return file.getvalue()


def as_csv(charts: Sequence[Chart]) -> str:
    """Return charts with one axis as a table: the axis, and a column for each curve."""
    names = [charts[0].axis, *(f"{curve.label}, {chart.title}" for chart in charts for curve in chart.curves)]
    return csv_of(names, [charts[0].along, *(curve.values for chart in charts for curve in chart.curves)])


def csv_of(names: Sequence[str], columns: Iterable[Iterable[float]]) -> str:
    """Return columns as a table under their names."""
    lines = [",".join(f'"{name}"' if "," in name else name for name in names)]
    lines += [",".join(f"{value:.9g}" for value in row) for row in zip(*columns, strict=True)]
    return "\n".join(lines) + "\n"


def _draw(charts: Sequence[Chart], pen: Pen, width: int, height: int) -> None:
    """Draw charts side by side."""
    for index, chart in enumerate(charts):
        left, right = width * index / len(charts), width * (index + 1) / len(charts)
        _draw_one(chart, pen, left + LEFT, right - RIGHT, TOP, height - BOTTOM)


def _draw_one(chart: Chart, pen: Pen, left: float, right: float, top: float, bottom: float) -> None:
    """Draw a chart into the area between pixels."""
    top = top + LINE * ((len(chart.curves) + 1) // 2)
    low, high = _ends(np.concatenate([curve.values for curve in chart.curves] or [np.zeros(0)]))
    begin, end = (chart.along[0], chart.along[-1]) if len(chart.along) > 1 else (0.0, 1.0)

    def x(place: np.ndarray | float) -> np.ndarray:
        return left + (np.asarray(place) - begin) / max(end - begin, 1e-9) * (right - left)

    def y(value: np.ndarray | float) -> np.ndarray:
        return bottom - (np.asarray(value) - low) / (high - low) * (bottom - top)

    pen.text(left, TOP - 8, chart.title, INK, "start")
    for tick in _ticks(low, high, 4):
        pen.line(np.array(((left, y(tick)), (right, y(tick)))), GRID, 1.0, ())
        pen.text(left - 4, float(y(tick)) + 4, f"{tick:.4g}", INK, "end")
    ticks = _ticks(begin, end, 5)
    for tick in ticks[x(ticks) < right - CHARACTER * (len(chart.axis) + 2)]:
        pen.text(float(x(tick)), bottom + 14, f"{tick:.4g}", INK, "middle")
    pen.text(right, bottom + 14, chart.axis, INK, "end")
    for border in chart.borders:
        pen.line(np.array(((x(border), top), (x(border), bottom))), BORDER, 1.0, (3, 3))
    if chart.now is not None:
        pen.line(np.array(((x(chart.now), top), (x(chart.now), bottom))), INK, 1.2, ())
    for index, curve in enumerate(chart.curves):
        for piece in _pieces(chart, curve.values):
            points = np.stack((x(chart.along[piece]), y(curve.values[piece])), axis=1)
            pen.line(points, curve.color, 1.6, curve.dash)
        line, column = divmod(index, 2)
        place, height = left + column * (right - left) / 2, TOP + LINE * line + 4
        pen.line(np.array(((place, height - 4), (place + 18, height - 4))), curve.color, 2.0, curve.dash)
        pen.text(place + 22, height, curve.label, INK, "start")


def _ends(values: np.ndarray) -> tuple[float, float]:
    """Return the ends of an axis that holds values."""
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 0.05
    return low - margin, high + margin


def _ticks(low: float, high: float, count: int) -> np.ndarray:
    """Return about as many round numbers between two."""
    raw = max(high - low, 1e-12) / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * next(figure for figure in STEPS if figure * power >= 0.999 * raw)
    ticks = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    return np.where(np.abs(ticks) < 1e-9 * step, 0.0, ticks)


def _pieces(chart: Chart, values: np.ndarray) -> list[np.ndarray]:
    """Return indices of the parts of a curve that are drawn in one: no gap, no border inside."""
    cuts = np.isin(chart.along, list(chart.borders))
    number = np.cumsum(cuts | ~np.isfinite(values))
    kept = np.flatnonzero(np.isfinite(values))
    groups = np.split(kept, np.flatnonzero(np.diff(number[kept])) + 1)
    return [group for group in groups if len(group) > 1]


class _SvgPen:
    """Draws SVG."""

    def __init__(self) -> None:
        self.parts: list[str] = []

    def line(self, points: np.ndarray, color: str, width: float, dash: tuple[int, ...]) -> None:
        places = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        dashes = f' stroke-dasharray="{" ".join(map(str, dash))}"' if dash else ""
        self.parts.append(
            f'<polyline points="{places}" fill="none" stroke="{color}" stroke-width="{width:g}"{dashes}/>'
        )

    def text(self, x: float, y: float, text: str, color: str, anchor: str) -> None:
        self.parts.append(
            f'<text x="{x:.1f}" y="{y:.1f}" fill="{color}" text-anchor="{anchor}">{html.escape(text)}</text>'
        )


class _PicturePen:
    """Draws into an image."""

    def __init__(self, draw: ImageDraw.ImageDraw) -> None:
        self._draw, self._font = draw, ImageFont.load_default(SHARPNESS * FONT)

    def line(self, points: np.ndarray, color: str, width: float, dash: tuple[int, ...]) -> None:
        points, thick = SHARPNESS * np.asarray(points, dtype=float), round(SHARPNESS * width)
        parts = _dashed(points, SHARPNESS * np.array(dash)) if dash else [points]
        for part in parts:
            self._draw.line([(float(x), float(y)) for x, y in part], color, thick, "curve")

    def text(self, x: float, y: float, text: str, color: str, anchor: str) -> None:
        place = {"start": "ls", "middle": "ms", "end": "rs"}[anchor]
        self._draw.text((SHARPNESS * x, SHARPNESS * y), text, color, self._font, place)


def _dashed(points: np.ndarray, dash: np.ndarray) -> list[np.ndarray]:
    """Return the parts of a line that a pattern of dashes leaves."""
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    marks = np.concatenate(([0.0], np.cumsum(lengths)))
    found, place, index = [], 0.0, 0
    while place < marks[-1]:
        after = min(place + dash[index % len(dash)], marks[-1])
        if index % 2 == 0:
            inside = marks[(marks > place) & (marks < after)]
            at = np.concatenate(([place], inside, [after]))
            found.append(np.stack([np.interp(at, marks, points[:, k]) for k in (0, 1)], axis=1))
        place, index = after, index + 1
    return found

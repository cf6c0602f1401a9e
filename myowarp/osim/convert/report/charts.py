"""Small charts as SVG text: lines over one axis, maps of numbers, and tendons seen from a side.

Written by hand since a model has hundreds of them: a page of 80 muscles takes less than a second.
"""

import base64
import math
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

Array = np.ndarray

WIDTH, HEIGHT = 250, 170
LEFT, RIGHT, TOP, BOTTOM = 42, 8, 20, 30
RAMP = np.array([[255, 255, 255], [253, 212, 158], [252, 141, 89], [179, 0, 0]], float)
"""Of numbers from 0 to 1: white, orange, dark red."""
DIVERGING = np.array([[33, 102, 172], [247, 247, 247], [178, 24, 43]], float)
"""Of numbers from -1 to 1: blue, white, red."""


@dataclass(frozen=True, eq=False)
class Line:
    """A curve of a chart; `style` is its class in the page's style sheet."""

    x: Array
    y: Array
    style: str


def chart(title: str, x_label: str, lines: Sequence[Line]) -> str:
    """Return lines over common axes; numbers that are not finite are gaps."""
    x = np.concatenate([line.x for line in lines])
    y = np.concatenate([line.y for line in lines])
    y = y[np.isfinite(y)] if np.isfinite(y).any() else np.zeros(1)
    low, high = min(float(y.min()), 0.0), max(float(y.max()), 0.0)
    room = 0.06 * (high - low) or 1.0
    ends = (float(x.min()), float(x.max()) if x.max() > x.min() else float(x.min()) + 1.0)
    box = _Box(ends, (low - room if low < 0 else low, high + room))
    parts = [_polyline(box, line) for line in lines]
    return _frame(title, x_label, "", box, "".join(parts))


def colored_map(
    title: str,
    x_label: str,
    x: tuple[float, float],
    y: tuple[float, float],
    y_label: str,
    values: Array,
    unit: float,
) -> str:
    """Return a map of numbers, values (x, y); `unit` is the number with the strongest color.

    Values are drawn from white to red if none is negative, else from blue over white to red.
    """
    signed = bool((values < 0).any())
    color = colors(values.T[::-1] / (unit or 1.0), signed)
    box = _Box(x, y)
    picture = base64.b64encode(png(color)).decode()
    image = (
        f'<image x="{LEFT}" y="{TOP}" width="{box.width}" height="{box.height}" preserveAspectRatio="none" '
        f'style="image-rendering:pixelated" href="data:image/png;base64,{picture}"/>'
    )
    return _frame(title, x_label, y_label, box, image)


def colors(values: Array, signed: bool) -> Array:
    """Return colors of numbers from 0 to 1, or -1 to 1, as bytes, shape (..., 3)."""
    ramp = DIVERGING if signed else RAMP
    place = np.nan_to_num((values + 1.0) / 2.0 if signed else values)
    place = np.clip(place, 0.0, 1.0) * (len(ramp) - 1)
    low = np.minimum(place.astype(int), len(ramp) - 2)
    return np.round(ramp[low] + (place - low)[..., None] * (ramp[low + 1] - ramp[low])).astype(np.uint8)


def legible(color: Array) -> str:
    """Return the style of a cell with a background (red, green, blue), its text light on what is dark."""
    red, green, blue = (int(part) for part in color)
    text = "" if 0.299 * red + 0.587 * green + 0.114 * blue > 140 else ";color:#fff"
    return f"background:rgb({red},{green},{blue}){text}"


def png(pixels: Array) -> bytes:
    """Return an image of bytes (height, width, 3) as PNG."""
    height, width, _ = pixels.shape
    rows = b"".join(b"\0" + row.tobytes() for row in np.ascontiguousarray(pixels))

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )


def outline(title: str, strokes: Sequence[tuple[str, Array]], dots: Array) -> str:
    """Return polylines (style, points (n, 2)) and dots (n, 2) in one scale, the second axis up.

    A style is a class, or `class:color`; the class `bone` has an edge.
    """
    size = 380
    points = np.concatenate([dots, *(stroke for _, stroke in strokes)]) if len(strokes) else dots
    low, high = points.min(axis=0), points.max(axis=0)
    scale = (size - 30) / max(float((high - low).max()), 1e-6)
    shift = (np.array([size, size]) - scale * (high - low)) / 2

    def at(place: Array) -> Array:
        x = shift + scale * (place - low)
        return np.stack([x[..., 0], size - x[..., 1]], axis=-1)

    parts = []
    for style, stroke in strokes:
        kind, _, color = style.partition(":")
        places = _points(at(stroke))
        parts += [f'<polyline class="edge" points="{places}"/>'] if kind == "bone" else []
        painted = f' stroke="{color}"' if color else ""
        parts.append(f'<polyline class="{kind}"{painted} points="{places}"/>')
    parts += [f'<circle class="joint" r="2.2" cx="{x:.1f}" cy="{y:.1f}"/>' for x, y in at(dots)]
    return (
        f'<svg viewBox="0 0 {size} {size}" width="{size}" height="{size}"><text x="8" y="14" '
        f'class="title">{escape(title)}</text>{"".join(parts)}</svg>'
    )


class _Box:
    """The area of a chart and its scales."""

    width, height = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM

    def __init__(self, x: tuple[float, float], y: tuple[float, float]) -> None:
        self.x, self.y = x, y

    def place(self, x: Array, y: Array) -> Array:
        """Return where points are drawn, shape (n, 2)."""
        across = LEFT + self.width * (x - self.x[0]) / (self.x[1] - self.x[0])
        up = TOP + self.height * (self.y[1] - y) / (self.y[1] - self.y[0])
        return np.stack([across, up], axis=-1)


def _polyline(box: _Box, line: Line) -> str:
    known = np.isfinite(line.y)
    pieces = np.split(np.arange(len(line.y)), np.flatnonzero(np.diff(known.astype(int))) + 1)
    placed = box.place(line.x, np.nan_to_num(line.y))
    return "".join(
        f'<polyline class="{line.style}" points="{_points(placed[piece])}"/>'
        for piece in pieces
        if known[piece[0]]
    )


def _points(places: Array) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in places)


def _frame(title: str, x_label: str, y_label: str, box: _Box, content: str) -> str:
    """Return a chart with axes, ticks and labels around its content."""
    bottom, right = TOP + box.height, LEFT + box.width
    ticks = []
    for value in _ticks(*box.x):
        x = LEFT + box.width * (value - box.x[0]) / (box.x[1] - box.x[0])
        ticks.append(
            f'<path d="M{x:.1f} {bottom}v3"/><text x="{x:.1f}" y="{bottom + 12}" class="x">{value:g}</text>'
        )
    for value in _ticks(*box.y):
        y = TOP + box.height * (box.y[1] - value) / (box.y[1] - box.y[0])
        ticks.append(
            f'<path d="M{LEFT} {y:.1f}h-3"/><text x="{LEFT - 5}" y="{y + 3:.1f}" class="y">{value:g}</text>'
        )
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}">'
        f'<text x="{LEFT}" y="12" class="title">{escape(title)}</text>{content}'
        f'<path class="axis" d="M{LEFT} {TOP}V{bottom}H{right}"/><g class="axis">{"".join(ticks)}</g>'
        f'<text x="{right}" y="{HEIGHT - 4}" class="y">{escape(x_label)}</text>'
        f'<text x="{LEFT}" y="{HEIGHT - 4}">{escape(y_label)}</text></svg>'
    )


def _ticks(low: float, high: float) -> list[float]:
    """Return three to six round numbers between two."""
    step = 10.0 ** math.floor(math.log10(high - low))
    step = next(step * part for part in (1.0, 0.5, 0.2, 0.1) if (high - low) / (step * part) >= 3.0)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(number * step, 12) for number in range(first, last + 1)]

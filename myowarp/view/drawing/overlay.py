"""Text on a picture: lines, and the legend of the muscles' colours; MuJoCo draws both."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from myowarp.view.drawing.muscles import Quantity

INK = (0.13, 0.16, 0.21)
PAPER = (0.95, 0.97, 0.99, 0.6)
OVERSAMPLING = 2
"""Drawn pixels per image pixel and side; for meshes faster than Mesa's multisampling, and smoother."""
STRIPES = 40
"""Rectangles of which the colours of a legend are made."""
FONT_SIZES = (50, 100, 150, 200, 250, 300)  # percent, those that MuJoCo has
LAST_CHARACTER = 127  # of MuJoCo's font
TEXT_HEIGHT = 22.0  # px of MuJoCo's font at 100 percent, about


def font_size(height: int) -> int:
    """Return the size of MuJoCo's font for a picture of some height [px], in percent."""
    wanted = OVERSAMPLING * max(height / 30.0, 11.0) / TEXT_HEIGHT * 100.0
    return min(FONT_SIZES, key=lambda size: abs(size - wanted))


class Overlay:
    """Writes on the picture that a context has just drawn."""

    def __init__(self, context: mujoco.MjrContext, width: int, height: int) -> None:
        self._context, self._width, self._height = context, width, height
        self._line = int(1.35 * context.charHeight)
        self._pad = self._line // 3

    def text(self, lines: Sequence[str]) -> None:
        """Write lines into the upper left corner."""
        if not lines:
            return
        wide = max(self._text_width(line) for line in lines) + 2 * self._pad
        tall = len(lines) * self._line + self._pad
        top = self._height - self._pad
        mujoco.mjr_rectangle(mujoco.MjrRect(self._pad, top - tall, wide, tall), *PAPER)
        for row, line in enumerate(lines):
            self._write(line, 2 * self._pad, top - (row + 1) * self._line)

    def legend(self, quantity: Quantity) -> None:
        """Draw the colours of a quantity, with its name and its ends, into the lower left corner."""
        line, pad = self._line, self._pad
        bar = max(int(0.22 * self._width), self._text_width(quantity.label))
        mujoco.mjr_rectangle(mujoco.MjrRect(pad, pad, bar + 2 * pad, int(2.6 * line) + pad), *PAPER)
        colors = quantity.rgb(np.linspace(quantity.low, quantity.high, STRIPES))
        edges = np.linspace(2 * pad, 2 * pad + bar, STRIPES + 1).astype(int)
        for left, right, rgb in zip(edges[:-1], edges[1:], colors, strict=True):
            area = mujoco.MjrRect(int(left), int(pad + 1.15 * line), int(right - left), line // 2)
            mujoco.mjr_rectangle(area, *rgb, 1.0)
        low, high = f"{quantity.low:g}", f"{quantity.high:g}"
        self._write(quantity.label, 2 * pad, int(pad + 1.75 * line))
        self._write(low, 2 * pad, pad)
        self._write(high, 2 * pad + bar - self._text_width(high), pad)

    def _text_width(self, text: str) -> int:
        """Return the width of a text [px]."""
        return int(sum(self._context.charWidth[ord(c)] for c in text if ord(c) < LAST_CHARACTER))

    def _write(self, text: str, left: int, bottom: int) -> None:
        """Write a text with its lower left corner at a pixel."""
        # A rectangle without colour: text is placed in the area that was drawn last.
        mujoco.mjr_rectangle(mujoco.MjrRect(left, bottom, self._width, self._line), 0.0, 0.0, 0.0, 0.0)
        mujoco.mjr_text(mujoco.mjtFont.mjFONT_NORMAL, text, self._context, 0.0, 0.0, *INK)

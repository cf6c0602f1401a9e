"""Colours of curves, bars and marks in all figures and pages; eyes without one kind of cones tell them apart.

Source: Okabe and Ito (2008), Color Universal Design, https://jfly.uni-koeln.de/color/. Their yellow is left
out, since it is too pale for a line on white.
"""

BLUE, ORANGE, GREEN, PINK = "#0072b2", "#e69f00", "#009e73", "#cc79a7"
SKY, VERMILION, BLACK = "#56b4e9", "#d55e00", "#000000"
INKS = (BLUE, ORANGE, GREEN, PINK, SKY, VERMILION, BLACK)
"""For things without an order."""
RED = "#b3261e"
"""Of words that warn: darker than `VERMILION`, so that they can be read."""
SHADES = ("#b7d7ec", "#86badf", "#5a9ccf", "#377dbb", "#1f5c99", "#0d3d6e")
"""From little to much."""
WORSE, BETTER = ("#fdf6ee", ORANGE, "#8a4b08"), ("#f4f8fb", BLUE, "#0d3d6e")
"""Ends and middles of scales: of what is wanted little, and of what is wanted much."""


def shades(count: int) -> tuple[str, ...]:
    """Return up to six shades from light to dark, as far apart as they can be."""
    last = len(SHADES) - 1
    return tuple(SHADES[last - round(k * last / max(count - 1, 1))] for k in reversed(range(count)))

"""Piecewise polynomials: joints that follow others, points of paths that move, curves of ligaments.

Functions are chains of them, applied one after the other: last(...(first(x))).
"""

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from myowarp.kernels.structs import struct_of

EVERYWHERE = (-np.inf, np.inf)


@dataclass(frozen=True)
class Pieces:
    """A piecewise polynomial of one variable.

    Attributes:
        breaks: Where pieces begin, ascending; the first piece also covers all below.
        coefficients: Of each piece, ascending in powers of x minus its beginning.
        held: Beyond it the value stays as at its ends; slopes do not, as those of OpenSim's moving points.
    """

    breaks: tuple[float, ...]
    coefficients: tuple[tuple[float, ...], ...]
    held: tuple[float, float] = EVERYWHERE

    def derivatives(self, x: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return f(x), f'(x) and f''(x), each in the shape of `x`."""
        x = np.asarray(x, float)
        breaks, table = self._table
        piece = np.maximum(np.searchsorted(breaks, x, side="right") - 1, 0)
        d = x - breaks[piece]
        value, slope, bend = np.zeros((3, *x.shape))
        for coefficient in table[::-1, piece]:
            bend = bend * d + 2 * slope
            slope = slope * d + value
            value = value * d + coefficient
        if np.isfinite(self.held).any():
            value = dataclasses.replace(self, held=EVERYWHERE).derivatives(np.clip(x, *self.held))[0]
        return value, slope, bend

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """Breaks, shape (n,), and coefficients, shape (terms, n)."""
        rows = zip_longest(*self.coefficients, fillvalue=0.0)
        return np.array(self.breaks), np.array(list(rows))

    def value(self, x: ArrayLike) -> np.ndarray:
        """Return f(x)."""
        return self.derivatives(x)[0]

    def derivative(self, x: ArrayLike) -> np.ndarray:
        """Return f'(x)."""
        return self.derivatives(x)[1]

    def scaled(self, scale: float) -> "Pieces":
        """Return scale f(x)."""
        rows = tuple(tuple(scale * c for c in row) for row in self.coefficients)
        return Pieces(self.breaks, rows, self.held)

    def entry(self) -> list[object]:
        """Return what a text says of it: breaks, coefficients, and where it is held if it is."""
        held = [self.held] if np.isfinite(self.held).any() else []
        return [self.breaks, self.coefficients, *held]


def chain_of(curves: Iterable[Sequence[Any]]) -> tuple[Pieces, ...]:
    """Return the piecewise polynomials that a text says, each as `Pieces.entry` has it.

    Raises:
        ValueError: They are broken.
    """
    pieces = []
    for breaks, rows, *held in curves:
        if not breaks or len(breaks) != len(rows) or not all(rows) or (np.diff(breaks) < 0).any():
            raise ValueError("a curve needs as many pieces as breaks, and these must ascend")
        numbers = np.concatenate([breaks, *rows]).astype(float)
        if not np.isfinite(numbers).all():
            raise ValueError("a curve has a number that is not finite")
        low, high = held[0] if held else EVERYWHERE
        if not low <= high:
            raise ValueError(f"a curve must be held from a lower to a higher value, got {low} and {high}")
        table = tuple(tuple(map(float, row)) for row in rows)
        pieces.append(Pieces(tuple(map(float, breaks)), table, (float(low), float(high))))
    return tuple(pieces)


def line(slope: float, offset: float = 0.0) -> Pieces:
    """Return slope x + offset."""
    return Pieces((0.0,), ((offset, slope),))


@wp.struct
class PieceTables:
    """Functions of one variable as chains of piecewise polynomials, in float64.

    Attributes:
        first_curve: Of each function, and the number of all.
        first_piece: Of each curve, and the number of all.
        held: Of each curve: beyond, the value stays as at the ends, the slope does not.
        breaks: Where pieces begin.
        coefficients: Ascending in powers of the distance from there, shape (num_pieces, num_terms).
    """

    first_curve: wp.array[int]
    first_piece: wp.array[int]
    held: wp.array[wp.vec2d]
    breaks: wp.array[wp.float64]
    coefficients: wp.array2d[wp.float64]


@wp.func
def on_curve(tables: PieceTables, curve: int, x: wp.float64) -> wp.vec3d:
    """Return a curve's value, slope and second derivative."""
    piece, end = int(tables.first_piece[curve]), tables.first_piece[curve + 1]
    while piece + 1 < end and x >= tables.breaks[piece + 1]:
        piece += 1
    d = x - tables.breaks[piece]
    f, df, ddf = wp.float64(0.0), wp.float64(0.0), wp.float64(0.0)
    for k in range(tables.coefficients.shape[1] - 1, -1, -1):
        ddf = ddf * d + wp.float64(2.0) * df
        df = df * d + f
        f = f * d + tables.coefficients[piece, k]
    return wp.vec3d(f, df, ddf)


@wp.func
def evaluated(tables: PieceTables, number: int, x: wp.float64) -> wp.vec3d:
    """Return a function's value, slope and second derivative."""
    value, slope, bend = x, wp.float64(1.0), wp.float64(0.0)
    for curve in range(tables.first_curve[number], tables.first_curve[number + 1]):
        found, held = on_curve(tables, curve, value), tables.held[curve]
        bend = found[2] * slope * slope + found[1] * bend
        slope = found[1] * slope
        inside = wp.clamp(value, held[0], held[1])
        if inside != value:
            found = on_curve(tables, curve, inside)
        value = found[0]
    return wp.vec3d(value, slope, bend)


def piece_tables(chains: Iterable[tuple[Pieces, ...]]) -> PieceTables:
    """Return functions on the current Warp device."""
    chains = list(chains)
    held = [curve.held for chain in chains for curve in chain] or [(0.0, 0.0)]
    return struct_of(PieceTables, held=held, **packed(chains))


def packed(chains: Sequence[tuple[Pieces, ...]]) -> dict[str, np.ndarray]:
    """Return breaks and coefficients of functions and where they begin, as `PieceTables` has them."""
    curves = [curve for chain in chains for curve in chain]
    terms = max((len(row) for curve in curves for row in curve.coefficients), default=1)
    table = [(*row, *[0.0] * (terms - len(row))) for curve in curves for row in curve.coefficients]
    return {
        "first_curve": np.cumsum([0, *map(len, chains)]),
        "first_piece": np.cumsum([0, *(len(curve.breaks) for curve in curves)]),
        "breaks": np.array([b for curve in curves for b in curve.breaks] or [0.0]),
        "coefficients": np.array(table or [(0.0,) * terms]),
    }

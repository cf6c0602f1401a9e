"""Muscles as tubes: a belly and a tendon, as wide as they are strong, in the colour of what they do.

The belly is as long as the fibers are, keeps its volume, and lies nearer to the trunk, with the longer part
of the tendon beyond it. Its cross section is proportional to the peak force; the scale is the picture's, so
that muscles of a finger and of a leg are both readable. `QUANTITIES` are what colours can show.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import mujoco
import numpy as np

from myowarp.models.muscles.mujoco import length_scale, peak_force
from myowarp.view.drawing import style as look

RELAXED_RGB = np.array((0.43, 0.52, 0.66))
"""Blue-grey of a muscle at rest."""
TENSED_RGB = np.array((0.80, 0.06, 0.10))
"""Red of a muscle at full activation."""
UNKNOWN_RGB = np.array((0.60, 0.57, 0.54))
"""Muscle or motor of which nothing is known."""
TENDON_RGB = np.array((0.80, 0.76, 0.68))
TENDON_TINT = 0.35
"""Share of the belly's colour in the tendon's."""

WIDEST = 0.08
"""Radius of the strongest belly in a body with one muscle, in units of the framed radius."""
CROWDING = 0.3
"""Bellies get thinner with the number of muscles to this power."""
TENDON_WIDTH = 0.30
"""Radius of a tendon over that of its belly."""
BELLY = (0.5, 0.85)
"""Least and greatest share of the path that the belly takes."""
BULGE = (0.8, 1.25)
"""Least and greatest width of a belly over the one at optimal fiber length."""
PROXIMAL = 0.35
"""Share of the tendon on the trunk's side."""
JUMP = 1e-6
"""m: farther than that from the end of a piece of a path, the next piece is another branch."""
SHORTEST = 1e-12
"""m: what is shorter has no direction."""
PIECES = 350
"""Pieces that all bellies together may have; each is a capsule."""


@dataclass(frozen=True)
class Quantity:
    """A quantity that colours muscles.

    Attributes:
        label: What the legend says.
        low: Value of the first colour.
        high: Value of the last colour.
        colors: Colours in 0..1 from `low` to `high`, evenly spaced, shape (num_colors, 3).
    """

    label: str
    low: float
    high: float
    colors: tuple[tuple[float, float, float], ...]

    def rgb(self, values: np.ndarray) -> np.ndarray:
        """Return colours (n, 3) of values (n,); those beyond an end have its colour, NaN `UNKNOWN_RGB`."""
        share = np.clip((np.asarray(values, dtype=float) - self.low) / (self.high - self.low), 0.0, 1.0)
        places, colors = np.linspace(0.0, 1.0, len(self.colors)), np.array(self.colors)
        mixed = np.stack([np.interp(share, places, colors[:, k]) for k in range(3)], axis=-1)
        return np.where(np.isnan(share)[:, None], UNKNOWN_RGB, mixed)

    def css(self) -> str:
        """Return the colours from `low` to `high` as a background of a page."""
        stops = (f"rgb({r:.0f},{g:.0f},{b:.0f})" for r, g, b in 255 * np.array(self.colors))
        return f"linear-gradient(to right,{','.join(stops)})"


LEVEL = (tuple(RELAXED_RGB), tuple(TENSED_RGB))
STRETCH = ((0.10, 0.30, 0.75), (0.62, 0.62, 0.64), (0.90, 0.48, 0.05))
FRACTION = ((0.43, 0.52, 0.66), (0.85, 0.70, 0.20), (0.45, 0.10, 0.45))

QUANTITIES = {
    "activation": Quantity("activation", 0.0, 1.0, LEVEL),
    "excitation": Quantity("excitation", 0.0, 1.0, LEVEL),
    "force": Quantity("force / peak force", 0.0, 1.0, LEVEL),
    "fiber_length": Quantity("fiber length / optimal", 0.5, 1.5, STRETCH),
    "fatigue": Quantity("fatigue", 0.0, 1.0, FRACTION),
}


@dataclass(frozen=True)
class Tubes:
    """Capsules that make up muscles.

    Attributes:
        starts: Begin of each [m], shape (n, 3).
        ends: End of each [m], shape (n, 3).
        radii: Radius of each [m], shape (n,).
        owner: Muscle of each, shape (n,).
        belly: Whether it is part of the belly, shape (n,).
    """

    starts: np.ndarray
    ends: np.ndarray
    radii: np.ndarray
    owner: np.ndarray
    belly: np.ndarray


@dataclass(frozen=True)
class Bellies:
    """Rings along the bellies of muscles, as many in each.

    Attributes:
        muscles: Which muscle each is, shape (n,).
        centers: Middle of each ring [m], shape (n, num_rings, 3).
        radii: Radius of each ring [m], shape (n, num_rings).
    """

    muscles: np.ndarray
    centers: np.ndarray
    radii: np.ndarray

    def vertices(self, sides: int) -> np.ndarray:
        """Return points on the rings [m], ring by ring, shape (n, num_rings * sides, 3).

        From ring to ring the frame turns as little as it can, so that the surface is not twisted.
        """
        along = np.gradient(self.centers, axis=1)
        along /= np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-9)
        least = np.eye(3)[np.abs(along[:, 0]).argmin(axis=1)]
        across, angles = np.zeros_like(along), 2.0 * np.pi * np.arange(sides) / sides
        for ring in range(along.shape[1]):
            axis = along[:, ring]
            least = least - (least * axis).sum(axis=1, keepdims=True) * axis
            least /= np.maximum(np.linalg.norm(least, axis=1, keepdims=True), 1e-9)
            across[:, ring] = least
        circle = np.cos(angles)[:, None] * across[:, :, None]
        circle = circle + np.sin(angles)[:, None] * np.cross(along, across)[:, :, None]
        points = self.centers[:, :, None] + self.radii[:, :, None, None] * circle
        return points.reshape(len(points), -1, 3)


class Muscles:
    """The muscles of a model, as tubes.

    Attributes:
        tendons: Tendon of each muscle, in actuator order, shape (num_muscles,).
        peak_force: Peak force of each [N], shape (num_muscles,); motors on tendons: their greatest pull.
        optimal: Optimal fiber length [m], NaN for motors, shape (num_muscles,).
        slack: Tendon slack length [m], NaN for motors, shape (num_muscles,).
    """

    def __init__(self, model: mujoco.MjModel, radius: float) -> None:
        """Read forces and lengths.

        Args:
            model: The full model.
            radius: Framed radius [m], which sets the scale of the widths.
        """
        self._model = model
        on_tendon = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
        self.tendons = look.muscle_tendons(model)
        gain, bounds = model.actuator_gainprm[on_tendon], model.actuator_ctrlrange[on_tendon]
        self._is_muscle = model.actuator_gaintype[on_tendon] == mujoco.mjtGain.mjGAIN_MUSCLE
        pull = np.abs(bounds).max(axis=1, initial=0.0) * np.abs(
            gain[:, 0] * model.actuator_gear[on_tendon, 0]
        )
        self.peak_force = np.where(self._is_muscle, peak_force(gain, model.actuator_acc0[on_tendon]), pull)
        optimal, slack = length_scale(gain, model.actuator_lengthrange[on_tendon])
        self.optimal, self.slack = (np.where(self._is_muscle, own, np.nan) for own in (optimal, slack))
        number = max(len(self.tendons), 1)
        self._widest = WIDEST * radius / number**CROWDING
        self._samples = int(np.clip(PIECES / number, 6, 40))
        self._away = np.array([self._runs_outwards(tendon) for tendon in self.tendons], dtype=bool)

    @property
    def any(self) -> bool:
        """Whether there are muscles, not motors alone."""
        return bool(self._is_muscle.any())

    def belly_radius(self, strength: np.ndarray | None = None) -> np.ndarray:
        """Return the radius of each belly at optimal fiber length [m], shape (num_muscles,).

        Args:
            strength: Peak force of the world's own muscles [N]; None: the model's.
        """
        own = self.peak_force if strength is None else np.where(np.isnan(strength), self.peak_force, strength)
        return self._widest * np.sqrt(np.maximum(own, 0.0) / max(self.peak_force.max(initial=0.0), 1e-9))

    def tubes(
        self,
        data: mujoco.MjData,
        known: Mapping[str, np.ndarray] = MappingProxyType({}),
        thinnest: float = 0.0,
        pieces: int | None = None,
    ) -> Tubes:
        """Return the capsules of all muscles in a pose.

        Args:
            data: The data, posed, tendons computed.
            known: What a snapshot says of the muscles, by name; the model's own where it says nothing.
            thinnest: Least radius [m]; one pixel, so that a tendon is seen.
            pieces: Capsules of a straight belly at least; None: as many as it needs to look round.
        """
        paths = self._paths(data, known, thinnest)
        shares = np.linspace(0.0, 1.0, (self._samples if pieces is None else pieces) + 1)
        cuts = np.unique(np.concatenate((paths.marks, paths.places(shares).ravel())))
        cuts = cuts[np.diff(cuts, prepend=-1.0) > SHORTEST]
        middle = (cuts[:-1] + cuts[1:]) / 2
        segment = paths.segment(middle)
        owner = paths.owner[segment]
        first, last, thin = paths.first[owner], paths.last[owner], paths.thin[owner]
        along = (middle - paths.begin[owner]) / np.maximum(paths.length[owner], SHORTEST)
        u = (along - first) / np.maximum(last - first, SHORTEST)
        belly = (u > 0.0) & (u < 1.0) & (last > first)
        radii = np.where(belly, _width(u, paths.thick[owner], thin), thin)
        cord = np.maximum(thin, 0.5 * paths.thick[owner])  # a motor's
        starts, ends = paths.points(cuts[:-1], segment), paths.points(cuts[1:], segment)
        return Tubes(starts, ends, np.where(last > first, radii, cord), owner, belly)

    def bellies(
        self, data: mujoco.MjData, known: Mapping[str, np.ndarray], thinnest: float, rings: int
    ) -> Bellies:
        """Return the bellies of all muscles in a pose, as rings; they begin and end as wide as the tendon.

        Args:
            data: As for `tubes`.
            known: As for `tubes`.
            thinnest: As for `tubes`.
            rings: Rings of each.
        """
        paths = self._paths(data, known, thinnest)
        muscles = np.flatnonzero((paths.last > paths.first) & (paths.length > 0.0))
        shares = np.linspace(0.0, 1.0, rings)
        places, owner = paths.places(shares)[muscles].ravel(), muscles.repeat(rings)
        segment = np.clip(paths.segment(places), paths.bounds[owner], paths.bounds[owner + 1] - 1)
        centers = paths.points(places, segment)
        radii = _width(shares, paths.thick[muscles, None], paths.thin[muscles, None])
        return Bellies(muscles, centers.reshape(len(muscles), rings, 3), radii)

    def _paths(self, data: mujoco.MjData, known: Mapping[str, np.ndarray], thinnest: float) -> _Paths:
        """Return where the bellies of all muscles lie on their paths, and how wide they are."""
        bellies = self.belly_radius(known.get("strength"))
        optimal, tendon = (
            own if name not in known else np.where(np.isnan(known[name]), own, known[name])
            for name, own in (("optimal_fiber_length", self.optimal), ("tendon_length", self.slack))
        )
        starts, ends, owner = look.tendon_segments(self._model, data, self.tendons)
        marks = np.concatenate(([0.0], np.cumsum(np.linalg.norm(ends - starts, axis=1))))
        bounds = np.searchsorted(owner, np.arange(len(self.tendons) + 1))
        length = data.ten_length[self.tendons]
        has = self._is_muscle & (length > 0.0)
        length, optimal = np.where(has, length, 1.0), np.where(has, optimal, 1.0)
        fiber = np.clip(length - np.where(has, tendon, 0.0), 0.4 * optimal, 1.7 * optimal)
        share = np.clip(fiber / length, *BELLY)
        before = (1.0 - share) * np.where(self._away, PROXIMAL, 1.0 - PROXIMAL)
        bulge = np.where(has, np.clip(np.sqrt(optimal / fiber), *BULGE), 1.0)
        unbranched = _unbranched(starts, ends, owner, marks, bounds)
        return _Paths(
            starts,
            ends,
            owner,
            marks,
            bounds,
            first=np.where(has, before, 0.0) * unbranched,
            last=np.where(has, before + share, 0.0) * unbranched,
            thick=np.maximum(bulge * bellies, 1.25 * thinnest),
            thin=np.maximum(TENDON_WIDTH * bellies, thinnest),
        )

    def values(self, quantity: str, known: Mapping[str, np.ndarray], data: mujoco.MjData) -> np.ndarray:
        """Return what colours show of each muscle, NaN where it is not known, shape (num_muscles,).

        Args:
            quantity: Name in `QUANTITIES`.
            known: What a snapshot says of the muscles, by name.
            data: The data, posed, tendons computed.
        """
        if quantity == "fiber_length":
            fibers = data.ten_length[self.tendons] - known.get("tendon_length", self.slack)
            return fibers / known.get("optimal_fiber_length", self.optimal)
        unknown = np.full(len(self.tendons), np.nan)
        if quantity == "force":
            return known.get("force", unknown) / np.maximum(known.get("strength", self.peak_force), 1e-9)
        return known.get(quantity, unknown)

    def _runs_outwards(self, tendon: int) -> bool:
        """Say whether the path of a tendon begins nearer to the root than it ends."""
        model = self._model
        first, count = model.tendon_adr[tendon], model.tendon_num[tendon]
        own = slice(first, first + count)
        sites = model.wrap_objid[own][model.wrap_type[own] == mujoco.mjtWrap.mjWRAP_SITE]
        if not len(sites):
            return True
        begin, end = (_depth(model, int(model.site_bodyid[site])) for site in sites[[0, -1]])
        return begin <= end


def _depth(model: mujoco.MjModel, body: int) -> int:
    """Return the number of ancestors of a body."""
    return 0 if body == 0 else 1 + _depth(model, int(model.body_parentid[body]))


@dataclass(frozen=True)
class _Paths:
    """Paths of all muscles as one line, one after the other; places on it are lengths from its begin [m].

    Attributes:
        starts: Begin of each straight piece [m], shape (n, 3).
        ends: End of each [m], shape (n, 3).
        owner: Muscle of each, shape (n,).
        marks: Where pieces begin, and where the last ends, shape (n + 1,).
        bounds: First piece of each muscle, and the number of pieces, shape (num_muscles + 1,).
        first: Where each belly begins, as a share of its path, shape (num_muscles,).
        last: Where it ends.
        thick: Its radius in the middle [m].
        thin: Radius of the tendon [m].
    """

    starts: np.ndarray
    ends: np.ndarray
    owner: np.ndarray
    marks: np.ndarray
    bounds: np.ndarray
    first: np.ndarray
    last: np.ndarray
    thick: np.ndarray
    thin: np.ndarray

    @property
    def begin(self) -> np.ndarray:
        """Return the first point of each muscle's path, shape (num_muscles,)."""
        return self.marks[self.bounds[:-1]]

    @property
    def length(self) -> np.ndarray:
        """Return the length of each path [m], shape (num_muscles,)."""
        return np.diff(self.marks[self.bounds])

    def places(self, shares: np.ndarray) -> np.ndarray:
        """Return places at shares of each belly, shape (num_muscles, num_shares)."""
        along = self.first[:, None] + (self.last - self.first)[:, None] * shares
        return self.begin[:, None] + self.length[:, None] * along

    def segment(self, places: np.ndarray) -> np.ndarray:
        """Return the piece in which each place is, of two the later one."""
        return np.clip(np.searchsorted(self.marks, places, side="right") - 1, 0, len(self.starts) - 1)

    def points(self, places: np.ndarray, segment: np.ndarray) -> np.ndarray:
        """Return points at places in these pieces [m], shape (n, 3)."""
        along = self.ends[segment] - self.starts[segment]
        share = (places - self.marks[segment]) / np.maximum(np.diff(self.marks)[segment], SHORTEST)
        return self.starts[segment] + share[:, None] * along


def _unbranched(
    starts: np.ndarray, ends: np.ndarray, owner: np.ndarray, marks: np.ndarray, bounds: np.ndarray
) -> np.ndarray:
    """Return which share of each path's length comes before a pulley, where it goes on from elsewhere."""
    elsewhere = np.linalg.norm(starts[1:] - ends[:-1], axis=1) > JUMP
    begins = 1 + np.flatnonzero(elsewhere & (owner[1:] == owner[:-1]))
    stop = bounds[1:].copy()
    np.minimum.at(stop, owner[begins], begins)
    whole = np.diff(marks[bounds])
    return (marks[stop] - marks[bounds[:-1]]) / np.maximum(whole, SHORTEST)


def _width(u: np.ndarray, thick: np.ndarray, thin: np.ndarray) -> np.ndarray:
    """Return the radius of a belly at shares u of its length: thin + (thick - thin) sin(pi u)."""
    return thin + (thick - thin) * np.sin(np.pi * np.clip(u, 0.0, 1.0))

"""Measures of a walk, stride by stride: angles, moments and forces over the cycle, steps, price, balance.

A stride of a foot goes from a heel strike to its next one. It goes ahead where the mass centre does, and has
one step of each foot: from the place where one foot came down to that where the other one does. Angles are
flexion and dorsiflexion > 0, moments are the muscles' and their helpers': extension and plantarflexion > 0.

    margin of stability = foot - (c + c' / w) at the heel strike, w^2 = g / height of c

with c the mass centre: ahead, and outwards; the foot stands for the edge of its sole. Source: Hof, Gazendam
and Sinke (2005), doi:10.1016/j.jbiomech.2004.03.025.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from myowarp.motion.gait import PERCENT, contacts, over_cycle, side_of

GRAVITY = 9.80665  # m/s^2
SIDES = ("r", "l")
JOINTS = {"hip": "hip_flexion", "knee": "knee_angle", "ankle": "ankle_angle"}
"""Joints that are scored: the first part of the names of their coordinates in models of legs."""
LEAST_ADVANCE = 0.1
"""Of the mass centre in a stride [m]; what is less is no walk over ground."""
ON = 0.25
"""Share of the way from least to greatest activation in the cycle above which a muscle is on."""
IDLE = 0.02
"""Activation below which a muscle is never on."""
MUSCLES = {
    "soleus": r"soleus",
    "gastrocnemius": r"gas(med|lat)|(med|lat)_gas|gastroc\w*",
    "tibialis anterior": r"tib(ant|_ant|ialis_anterior)",
    "hamstrings": r"semi(mem|ten)\w*|bf(lh|_lh)|bifemlh|hamstrings|medial_hamstrings|biceps_femoris",
    "vasti": r"vas_?(med|int|lat)|vasti|vastus_\w+",
    "rectus femoris": r"rec_?fem|rect_fem|rectus_femoris",
    "gluteus maximus": r"gl(ut)?_?max\d?|gluteus_maximus",
    "gluteus medius": r"gl(ut)?_?med\d?|gluteus_medius",
}
"""Muscles whose timing is scored, and what models call them."""


@dataclass(frozen=True, eq=False)
class Walk:
    """A walk over level ground; level places are x and y of axes whose z is up.

    Attributes:
        mass: Of the body [kg].
        time: Of all but the forces [s], shape (rows,).
        center: Mass centre: level place and height over the ground [m], shape (rows, 3).
        foot: Level place of the heel of each side [m], shape (rows, 2).
        curves: What is drawn over the cycle, by name with its side, shape (rows,): hip_angle_r [degrees],
            hip_moment_r [N m/kg], and activations [1] by the names of `MUSCLES`, such as soleus_r.
        force_time: Of the forces [s], shape (samples,).
        force: Vertical force of the ground on each side [N], shape (samples,).
        metabolic_rate: Of the whole body, rest included [W/kg], shape (rows,); None: not known.
        fell: Whether it ended with a fall.
    """

    mass: float
    time: np.ndarray
    center: np.ndarray
    foot: Mapping[str, np.ndarray]
    curves: Mapping[str, np.ndarray]
    force_time: np.ndarray
    force: Mapping[str, np.ndarray]
    metabolic_rate: np.ndarray | None = None
    fell: bool = False

    @cached_property
    def velocity(self) -> np.ndarray:
        """Level velocity of the mass centre [m/s], shape (rows, 2)."""
        return np.gradient(self.center[:, :2], self.time, axis=0)

    @cached_property
    def contacts(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """When each foot comes to the ground and leaves it [s]."""
        return {side: contacts(self.force_time, up) for side, up in self.force.items()}

    def at(self, values: np.ndarray, time: float) -> np.ndarray:
        """Return values (rows, n) at a time [s], NaN where they are not known."""
        return np.array([np.interp(time, self.time, x, left=np.nan, right=np.nan) for x in values.T])


@dataclass(frozen=True, eq=False)
class Strides:
    """Strides of a walk, one a row; NaN where something is not known.

    Attributes:
        curves: Over `PERCENT` of the cycle, by name with its side, shape (strides of the side, 101).
        values: Measures by name in `UNITS`, shape (strides,).
        steps: Heel strikes of both feet, of all of the walk.
        fell: Whether it ended with a fall.
    """

    curves: Mapping[str, np.ndarray] = field(default_factory=dict)
    values: Mapping[str, np.ndarray] = field(default_factory=dict)
    steps: int = 0
    fell: bool = False


UNITS = {
    "speed": "m/s",
    "step_length": "m",
    "step_width": "m",
    "cadence": "1/min",
    "stance": "%",
    "step_length_asymmetry": "%",
    "step_time_asymmetry": "%",
    "first_peak": "BW",
    "valley": "BW",
    "second_peak": "BW",
    "margin_ahead": "m",
    "margin_outwards": "m",
    "metabolic_rate": "W/kg",
    "cost_of_transport": "J/kg/m",
    "weight": "BW",
}
"""Measures of a stride. Asymmetry is right minus left over their mean; `weight` is what both feet bear on
the mean of a stride, 1 where the forces are those of the motion; BW is the weight of the body."""


def strides_of(walk: Walk, after: float = -np.inf) -> Strides:
    """Return the whole strides of a walk, those that go ahead by `LEAST_ADVANCE`.

    Args:
        walk: The walk.
        after: Time before which no stride begins that counts [s].
    """
    curves, values = defaultdict[str, list[np.ndarray]](list), defaultdict[str, list[float]](list)
    for side in SIDES:
        strikes = walk.contacts[side][0]
        for stride in pairwise(strikes[np.isfinite(strikes) & (strikes >= after)].tolist()):
            first, last = (walk.at(walk.center[:, :2], time) for time in stride)
            if (length := float(np.linalg.norm(last - first))) < LEAST_ADVANCE:
                continue
            own = {name: x for name, x in walk.curves.items() if side_of(name)[1] == side}
            for name, x in own.items():
                curves[name].append(over_cycle(walk.time, x, stride))
            up = walk.force[side] / (walk.mass * GRAVITY)
            curves[f"ground_force_{side}"].append(over_cycle(walk.force_time, up, stride))
            for name, value in _measures(walk, side, *stride, length, (last - first) / length):
                values[name].append(value)
    found = {name: np.array(rows) for name, rows in curves.items()}
    steps = sum(int(np.isfinite(begin).sum()) for begin, _ in walk.contacts.values())
    return Strides(found, {name: np.array(x) for name, x in values.items()}, steps, walk.fell)


def _measures(
    walk: Walk, side: str, begin: float, end: float, length: float, ahead: np.ndarray
) -> Iterator[tuple[str, float]]:
    """Yield the measures of a stride of a side.

    Args:
        walk: The walk.
        side: Of the foot.
        begin: Heel strike [s].
        end: The next one [s].
        length: Of the way of the mass centre [m].
        ahead: Its direction, level.
    """
    other, duration = ("l" if side == "r" else "r"), end - begin
    outwards = np.array((ahead[1], -ahead[0])) * (1.0 if side == "r" else -1.0)
    yield "speed", length / duration
    yield "cadence", 120.0 / duration
    between = [at for at in walk.contacts[other][0] if begin < at < end]
    first, here, last = (begin, between[0] if between else np.nan, end)
    places = [walk.at(walk.foot[s], at) for s, at in ((side, first), (other, here), (side, last))]
    its, own = places[1] - places[0], places[2] - places[1]  # step of the other foot, then of this one
    yield "step_length", float((its + own) @ ahead) / 2.0
    yield "step_width", float((own - its) @ outwards) / 2.0
    sign = 100.0 if side == "r" else -100.0
    for name, x, y in (("length", own @ ahead, its @ ahead), ("time", last - here, here - first)):
        yield f"step_{name}_asymmetry", sign * float((x - y) / ((x + y) / 2.0))
    comes, leaves = walk.contacts[side]
    off = float(leaves[comes == begin][0])
    yield "stance", 100.0 * (off - begin) / duration
    yield from _peaks(walk, side, begin, off)
    height = float(walk.at(walk.center, begin)[2])
    center, velocity = walk.at(walk.center[:, :2], begin), walk.at(walk.velocity, begin)
    margin = places[0] - center - velocity * np.sqrt(height / GRAVITY)
    yield "margin_ahead", float(margin @ ahead)
    yield "margin_outwards", float(margin @ outwards)
    both = sum(walk.force.values(), np.zeros(len(walk.force_time)))
    yield "weight", float(over_cycle(walk.force_time, both, (begin, end)).mean() / (walk.mass * GRAVITY))
    if walk.metabolic_rate is not None:
        rate = float(over_cycle(walk.time, walk.metabolic_rate, (begin, end)).mean())
        yield "metabolic_rate", rate
        yield "cost_of_transport", rate * duration / length


def _peaks(walk: Walk, side: str, begin: float, off: float) -> Iterator[tuple[str, float]]:
    """Yield the greatest force of each half of the stance, and the least between them [BW]."""
    inside = (walk.force_time >= begin) & (walk.force_time <= off)
    up = walk.force[side][inside] / (walk.mass * GRAVITY)
    late = walk.force_time[inside] > 0.5 * (begin + off)
    if late.all() or not late.any():
        return
    first, second = int(up[~late].argmax()), int((~late).sum() + up[late].argmax())
    yield "first_peak", float(up[first])
    yield "valley", float(up[first : second + 1].min())
    yield "second_peak", float(up[second])


def muscle_groups(names: Sequence[str]) -> dict[str, list[int]]:
    """Return the numbers of the muscles of each group of `MUSCLES`, by its name with the side."""
    found: dict[str, list[int]] = {}
    for number, name in enumerate(names):
        own, side = side_of(name)
        for group, pattern in MUSCLES.items():
            if side and re.fullmatch(pattern, own):
                found.setdefault(f"{group}_{side}", []).append(number)
    return found


def is_on(activation: np.ndarray) -> np.ndarray:
    """Return where in the cycle a muscle is on, (101,) bool for its activation (101,)."""
    low, high = activation.min(), activation.max()
    return (activation > low + ON * (high - low)) & (high > IDLE)


def within(spans: Sequence[tuple[float, float]]) -> np.ndarray:
    """Return where in the cycle spans [%] are, (101,) bool; one may go on over 100 %, such as (95, 29)."""
    inside = [
        (on <= PERCENT) & (off >= PERCENT) if on <= off else (on <= PERCENT) | (off >= PERCENT)
        for on, off in spans
    ]
    return np.any([np.zeros(len(PERCENT), dtype=bool), *inside], axis=0)

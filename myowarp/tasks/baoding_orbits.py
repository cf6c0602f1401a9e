"""Targets of the baoding balls: two points opposite each other on an ellipse, circling or jumping along it.

    angle_i(t) = start + direction 2 pi turns(t) - (i - 1) pi
    turns(t) = t / period,  or  floor(m t / period) / m  with m jumps in a revolution

Source: MyoSuite 3.0.0, family Baoding, whose targets circle; the paper's own code (Caggiano et al. 2022,
arXiv:2205.13600) also has targets that jump.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from myowarp.definitions.entries import XYZ
from myowarp.definitions.task import Draw
from myowarp.kernels.random import GOAL, RandomKeys, open_stream

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene

ELLIPSE_CENTER = wp.constant(wp.vec3(-0.0125, -0.07, -0.02))  # m, frame of the trapezium
TWO_PI = wp.constant(2.0 * np.pi)
JUMP_SLACK = wp.constant(1.0e-4)  # jumps; rounding of the time must not delay one by a step

Range = tuple[float, float]


@wp.struct
class OrbitBounds:
    """`OrbitRanges` on the device; radii along (x, y)."""

    directions: wp.array[float]
    angle: wp.vec2
    radii_low: wp.vec2
    radii_high: wp.vec2
    period: wp.vec2


@dataclass(frozen=True)
class OrbitRanges:
    """Ranges from which the orbits of the targets are drawn uniformly.

    Attributes:
        directions: Senses of rotation to choose from: 1 counter-clockwise, -1 clockwise, 0 hold.
        angle: Bounds of the first target's angle at the reset [rad].
        radius_x: Bounds of the ellipse's half axis along x [m].
        radius_y: Bounds of its half axis along y [m].
        period: Bounds of the duration of a revolution [s].
        jumps: Jumps in a revolution, after equal times; 0: the targets circle.
    """

    directions: tuple[float, ...] = (1.0,)
    angle: Range = (0.25 * np.pi, 0.25 * np.pi)
    radius_x: Range = (0.025, 0.025)
    radius_y: Range = (0.028, 0.028)
    period: Range = (5.0, 5.0)
    jumps: int = 0

    @property
    def draws(self) -> tuple[Draw, ...]:
        """Quantities that a new episode draws."""
        low, high = zip(self.radius_x, self.radius_y, strict=True)
        path = f"jump, {self.jumps} times a revolution" if self.jumps else "circle"
        half_axes = f"half axes of the ellipse along which the targets {path}, frame of the trapezium"
        sense = "how the targets turn: 1 counter-clockwise, -1 clockwise, 0 not at all"
        return (
            Draw("direction", "1", (), (), sense, choices=self.directions),
            Draw("start angle", "rad", self.angle[:1], self.angle[1:], "angle of target 1 at the reset"),
            Draw("half axes", "m", low, high, half_axes, XYZ[:2]),
            Draw("period", "s", self.period[:1], self.period[1:], "duration of a revolution"),
        )

    def on_device(self) -> OrbitBounds:
        """Return the bounds for a kernel."""
        bounds = OrbitBounds()
        bounds.directions = wp.array(self.directions, dtype=float)
        bounds.angle, bounds.period = wp.vec2(*self.angle), wp.vec2(*self.period)
        low, high = zip(self.radius_x, self.radius_y, strict=True)
        bounds.radii_low, bounds.radii_high = wp.vec2(*low), wp.vec2(*high)
        return bounds


@wp.struct
class Orbits:
    """The orbit of every world's targets; arrays (num_worlds,).

    Attributes:
        direction: 1 counter-clockwise, -1 clockwise, 0 hold.
        start_angle: Angle of the first target at the reset [rad].
        radii: Half axes of the ellipse [m].
        period: Duration of a revolution [s].
        jumps: Jumps in a revolution, of all worlds; 0: the targets circle.
    """

    direction: wp.array[float]
    start_angle: wp.array[float]
    radii: wp.array[wp.vec2]
    period: wp.array[float]
    jumps: int


def new_orbits(scene: Scene, ranges: OrbitRanges) -> Orbits:
    """Allocate the orbits of all worlds."""
    orbits = Orbits()
    for name in ("direction", "start_angle", "period"):
        setattr(orbits, name, scene.zeros(f"task.{name}"))
    orbits.radii = scene.zeros("task.radii", dtype=wp.vec2)
    orbits.jumps = ranges.jumps
    return orbits


@wp.func
def orbit_turns(orbits: Orbits, worldid: int, control_dt: float, step: int) -> float:
    """Revolutions of the targets, whichever way, in a step of the episode, counted from 1."""
    turns = control_dt * float(wp.max(step - 1, 0)) / orbits.period[worldid]
    if orbits.jumps > 0:
        jumps = float(orbits.jumps)
        turns = wp.floor(turns * jumps + JUMP_SLACK) / jumps
    return turns


@wp.func
def orbit_point(orbits: Orbits, worldid: int, ball: int, turns: float) -> wp.vec3:
    """Target of ball 0 or 1 after these revolutions, in the frame of the trapezium [m]."""
    turn = orbits.direction[worldid] * TWO_PI * turns
    angle = orbits.start_angle[worldid] + turn - 0.5 * TWO_PI * float(ball)
    radii = orbits.radii[worldid]
    return ELLIPSE_CENTER + wp.vec3(radii[0] * wp.cos(angle), radii[1] * wp.sin(angle), 0.0)


@wp.kernel(enable_backward=False)
def sample_orbit(
    # Params:
    orbit_bounds: OrbitBounds,
    # In:
    keys: RandomKeys,
    mask: wp.array[bool],
    # Out:
    orbits: Orbits,
    target: wp.array2d[wp.vec3],
):
    """direction ~ choice, all else ~ U(low, high); the targets are at their start angles."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    state = open_stream(keys, worldid, GOAL)
    b = orbit_bounds
    orbits.direction[worldid] = b.directions[wp.randi(state, 0, b.directions.shape[0])]
    orbits.start_angle[worldid] = wp.randf(state, b.angle[0], b.angle[1])
    radius_x = wp.randf(state, b.radii_low[0], b.radii_high[0])
    radius_y = wp.randf(state, b.radii_low[1], b.radii_high[1])
    orbits.radii[worldid] = wp.vec2(radius_x, radius_y)
    orbits.period[worldid] = wp.randf(state, b.period[0], b.period[1])
    for ball in range(2):
        target[worldid, ball] = orbit_point(orbits, worldid, ball, 0.0)


@wp.kernel(enable_backward=False)
def move_targets(
    # In:
    orbits: Orbits,
    control_dt: float,
    step_count: wp.array[int],
    # Out:
    target: wp.array2d[wp.vec3],
):
    """Targets of this step of the episode."""
    worldid = wp.tid()
    turns = orbit_turns(orbits, worldid, control_dt, step_count[worldid])
    for ball in range(2):
        target[worldid, ball] = orbit_point(orbits, worldid, ball, turns)

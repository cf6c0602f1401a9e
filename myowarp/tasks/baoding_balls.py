"""Baoding balls that differ: mass, size and friction drawn anew in every episode.

Source: MyoSuite 3.0.0, `myoChallengeBaodingP2-v1`. It recompiles what MuJoCo derives from a ball's size and
mass; here the same fields of the model are written per world. Mass and size are drawn independently. Contacts
have four dimensions, so that rolling friction never acts.

In MyoSuite the engine takes the larger friction of ball and hand, so that draws below the hand's
(1, 0.005, 0.0001) have no effect, and every ball has the inertia floor of 1e-4 kg m^2. Corrected balls are
solid spheres, and their friction comes before the hand's; between two balls the larger one acts, and contacts
are as soft as with the hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from myowarp.kernels.random import START, RandomKeys, open_stream

BATCHED = (
    "body_mass",
    "body_subtreemass",
    "body_invweight0",
    "geom_size",
    "geom_rbound",
    "geom_aabb",
    "geom_friction",
)
"""Names of the model's fields that `sample_balls` writes per world."""

BATCHED_INERTIA = ("body_inertia",)
"""Further fields that `weigh_balls` writes."""

Range = tuple[float, float]


@wp.struct
class BallBounds:
    """`BallRanges` on the device."""

    mass: wp.vec2
    radius: wp.vec2
    friction_low: wp.vec3
    friction_high: wp.vec3


@dataclass(frozen=True)
class BallRanges:
    """Bounds of the balls' uniformly drawn properties.

    Attributes:
        mass: Mass [kg].
        radius: Radius [m].
        friction: Lower and upper bounds of the coefficients (slide, spin, roll).
    """

    mass: Range
    radius: Range
    friction: tuple[tuple[float, float, float], tuple[float, float, float]]

    def on_device(self) -> BallBounds:
        """Return the bounds for a kernel."""
        bounds = BallBounds()
        bounds.mass, bounds.radius = wp.vec2(*self.mass), wp.vec2(*self.radius)
        bounds.friction_low, bounds.friction_high = (wp.vec3(*end) for end in self.friction)
        return bounds


@wp.kernel(enable_backward=False)
def sample_balls(
    # Params:
    ball_body: wp.vec2i,
    ball_geom: wp.vec2i,
    ball_bounds: BallBounds,
    # In:
    keys: RandomKeys,
    mask: wp.array[bool],
    # Out:
    body_mass: wp.array2d[float],
    body_subtreemass: wp.array2d[float],
    body_invweight0: wp.array2d[wp.vec2],
    geom_size: wp.array2d[wp.vec3],
    geom_rbound: wp.array2d[float],
    geom_aabb: wp.array3d[wp.vec3],
    geom_friction: wp.array2d[wp.vec3],
):
    """mass, radius, friction ~ U(low, high) for each ball, and what follows from them but inertia."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    state = open_stream(keys, worldid, START)
    b = ball_bounds
    for i in range(2):
        body, geom = ball_body[i], ball_geom[i]
        mass = wp.randf(state, b.mass[0], b.mass[1])
        body_mass[worldid, body] = mass
        body_subtreemass[worldid, body] = mass
        body_invweight0[worldid, body][0] = 1.0 / mass
        radius = wp.randf(state, b.radius[0], b.radius[1])
        geom_size[worldid, geom] = wp.vec3(radius, radius, radius)
        geom_rbound[worldid, geom] = radius
        geom_aabb[worldid, geom, 1] = wp.vec3(radius, radius, radius)
        slide = wp.randf(state, b.friction_low[0], b.friction_high[0])
        spin = wp.randf(state, b.friction_low[1], b.friction_high[1])
        roll = wp.randf(state, b.friction_low[2], b.friction_high[2])
        geom_friction[worldid, geom] = wp.vec3(slide, spin, roll)


@wp.kernel(enable_backward=False)
def weigh_balls(
    # Model:
    body_mass: wp.array2d[float],
    geom_size: wp.array2d[wp.vec3],
    # Params:
    ball_body: wp.vec2i,
    ball_geom: wp.vec2i,
    # In:
    mask: wp.array[bool],
    # Out:
    body_inertia: wp.array2d[wp.vec3],
    body_invweight0: wp.array2d[wp.vec2],
):
    """I = 2/5 m r^2 about every axis; inverse weight of rotation 1/I, the mean over the axes."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    for i in range(2):
        body = ball_body[i]
        radius = geom_size[worldid, ball_geom[i]][0]
        inertia = 0.4 * body_mass[worldid, body] * radius * radius
        body_inertia[worldid, body] = wp.vec3(inertia, inertia, inertia)
        body_invweight0[worldid, body][1] = 1.0 / inertia

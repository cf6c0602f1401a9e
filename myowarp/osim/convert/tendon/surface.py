"""The path of a line over a wrapping sphere or cylinder, as MuJoCo 4.0 computes it, with its gradients.

The rule for a side site: the path winds around the centre like the polyline start, side, end. So only
which side of the centre counts, until an end point crosses the ray opposite to the side site. A side site
inside the surface makes the path pass through the hole instead. Source: `mju_wrap` of MuJoCo 4.0.

A path of stationary length has simple gradients: with the unit vectors from the tangent points to the end
points as derivatives with respect to the end points, moving or turning the surface is moving or turning
the end points the other way, and the derivative with respect to the radius is the wrapped angle (times
the sine of the spiral's slope on a cylinder).
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

MIN = 1e-15
"""MuJoCo's smallest number."""
INSIDE_STEPS, INSIDE_ERROR = 20, 1e-6
"""Of the point that an inside wrap passes."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A sphere or cylinder in a body.

    Attributes:
        kind: `sphere` or `cylinder`; the cylinder is endless.
        centre: in the body [m], shape `(3,)`.
        rotation: axes as columns, the cylinder's is z, shape `(3, 3)`.
        radius: [m].
        side: direction in the body from the centre to the side site, shape `(3,)`; None without one.
        inside: whether the side site is at the centre and the path passes through the surface.
    """

    kind: Literal["sphere", "cylinder"]
    centre: np.ndarray
    rotation: np.ndarray
    radius: float
    side: np.ndarray | None = None
    inside: bool = False


class Path(NamedTuple):
    """Lines over a surface, and gradients of their lengths.

    Attributes:
        length: of the whole line [m], shape `(n,)`.
        wrapped: whether it touches the surface, shape `(n,)`.
        gradient: of the length with respect to centre (3), logarithm of the radius (1) and a small turn
            about the axes of the body (3) [m], shape `(n, 7)`.
    """

    length: np.ndarray
    wrapped: np.ndarray
    gradient: np.ndarray


def over_surface(surface: Surface, start: np.ndarray, end: np.ndarray) -> Path:
    """Return lines over a surface; end points are given in its body [m], shape `(n, 3)`."""
    p0, p1 = ((points - surface.centre) @ surface.rotation for points in (start, end))
    x, y = _axes(surface.kind, p0, p1)
    e0, e1 = (np.stack([dot(points, x), dot(points, y)], axis=1) for points in (p0, p1))
    if surface.inside:
        wrapped, t0, t1, arc = _through(e0, e1, surface.radius)
    else:
        side = None
        if surface.side is not None:
            local = np.broadcast_to(surface.side @ surface.rotation, p0.shape)
            side = np.stack([dot(local, x), dot(local, y)], axis=1)
            weak = np.linalg.norm(side, axis=1) < MIN
            side[weak] = [1.0, 0.0]
        wrapped, t0, t1, arc = _around(e0, e1, side, surface.radius)
    q0 = t0[:, :1] * x + t0[:, 1:] * y
    q1 = t1[:, :1] * x + t1[:, 1:] * y
    flat = surface.radius * arc
    surface_length = flat
    if surface.kind == "cylinder":
        near, far = np.linalg.norm(e0 - t0, axis=1), np.linalg.norm(e1 - t1, axis=1)
        total = np.maximum(near + flat + far, MIN)
        rise = p1[:, 2] - p0[:, 2]
        q0[:, 2] = p0[:, 2] + rise * near / total
        q1[:, 2] = p0[:, 2] + rise * (near + flat) / total
        surface_length = np.hypot(flat, q1[:, 2] - q0[:, 2])
    out0, out1 = p0 - q0, p1 - q1
    length = np.linalg.norm(out0, axis=1) + surface_length + np.linalg.norm(out1, axis=1)
    length = np.where(wrapped, length, np.linalg.norm(p0 - p1, axis=1))
    return Path(length, wrapped, _gradient(surface, wrapped, (p0, p1), (q0, q1), arc, surface_length))


def _gradient(
    surface: Surface, wrapped: np.ndarray, ends: tuple, tangents: tuple, arc: np.ndarray, over: np.ndarray
) -> np.ndarray:
    """Return the gradient of the lengths, see `Path`."""
    directions = [unit(end - tangent) for end, tangent in zip(ends, tangents, strict=True)]
    gradient = np.zeros((len(arc), 7))
    gradient[:, :3] = -(directions[0] + directions[1]) @ surface.rotation.T
    if surface.inside:
        outward = tangents[0] * ([1.0, 1.0, 1.0] if surface.kind == "sphere" else [1.0, 1.0, 0.0])
        gradient[:, 3] = -surface.radius * dot(directions[0] + directions[1], unit(outward))
    else:
        flat = surface.radius * arc
        gradient[:, 3] = flat * flat / np.maximum(over, MIN)
    torque = sum(np.cross(end, direction) for end, direction in zip(ends, directions, strict=True))
    if surface.kind == "cylinder":
        gradient[:, 4:] = -torque @ surface.rotation.T
    return np.where(wrapped[:, None], gradient, 0.0)


def _axes(kind: str, p0: np.ndarray, p1: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the axes of the plane in which the surface is a circle, each of shape `(n, 3)`."""
    if kind == "cylinder":
        shape = p0.shape
        return np.broadcast_to([1.0, 0.0, 0.0], shape), np.broadcast_to([0.0, 1.0, 0.0], shape)
    x = unit(p0)
    normal = np.cross(p0, p1)
    parallel = np.linalg.norm(normal, axis=1) < MIN
    if parallel.any():
        other = np.ones_like(x)
        other[np.arange(len(x)), np.argmax(np.abs(x), axis=1)] = 0.0
        normal = np.where(parallel[:, None], np.cross(x, other), normal)
    return x, unit(np.cross(unit(normal), x))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _around(
    e0: np.ndarray, e1: np.ndarray, side: np.ndarray | None, radius: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return whether lines wrap a circle, both tangent points, and the angle between them [rad]."""
    squares = dot(e0, e0), dot(e1, e1)
    along = e1 - e0
    t = np.clip(-dot(along, e0) / np.maximum(dot(along, along), MIN), 0.0, 1.0)
    near = e0 + t[:, None] * along
    clear = dot(near, near) > radius**2
    turn = _cross(e0, e1)
    enclosed = np.zeros(len(e0), bool)
    if side is not None:
        turns = _cross(e0, side), _cross(side, e1)
        # The centre is inside the triangle: the polyline over the side passes it on the other side.
        enclosed = (turns[0] * turn < 0) & (turns[1] * turn < 0)
    sense = np.where(turn < 0, -1.0, 1.0) * np.where(enclosed, -1.0, 1.0)
    outside = (squares[0] >= radius**2) & (squares[1] >= radius**2) & (dot(along, along) >= MIN)
    wrapped = outside & (enclosed | ~clear)
    tangents = []
    for end, square, direction in ((e0, squares[0], sense), (e1, squares[1], -sense)):
        reach = np.sqrt(np.maximum(square - radius**2, 0.0))
        across = np.stack([-end[:, 1], end[:, 0]], axis=1)
        scale = radius / np.maximum(square, MIN)
        tangents.append(scale[:, None] * (radius * end + (direction * reach)[:, None] * across))
    arc = np.arctan2(sense * _cross(*tangents), dot(*tangents))
    arc = np.where((arc < 0) & enclosed, arc + 2 * np.pi, arc)
    wrapped = wrapped & (arc >= 0)
    return wrapped, tangents[0], tangents[1], np.maximum(arc, 0.0)


def _through(
    e0: np.ndarray, e1: np.ndarray, radius: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the same for lines that pass through a circle: both tangent points coincide."""
    lengths = np.linalg.norm(e0, axis=1), np.linalg.norm(e1, axis=1)
    along = e1 - e0
    square = np.maximum(dot(along, along), MIN)
    t = -dot(along, e0) / square
    near = e0 + t[:, None] * along
    meets = (t > 0) & (t < 1) & (np.linalg.norm(near, axis=1) <= radius)
    wrapped = (lengths[0] > radius) & (lengths[1] > radius) & ~meets
    a, b = (radius / np.maximum(length, radius) for length in lengths)
    cosine = dot(e0, e1) / np.maximum(lengths[0] * lengths[1], MIN)
    wrapped &= cosine >= -1 + MIN
    opening = np.arccos(np.clip(cosine, -1.0, 1.0))
    phi = np.full(len(e0), np.pi / 2)
    error = np.arcsin(a) + np.arcsin(b) - np.pi + opening
    average = (error > 0) | (cosine > 1 - MIN)
    for _ in range(INSIDE_STEPS):
        z = np.sin(phi)
        slopes = a / np.sqrt(np.maximum(1 - (a * z) ** 2, MIN)) + b / np.sqrt(
            np.maximum(1 - (b * z) ** 2, MIN)
        )
        slope = np.cos(phi) * slopes - 2
        moving = ~average & (np.abs(error) > INSIDE_ERROR)
        phi = np.where(moving, phi - error / slope, phi)
        error = np.arcsin(a * np.sin(phi)) + np.arcsin(b * np.sin(phi)) - 2 * phi + opening
    first = _cross(e0, e1) > 0
    base = unit(np.where(first[:, None], e0, e1))
    angle = phi - np.arcsin(np.where(first, a, b) * np.sin(phi))
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    point = radius * (cosine * base + sine * np.stack([-base[:, 1], base[:, 0]], axis=1))
    point = np.where(average[:, None], radius * unit(e0 + e1), point)
    return wrapped, point, point, np.zeros(len(e0))


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the scalar products of two arrays of vectors."""
    return np.einsum("...i,...i->...", a, b)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors of length one; a zero vector stays zero."""
    norms = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(norms > 0, norms, 1.0)

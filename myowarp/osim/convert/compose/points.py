"""Markers and moving path points of a `Model` -> sites and small bodies of an MjSpec."""

import dataclasses
from collections.abc import Hashable

import numpy as np

from myowarp.osim.convert.compose.geometry import (
    MIN_MASS,
    SLIDE,
    TIED_ARMATURE,
    Build,
    Demand,
    default_of,
    quaternion,
    reduced,
    weigh,
)
from myowarp.osim.document.elements import MovingPathPoint, Path, PathPoint, Point
from myowarp.osim.document.model import Model

MARKER_GROUP = 5
MARKER_SIZE = 0.005  # m, as drawn


def add_markers(build: Build) -> None:
    """Add a site for every marker."""
    for marker in build.model.markers.values():
        build.bodies[marker.body].add_site(
            name=build.free_name("site", marker.name),
            pos=marker.location,
            size=[MARKER_SIZE] * 3,
            group=MARKER_GROUP,
            rgba=[1.0, 0.6, 0.7, 1.0],
        )


def add_moving_points(build: Build) -> dict[str, dict[int, str]]:
    """Add a body for every moving path point; points that move alike share one.

    Returns:
        Of each muscle or other path: number of the point, and name of the body at it.
    """
    shared: dict[Hashable, str] = {}
    return {name: _of_path(build, name, path, shared) for name, path in build.model.pulling.items()}


def stilled(model: Model) -> Model:
    """Return a model whose moving path points stand where they are by default."""

    def still(path: Path) -> Path:
        return dataclasses.replace(path, points=tuple(_still(model, point) for point in path.points))

    return dataclasses.replace(
        model,
        muscles={name: dataclasses.replace(m, path=still(m.path)) for name, m in model.muscles.items()},
        ligaments={name: dataclasses.replace(g, path=still(g.path)) for name, g in model.ligaments.items()},
        path_actuators=tuple(dataclasses.replace(a, path=still(a.path)) for a in model.path_actuators),
    )


def _still(model: Model, point: Point) -> Point:
    """Return a point, one that moves as a fixed one."""
    if not isinstance(point, MovingPathPoint):
        return point
    pairs = zip(point.functions, point.coordinates, strict=True)
    place = np.array([default_of(model, function, coordinate) for function, coordinate in pairs])
    return PathPoint(point.name, point.body, point.frame.point(place))


def _of_path(build: Build, owner: str, path: Path, shared: dict[Hashable, str]) -> dict[int, str]:
    """Add the bodies of one path's moving points."""
    found = {}
    for number, point in enumerate(path.points):
        if isinstance(point, MovingPathPoint):
            frame = (*point.frame.position, *point.frame.rotation.ravel())
            key = (point.body, frame, point.functions, point.coordinates)
            if key not in shared:
                shared[key] = _add_point(build, f"{owner}-P{number + 1}", point)
            found[number] = shared[key]
    return found


def _add_point(build: Build, name: str, point: MovingPathPoint) -> str:
    """Add a body with a slide for every axis that moves, and demand what the slides have to do."""
    moves: list[tuple[int, str]] = []
    start = np.zeros(3)
    for axis, (function, coordinate) in enumerate(zip(point.functions, point.coordinates, strict=True)):
        function, free = reduced(build.model, function, coordinate)
        start[axis] = default_of(build.model, function, free)
        if free is None:
            continue
        joint = build.free_name("joint", f"{name}-{'xyz'[axis]}")
        start[axis] = build.starts.get(joint, start[axis])
        build.demands.append(Demand(joint, function, free, 1.0))
        moves.append((axis, joint))
    body = build.bodies[point.body].add_body(
        name=build.free_name("body", name),
        pos=point.frame.point(start),
        quat=quaternion(point.frame.rotation),
    )
    for axis, joint in moves:
        body.add_joint(
            name=joint, type=SLIDE, axis=np.eye(3)[axis], armature=TIED_ARMATURE[SLIDE], ref=start[axis]
        )
    if moves:
        weigh(build, body)
        body.gravcomp = 1.0
        build.note(
            f"/forceset/{name}",
            "a moving point became a light body on slides",
            f"{MIN_MASS:g} kg, and {TIED_ARMATURE[SLIDE]:g} kg along each slide",
        )
    return body.name

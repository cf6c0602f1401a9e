"""Frames of an .osim file: sockets and chains of offset frames -> a pose in a body."""

import contextlib
import posixpath
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from myowarp.osim.document.elements import Pose
from myowarp.osim.document.model import GROUND
from myowarp.osim.document.read.element import Element
from myowarp.process import warn_once

MAX_CHAIN = 100  # offset frames on offset frames

DEFINED = "StationDefinedFrame"
"""A frame that four points of one body define."""

FRAMES = ("Body", "Ground", "PhysicalOffsetFrame", "OffsetFrame", DEFINED)

STATIONS = ("Station", "Marker")

TURN = 2.0 * np.pi * (1.0 + 1e-5)
"""[rad] beyond which no angle needs to be."""

SMALLEST = 1e-9
"""[m] from the line through two points that a third one may be."""

IDENTITY = Pose(np.zeros(3), np.eye(3))


def euler_xyz(angles: np.ndarray) -> np.ndarray:
    """Return the rotation Rx(a) Ry(b) Rz(c), shape (3, 3): body-fixed angles [rad], shape (3,)."""
    (a, b, c), (d, e, f) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1, 0, 0], [0, a, -d], [0, d, a]])
    about_y = np.array([[b, 0, e], [0, 1, 0], [-e, 0, b]])
    about_z = np.array([[c, -f, 0], [f, c, 0], [0, 0, 1]])
    return about_x @ about_y @ about_z


def pose_of(element: Element, translation: tuple[str, ...], orientation: tuple[str, ...]) -> Pose:
    """Return the pose that two properties of an element describe; both default to zero."""
    zero = (0.0, 0.0, 0.0)
    angles = element.numbers(*orientation, default=zero, count=3)
    if np.abs(angles).max() > TURN:
        say_radians(element, "the orientation", angles)
    return Pose(element.numbers(*translation, default=zero, count=3), euler_xyz(angles))


def say_radians(element: Element, what: str, angles: Iterable[float]) -> None:
    """Say that angles which look like degrees are read in radians, as OpenSim reads them."""
    numbers = " ".join(f"{angle:g}" for angle in angles)
    warn_once(str(element.error(f"has {what} {numbers} in radians, as OpenSim reads it; is it in degrees?")))


def socket(element: Element, *names: str) -> str:
    """Return what a socket is connected to, "" where the element has no such socket.

    Spellings: `socket_x` (4.0), `socket_x_connectee_name` and `connector_x_connectee_name` (before it),
    `<connectors>` with `<connectee_name>` (before these); the plain properties of 3.x are among `names`.
    """
    for name in names:
        for tag in (
            f"socket_{name}",
            f"socket_{name}_connectee_name",
            f"connector_{name}_connectee_name",
            name,
        ):
            if text := element.string(tag):
                return text
        for connector in element.objects("connectors"):
            if connector.name == name and (text := connector.string("connectee_name")):
                return text
    return ""


def _component_path(element: Element) -> str:
    """Return the absolute path of a component: the names of its owners and its own."""
    parts = []
    while element.parent is not None and element.tag != "Model":
        name = element.name or (element.tag.lower() if element.tag.endswith("Set") else "")
        parts.append(name)
        element = element.parent
    return "/" + "/".join(part for part in reversed(parts) if part)


def _direction(element: Element, tag: str, default: str) -> tuple[int, float]:
    """Return the number of an axis such as `-y`, and its sign.

    Raises:
        ValueError: It is none.
    """
    word = element.string(tag, default=default)
    axis = word.lstrip("+-").lower()
    if axis not in ("x", "y", "z") or len(word) > 2:
        raise element.error(f"must have {tag} of x, y or z with a sign, got {word[:60]!r}")
    return "xyz".index(axis), -1.0 if word.startswith("-") else 1.0


@dataclass(frozen=True)
class Frames:
    """All frames and stations of a model, by path and by name."""

    by_path: dict[str, Element]
    by_name: dict[str, list[Element]]
    """Frames alone."""
    defined: dict[int, tuple[str, Pose] | None] = field(default_factory=dict)
    """By element, body and pose of frames that stations define; None while these are looked for."""

    @staticmethod
    def of(model: Element, bodies: Iterable[Element]) -> "Frames":
        """Collect the frames of a `<Model>`, and of its bodies only those that are components."""
        components = {id(body) for body in bodies}
        by_path: dict[str, Element] = {}
        by_name: dict[str, list[Element]] = {}
        for element in model.walk():
            if element.tag in FRAMES and (element.tag != "Body" or id(element) in components):
                by_path.setdefault(_component_path(element), element)
                by_name.setdefault(element.name or GROUND, []).append(element)
            elif element.tag in STATIONS:
                by_path.setdefault(_component_path(element), element)
        return Frames(by_path, by_name)

    def resolve(self, target: str, owner: Element) -> tuple[str, Pose]:
        """Return the body that a socket of `owner` leads to, and the pose of the frame in it.

        Raises:
            ValueError: There is no such frame, or it is its own parent.
        """
        pose, start, first = IDENTITY, owner, target
        for _ in range(MAX_CHAIN):
            frame = self._find(target, owner)
            if frame is None:
                return GROUND, pose
            if frame.tag in ("Body", "Ground"):
                return (GROUND if frame.tag == "Ground" else frame.name), pose
            if frame.tag == DEFINED:
                body, inner = self._defined(frame)
                return body, inner @ pose
            pose = pose_of(frame, ("translation",), ("orientation",)) @ pose
            owner, target = frame, socket(frame, "parent")
            if not target:
                raise frame.error("has no <socket_parent>")
        raise start.error(f"is attached to {first!r}, which is its own parent or on over {MAX_CHAIN} frames")

    def _defined(self, frame: Element) -> tuple[str, Pose]:
        """Return body and pose of a frame whose axes are those of a triangle: a to b, and its normal.

        Raises:
            ValueError: A point is missing or of another body, or the points are on one line.
        """
        if id(frame) not in self.defined:
            if list(self.defined.values()).count(None) > MAX_CHAIN:
                raise frame.error(f"is defined through over {MAX_CHAIN} frames")
            self.defined[id(frame)] = None
            names = ("point_a", "point_b", "point_c", "origin_point")
            bodies, points = zip(*(self._station(frame, name) for name in names), strict=True)
            if len(set(bodies)) > 1:
                raise frame.error(f"must have points of one body, got {', '.join(sorted(set(bodies)))}")
            along = points[1] - points[0]
            normal = np.cross(along, points[2] - points[0])
            if not np.linalg.norm(normal) > SMALLEST * np.linalg.norm(along):
                raise frame.error("must have points a, b and c that form a triangle")
            along, normal = along / np.linalg.norm(along), normal / np.linalg.norm(normal)
            one, one_sign = _direction(frame, "ab_axis", "+x")
            other, other_sign = _direction(frame, "ab_x_ac_axis", "+y")
            if one == other:
                raise frame.error(f"has {'xyz'[one]!r} as both of its axes; they must differ")
            rotation = np.empty((3, 3))
            rotation[:, one], rotation[:, other] = one_sign * along, other_sign * normal
            third = 3 - one - other
            rotation[:, third] = np.cross(rotation[:, (third + 1) % 3], rotation[:, (third + 2) % 3])
            self.defined[id(frame)] = bodies[0], Pose(points[3], rotation)
        found = self.defined[id(frame)]
        if found is None:
            raise frame.error("is defined by points in itself")
        return found

    def _station(self, frame: Element, name: str) -> tuple[str, np.ndarray]:
        """Return body and place of one of the points that define a frame [m].

        Raises:
            ValueError: The model has none there.
        """
        target = socket(frame, name)
        station = self.by_path.get(posixpath.normpath(posixpath.join(_component_path(frame), target)))
        if station is None or station.tag not in STATIONS:
            raise frame.error(f"has the {name} {target!r}, but the model has no such station")
        body, pose = self.attached(station, "parent_frame", "body")
        return body, pose.point(station.numbers("location", default=(0.0, 0.0, 0.0), count=3))

    def _find(self, target: str, owner: Element) -> Element | None:
        """Return the frame at a path, absolute or as seen from `owner`; None: ground."""
        path = posixpath.normpath(posixpath.join(_component_path(owner), target))
        if path in self.by_path:
            return self.by_path[path]
        name = posixpath.basename(path)
        found = self.by_name.get(name, [])
        near = [frame for frame in found if frame.tag in ("Body", "Ground")] or [
            frame for frame in found if frame.parent is not None and frame.parent.parent is owner
        ]
        if len(near) == 1:
            return near[0]
        if name == GROUND:
            return None
        if near:
            raise owner.error(f"is attached to {target!r}, and {len(near)} frames have that name")
        if found:
            raise owner.error(f"is attached to {target!r}; a frame of that name is, but not there")
        raise owner.error(f"is attached to {target!r}, but the model has no such body or frame")

    def attached(self, element: Element, *sockets: str) -> tuple[str, Pose]:
        """Return the body and pose of the frame that one of these sockets leads to.

        Raises:
            ValueError: The element has none of them, or it leads nowhere.
        """
        target = socket(element, *sockets)
        if not target:
            raise element.error(f"has no <socket_{sockets[0]}>")
        return self.resolve(target, element)

    def named(self) -> dict[str, tuple[str, Pose]]:
        """Return body and pose of each frame whose name no other has; what leads nowhere is left out."""
        found = {}
        for name, same in self.by_name.items():
            if len(same) == 1:
                with contextlib.suppress(ValueError):
                    found[name] = self.resolve(_component_path(same[0]), same[0])
        return found

    def of_owner(self, element: Element) -> tuple[str, Pose]:
        """Return the body and pose of the frame inside which an element such as a wrap object stands."""
        owner = element.parent
        while owner is not None and owner.tag not in FRAMES:
            owner = owner.parent
        if owner is None:
            raise element.error("stands in no body or frame")
        return self.resolve(_component_path(owner), owner)

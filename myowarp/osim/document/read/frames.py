"""Frames of an .osim file: sockets and chains of offset frames -> a pose in a body."""

import posixpath
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from myowarp.osim.document.elements import Pose
from myowarp.osim.document.model import GROUND
from myowarp.osim.document.read.element import Element

MAX_CHAIN = 100  # offset frames on offset frames

FRAMES = ("Body", "Ground", "PhysicalOffsetFrame", "OffsetFrame")

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
    return Pose(
        element.numbers(*translation, default=zero, count=3),
        euler_xyz(element.numbers(*orientation, default=zero, count=3)),
    )


def socket(element: Element, *names: str) -> str:
    """Return what a socket is connected to, "" where the element has no such socket.

    Spellings: `socket_x` (4.0), `socket_x_connectee_name` (beta versions of 4.0), `<connectors>` with
    `<connectee_name>` (3.3 beta); the plain properties of 3.x are among `names`.
    """
    for name in names:
        for tag in (f"socket_{name}", f"socket_{name}_connectee_name", name):
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


@dataclass(frozen=True)
class Frames:
    """All frames of a model, by path and by name."""

    by_path: dict[str, Element]
    by_name: dict[str, list[Element]]

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
            pose = pose_of(frame, ("translation",), ("orientation",)) @ pose
            owner, target = frame, socket(frame, "parent")
            if not target:
                raise frame.error("has no <socket_parent>")
        raise start.error(f"is attached to {first!r}, which is its own parent or on over {MAX_CHAIN} frames")

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
        if len(found) == 1 or len(near) == 1:
            return near[0] if near else found[0]
        if name == GROUND:
            return None
        if found:
            raise owner.error(f"is attached to {target!r}, and {len(found)} frames have that name")
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

    def of_owner(self, element: Element) -> tuple[str, Pose]:
        """Return the body and pose of the frame inside which an element such as a wrap object stands."""
        owner = element.parent
        while owner is not None and owner.tag not in FRAMES:
            owner = owner.parent
        if owner is None:
            raise element.error("stands in no body or frame")
        return self.resolve(_component_path(owner), owner)

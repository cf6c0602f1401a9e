"""Joints and coordinates of an .osim file -> chains of moves."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from myowarp.osim.document.elements import Pose
from myowarp.osim.document.functions import IDENTITY, Constant, Multiplier, affine
from myowarp.osim.document.model import GROUND, Coordinate, Joint, Move, Note
from myowarp.osim.document.read.element import Element
from myowarp.osim.document.read.frames import IDENTITY as IDENTITY_POSE
from myowarp.osim.document.read.frames import TURN, Frames, pose_of, say_radians
from myowarp.osim.document.read.functions import function_in

X, Y, Z = np.eye(3)

ROTATIONS, TRANSLATIONS = (
    ("rotation1", "rotation2", "rotation3"),
    ("translation1", "translation2", "translation3"),
)


def _hinge(axis: np.ndarray, coordinate: str) -> Move:
    return Move("hinge", axis, IDENTITY, coordinate)


def _slide(axis: np.ndarray, coordinate: str) -> Move:
    return Move("slide", axis, IDENTITY, coordinate)


SIMPLE: dict[str, tuple[int, Callable[[list[str]], list[Move]]]] = {
    "WeldJoint": (0, lambda _: []),
    "PinJoint": (1, lambda q: [_hinge(Z, q[0])]),
    "SliderJoint": (1, lambda q: [_slide(X, q[0])]),
    "UniversalJoint": (2, lambda q: [_hinge(X, q[0]), _hinge(Y, q[1])]),
    "BallJoint": (3, lambda q: [_hinge(X, q[0]), _hinge(Y, q[1]), _hinge(Z, q[2])]),
    "GimbalJoint": (3, lambda q: [_hinge(X, q[0]), _hinge(Y, q[1]), _hinge(Z, q[2])]),
    "PlanarJoint": (3, lambda q: [_slide(X, q[1]), _slide(Y, q[2]), _hinge(Z, q[0])]),
    "FreeJoint": (
        6,
        lambda q: [
            *(_slide(axis, name) for axis, name in zip((X, Y, Z), q[3:], strict=True)),
            *(_hinge(axis, name) for axis, name in zip((X, Y, Z), q[:3], strict=True)),
        ],
    ),
}
"""OpenSim's class: number of coordinates, and their moves. Rotations come first among coordinates."""

ELLIPSOIDS = {
    "EllipsoidJoint": (3, X, Y, "radii_x_y_z"),
    "ScapulothoracicJoint": (4, Y, -X, "thoracic_ellipsoid_radii_x_y_z"),
}
"""OpenSim's class: number of coordinates, axes of the first two, and the property that holds the radii."""

JOINTS = (*SIMPLE, "CustomJoint", *ELLIPSOIDS, "ConstantCurvatureJoint")

LIKE_DEGREES = 10.0, 720.0
"""Ends of a range that no angle in radians has: beyond OpenSim's default, and below those of no range."""

SAME_RADIUS = 1e-5
"""[m]: radii of an ellipsoid that differ by less are the same; their mean is taken."""


@dataclass(frozen=True)
class Joints:
    """Joints of a model, parents first, with their coordinates and what was approximated."""

    joints: dict[str, Joint]
    coordinates: dict[str, Coordinate]
    notes: list[Note]


def read_joint(
    element: Element, frames: Frames, child_body: str | None, notes: list[Note]
) -> tuple[Joint, list[Element], list[str]]:
    """Return a joint, the elements of its coordinates, and the names of these.

    Args:
        element: The joint.
        frames: All frames of the model.
        child_body: Body that contains the joint, in documents before 4.0; None: the joint says so.
        notes: What is approximated is added.

    Raises:
        ValueError: Frames or axes missing or wrong.
        NotImplementedError: A joint class or function that is not supported.
    """
    parent, parent_frame = frames.attached(element, "parent_frame", "parent_body")
    child, child_frame = (
        (child_body, IDENTITY_POSE)
        if child_body is not None
        else frames.attached(element, "child_frame", "child_body")
    )
    # Places in the bodies themselves, before 30505.
    parent_frame = parent_frame @ pose_of(element, ("location_in_parent",), ("orientation_in_parent",))
    child_frame = child_frame @ pose_of(
        element, ("location_in_child", "location"), ("orientation_in_child", "orientation")
    )
    coordinates = element.objects("coordinates", "CoordinateSet")
    names = [item.name or f"{element.name}_coord_{index}" for index, item in enumerate(coordinates)]
    if element.tag in (*SIMPLE, *ELLIPSOIDS):
        count = (SIMPLE.get(element.tag) or ELLIPSOIDS[element.tag])[0]
        if names and len(names) != count:
            raise element.error(f"must have {count} coordinates, got {len(names)}")
        names += [f"{element.name}_coord_{index}" for index in range(len(names), count)]
    if element.tag in SIMPLE:
        moves = SIMPLE[element.tag][1](names)
    elif element.tag in ELLIPSOIDS:
        moves = _ellipsoid_moves(element, names, notes)
    elif element.tag == "CustomJoint":
        moves = _custom_moves(element, names)
    else:
        supported = ", ".join((*SIMPLE, *ELLIPSOIDS, "CustomJoint"))
        raise element.unsupported(f"is no supported joint; these are: {supported}")
    joint = Joint(element.name, element.tag, parent, child, parent_frame, child_frame, tuple(moves))
    if element.flag("reverse", default=False):
        # Before 4.0: the moves lead from the child to the parent; `in_order` turns the joint round again.
        joint = replace(reverse(joint), moves=joint.moves)
    return joint, coordinates, names


def _ellipsoid_moves(element: Element, names: list[str], notes: list[Note]) -> list[Move]:
    """Return the moves of a body whose z axis stays normal to the sphere that an ellipsoid is scaled from.

    With u and w the axes of the first two coordinates q, p, and c, d, e the radii along z, u x z and w x z,
    the point is cos p (c cos q z + d sin q u x z) + e sin p w x z. Vectors of constant length turned by q and
    -q, by p and -p, add up to that exactly: the joint needs no function that MuJoCo could only approximate.
    """
    _, first, second, radii = ELLIPSOIDS[element.tag]
    sizes = element.numbers(radii, count=3)
    if (sizes <= 0).any():
        raise element.error(f"must have {radii} above 0")
    along, across, other = (
        float(sizes @ np.abs(axis)) for axis in (Z, np.cross(first, Z), np.cross(second, Z))
    )
    mean, half = (along + across) / 2, (across - along) / 2
    q, p, about = names[:3]

    def turn(axis: np.ndarray, coordinate: str, times: float) -> Move:
        return Move("hinge", axis, IDENTITY if times == 1 else Multiplier(IDENTITY, times), coordinate)

    def outward(distance: float) -> Move:
        return Move("slide", Z, Constant(distance), None)

    moves = [turn(first, q, 1.0)]
    if 2 * abs(half) > SAME_RADIUS:
        moves = [
            *(turn(first, q, -1.0), turn(second, p, 1.0), outward(-half / 2), turn(second, p, -2.0)),
            *(outward(-half / 2), turn(second, p, 1.0), turn(first, q, 2.0)),
        ]
    elif half:
        rule = f"radii {along:g} and {across:g} became their mean"
        notes.append(Note(f"/jointset/{element.name}", rule, f"{abs(half):.2g} m"))
    moves += [turn(second, p, -1.0), outward((mean - other) / 2), turn(second, p, 2.0)]
    moves += [outward((mean + other) / 2), _hinge(Z, about)]
    if element.tag == "ScapulothoracicJoint":
        x, y = element.numbers("scapula_winging_axis_origin", default=(0.0, 0.0), count=2)
        angle = element.number("scapula_winging_axis_direction", default=0.0)
        axis = np.array([-np.sin(angle), np.cos(angle), 0.0])
        steps = [
            Move("slide", way, Constant(float(far)), None) for way, far in ((X, x), (Y, y), (X, -x), (Y, -y))
        ]
        moves += [*steps[:2], _hinge(axis, names[3]), *steps[2:]]
    return moves


def _custom_moves(element: Element, names: list[str]) -> list[Move]:
    """Return slides, then hinges, of a `CustomJoint`."""
    transform = element.find("SpatialTransform")
    listed = [] if transform is None else [one for one in transform.children if one.tag == "TransformAxis"]
    axes = {axis.name: axis for axis in listed}
    if len(axes) < len(listed):
        raise element.error("has two axes of one name in its <SpatialTransform>")
    if unknown := set(axes) - {*ROTATIONS, *TRANSLATIONS}:
        raise element.error(
            f"has an axis {sorted(unknown)[0]!r}; axes are {', '.join((*ROTATIONS, *TRANSLATIONS))}"
        )
    for group in (ROTATIONS, TRANSLATIONS):
        given = np.array([_axis(axes[name]) for name in group if name in axes])
        # OpenSim refuses such joints too: its mobilizer inverts the matrix of axes.
        if len(given) and np.linalg.matrix_rank(given, tol=1e-6) < len(given):
            raise element.error(f"has {group[0][:-1]} axes that are not independent")
    moves = []
    for name in (*TRANSLATIONS, *ROTATIONS):
        if name in axes and (move := _custom_move(axes[name], name in ROTATIONS, names)) is not None:
            moves.append(move)
    return moves


def _axis(element: Element) -> np.ndarray:
    """Return the unit vector of a `TransformAxis`."""
    axis = element.numbers("axis", default=(1.0, 0.0, 0.0), count=3)
    length = np.linalg.norm(axis)
    if length < 1e-9:
        raise element.error("must have an axis other than 0 0 0")
    return axis / length


def _custom_move(element: Element, rotates: bool, names: list[str]) -> Move | None:
    """Return the motion along one axis, None if there is none."""
    arguments = element.string("coordinates").split()
    if len(arguments) > 1:
        raise element.unsupported(f"depends on {len(arguments)} coordinates; one is supported")
    coordinate = arguments[0] if arguments else None
    if coordinate is not None and coordinate not in names:
        raise element.error(f"depends on coordinate {coordinate!r}; its joint has: {', '.join(names)}")
    function = function_in(element, "function", "")
    if function is None:
        # OpenSim lets the coordinate move nothing then.
        if coordinate is not None:
            raise element.error(f"has no <function> of its coordinate {coordinate!r}")
        function = Constant(0.0)
    line = affine(function)
    if coordinate is None and (line is None or line[0] != 0):
        raise element.error("has a function that is no constant, and names no coordinate in <coordinates>")
    if line is not None and line[0] == 0:
        if line[1] == 0:
            return None
        coordinate, function = None, Constant(line[1])
    return Move("hinge" if rotates else "slide", _axis(element), function, coordinate)


def reverse(joint: Joint) -> Joint:
    """Return the same joint with parent and child exchanged."""
    moves = tuple(
        Move(move.kind, move.axis, Multiplier(move.function, -1.0), move.coordinate)
        for move in reversed(joint.moves)
    )
    return replace(
        joint,
        parent=joint.child,
        child=joint.parent,
        parent_frame=joint.child_frame,
        child_frame=joint.parent_frame,
        moves=moves,
    )


def read_coordinate(element: Element | None, name: str, joint: Joint) -> tuple[Coordinate, list[Note]]:
    """Return a coordinate, and what was approximated; `element` None: all defaults."""
    moves = [move for move in joint.moves if move.coordinate == name]
    hinges = [move for move in moves if move.kind == "hinge"]
    straight = [move for move in moves if affine(move.function) is not None]
    rotational = (straight[0] if straight else moves[0]).kind == "hinge" if moves else True
    if hinges and not straight:
        rotational = True
    if element is None:
        return Coordinate(name, joint.name, rotational, 0.0, (-10.0, 10.0), False, False), []
    low, high = element.numbers("range", default=(-10.0, 10.0), count=2)
    clamped, locked = element.flag("clamped", default=False), element.flag("locked", default=False)
    if low > high:
        raise element.error(f"must have an ascending range, got {low:g} {high:g}")
    default, notes = element.number("default_value", default=0.0), []
    if rotational and abs(default) > TURN:
        say_radians(element, "the default", (default,))
    if rotational and LIKE_DEGREES[0] < max(abs(low), abs(high)) <= LIKE_DEGREES[1]:
        say_radians(element, "the range", (low, high))
    prescribed = function_in(element, "prescribed_function")
    if prescribed is not None and element.flag("prescribed", default=False):
        default, locked = float(prescribed.value(0.0)), True
        notes.append(
            Note(
                f"/jointset/{joint.name}/{name}",
                "prescribed by a function of time: locked at its value at 0 s",
            )
        )
    if speed := element.number("default_speed_value", default=0.0):
        said = f"begins with {speed:g} {'rad' if rotational else 'm'}/s in OpenSim; here it begins at rest"
        notes.append(Note(f"/jointset/{joint.name}/{name}", said))
    coordinate = Coordinate(name, joint.name, rotational, default, (float(low), float(high)), clamped, locked)
    return coordinate, notes


def in_order(
    joints: dict[str, tuple[Joint, Element]], bodies: list[str]
) -> tuple[list[Joint], dict[str, str], list[Note]]:
    """Return the joints with parents first, turned round where the child is the one that leads to ground.

    A body without a joint gets a free one, as in OpenSim. A joint that closes a loop moves a copy of its
    body, which is to be welded to the body; the second result says which body each copy is of.
    """
    ordered: list[Joint] = []
    notes: list[Note] = []
    copies: dict[str, str] = {}
    waiting = {name: joint for name, (joint, _) in joints.items()}
    placed = {GROUND}
    while waiting or not placed >= set(bodies):
        ready = [joint for joint in waiting.values() if joint.parent in placed or joint.child in placed]
        forward = next((joint for joint in ready if joint.parent in placed), None)
        if not ready:
            children = {joint.child for joint in waiting.values()}
            left = [body for body in bodies if body not in placed]
            base = next((body for body in left if body not in children), left[0])
            notes.append(
                Note(f"/bodyset/{base}", "not connected to ground: a free joint was added, as OpenSim does")
            )
            names = [f"free_{base}_coord_{index}" for index in range(6)]
            origin = Pose(np.zeros(3), np.eye(3))
            free = SIMPLE["FreeJoint"][1](names)
            ordered.append(Joint(f"free_{base}", "FreeJoint", GROUND, base, origin, origin, tuple(free)))
            placed.add(base)
            continue
        joint = forward or reverse(ready[0])
        del waiting[joint.name]
        if joint.child in placed:
            copy = f"{joint.child}-closed-by-{joint.name}"
            copies[copy] = joint.child
            joint = replace(joint, child=copy)
        ordered.append(joint)
        placed.add(joint.child)
    return ordered, copies, notes

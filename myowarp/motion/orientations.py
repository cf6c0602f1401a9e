"""Orientations of inertial sensors: `.sto` files of quaternions, where sensors sit on bodies, and weights.

OpenSense's workflow. A first recording, in the model's default pose, gives how each sensor is turned on its
body: of body B with axes R_GB, the sensor that was recorded as R_GS sits there as R_GB^T R_GS. Frames of that
orientation, named as the sensors, go into the model. Later recordings are followed by these frames
(`orientation_kinematics`). A sensor called `femur_r_imu` is on the body `femur_r`.

Source: OpenSim's `IMUPlacer`, `OpenSenseUtilities` and `IMUInverseKinematicsTool`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from myowarp.disk import make_folder
from myowarp.motion.headers import Header
from myowarp.motion.setup_words import file_of
from myowarp.motion.storage import Rows, rows_between
from myowarp.osim.document.kinematics import about, complete, forward
from myowarp.osim.document.model import GROUND, Model
from myowarp.osim.document.read.element import Element, parse, write
from myowarp.osim.document.read.frames import TURN, say_radians
from myowarp.osim.document.read.model import Document

SUFFIX = "_imu"
"""Of a sensor's name, after that of its body."""

AXES = dict(zip("xyz", np.eye(3), strict=True))


@dataclass(frozen=True, eq=False)
class Orientations:
    """Orientations of sensors over time.

    Attributes:
        names: Of sensors.
        time: [s], increasing, shape (frames,).
        rotations: Axes of sensors as columns, NaN where one was not recorded, shape (frames, sensors, 3, 3).
    """

    names: tuple[str, ...]
    time: np.ndarray
    rotations: np.ndarray

    def turned(self, rotation: np.ndarray) -> Orientations:
        """Return them in other axes, into which a rotation of shape (3, 3) leads."""
        return replace(self, rotations=rotation @ self.rotations)

    def between(self, start: float, end: float) -> Orientations:
        """Return the frames from `start` to `end` [s], both included.

        Raises:
            ValueError: There is none.
        """
        kept = rows_between(self.time, start, end, "orientations are")
        return Orientations(self.names, self.time[kept], self.rotations[kept])


class QuaternionRows(Rows):
    """Rows of a `.sto` file whose cells are quaternions, `w,x,y,z`; NaN where there is none."""

    def _head(self) -> Header:
        header = super()._head()
        self.names = header.labels
        return replace(header, labels=tuple(f"{name} {part}" for name in header.labels for part in "wxyz"))

    def _numbers(self, lines: list[str]) -> np.ndarray:
        for number, line in enumerate(lines, self._read + 1):
            cells = line.split()[1:]
            if wrong := [cell for cell in cells if cell.count(",") != 3]:
                raise ValueError(
                    f"row {number} of {str(self.path)!r} has a cell that is no quaternion w,x,y,z: "
                    f"{wrong[0][:60]!r}; orientations have four numbers in each, with commas between"
                )
        return super()._numbers([line.replace(",", "\t") for line in lines])


def read_orientations(path: Path) -> Orientations:
    """Read a `.sto` file of quaternions.

    Raises:
        ValueError: It is none, or a quaternion is 0.
        OSError: It cannot be read.
    """
    with QuaternionRows(path, gaps=True) as rows:
        table, names = rows.whole(), rows.names
    quaternions = table.values.reshape(len(table.time), len(names), 4)
    length = np.linalg.norm(quaternions, axis=2, keepdims=True)
    if len(zero := np.argwhere(length[..., 0] == 0.0)):
        frame, sensor = zero[0]
        raise ValueError(
            f"{str(path)!r} has the quaternion 0 of {names[sensor]!r} at {table.time[frame]:g} s; where a "
            "sensor was not recorded, write NaN,NaN,NaN,NaN"
        )
    return Orientations(names, table.time, rotations_of(quaternions / length))


def rotations_of(quaternions: np.ndarray) -> np.ndarray:
    """Return the rotations of unit quaternions w, x, y, z, shape (..., 4), as matrices, shape (..., 3, 3)."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def axes_of_sensors(angles: Sequence[float]) -> np.ndarray:
    """Return the rotation from the sensors' world into OpenSim's, shape (3, 3).

    Args:
        angles: About x, then y, then z of OpenSim's world [rad]; -pi/2 0 0 where the sensors' z axis is up.
    """
    x, y, z = (about(axis, np.array([angle]))[0] for axis, angle in zip(np.eye(3), angles, strict=True))
    return np.asarray(z @ y @ x)


@dataclass(frozen=True)
class Placing:
    """Placement of sensors.

    Attributes:
        orientations: File of quaternions, recorded in the model's default pose.
        angles: As in `axes_of_sensors` [rad].
        base: Sensor whose heading is brought to that of the model; empty: none is.
        heading: Its axis that points forwards, such as `-z`.
    """

    orientations: Path | None = None
    angles: tuple[float, float, float] = (0.0, 0.0, 0.0)
    base: str = ""
    heading: str = ""

    @staticmethod
    def read(path: Path) -> Placing:
        """Read a set-up file of OpenSim's `IMUPlacer`.

        Raises:
            ValueError: It is none.
            OSError: It cannot be read.
        """
        root, _ = parse(path)
        tool = next((element for element in root.walk() if element.tag == "IMUPlacer"), None)
        if tool is None:
            raise root.error("holds no <IMUPlacer>")
        return Placing(
            file_of(tool, "orientation_file_for_calibration"),
            angles_in(tool),
            tool.string("base_imu_label"),
            tool.string("base_heading_axis"),
        )


def angles_in(tool: Element) -> tuple[float, float, float]:
    """Return the `sensor_to_opensim_rotations` of a set-up file [rad]."""
    tag = "sensor_to_opensim_rotations"
    x, y, z = map(float, tool.numbers(tag, default=(0.0, 0.0, 0.0), count=3))
    if max(map(abs, (x, y, z))) > TURN:
        say_radians(tool, f"the {tag}", (x, y, z))
    return x, y, z


@dataclass(frozen=True, eq=False)
class Placed:
    """Sensors on a model.

    Attributes:
        document: The model with a frame for each.
        sensors: By name, body and axes in the body as columns, shape (3, 3).
        heading: By how much the recording was turned about the vertical [rad].
        left: Sensors that are on no body of the model.
    """

    document: Document
    sensors: Mapping[str, tuple[str, np.ndarray]] = field(default_factory=dict)
    heading: float = 0.0
    left: tuple[str, ...] = ()

    def write(self, folder: Path) -> None:
        """Write `placed.osim` into a folder, which is made.

        Raises:
            OSError: The file cannot be written.
        """
        make_folder(folder)
        write(folder / "placed.osim", self.document.root)


def place(document: Document, recorded: Orientations, placing: Placing) -> Placed:
    """Put frames of sensors into a model, by the first frame of a recording in its default pose.

    Raises:
        ValueError: No sensor is on a body, the base is unknown, or its heading cannot be found.
    """
    model = document.model
    recorded = recorded.turned(axes_of_sensors(placing.angles))
    frames = forward(model, complete(model, {}, 1))
    turn = 0.0
    if placing.base and placing.heading:
        turn = _heading(model, recorded, placing, frames[_base(model)][0][0])
        recorded = recorded.turned(about(AXES["y"], np.array([turn]))[0])
    sensors = {}
    for name, rotation in zip(recorded.names, recorded.rotations[0], strict=True):
        body = name.removesuffix(SUFFIX)
        if name.endswith(SUFFIX) and body in model.bodies:
            if not np.isfinite(rotation).all():
                raise ValueError(f"the first frame has no orientation of {name!r}, which places the sensor")
            sensors[name] = body, frames[body][0][0].T @ rotation
    if not sensors:
        raise ValueError(
            f"no sensor is called like a body with {SUFFIX} behind it; the recording has "
            f"{', '.join(recorded.names)}, the model {', '.join(model.bodies)}"
        )
    for name, (body, rotation) in sensors.items():
        _put_frame(document, name, body, rotation)
    left = tuple(name for name in recorded.names if name not in sensors)
    return Placed(Document(model.source, document.root), sensors, turn, left)


def _base(model: Model) -> str:
    """Return the body that the first joint on ground carries."""
    return next(joint.child for joint in model.joints.values() if joint.parent == GROUND)


def _heading(model: Model, recorded: Orientations, placing: Placing, forwards: np.ndarray) -> float:
    """Return the angle about the vertical from a sensor's axis to the x axis of the model's base [rad]."""
    axis = placing.heading.lower()
    if axis.lstrip("-+") not in AXES or len(axis) > 2:
        raise ValueError(f"the heading axis must be x, y or z, with a sign, got {placing.heading!r}")
    if placing.base not in recorded.names:
        raise ValueError(
            f"the recording has no base sensor {placing.base!r}; available: {', '.join(recorded.names)}"
        )
    seen = recorded.rotations[0, recorded.names.index(placing.base)] @ AXES[axis[-1]]
    if axis[0] == "-":
        seen = -seen
    if not np.isfinite(seen).all():
        raise ValueError(f"the first frame has no orientation of the base sensor {placing.base!r}")
    ahead = forwards @ AXES["x"]
    angle = float(np.arccos(np.clip(seen @ ahead, -1.0, 1.0)))
    return -angle if np.cross(ahead, seen)[1] > 0.0 else angle


def _put_frame(document: Document, name: str, body: str, rotation: np.ndarray) -> None:
    """Put a frame on a body, at its mass centre, or turn the one of that name."""
    angles = euler_of(rotation)
    frames = [element for element in document.root.walk() if element.tag == "PhysicalOffsetFrame"]
    for frame in frames:
        if frame.name == name:
            frame.put_numbers("orientation", angles)
            return
    owner = next(e for e in document.root.walk() if e.tag == "Body" and e.name == body)
    components = owner.own("components") or owner.put("components", "")
    frame = Element(owner.source, "PhysicalOffsetFrame", {"name": name}, owner.line, parent=components)
    frame.put("socket_parent", "..")
    frame.put_numbers("translation", document.model.bodies[body].mass_center)
    frame.put_numbers("orientation", angles)
    components.children.append(frame)


def euler_of(rotation: np.ndarray) -> np.ndarray:
    """Return a, b, c of Rx(a) Ry(b) Rz(c) [rad], shape (3,)."""
    b = np.arctan2(rotation[0, 2], np.hypot(rotation[0, 0], rotation[0, 1]))
    if np.hypot(rotation[0, 0], rotation[0, 1]) < 1e-12:  # a and c turn about one axis
        return np.array([np.arctan2(rotation[2, 1], rotation[1, 1]), b, 0.0])
    return np.array(
        [
            np.arctan2(-rotation[1, 2], rotation[2, 2]),
            b,
            np.arctan2(-rotation[0, 1], rotation[0, 0]),
        ]
    )

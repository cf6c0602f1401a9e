"""Scaling: a generic model becomes that of a person who stood still, by OpenSim's set-up file.

A measurement is the mean, over pairs of markers, of the recorded distance over that in the model, in its
default pose; it scales the bodies that it names along the axes that it names, and factors by hand replace
those of a body. Then the model is posed to the recorded markers, averaged over time, by weighted inverse
kinematics, and every marker that is not fixed goes to where it was recorded.

Source: OpenSim's `ScaleTool`, `ModelScaler` and `MarkerPlacer`. A marker of a measurement that is not there
is an error here; OpenSim leaves the measurement out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from myowarp.disk import make_folder
from myowarp.motion.inverse_kinematics import Fitted, inverse_kinematics
from myowarp.motion.markers import Markers, read_trc, say_unmatched
from myowarp.motion.movement import write_angles
from myowarp.motion.setup_words import Span, body_of, file_of, span_of
from myowarp.motion.tasks import Tasks, tasks_of
from myowarp.osim.body.scale_document import scale_document
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.kinematics import complete, forward, station
from myowarp.osim.document.model import GROUND, Model
from myowarp.osim.document.read.element import Element, parse, write
from myowarp.osim.document.read.model import Document, set_markers

AXES = ("X", "Y", "Z")
UNSTATED = (-1.0, -1.0)
"""Times that ScaleTool writes where none are stated: it then takes the first frame."""

MOST = 10.0
"""By which a measurement may enlarge a body; 1 over it is the least."""
HEAVIER = 100.0
"""By which a person may be heavier than the model, which a mass in grams is not; 1 over it is the least."""

Measured = tuple[float, tuple[tuple[str, str, float, float], ...]]
"""A factor, and for each pair the names, and distances in the model and in the recording [m]."""


@dataclass(frozen=True)
class Measurement:
    """Distances of markers that scale bodies."""

    name: str
    pairs: tuple[tuple[str, str], ...]
    bodies: Mapping[str, tuple[int, ...]]
    """Axes along which each body grows."""


@dataclass(frozen=True)
class ScaleSetup:
    """Contents of a set-up file of `ScaleTool`.

    Attributes:
        model: The generic model, None where it is not stated.
        markers: A set of markers that replace those of the model.
        mass: Of the person [kg], None where it stays.
        order: `measurements` and `manualScale`, in the order in which they are done; empty: no scaling.
        measurements: Those that apply.
        manual: By body, factors that apply, shape (3,).
        static: The recording that is measured.
        span: Time over which it is averaged [s].
        keep_masses: Whether bodies keep their shares of the mass.
        tasks: Weights of the pose, None: markers stay.
        pose: The recording of the pose.
        pose_span: Time over which it is averaged [s].
    """

    model: Path | None
    markers: Path | None
    mass: float | None
    order: tuple[str, ...]
    measurements: tuple[Measurement, ...]
    manual: Mapping[str, np.ndarray]
    static: Path | None
    span: Span
    keep_masses: bool
    tasks: Tasks | None
    pose: Path | None
    pose_span: Span


@dataclass(frozen=True, eq=False)
class Scaled:
    """A model that became a person's.

    Attributes:
        document: The model.
        factors: By body, shape (3,).
        measured: By measurement: its factor, and for each pair the names, distance in the model and in the
            recording [m].
        pose: How markers fitted the pose before they moved; None: they stayed.
        moved: By marker, how far it went in its body [m].
        unknown: Bodies that the set-up file scales and the model does not have.
    """

    document: Document
    factors: dict[str, np.ndarray]
    measured: dict[str, Measured]
    pose: Fitted | None
    moved: dict[str, float]
    unknown: tuple[str, ...]

    def write(self, folder: Path) -> None:
        """Write `scaled.osim`, `scale_factors.xml`, OpenSim's `ScaleSet`, and, posed, `static.mot`.

        Raises:
            ValueError: The folder cannot be made.
            OSError: A file cannot be written.
        """
        make_folder(folder)
        write(folder / "scaled.osim", self.document.root)
        path = folder / "scale_factors.xml"
        root = Element(path, "OpenSimDocument", {"Version": "40000"}, 1)
        objects = Element(path, "objects", {}, 1)
        for name, scales in self.factors.items():
            one = Element(path, "Scale", {}, 1)
            one.put_numbers("scales", scales)
            one.put("segment", name)
            one.put("apply", "true")
            objects.children.append(one)
        root.children.append(Element(path, "ScaleSet", {"name": "factors"}, 1, children=[objects]))
        write(path, root)
        if (pose := self.pose) is not None:
            model = self.document.model
            write_angles(folder / "static.mot", model, pose.coordinates, pose.time, pose.values)


def read_setup(path: Path) -> ScaleSetup:
    """Read a set-up file of `ScaleTool`; files that it names are beside it.

    Raises:
        ValueError: It is none, or says something impossible.
        OSError: It cannot be read.
    """
    root, _ = parse(path)
    tool = next((element for element in root.walk() if element.tag == "ScaleTool"), None)
    if tool is None:
        raise root.error("holds no <ScaleTool>; scaling needs a set-up file of OpenSim's scale tool")
    empty = Element(path, "", {}, tool.line)
    maker, scaler, placer = (
        tool.own(tag) or empty for tag in ("GenericModelMaker", "ModelScaler", "MarkerPlacer")
    )
    order = tuple(scaler.string("scaling_order").split()) if _on(scaler, empty) else ()
    for word in order:
        if word not in ("measurements", "manualScale"):
            raise scaler.need("scaling_order").error(f"must name measurements or manualScale, got {word!r}")
    mass = tool.number("mass", default=-1.0)
    manual = {
        body_of(scale.string("segment")): scale.numbers("scales", count=3)
        for scale in scaler.objects("ScaleSet")
        if scale.flag("apply", default=True)
    }
    if bad := [name for name, scales in manual.items() if (scales <= 0.0).any()]:
        raise scaler.error(f"must have factors above 0, got {manual[bad[0]]} for {bad[0]!r}")
    return ScaleSetup(
        model=file_of(maker, "model_file"),
        markers=file_of(maker, "marker_set_file"),
        mass=mass if mass > 0.0 else None,
        order=order,
        measurements=tuple(
            _measurement(one) for one in scaler.objects("MeasurementSet") if one.flag("apply", default=True)
        ),
        manual=manual,
        static=file_of(scaler, "marker_file"),
        span=span_of(scaler, UNSTATED),
        keep_masses=scaler.flag("preserve_mass_distribution", default=False),
        tasks=tasks_of(placer) if _on(placer, empty) else None,
        pose=file_of(placer, "marker_file"),
        pose_span=span_of(placer, UNSTATED),
    )


def _on(element: Element, empty: Element) -> bool:
    return element is not empty and element.flag("apply", default=True)


def _measurement(element: Element) -> Measurement:
    """Return a measurement."""
    pairs = []
    for pair in element.objects("MarkerPairSet"):
        names = pair.string("markers").split()
        if len(names) != 2:
            raise pair.error(f"must name two markers, got {' '.join(names)!r}")
        pairs.append((names[0], names[1]))
    if not pairs:
        raise element.error("has no pair of markers; name some, or set its <apply> to false")
    bodies = {}
    for body in element.objects("BodyScaleSet"):
        axes = body.string("axes").upper().split()
        if unknown := [axis for axis in axes if axis not in AXES]:
            raise body.error(f"must have axes of X Y Z, got {unknown[0]!r}")
        bodies[body_of(body.name)] = tuple(AXES.index(axis) for axis in axes)
    return Measurement(element.name, tuple(pairs), bodies)


def window(recorded: Markers, span: Span) -> Markers:
    """Return the frames from the last one not after the start to the first one not before the end.

    Raises:
        ValueError: The recording has ended, or not begun.
    """
    time = recorded.time
    if span != UNSTATED and (span[0] > time[-1] or span[1] < time[0]):
        return recorded.between(*span)
    first = max(int(np.searchsorted(time, span[0], "right")) - 1, 0)
    last = min(max(int(np.searchsorted(time, span[1], "left")), first), len(time) - 1)
    return recorded.between(time[first], time[last])


def measure(model: Model, recorded: Markers, measurement: Measurement) -> Measured:
    """Return the factor of a measurement, and what it is from.

    Raises:
        ValueError: A marker is not there, was never seen, or is where its partner is; or nobody is so large.
    """
    frames = forward(model, complete(model, {}, 1))
    rows = []
    for pair in measurement.pairs:
        for name in pair:
            for where, names in (("model", model.markers), ("recording", recorded.names)):
                if name not in names:
                    raise ValueError(
                        f"measurement {measurement.name!r} needs the marker {name!r}, which the {where} does "
                        f"not have; it has {', '.join(names)}"
                    )
        a, b = (station(frames, model.markers[name].body, model.markers[name].location)[0] for name in pair)
        p, q = (recorded.positions[:, recorded.names.index(name)] for name in pair)
        apart = np.linalg.norm(p - q, axis=1)
        ours, seen = float(np.linalg.norm(a - b)), apart[np.isfinite(apart)]
        if not len(seen) or ours <= 0.0 or not seen.mean() > 0.0:
            raise ValueError(
                f"measurement {measurement.name!r}: markers {pair[0]!r} and {pair[1]!r} must be apart in the "
                f"model ({ours:g} m) and seen together in the recording ({len(seen)} frames)"
            )
        rows.append((*pair, ours, float(seen.mean())))
    factor = float(np.mean([row[3] / row[2] for row in rows]))
    if not 1.0 / MOST < factor < MOST:
        raise ValueError(
            f"measurement {measurement.name!r} makes bodies {factor:.3g} times as large, which must be "
            f"{1.0 / MOST:g} to {MOST:g}; check the units of the recording and of the model"
        )
    return factor, tuple(rows)


def scale(source: Path, setup: ScaleSetup, static: Path | None = None, device: Any = "cpu") -> Scaled:
    """Scale a generic model to a person.

    Args:
        source: The generic model, .osim.
        setup: What to do.
        static: Markers of the person who stands still, .trc; by default those that `setup` names.
        device: Where the pose is found.

    Raises:
        ValueError: A file is not what it should be, a marker is missing, or the mass is no person's.
        NotImplementedError: The model has something that is not supported.
        OSError: A file cannot be read.
    """
    document = Document(source, parse(source)[0])
    if setup.markers is not None:
        document = set_markers(document, parse(setup.markers)[0])
    named = [*setup.manual, *(body for one in setup.measurements for body in one.bodies)]
    there = document.model.mass
    if setup.mass is not None and there and not there / HEAVIER < setup.mass < HEAVIER * there:
        raise ValueError(
            f"<mass> must be {1.0 / HEAVIER:g} to {HEAVIER:g} times the model's {there:.4g} kg, got "
            f"{setup.mass:g} kg; write it in kg"
        )
    bodies = (GROUND, *document.model.bodies)
    unknown = tuple(dict.fromkeys(name for name in named if name not in bodies))
    factors = {name: np.ones(3) for name in bodies}
    measured = {}
    for step in setup.order:
        if step == "manualScale":
            factors |= {name: scales for name, scales in setup.manual.items() if name in bodies}
            continue
        recorded = window(_recording(static or setup.static), setup.span)
        for one in setup.measurements:
            measured[one.name] = measure(document.model, recorded, one)
            for body, axes in one.bodies.items():
                if body in bodies:
                    factors[body][list(axes)] = measured[one.name][0]
    if setup.order:
        document = scale_document(document, factors, setup.mass, setup.keep_masses)
    pose: Fitted | None = None
    moved: dict[str, float] = {}
    if setup.tasks is not None:
        recorded = window(_recording(static or setup.pose), setup.pose_span)
        document, pose, moved = place_markers(document, recorded, setup.tasks, device)
    return Scaled(document, factors, measured, pose, moved, unknown)


def _recording(path: Path | None) -> Markers:
    if path is None:
        raise ValueError("scaling needs a recording of the person who stands still; give --markers FILE")
    return read_trc(path)


def place_markers(
    document: Document, recorded: Markers, tasks: Tasks, device: Any = "cpu"
) -> tuple[Document, Fitted, dict[str, float]]:
    """Move markers to where they were recorded, in the pose that fits best.

    Args:
        document: The scaled model, changed in place.
        recorded: Frames over which markers are averaged.
        tasks: Weights of markers and coordinates.
        device: Where the pose is found.

    Returns:
        The model, the pose and how it fitted, and by marker how far it went in its body [m].

    Raises:
        ValueError: Markers are missing, or a weight is wrong.
    """
    if tasks.recorded:
        raise ValueError(
            f"coordinate {tasks.recorded[0]!r} takes its value from a file, which scaling does not read; "
            "state it, or leave it out"
        )
    seen = np.isfinite(recorded.positions).all(axis=2)
    total = np.where(seen[:, :, None], recorded.positions, 0.0).sum(axis=0)
    count = seen.sum(axis=0)[:, None]
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    still = Markers(recorded.names, recorded.time[:1], mean[None])
    bones = Bones(document.model, device)
    say_unmatched(tuple(bones.model.markers), still)
    pose = inverse_kinematics(bones, still, tasks.among(still.names), tasks.coordinates, tasks.values)
    frames = forward(
        document.model, complete(document.model, dict(zip(pose.coordinates, pose.values.T, strict=True)), 1)
    )
    moved: dict[str, float] = {}
    for own, element in document.pairs:
        if element.tag != "Marker" or element.name not in still.names:
            continue
        point = mean[still.names.index(element.name)]
        if element.flag("fixed", default=False) or not np.isfinite(point).all():
            continue
        body, frame = document.frames.attached(element, "parent_frame", "body")
        rotation, origin = frames[body][0][0], frames[body][1][0]
        place = frame.inverse().point(rotation.T @ (point - origin))
        moved[element.name] = float(
            np.linalg.norm(place - element.numbers("location", default=(0.0, 0.0, 0.0)))
        )
        own.put_numbers("location", place)
    return Document(document.model.source, document.root), pose, moved

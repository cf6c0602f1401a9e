"""Steps of a trial: functions of a model and a set-up, which read its files and return what they find.

Nothing is written here; results write themselves (`results`). A step takes the whole motion of the set-up, or
a part of it from `moved_in_parts` where the motion is too long for memory.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from myowarp.motion.actuators import Actuators, actuators_of
from myowarp.motion.inverse_dynamics import Load, Needed, inverse_dynamics
from myowarp.motion.inverse_kinematics import Fitted, inverse_kinematics
from myowarp.motion.joint_reactions import joint_reactions
from myowarp.motion.loads import Loads, prescribed_loads
from myowarp.motion.markers import Markers, MarkerStream, read_trc, say_unmatched
from myowarp.motion.metabolic_power import metabolic_power
from myowarp.motion.movement import Movement, read_motion, read_parts
from myowarp.motion.muscle_forces import MuscleForces, muscle_forces, rigid_capacity
from myowarp.motion.orientation_kinematics import orientation_kinematics
from myowarp.motion.orientations import axes_of_sensors, read_orientations
from myowarp.motion.residuals import Residuals, astray, carried, too_heavy
from myowarp.motion.results import (
    Gaps,
    JointAngles,
    JointMoments,
    MotionForces,
    MuscleAnalysis,
    TrackedMotion,
)
from myowarp.motion.setup import EXPONENT, POSES, TrialSetup
from myowarp.motion.streams import Margin, is_long
from myowarp.motion.tracking import track as simulate
from myowarp.motion.units import hardly_seconds
from myowarp.osim.body.hill_muscle import HillMuscle, known
from myowarp.osim.body.model_forces import open_loops
from myowarp.osim.body.muscle_paths import MusclePaths, muscle_paths
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.kinematics import complete, floating, forward
from myowarp.process import warn_once

TIPPED = 45.0
"""Angle from its default vertical beyond which a root is doubted [degrees]."""

logger = logging.getLogger("myowarp")


def kinematics(bones: Bones, setup: TrialSetup) -> JointAngles:
    """Find the joint angles of recorded markers, or of recorded orientations of sensors.

    Args:
        bones: The model; with a frame of the name of each sensor.
        setup: With a file of markers or of orientations; those without a weight do not count.

    Raises:
        ValueError: A file is missing or not what it should be, or the model has no frame of a sensor.
        OSError: A file cannot be read.
    """
    return next(_angles(bones, setup, whole=True))


def kinematics_in_parts(bones: Bones, setup: TrialSetup) -> Iterator[JointAngles]:
    """Do what `kinematics` does, and yield joint angles of markers by parts; each begins at the one before.

    Raises:
        As `kinematics`.
    """
    return _angles(bones, setup, whole=False)


def _angles(bones: Bones, setup: TrialSetup, whole: bool) -> Iterator[JointAngles]:
    setup.check_tool(POSES)
    if sentence := open_loops(bones.model):
        warn_once(f"{bones.model.source.name}: {sentence}")
    if setup.orientations is not None:
        yield kinematics_of_sensors(bones, setup)
        return
    held, gaps, start = _held(bones, setup), Gaps(), None
    for seen, recorded, total in _marker_parts(setup, whole):
        gaps = gaps.after(seen, recorded)
        wanted = _targets(bones, setup, held, recorded)
        fitted = inverse_kinematics(bones, recorded, **wanted, start=start)
        if start is None:
            say_unmatched(tuple(bones.model.markers), recorded)
            if doubt := hardly_seconds(setup.recording, recorded.time):
                logger.warning("%s", doubt)
            say_tipped(bones, fitted)
        start = dict(zip(fitted.coordinates, fitted.values[-1], strict=True))
        yield JointAngles(bones, fitted, recorded, wanted, gaps, total)


def _marker_parts(setup: TrialSetup, whole: bool) -> Iterator[tuple[Markers, Markers, int | None]]:
    """Yield the markers of a file in parts: as they were seen, with gaps filled, and the frames of all."""
    path, span, fill = setup.recording, setup.span, setup.fill
    if whole or not is_long(path):
        seen = read_trc(path)
        recorded = seen if fill is None else seen.filled(fill)
        if span is not None:
            seen = seen.between(*span)
            recorded = recorded.between(seen.time[0], seen.time[-1])
        yield seen, recorded, None
        return
    begin, end = span or (-np.inf, np.inf)
    with MarkerStream(path) as stream:
        total = stream.count(span)
        for table, own in stream.parts(Margin(seconds=2.0 * (fill or 0.0))):
            seen = stream.placed(table)
            recorded = seen if fill is None else seen.filled(fill)
            inside = [max(begin, seen.time[own][0]), min(end, seen.time[own][-1])]
            if inside[0] <= inside[1]:
                yield seen.between(*inside), recorded.between(*inside), total


def _held(bones: Bones, setup: TrialSetup) -> Movement | None:
    """Return the joint angles that coordinates of a set-up should have; None: they have none of a file."""
    tasks, path = setup.tasks, setup.coordinates
    if tasks is None and setup.file is not None:
        raise ValueError(
            f"{str(setup.file)!r} has no <IKMarkerTask>; a set-up file of inverse kinematics has"
        )
    if tasks is None or not tasks.recorded:
        return None
    if path is None:
        raise ValueError(
            f"{str(setup.file)!r} has coordinates whose values are in a file, and names no <coordinate_file>"
        )
    held = read_motion(path, bones)
    unknown = [name for name in tasks.recorded if name in held.absent or name not in bones.coordinates]
    if unknown:
        raise ValueError(f"{str(path)!r} has no column of the coordinate {unknown[0]!r}")
    return held


def _targets(bones: Bones, setup: TrialSetup, held: Movement | None, recorded: Markers) -> dict[str, Any]:
    """Return what a pose fits, as `inverse_kinematics` takes it: weights, and wanted values."""
    tasks, time = setup.tasks, recorded.time
    if tasks is None:
        return {}
    values: dict[str, float | np.ndarray] = {**tasks.values}
    if held is not None:
        if time[0] < held.time[0] - 1e-6 or time[-1] > held.time[-1] + 1e-6:
            raise ValueError(
                f"{str(setup.coordinates)!r} is from {held.time[0]:g} to {held.time[-1]:g} s; the markers "
                f"are from {time[0]:g} to {time[-1]:g} s"
            )
        for name in tasks.recorded:
            values[name] = np.interp(time, held.time, held.values[:, bones.coordinates.index(name)])
    return {
        "marker_weights": tasks.among(recorded.names),
        "coordinate_weights": tasks.coordinates,
        "coordinate_values": values,
    }


def kinematics_of_sensors(bones: Bones, setup: TrialSetup) -> JointAngles:
    """Find the joint angles of recorded orientations, see `kinematics`."""
    if setup.orientations is None:
        raise ValueError("joint angles of sensors need a file of quaternions; give --orientations FILE")
    recorded = read_orientations(setup.orientations).turned(axes_of_sensors(setup.sensor_angles))
    if setup.span is not None:
        recorded = recorded.between(*setup.span)
    fitted = orientation_kinematics(bones, recorded, setup.sensor_weights)
    say_tipped(bones, fitted)
    return JointAngles(bones, fitted)


def say_tipped(bones: Bones, fitted: Fitted) -> None:
    """Say which body at a free root is far from its default vertical, in each of 100 frames or more."""
    model, rows = bones.model, fitted.values[:: max(1, len(fitted.time) // 100)]
    names, gravity = fitted.coordinates, float(np.linalg.norm(model.gravity))
    roots = dict.fromkeys(model.coordinates[name].joint for name in floating(model))
    if not roots or not gravity:
        return
    defaults, up = np.array([[model.coordinates[name].default for name in names]]), -model.gravity / gravity
    stands, lies = (
        forward(model, complete(model, dict(zip(names, part.T, strict=True)), len(part)))
        for part in (defaults, rows)
    )
    for body in (model.joints[joint].child for joint in roots):
        lean = np.degrees(np.arccos(np.clip(lies[body][0] @ stands[body][0][0].T @ up @ up, -1.0, 1.0)))
        if lean.min() > TIPPED:
            least = f"the {body} is tipped by {lean.min():.0f} degrees at least, in every frame"
            logger.warning("%s; check which axis of the recording is up, unless the person lies", least)


@dataclass(frozen=True, eq=False)
class Loaded(Movement):
    """A motion, or a part of one, under loads.

    Attributes:
        loads: Returns at some times [s] the loads from outside, and what forces of the model prescribe.
    """

    loads: Callable[[np.ndarray], list[Load]] = field(kw_only=True)


def moved(bones: Bones, setup: TrialSetup) -> Loaded:
    """Return the whole motion of a set-up.

    Raises:
        ValueError: The set-up has no joint angles, or a file is not what it should be.
        OSError: A file cannot be read.
    """
    known = None if setup.loads is None else Loads(setup.loads)
    motion = read_motion(setup.angles, bones, setup.cutoff)
    return _loaded(bones, motion if setup.span is None else motion.between(*setup.span), known)


def moved_in_parts(bones: Bones, setup: TrialSetup) -> Iterator[Loaded]:
    """Yield the motion of a set-up, in parts where it is long.

    Raises:
        As `moved`.
    """
    with ExitStack() as stack:
        known = None
        if setup.loads is not None:
            known = stack.enter_context(closing(Loads(setup.loads, forwards=is_long(setup.angles))))
        for part in read_parts(setup.angles, bones, setup.cutoff, setup.span):
            yield _loaded(bones, part, known)


def _loaded(bones: Bones, motion: Movement, known: Loads | None) -> Loaded:
    return Loaded(**vars(motion), loads=partial(acting, bones, known))


def acting(bones: Bones, known: Loads | None, times: np.ndarray) -> list[Load]:
    """Return the loads from outside at some times [s], where there are any, and those of the model."""
    return [*(() if known is None else known.at(times)), *prescribed_loads(bones, times)]


def dynamics(bones: Bones, setup: TrialSetup, part: Loaded | None = None) -> JointMoments:
    """Find the joint moments that a motion takes under its loads.

    Args:
        bones: The model.
        setup: With files of joint angles and, as it may be, of external loads.
        part: A part of the motion; None: all of it.

    Raises:
        ValueError: A file is not what it should be.
        OSError: A file cannot be read.
    """
    motion = part or moved(bones, setup)
    loads = motion.loads(motion.time)
    needed = inverse_dynamics(bones, *motion.moved, loads)
    left = Residuals.of(bones, motion.time, needed.joint_moment)
    doubt = doubted(bones, motion, needed, loads, left)
    return JointMoments(bones, motion, needed, replace(left, carried=carried(bones, needed, loads)), doubt)


def doubted(bones: Bones, motion: Loaded, needed: Needed, loads: Sequence[Load], left: Residuals) -> str:
    """Return what is likely wrong with the loads of a motion, and say it once; "": nothing is.

    Args:
        bones: The model.
        motion: The motion, or a part of it.
        needed: What it takes.
        loads: At its times.
        left: What they leave at the root.
    """
    said = [*filter(None, [left.doubt(bool(loads))]), *astray(bones, needed, loads), *too_heavy(bones)]
    if not motion.first:
        for sentence in said:
            logger.warning("%s", sentence)
    return "; ".join(said)


def analyze(bones: Bones, setup: TrialSetup, part: Loaded | None = None) -> MuscleAnalysis:
    """Follow the muscles along a motion.

    Args:
        bones: The model.
        setup: With a file of joint angles.
        part: A part of the motion; None: all of it.

    Raises:
        ValueError: A file is not what it should be, or the model has no muscle.
        OSError: A file cannot be read.
    """
    motion = part or moved(bones, setup)
    paths = muscle_paths(bones, motion.values, motion.speeds)
    active, passive = np.zeros_like(paths.length), np.zeros_like(paths.length)
    for i, name in enumerate(paths.muscles):
        muscle = known(HillMuscle.of(bones.model.muscles[name]))[0]
        length, velocity = paths.length[:, i], paths.velocity[:, i]
        active[:, i] = rigid_capacity(muscle, length, velocity)
        passive[:, i] = muscle.values["max_isometric_force"] * muscle.tendon_force(0.0, length, velocity)
    return MuscleAnalysis(bones, motion, paths, active, passive, inverse_dynamics(bones, *motion.moved))


def forces(bones: Bones, setup: TrialSetup, part: Loaded | None = None) -> MotionForces:
    """Find the forces of muscles and motors that give a motion's moments at the least cost.

    Args:
        bones: The model.
        setup: With a file of joint angles; loads, mode, exponent and reserves as it may be.
        part: A part of the motion; None: all of it.

    Raises:
        ValueError: A file is not what it should be, or the model has no muscle.
        OSError: A file cannot be read.
    """
    motion = part or moved(bones, setup)
    paths = muscle_paths(bones, motion.values, motion.speeds)
    moments = dynamics(bones, setup, motion)
    actuators = actuators_of(bones, motion.values)
    found = least_forces(bones, setup, paths, moments.needed, actuators)
    burnt = metabolic_power(bones.model, found, paths, bones.device)
    tension, under = dict(zip(found.muscles, found.force.T, strict=True)), moments.needed
    if actuators is not None:
        pulls = zip(found.motors, (found.control * actuators.optimal).T, strict=True)
        tension |= {name: force for name, force in pulls if name in actuators.paths}
        if pushed := actuators.acting(found.control):
            under = inverse_dynamics(bones, *motion.moved, [*motion.loads(motion.time), *pushed])
    reactions = joint_reactions(bones, motion.values, under, tension)
    return MotionForces(bones, motion, moments, found, burnt, actuators, reactions)


def least_forces(
    bones: Bones,
    setup: TrialSetup,
    paths: MusclePaths,
    needed: Needed,
    actuators: Actuators | None,
    **draws: Any,
) -> MuscleForces:
    """Return the forces of least cost as a set-up has mode, exponent and reserves.

    Raises:
        As `muscle_forces`, which takes `draws`, too.
    """
    return muscle_forces(
        bones.model,
        bones.coordinates,
        paths,
        needed.joint_moment,
        mode=setup.mode,
        exponent=setup.exponent or EXPONENT,
        reserves=setup.reserves_of(bones),
        actuators=actuators,
        device=bones.device,
        **draws,
    )


def track(
    bones: Bones,
    setup: TrialSetup,
    motion: Loaded | None = None,
    advance: Callable[[int], None] = lambda count: None,
) -> TrackedMotion:
    """Simulate a motion by computed muscle control.

    Args:
        bones: The model.
        setup: With a file of joint angles, and a reserve on every coordinate; loads, strengths, gains and
            controls as it may be.
        motion: All of the motion, without regard to the set-up's times; None: it is read.
        advance: Is told how many windows are done.

    Raises:
        ValueError: A file is not what it should be, a muscle is unknown, or the simulation is lost.
        OSError: A file cannot be read.
    """
    motion = motion or moved(bones, setup.whole)
    names = [name for name, muscle in bones.model.muscles.items() if muscle.applies_force]
    if unknown := set(setup.strength) - set(names):
        raise ValueError(f"muscle {sorted(unknown)[0]!r} unknown; available: {', '.join(names)}")
    loads = motion.loads(motion.time)
    needed = inverse_dynamics(bones, *motion.moved, loads)
    doubted(bones, motion, needed, loads, Residuals.of(bones, motion.time, needed.joint_moment))
    strength = np.array([setup.strength.get(name, 1.0) for name in names])
    if not ((strength >= 0.0) & np.isfinite(strength)).all():
        raise ValueError("the strength of a muscle must be at least 0 and finite")
    found = simulate(
        bones,
        motion.time,
        motion.values,
        motion.loads,
        reserves=setup.reserves_of(bones),
        strength=strength,
        gains=setup.gains,
        controls=setup.controls,
        span=setup.within(motion.time),
        advance=advance,
    )
    return TrackedMotion(bones, replace(motion, time=found.time), found)

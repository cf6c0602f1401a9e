"""Forces other than muscles: a `Model` -> springs, motors and constraints of an MjSpec.

What MuJoCo cannot say, or says differently, is noted.
"""

import math
from collections.abc import Mapping

import mujoco
import numpy as np

from myowarp.opensim.build.geometry import TIGHT, Build, quaternion
from myowarp.opensim.elements import BodyActuator, Bushing, ConditionalPathPoint, Ligament, Path
from myowarp.opensim.model import GROUND, Note
from myowarp.opensim.tendon.path import TendonPath, Via, add_tendon

STRAIN = np.linspace(0.0, 0.1, 51)[1:]
"""Of a ligament, over which its curve is fitted with a straight line and a parabola."""

FAR = 1e6
"""m or rad: the end of a spring that acts on one side only."""

SAME = 1e-9
"""m and 1: frames that differ by less coincide."""


def add_forces(
    build: Build, moving: Mapping[str, Mapping[int, str]], tendons: Mapping[str, TendonPath]
) -> None:
    """Add what acts on coordinates, bodies and paths, muscles left out; after `tie`."""
    _add_coordinate_actuators(build)
    for item in build.model.body_actuators:
        _add_body_actuator(build, item)
    for actuator in build.model.path_actuators:
        path_tendon(build, actuator.name, actuator.path, moving[actuator.name], tendons)
        _motor(
            build,
            actuator.name,
            mujoco.mjtTrn.mjTRN_TENDON,
            actuator.name,
            -actuator.optimal_force,
            actuator.control_range,
        )
    for ligament in build.model.ligaments.values():
        _add_ligament(build, ligament, moving[ligament.name], tendons)
    _add_limits(build)
    for spring in build.model.coordinate_springs:
        fixed_tendon(
            build,
            spring.name,
            spring.coordinate,
            (spring.rest, spring.rest),
            spring.stiffness,
            spring.damping,
        )
    for bushing in build.model.bushings:
        _add_bushing(build, bushing)
    _add_constraints(build)


def _motor(
    build: Build, name: str, kind: int, target: str, gear: float, limits: tuple[float, float]
) -> mujoco.MjsActuator:
    """Add a motor whose control is OpenSim's."""
    actuator = build.spec.add_actuator(name=build.free_name("actuator", name), trntype=kind, target=target)
    actuator.gear[0] = gear
    bounded = all(math.isfinite(limit) for limit in limits) and limits[0] < limits[1]
    actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE if bounded else mujoco.mjtLimited.mjLIMITED_FALSE
    if bounded:
        actuator.ctrlrange = limits
    return actuator


def _add_coordinate_actuators(build: Build) -> None:
    """Add a motor on the joint that shows the coordinate: gear = force per coordinate / scale."""
    for item in build.model.coordinate_actuators:
        if item.coordinate not in build.carriers:
            build.notes.append(
                Note(f"/forceset/{item.name}", f"no joint shows {item.coordinate!r}; left out")
            )
            continue
        joint, scale = build.carriers[item.coordinate]
        _motor(
            build, item.name, mujoco.mjtTrn.mjTRN_JOINT, joint, item.optimal_force / scale, item.control_range
        )


def _add_body_actuator(build: Build, item: BodyActuator) -> None:
    """Add a wrench at a site; in ground's axes where the file says so."""
    site = build.free_name("site", f"{item.name}-at")
    build.bodies[item.body].add_site(name=site, pos=item.location, size=[0.002] * 3, group=4)
    actuator = _motor(build, item.name, mujoco.mjtTrn.mjTRN_SITE, site, 0.0, item.control_range)
    actuator.gear = np.zeros(6)
    first = 0 if item.kind == "point" else 3
    actuator.gear[first : first + 3] = item.optimal_force * item.axis
    if item.in_ground:
        reference = build.free_name("site", f"{item.name}-reference")
        build.bodies[GROUND].add_site(name=reference, size=[0.002] * 3, group=4)
        actuator.refsite = reference
    if item.reaction != GROUND:
        build.notes.append(
            Note(f"/forceset/{item.name}", f"its reaction acts on ground, not on {item.reaction!r}")
        )


def path_tendon(
    build: Build, name: str, path: Path, moving: Mapping[int, str], tendons: Mapping[str, TendonPath]
) -> mujoco.MjsTendon:
    """Add a tendon: as fitted, else through the fixed and moving points, noting what that leaves out."""
    if name in tendons:
        return add_tendon(build.spec, tendons[name], path, moving)
    last = len(path.points) - 1
    kept = [
        number
        for number, point in enumerate(path.points)
        if number in (0, last) or not isinstance(point, ConditionalPathPoint)
    ]
    left = len(path.points) - len(kept)
    if left or path.wraps:
        build.notes.append(
            Note(
                f"/forceset/{name}",
                f"a path without its {len(path.wraps)} wraps and {left} conditional points",
            )
        )
    return add_tendon(build.spec, TendonPath(name, tuple(Via(number) for number in kept)), path, moving)


def _add_ligament(
    build: Build, ligament: Ligament, moving: Mapping[int, str], tendons: Mapping[str, TendonPath]
) -> None:
    """Add a spring along a path: the parabola through 0 that is nearest to the ligament's force."""
    tendon = path_tendon(build, ligament.name, ligament.path, moving, tendons)
    length = STRAIN * ligament.resting_length
    force = np.asarray(ligament.force.value(1 + STRAIN))
    basis = np.stack([length, length**2], axis=1)
    first, second = np.linalg.lstsq(basis, force, rcond=None)[0]
    error = float(np.abs(basis @ [first, second] - force).max())
    tendon.stiffness[:2] = first, second
    tendon.springlength = 0.0, ligament.resting_length
    tendon.rgba = (0.9, 0.8, 0.3, 1.0)
    rule = "a spring with a parabola for its curve, without damping"
    build.notes.append(
        Note(f"/forceset/{ligament.name}", rule, f"{error:.3g} N up to a strain of {STRAIN[-1]:g}")
    )


def fixed_tendon(
    build: Build,
    name: str,
    coordinate: str,
    springlength: tuple[float, float],
    stiffness: float,
    damping: float,
) -> None:
    """Add a spring on a coordinate: a tendon whose length is the coordinate."""
    if coordinate not in build.carriers:
        build.notes.append(Note(f"/forceset/{name}", f"no joint shows {coordinate!r}; left out"))
        return
    joint, scale = build.carriers[coordinate]
    tendon = build.spec.add_tendon(name=build.free_name("tendon", name))
    tendon.wrap_joint(joint, 1.0 / scale)
    tendon.stiffness[0], tendon.damping[0], tendon.springlength = stiffness, damping, springlength


def _add_limits(build: Build) -> None:
    """Add the springs at a coordinate's limits, one tendon for both sides where they are alike."""
    for item in build.model.limit_forces:
        (low, high), (soft, stiff) = item.limits, item.stiffness
        if soft == stiff:
            fixed_tendon(build, item.name, item.coordinate, (low, high), soft, 0.0)
        else:
            fixed_tendon(build, f"{item.name}-low", item.coordinate, (low, FAR), soft, 0.0)
            fixed_tendon(build, f"{item.name}-high", item.coordinate, (-FAR, high), stiff, 0.0)
        rule = f"springs without the damping of {item.damping:.3g} beyond the limits; they set in at once"
        bound = f"{max(soft, stiff) * item.transition:.3g} N or N m within {item.transition:.3g} rad or m"
        build.notes.append(Note(f"/forceset/{item.name}", rule, bound))


def _add_bushing(build: Build, bushing: Bushing) -> None:
    """Add springs on the coordinates of the joint at which a bushing sits, if it sits at one."""
    path = f"/forceset/{bushing.name}"
    for joint in build.model.joints.values():
        ends = [(joint.parent, joint.parent_frame), (joint.child, joint.child_frame)]
        given = list(zip(bushing.bodies, bushing.frames, strict=True))
        for order in (given, given[::-1]):
            if all(
                a[0] == b[0]
                and np.abs(a[1].position - b[1].position).max() < SAME
                and np.abs(a[1].rotation - b[1].rotation).max() < SAME
                for a, b in zip(ends, order, strict=True)
            ):
                for move in joint.moves:
                    axis = int(np.argmax(np.abs(move.axis)))
                    if move.coordinate is None or np.abs(move.axis).max() < 1 - SAME:
                        continue
                    angle = move.kind == "hinge"
                    stiffness = (bushing.rotational_stiffness if angle else bushing.translational_stiffness)[
                        axis
                    ]
                    damping = (bushing.rotational_damping if angle else bushing.translational_damping)[axis]
                    name = f"{bushing.name}-{move.coordinate}"
                    fixed_tendon(build, name, move.coordinate, (0.0, 0.0), float(stiffness), float(damping))
                build.notes.append(
                    Note(path, "springs on the coordinates of its joint; exact for small angles")
                )
                return
    build.notes.append(Note(path, "a bushing whose frames are not those of a joint; left out"))


def _add_constraints(build: Build) -> None:
    """Add welds and connections that close loops."""
    for item in build.model.constraints:
        names = []
        for body, frame, side in zip(item.bodies, item.frames, "12", strict=True):
            name = build.free_name("site", f"{item.name}-{side}")
            build.bodies[body].add_site(
                name=name, pos=frame.position, quat=quaternion(frame.rotation), size=[0.002] * 3, group=4
            )
            names.append(name)
        kind = mujoco.mjtEq.mjEQ_WELD if item.kind == "weld" else mujoco.mjtEq.mjEQ_CONNECT
        equality = build.spec.add_equality(name=item.name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE)
        equality.name1, equality.name2 = names
        equality.solref, equality.solimp = TIGHT
        if item.kind == "weld":
            equality.data[10] = 1.0
        rule = "closes a loop in simulation; poses that are sampled and compared leave it open"
        build.notes.append(Note(f"/constraintset/{item.name}", rule))

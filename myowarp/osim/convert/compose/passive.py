"""Forces other than muscles: a `Model` -> springs, motors and constraints of an MjSpec.

What MuJoCo cannot say, or says differently, is noted.
"""

import itertools
import math
from collections.abc import Mapping

import mujoco
import numpy as np

from myowarp.osim.bundle.forces import PassiveForces
from myowarp.osim.convert.compose.geometry import TIGHT, Build, default_of, quaternion, reduced
from myowarp.osim.convert.tendon.path import TendonPath, Via, add_tendon
from myowarp.osim.document.elements import (
    BodyActuator,
    Bushing,
    ConditionalPathPoint,
    CoordinateLimitForce,
    LengthFunction,
    Ligament,
    Path,
)
from myowarp.osim.document.functions import IDENTITY
from myowarp.osim.document.model import GROUND, Joint

STRAIN = np.linspace(0.0, 0.1, 51)[1:]
"""Of a ligament, over which its curve is fitted with a straight line and a parabola."""

MARGIN = {True: 0.2, False: 0.02}
"""rad, m: beyond limits that a coordinate's range does not pass, over which springs are fitted."""

WEAK = 1e-4
"""N m or N: springs of which there is less in the whole range are none."""

FAR = 1e6
"""m or rad: the end of a spring that acts on one side only."""

ONLY_HERE = "left out of plain MuJoCo; acts in MyoWarp"
"""Note of a force that has no counterpart there."""

SAME = 1e-9
"""m and 1: frames that differ by less coincide."""


def add_forces(
    build: Build,
    moving: Mapping[str, Mapping[int, str]],
    tendons: Mapping[str, TendonPath],
    exact: PassiveForces | None = None,
    instead: bool = True,
) -> None:
    """Add what acts on coordinates, bodies and paths, muscles left out; after `tie`.

    Args:
        build: What grows.
        moving: As in `Converted`.
        tendons: As in `Stages`.
        exact: What MyoWarp has as the document says.
        instead: Whether MuJoCo's springs are to stand for that, too.
    """
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
        tendon = path_tendon(build, ligament.name, ligament.path, moving[ligament.name], tendons)
        tendon.rgba = (0.9, 0.8, 0.3, 1.0)
        alone = exact is None or ligament.name not in {own.tendon for own in exact.ligaments}
        if instead or alone:
            _add_ligament(build, ligament, tendon)
        if not alone:
            build.springs.append(ligament.name)
    for limit in build.model.limit_forces:
        if _has_joint(build, limit.name, "CoordinateLimitForce", limit.coordinate) and instead:
            _add_limit(build, limit)
    for spring in build.model.coordinate_springs:
        if _has_joint(build, spring.name, "SpringGeneralizedForce", spring.coordinate):
            joint, scale = build.carriers[spring.coordinate]
            stiffness, damping = spring.stiffness / scale**2, spring.damping / scale**2
            _spring(build, joint, scale * spring.rest, stiffness, damping)
    # Springs that stay come first: what joints have without the others is kept in `build.bare`.
    for bushing in sorted(build.model.bushings, key=lambda one: not is_of_joint(build, one)):
        if instead or is_of_joint(build, bushing):
            _add_bushing(build, bushing)
    for formula in build.model.coordinate_formulas:
        kind = "ExpressionBasedCoordinateForce"
        if _has_joint(build, formula.name, kind, formula.coordinate) and instead:
            build.lose(f"/forceset/{formula.name}", ONLY_HERE, code=kind)
    for force in build.model.prescribed_forces if instead else ():
        build.lose(f"/forceset/{force.name}", ONLY_HERE, code="PrescribedForce")
    _add_constraints(build, instead)


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
        if not _has_joint(build, item.name, "CoordinateActuator", item.coordinate):
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
        rule = f"its reaction acts on ground, not on {item.reaction!r}"
        strongest = item.optimal_force * max(map(abs, item.control_range))
        build.lose(
            f"/forceset/{item.name}",
            rule,
            code="TorqueActuator",
            largest=strongest if math.isfinite(strongest) else item.optimal_force,
            unit="N m",
        )


def path_tendon(
    build: Build, name: str, path: Path, moving: Mapping[int, str], tendons: Mapping[str, TendonPath]
) -> mujoco.MjsTendon:
    """Add a tendon: as fitted, else through the fixed and moving points, noting what that leaves out."""
    if path.function is not None:
        return _line_tendon(build, name, path.function)
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
        build.note(
            f"/forceset/{name}", f"a path without its {len(path.wraps)} wraps and {left} conditional points"
        )
    return add_tendon(build.spec, TendonPath(name, tuple(Via(number) for number in kept)), path, moving)


def _line_tendon(build: Build, name: str, function: LengthFunction) -> mujoco.MjsTendon:
    """Add the tangent of a length in its coordinates at the default pose, which plain MuJoCo has for it."""
    model, tendon = build.model, build.spec.add_tendon(name=name)
    at = {of: np.array([default_of(model, IDENTITY, of)]) for of in function.coordinates}
    slopes: dict[str, float] = {}
    for of, slope in zip(function.coordinates, function.at(at)[1][:, 0], strict=True):
        follows, free = reduced(model, IDENTITY, of)
        if free is not None and free in build.carriers:
            joint, scale = build.carriers[free]
            rate = float(follows.derivatives(model.coordinates[free].default)[1])
            slopes[joint] = slopes.get(joint, 0.0) + float(slope) * rate / scale
    if not slopes:
        raise ValueError(f"{model.source}: the length of {name!r} depends on no coordinate that moves")
    for joint, slope in slopes.items():
        tendon.wrap_joint(joint, slope)
    rule = "in plain MuJoCo the tangent of its length at the default pose, without the length there"
    build.lose(f"/forceset/{name}", rule, code="FunctionBasedPath")
    return tendon


def _add_ligament(build: Build, ligament: Ligament, tendon: mujoco.MjsTendon) -> None:
    """Give a tendon a spring: the parabola through 0 that is nearest to the ligament's force."""
    if ligament.formula is not None:
        build.lose(f"/forceset/{ligament.name}", ONLY_HERE, code=ligament.type)
        return
    length = STRAIN * ligament.resting_length
    force = np.asarray(ligament.force.value(1 + STRAIN))
    basis = np.stack([length, length**2], axis=1)
    first, second = np.linalg.lstsq(basis, force, rcond=None)[0]
    error = float(np.abs(basis @ [first, second] - force).max())
    tendon.stiffness[:2] = first, second
    tendon.springlength = 0.0, ligament.resting_length
    rule = "in plain MuJoCo a spring with a parabola for its curve, without damping"
    build.note(f"/forceset/{ligament.name}", rule, f"{error:.3g} N up to a strain of {STRAIN[-1]:g}")


def _has_joint(build: Build, name: str, kind: str, coordinate: str) -> bool:
    """Whether a joint shows the coordinate that something acts on; a loss is noted if none does."""
    if coordinate in build.carriers:
        return True
    path, rule = f"/forceset/{name}", f"left out, no joint shows its coordinate: {coordinate}"
    if reduced(build.model, IDENTITY, coordinate)[1] is None:
        build.note(path, rule, "0: the coordinate is locked")
    else:
        build.lose(path, rule, code=kind)
    return False


def _spring(build: Build, joint: str, rest: float, stiffness: float, damping: float) -> None:
    """Add a spring and a damper to a joint, beside those that it has."""
    found = build.spec.joint(joint)
    total = found.stiffness[0] + stiffness
    if total > 0:
        found.springref = (found.stiffness[0] * found.springref + stiffness * rest) / total
    found.stiffness[0] = total
    found.damping[0] += damping


def _one_sided(
    build: Build, name: str, coordinate: str, springlength: tuple[float, float], stiffness: np.ndarray
) -> None:
    """Add a spring that acts on a coordinate beyond two ends: a tendon whose length is the coordinate.

    Its force is c[0] x + c[1] x^2 + c[2] x^3 of the way x beyond an end, c the stiffness.
    """
    joint, scale = build.carriers[coordinate]
    tendon = build.spec.add_tendon(name=build.free_name("tendon", name))
    tendon.wrap_joint(joint, 1.0 / scale)
    # MuJoCo's force is -x (k0 + k1 x + k2 x^2), x negative below the lower end.
    below = springlength[1] >= FAR
    tendon.stiffness[:3] = stiffness * [1.0, -1.0 if below else 1.0, 1.0]
    tendon.springlength = springlength
    build.springs.append(tendon.name)


def _add_limit(build: Build, item: CoordinateLimitForce) -> None:
    """Add springs beyond a coordinate's limits, and the damping that is there in its whole range."""
    low, high = build.model.coordinates[item.coordinate].sampling_range
    sides = [(item.limits[0] - low, item.stiffness[0]), (high - item.limits[1], item.stiffness[1])]
    errors, transition = [], max(item.transition, SAME)
    for name, (beyond, stiffness), ends in zip(
        ("low", "high"), sides, ((item.limits[0], FAR), (-FAR, item.limits[1])), strict=True
    ):
        reach = max(beyond, min(item.transition, MARGIN[build.model.coordinates[item.coordinate].rotational]))
        x = np.linspace(0.0, reach, 41)[1:]
        force = stiffness * x * onset(x / transition)
        if force[-1] > WEAK:
            sudden = transition <= reach
            spring = np.array([stiffness, 0.0, 0.0]) if sudden else rising(x, force)
            _one_sided(build, f"{item.name}-{name}", item.coordinate, ends, spring)
            errors.append(float(np.abs(x[:, None] ** [1, 2, 3] @ spring - force).max()))
    grid = np.linspace(low, high, 101)
    share = onset((item.limits[0] - grid) / transition) + onset((grid - item.limits[1]) / transition)
    joint, scale = build.carriers[item.coordinate]
    steady = float(share.min()) * item.damping / scale**2
    _spring(build, joint, 0.0, 0.0, steady)
    build.dampers[joint] = build.dampers.get(joint, 0.0) + steady
    path = f"/forceset/{item.name}"
    if errors:
        rule = "in plain MuJoCo springs linear in the way beyond the limits, or with a cubic that never falls"
        build.note(path, rule, f"{max(errors):.2g} N m or N in the coordinate's range")
    left = float(np.ptp(share)) * item.damping
    if left > 0:
        rule = "in plain MuJoCo its damping beyond the limits is left out"
        build.note(path, rule, f"{left:.2g} N m s or N s/m at most")


def onset(x: np.ndarray) -> np.ndarray:
    """Return how much of a limit's stiffness acts, as x runs from 0 to 1 over its transition."""
    t = np.clip(x, 0.0, 1.0)
    return t**3 * (10.0 - 15.0 * t + 6.0 * t**2)


def rising(x: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return c >= 0 of the best c[0] x + c[1] x^2 + c[2] x^3: it falls nowhere, beyond the samples either."""
    best, least = np.zeros(3), np.inf
    for powers in (p for count in (1, 2, 3) for p in itertools.combinations(range(3), count)):
        basis = x[:, None] ** (np.array(powers) + 1)
        found = np.linalg.lstsq(basis, force)[0]
        error = float(np.linalg.norm(basis @ found - force))
        if (found >= 0).all() and error < least:
            best, least = np.zeros(3), error
            best[list(powers)] = found
    return best


def is_of_joint(build: Build, bushing: Bushing) -> bool:
    """Whether springs on joints are all that a bushing does."""
    spanned = None if bushing.formulas else _spanned(build, bushing)
    return spanned is not None and spanned[1] and _along_axes(spanned[0])


def _add_bushing(build: Build, bushing: Bushing) -> None:
    """Add springs on the joints of the OpenSim joint at which a bushing sits, else what a tendon can do."""
    path, spanned = f"/forceset/{bushing.name}", _spanned(build, bushing)
    if bushing.formulas:
        build.lose(path, ONLY_HERE, code=bushing.type)
        return
    if spanned is None:
        _add_bushing_between(build, bushing, path)
        return
    joint, _ = spanned
    exact = is_of_joint(build, bushing)
    for index, move in enumerate(joint.moves):
        if (joint.name, index) not in build.shown:
            continue  # it stands still
        name, sign, offset = build.shown[joint.name, index]
        if not exact:
            own = build.spec.joint(name)
            build.bare.setdefault(name, (float(own.stiffness[0]), float(own.springref)))
        along = move.axis**2
        if move.kind == "hinge":
            stiffness, damping = along @ bushing.rotational_stiffness, along @ bushing.rotational_damping
        else:
            stiffness, damping = (
                along @ bushing.translational_stiffness,
                along @ bushing.translational_damping,
            )
        if not exact:
            build.dampers[name] = build.dampers.get(name, 0.0) + float(damping)
        _spring(build, name, -sign * offset, float(stiffness), float(damping))
    rule = "springs and dampers on the joints between its frames"
    where = "" if exact else "in plain MuJoCo "
    build.note(path, where + rule, "0" if exact else "exact for small angles")


def _spanned(build: Build, bushing: Bushing) -> tuple[Joint, bool] | None:
    """Return the joint whose frames are a bushing's, and whether its first frame is the parent's."""
    given = list(zip(bushing.bodies, bushing.frames, strict=True))
    for joint in build.model.joints.values():
        ends = [(joint.parent, joint.parent_frame), (joint.child, joint.child_frame)]
        for forward in (True, False):
            if all(
                a[0] == b[0]
                and np.abs(a[1].position - b[1].position).max() < SAME
                and np.abs(a[1].rotation - b[1].rotation).max() < SAME
                for a, b in zip(ends, given if forward else given[::-1], strict=True)
            ):
                return joint, forward
    return None


def _along_axes(joint: Joint) -> bool:
    """Whether a joint slides along axes, then turns about x, y, z in this order, as a bushing does."""
    numbers = []
    for move in joint.moves:
        axis = int(np.argmax(np.abs(move.axis)))
        if np.abs(move.axis).max() < 1 - SAME:
            return False
        numbers.append(axis if move.kind == "slide" else 3 + axis)
    slides = [number for number in numbers if number < 3]
    hinges = [number for number in numbers if number >= 3]
    return numbers == slides + hinges and hinges == sorted(set(hinges)) and len(slides) == len(set(slides))


def _add_bushing_between(build: Build, bushing: Bushing, path: str) -> None:
    """Add a spring from point to point for a bushing that is as stiff in all directions; the rest is lost."""
    stiffness = bushing.translational_stiffness
    alike = bool(np.ptp(stiffness) <= SAME * stiffness.max())
    if alike and stiffness[0] > 0:
        tendon = build.spec.add_tendon(name=build.free_name("tendon", bushing.name))
        for body, frame, side in zip(bushing.bodies, bushing.frames, "12", strict=True):
            site = build.free_name("site", f"{bushing.name}-{side}")
            build.bodies[body].add_site(name=site, pos=frame.position, size=[0.002] * 3, group=4)
            tendon.wrap_site(site)
        tendon.stiffness[0], tendon.springlength = stiffness[0], (0.0, 0.0)
        build.springs.append(tendon.name)
        build.note(path, "in plain MuJoCo a spring from point to point")
    lost = {
        "translational stiffness": not alike,
        "rotational stiffness": bushing.rotational_stiffness.any(),
        "damping": bushing.translational_damping.any() or bushing.rotational_damping.any(),
    }
    if any(lost.values()):
        said = ", ".join(what for what, gone in lost.items() if gone)
        rule = f"its frames are not those of a joint; left out of plain MuJoCo: {said}"
        build.lose(path, rule, code=bushing.type)


def _add_constraints(build: Build, instead: bool) -> None:
    """Add welds and connections that close loops; `instead` as in `add_forces`."""
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
        if instead:
            rule = "in plain MuJoCo a soft equality closes its loop; poses that are compared leave it open"
            code = "WeldConstraint" if item.kind == "weld" else "PointConstraint"
            build.lose(f"/constraintset/{item.name}", rule, code=code, effect="motion")

"""Bodies and joints: a `Model` -> MuJoCo's MjSpec, exact in every frame.

A joint's moves become slides and hinges of the child body in the same order; constant moves and offsets fold
into the body's pose, which is that of the default coordinates (`ref` of the joints). The body `ground` keeps
OpenSim's axes and is turned so that up is z. A coordinate is identified with the first move that is linear in
it; what follows a coordinate by a spline or coupler becomes a joint of its own, tied by an equality to a
quartic (see `fit`). Masses of zero get a floor where MuJoCo needs one. Every deviation is noted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.polynomial import Polynomial

from myowarp.laws.pieces import Pieces
from myowarp.osim.bundle.coordinate_map import CoordinateMap, Dependent, MappedCoordinate
from myowarp.osim.bundle.couplings import REGULAR, Couplings, regularity
from myowarp.osim.convert.compose.quartics import Quartic, fit_all
from myowarp.osim.document.dynamics import equations
from myowarp.osim.document.elements import Pose
from myowarp.osim.document.functions import (
    IDENTITY,
    Composed,
    Constant,
    Function,
    Linear,
    Multiplier,
    affine,
    curves,
)
from myowarp.osim.document.kinematics import about
from myowarp.osim.document.model import GROUND, Joint, Loss, Model, Move, Note

Array = np.ndarray

HINGE, SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE

MIN_MASS = 1e-3  # kg, of a moving body that has none
MIN_INERTIA = 1e-6  # kg m^2
LEAST_INERTIA = 1e-12  # kg m^2, below which a principal moment is none
ROUNDING = 1e-6  # relative; MuJoCo refuses A + B >= C that its own rounding breaks
MAX_JOINTS = 6  # of one body, in MuJoCo
PHANTOM_INERTIA = 1e-3  # kg m^2, of a phantom whose angle runs over about 2 rad
TIED_ARMATURE = {HINGE: 1e-3, SLIDE: 0.1}
"""kg m^2 and kg, of a joint that follows another one: keeps the equality stiff where its body is light, as a
patella is, and adds about 1e-3 kg m^2 at most to the joint that it follows."""
ANGLE_LEVER = 0.05  # m: an angle that follows a spline is fitted as the travel of a point this far out
TIGHT = ((0.004, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0))
"""solref and solimp of equalities: the stiffest that a step of 2 ms allows."""


@dataclass(frozen=True)
class Demand:
    """A joint that has to have the value function(coordinate), coordinate being free."""

    joint: str
    function: Function
    coordinate: str
    lever: float
    """Length for which one unit of the joint counts [m]."""


@dataclass
class Build:
    """State of a conversion."""

    model: Model
    spec: mujoco.MjSpec
    bodies: dict[str, mujoco.MjsBody]
    """By name in the OpenSim model."""
    starts: dict[str, float] = field(default_factory=dict)
    """Positions of joints in the default pose, as far as they are known before the joints are there."""
    carriers: dict[str, tuple[str, float]] = field(default_factory=dict)
    """Coordinate: joint that shows it, and scale."""
    shown: dict[tuple[str, int], tuple[str, float, float]] = field(default_factory=dict)
    """OpenSim's joint and number of a move: MuJoCo's joint, sign and offset; move = sign joint + offset."""
    light: dict[str, tuple[float, tuple[float, ...]]] = field(default_factory=dict)
    """Bodies that the document gives another mass [kg] or other principal moments [kg m^2]."""
    springs: list[str] = field(default_factory=list)
    """Tendons whose springs stand for forces that MyoWarp has as the document says."""
    bare: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Stiffness and resting place of joints without springs that stand for such forces."""
    dampers: dict[str, float] = field(default_factory=dict)
    """Joint: damping that does so."""
    demands: list[Demand] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)
    names: set[tuple[str, str]] = field(default_factory=set)

    def free_name(self, kind: str, name: str) -> str:
        """Return a name that no other element of this kind has, and reserve it."""
        unique, number = name or kind, 2
        while (kind, unique) in self.names:
            unique, number = f"{name}_{number}", number + 1
        self.names.add((kind, unique))
        return unique

    def note(self, path: str, rule: str, error_bound: str | None = None) -> None:
        """Note an element that is not carried over exactly."""
        self.notes.append(Note(path, rule, error_bound))

    def lose(self, path: str, rule: str, **said: Any) -> None:
        """Note what acts in the document and not, or not as there, in the result; see `Loss`."""
        self.notes.append(Loss(path, rule, **said))


def begin(model: Model, starts: dict[str, float]) -> Build:
    """Return a spec with the bodies and joints of a model, not yet with what its coordinates demand.

    Args:
        model: The model.
        starts: Where joints are in the default pose; those that are missing are where the document says.
    """
    spec = mujoco.MjSpec()
    spec.modelname = model.name
    spec.compiler.degree = False
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.option.timestep = 0.002
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # MuJoCo 4.0.0 factorises sparse Hessians wrongly (mended in 4.0.1), so that its Newton solver does not
    # converge on chains of equalities; dense costs 10 % more.
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    turn = upright(model.gravity)
    spec.option.gravity = turn @ model.gravity
    ground = spec.worldbody.add_body(name=GROUND, quat=quaternion(turn))
    build = Build(model, spec, {GROUND: ground}, starts, names={("body", "world"), ("body", GROUND)})
    moving = _moving_masses(model)
    for joint in model.joints.values():
        _add_body(build, joint, moving)
    return build


def upright(gravity: Array) -> Array:
    """Return the rotation (3, 3) that turns the axis nearest to up, y where there is no gravity, to z."""
    up = np.array([0.0, 1.0, 0.0])
    if np.abs(gravity).max() > 0:
        axis = int(np.argmax(np.abs(gravity)))
        up = -np.sign(gravity[axis]) * np.eye(3)[axis]
    across = np.cross(up, [0.0, 0.0, 1.0])
    if not across.any():
        return np.eye(3) if up[2] > 0 else np.diag([1.0, -1.0, -1.0])
    return about(across, np.array([np.pi / 2]))[0].round()


def quaternion(rotation: Array) -> Array:
    """Return the quaternion (w, x, y, z) of a rotation matrix."""
    result = np.zeros(4)
    mujoco.mju_mat2Quat(result, rotation.ravel())
    return result / np.linalg.norm(result)


def reduced(model: Model, function: Function, coordinate: str | None) -> tuple[Function, str | None]:
    """Return the same motion as a function of a free coordinate, or as a constant and None."""
    while coordinate is not None:
        if coordinate in model.couplers:
            coupler = model.couplers[coordinate]
            inner = coupler.function
            function = inner if affine(function) == (1.0, 0.0) else Composed(function, inner)
            coordinate = coupler.independent
        elif model.coordinates[coordinate].locked:
            return Constant(float(function.value(model.coordinates[coordinate].default))), None
        else:
            break
    line = affine(function)
    if coordinate is None or (line is not None and line[0] == 0):
        return Constant(float(function.value(0.0))), None
    return function, coordinate


def default_of(model: Model, function: Function, coordinate: str | None) -> float:
    """Return the value of a function of a coordinate in the default pose."""
    function, free = reduced(model, function, coordinate)
    return float(function.value(0.0 if free is None else model.coordinates[free].default))


def _elementary(move: Move, value: float) -> Pose:
    """Return a move by a value [m] or [rad] as a pose."""
    if move.kind == "slide":
        return Pose(value * move.axis, np.eye(3))
    return Pose(np.zeros(3), about(move.axis, np.array([value]))[0])


def _add_body(build: Build, joint: Joint, moving: dict[str, float]) -> None:
    """Add the child of a joint with its MuJoCo joints."""
    model = build.model
    fixed = Pose(np.zeros(3), np.eye(3))
    placed: list[tuple[Move, Pose, str, float, float, float]] = []
    carried = _carriers(model, joint)
    for index, move in enumerate(joint.moves):
        function, free = reduced(model, move.function, move.coordinate)
        if free is None:
            fixed = fixed @ _elementary(move, float(function.value(0.0)))
            continue
        line = affine(move.function)
        sign, scale = 1.0, 1.0
        if line is not None:
            fixed = fixed @ _elementary(move, line[1])
            sign, scale = (1.0 if line[0] > 0 else -1.0), abs(line[0])
        if carried.get(index) is not None and move.coordinate is not None:
            name = build.free_name("joint", move.coordinate)
            build.carriers[move.coordinate] = (name, scale)
            function = Multiplier(IDENTITY, scale)
        else:
            name = build.free_name("joint", f"{joint.name}_{move.kind}{index + 1}")
            function = move.function if line is None else Multiplier(IDENTITY, scale)
        build.shown[joint.name, index] = name, sign, 0.0 if line is None else line[1]
        start = build.starts.get(name, default_of(model, function, move.coordinate))
        lever = 1.0 if move.kind == "slide" else ANGLE_LEVER
        if carried.get(index) is None or move.coordinate in model.couplers:
            function, free = reduced(model, function, move.coordinate)
            if free is not None:
                build.demands.append(Demand(name, function, free, lever))
        placed.append((move, fixed, name, sign, scale, start))
        fixed = fixed @ _elementary(move, sign * start)
    total = fixed @ joint.child_frame.inverse()
    back = total.inverse()
    body, pose = build.bodies[joint.parent], joint.parent_frame @ total
    for first in range(0, max(len(placed), 1), MAX_JOINTS):
        last = first + MAX_JOINTS >= len(placed)
        name = joint.child if last else f"{joint.child}-moved"
        body = body.add_body(
            name=build.free_name("body", name), pos=pose.position, quat=quaternion(pose.rotation)
        )
        pose = Pose(np.zeros(3), np.eye(3))
        for move, at, name, sign, scale, start in placed[first : first + MAX_JOINTS]:
            local = back @ at
            added = body.add_joint(name=name, type=SLIDE if move.kind == "slide" else HINGE)
            added.axis, added.pos = sign * local.rotation @ move.axis, local.position
            added.ref = start
            if any(demand.joint == name for demand in build.demands):
                added.armature = TIED_ARMATURE[added.type]
            _limit(build, added, move, scale)
        if not last:
            weigh(build, body)
            rule = "moves by more joints than a body may have; some are on a light body before it"
            bound = f"{MIN_MASS:g} kg, {MIN_INERTIA:g} kg m^2"
            build.note(f"/bodyset/{joint.child}", rule, bound)
    build.bodies[joint.child] = body
    _add_inertia(build, joint.child, body, floor=bool(placed) and moving[joint.child] <= 0)


def weigh(build: Build, body: mujoco.MjsBody, inertia: float = MIN_INERTIA) -> None:
    """Give a body the mass that MuJoCo needs and the document has not."""
    body.explicitinertial, body.mass, body.ipos = True, MIN_MASS, np.zeros(3)
    body.inertia = (inertia,) * 3
    build.light[body.name] = 0.0, (0.0, 0.0, 0.0)


def _carriers(model: Model, joint: Joint) -> dict[int, str]:
    """Return which moves show a coordinate: the first with slope 1 or -1, else the first that is linear."""
    found: dict[str, tuple[bool, int]] = {}
    for index, move in enumerate(joint.moves):
        line = affine(move.function)
        if move.coordinate is None or line is None or line[0] == 0:
            continue
        unit = abs(line[0]) == 1
        if move.coordinate not in found or (unit and not found[move.coordinate][0]):
            found[move.coordinate] = unit, index
    return {index: name for name, (_, index) in found.items()}


def _limit(build: Build, added: mujoco.MjsJoint, move: Move, scale: float) -> None:
    """Give a joint that shows a free coordinate its range, and limit it there where the file does."""
    name = move.coordinate
    if name is None or build.carriers.get(name, ("", 0.0))[0] != added.name or name in build.model.couplers:
        return
    coordinate = build.model.coordinates[name]
    low, high = coordinate.range
    if low < high:
        limits = mujoco.mjtLimited
        added.range = scale * low, scale * high
        added.limited = limits.mjLIMITED_TRUE if coordinate.clamped else limits.mjLIMITED_FALSE


def _moving_masses(model: Model) -> dict[str, float]:
    """Return for every body its mass and that of all bodies that do not move relative to it [kg]."""
    total = {name: body.mass for name, body in model.bodies.items()}
    for joint in reversed(tuple(model.joints.values())):
        still = all(reduced(model, move.function, move.coordinate)[1] is None for move in joint.moves)
        if still and joint.parent != GROUND:
            total[joint.parent] += total[joint.child]
    return total


def positive(moments: Array, mass: float) -> Array:
    """Return principal moments (3,), raised if one is not positive: a joint may turn about that axis."""
    return moments if moments.min() >= LEAST_INERTIA else np.maximum(moments, MIN_INERTIA * min(1.0, mass))


def _regular(model: Model) -> bool:
    """Return whether forces determine accelerations in the default pose, with the document's inertias."""
    free = model.independent
    start = {name: np.array([model.coordinates[name].default]) for name in free}
    M, _ = equations(model, start, np.zeros((1, len(free))))
    return not free or regularity(M[0]) >= REGULAR


def _add_inertia(build: Build, name: str, body: mujoco.MjsBody, floor: bool) -> None:
    """Give a body its mass and inertia, repaired where MuJoCo would refuse them."""
    source = build.model.bodies[name]
    mass = source.mass
    xx, yy, zz, xy, xz, yz = source.inertia
    values, axes = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    stated = mass, tuple(values.tolist()) if mass > 0 else (0.0, 0.0, 0.0)
    if floor:
        mass, values = MIN_MASS, np.maximum(values, MIN_INERTIA)
        build.note(
            f"/bodyset/{name}",
            "moves without mass; given a small one",
            f"{MIN_MASS:g} kg, {MIN_INERTIA:g} kg m^2",
        )
    elif mass > 0 and values[0] < LEAST_INERTIA:
        lift = positive(values, mass)
        bound = f"{float((lift - values).max()):.3g} kg m^2"
        rule = "its inertia is not positive; least moments were raised in model.xml and model.mjb"
        if values[0] < 0 and not _regular(build.model):
            stated = mass, tuple(np.maximum(values, 0.0).tolist())
            rule += ", and to 0 in couplings.json: no accelerations follow from them"
        build.note(f"/bodyset/{name}", rule, bound)
        values = lift
    lack = values[2] - values[0] - values[1]
    if mass > 0 and lack > -ROUNDING * values[2]:
        lift = (lack + ROUNDING * values[2]) / 2
        values = values + np.array([lift, lift, 0.0])
        if lack > ROUNDING * values[2]:
            build.note(
                f"/bodyset/{name}",
                "its moments of inertia break A + B >= C; the lesser ones were raised in model.xml",
                f"{lift:.3g} kg m^2",
            )
    if mass > 0:
        if np.linalg.det(axes) < 0:
            axes = axes * [1.0, 1.0, -1.0]
        body.explicitinertial, body.mass, body.ipos = True, mass, source.mass_center
        body.inertia, body.iquat = values, quaternion(axes)
        if stated != (mass, tuple(values.tolist())):
            build.light[body.name] = stated


def tie(build: Build) -> CoordinateMap:
    """Add phantoms and equalities for all demands, and return how coordinates and joints belong together."""
    model, dependents = build.model, []
    for name in dict.fromkeys(demand.coordinate for demand in build.demands):
        if name not in build.carriers:
            coordinate = model.coordinates[name]
            phantom = add_phantom(build, name, coordinate.default)
            build.carriers[name] = phantom, 1.0
            if coordinate.clamped and coordinate.range[0] < coordinate.range[1]:
                joint = build.spec.joint(phantom)
                joint.range, joint.limited = coordinate.range, mujoco.mjtLimited.mjLIMITED_TRUE
            build.note(
                f"/jointset/{model.coordinates[name].joint}/{name}",
                "no axis is linear in it; a phantom joint shows it",
                "0",
            )
        dependents += _tied(build, name, [demand for demand in build.demands if demand.coordinate == name])
    for dependent in dependents:
        equality = build.spec.add_equality(name=dependent.joint, type=mujoco.mjtEq.mjEQ_JOINT)
        equality.name1, equality.name2 = dependent.joint, dependent.of
        ends = (build.spec.joint(name).ref for name in (dependent.of, dependent.joint))
        equality.data[:5] = _about(dependent.polynomial, *ends)
        equality.solref, equality.solimp = TIGHT
    return CoordinateMap(tuple(_mapped(build, name) for name in model.coordinates), tuple(dependents))


def _about(polynomial: Sequence[float], of: float, joint: float) -> Array:
    """Return a quartic of x with values y as one of x - of with values y - joint."""
    moved = (Polynomial(polynomial)(Polynomial([of, 1.0])) - joint).coef
    return np.pad(moved, (0, 5 - len(moved)))


def starts_of(coordinates: CoordinateMap) -> dict[str, float]:
    """Return where joints are in the default pose, those that follow by quartics included."""
    values = {c.joint: c.scale * c.default for c in coordinates.coordinates if c.joint and c.kind == "free"}
    for dependent in coordinates.dependents:
        values[dependent.joint] = float(Polynomial(dependent.polynomial)(values[dependent.of]))
    return values


def exact_couplings(build: Build, coordinates: CoordinateMap) -> Couplings:
    """Return what the document says of joints that follow, and of bodies that are lighter there.

    Phantoms whose quartics nothing needs then stay at their ends beyond the range of the coordinate: there
    quartics of quartics, of degree 16, would turn them by 1e6 rad/s while the coordinate turns by 10.
    """
    said: dict[str, tuple[str | None, tuple[Pieces, ...]]] = {}
    needed = set()
    for demand in build.demands:
        chain = curves(demand.function)
        joint, scale = build.carriers[demand.coordinate]
        if chain is None:  # the equality is all there is
            needed.add(joint)
        else:
            said[demand.joint] = joint, chain if scale == 1 else (Linear(1 / scale).pieces, *chain)
    ranges = {c.joint: sorted(c.scale * end for end in c.range) for c in coordinates.coordinates if c.joint}
    followed = {joint for joint, _ in build.carriers.values()} - needed
    for dependent in coordinates.dependents:
        if dependent.joint not in said and dependent.of in followed:
            said[dependent.joint] = dependent.of, (_held(dependent.polynomial, *ranges[dependent.of]),)
    return Couplings(said, build.light)


def _held(polynomial: Sequence[float], low: float, high: float) -> Pieces:
    """Return a polynomial from `low` to `high`, and its values there beyond."""
    inside = Polynomial(polynomial)(Polynomial([low, 1.0]))
    ends = (float(inside(0.0)),), (float(inside(high - low)),)
    return Pieces((low, low, high), (ends[0], tuple(inside.coef.tolist()), ends[1]))


def _tied(build: Build, name: str, demands: Sequence[Demand]) -> list[Dependent]:
    """Return the joints that follow one coordinate, phantoms first."""
    carrier, scale = build.carriers[name]
    lines = {demand.joint: affine(demand.function) for demand in demands}
    exact = [
        Dependent(joint, carrier, (line[1], line[0] / scale, 0.0, 0.0, 0.0), 0.0, 0.0)
        for joint, line in lines.items()
        if line is not None
    ]
    bent = [demand for demand in demands if lines[demand.joint] is None]
    if not bent:
        return exact
    low, high = build.model.coordinates[name].sampling_range
    fit = fit_all([d.function for d in bent], [d.lever for d in bent], low, high)
    phantoms: list[str] = []
    start = build.model.coordinates[name].default
    values: list[float] = []
    for index, quartic in enumerate(fit.phantoms):
        x = start if quartic.of is None else values[quartic.of]
        values.append(float(Polynomial(quartic.coefficients)(x)))
        phantoms.append(add_phantom(build, f"{name}_phantom{index + 1}", values[-1]))

    def follow(joint: str, quartic: Quartic) -> Dependent:
        of, coefficients = quartic.of, np.array(quartic.coefficients)
        if of is None:
            coefficients = coefficients / scale ** np.arange(5)
        a, b, c, d, e = coefficients.tolist()
        parent = carrier if of is None else phantoms[of]
        return Dependent(joint, parent, (a, b, c, d, e), quartic.error, quartic.slope_error)

    chain = [follow(joint, quartic) for joint, quartic in zip(phantoms, fit.phantoms, strict=True)]
    ends = [follow(demand.joint, quartic) for demand, quartic in zip(bent, fit.functions, strict=True)]
    for demand, end in zip(bent, ends, strict=True):
        unit = "m" if demand.lever == 1 else "rad"
        slope = f"slope {end.slope_error:.2g} {unit} per unit of {name} root mean square"
        build.note(
            f"/joint/{demand.joint}", f"follows by a quartic: {name}", f"{end.error:.2g} {unit}; {slope}"
        )
    return exact + chain + ends


def add_phantom(build: Build, name: str, start: float) -> str:
    """Add a body on ground that only carries a hinge, `start` by default, and return the hinge's name."""
    body = build.bodies[GROUND].add_body(name=build.free_name("body", name))
    joint = build.free_name("joint", name)
    body.add_joint(name=joint, type=HINGE, axis=(1.0, 0.0, 0.0), ref=start)
    weigh(build, body, PHANTOM_INERTIA)
    return joint


def _mapped(build: Build, name: str) -> MappedCoordinate:
    """Return the entry of a coordinate in the map."""
    coordinate = build.model.coordinates[name]
    coupled = name in build.model.couplers
    kind = "coupled" if coupled else "locked" if coordinate.locked else "free"
    joint, scale = build.carriers.get(name, (None, 1.0))
    return MappedCoordinate(
        name,
        joint,
        scale,
        kind,
        coordinate.rotational,
        coordinate.default,
        coordinate.sampling_range,
        coordinate.clamped,
    )

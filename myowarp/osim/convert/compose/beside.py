"""Parts of a bundle beside MJCF, in terms of the converted model: paths, forces, contacts, muscles."""

import csv
import dataclasses
import io
import json
from collections.abc import Iterable

from myowarp.osim.body.described import Value, axes_and_origin, bushing_of, described
from myowarp.osim.body.hill_muscle import HillMuscle
from myowarp.osim.bundle.contacts import DocumentContacts, SurfacePair
from myowarp.osim.bundle.forces import (
    BodyPush,
    JointLimit,
    JointPush,
    PassiveForces,
    TendonSpring,
)
from myowarp.osim.bundle.paths import DocumentPaths, Driven
from myowarp.osim.convert.compose.geometry import Build, default_of, reduced
from myowarp.osim.convert.compose.passive import is_of_joint
from myowarp.osim.document.contacts import contact_pairs
from myowarp.osim.document.elements import LEAST_TRANSITION, CoordinateLimitForce, Ligament
from myowarp.osim.document.functions import Constant, Function, Linear, curves
from myowarp.osim.document.model import GROUND, Model

UNITS = {
    "max_isometric_force": "N",
    "optimal_fiber_length": "m",
    "tendon_slack_length": "m",
    "default_fiber_length": "m",
    "pennation_angle_at_optimal": "rad",
    "maximum_pennation_angle": "rad",
    "max_contraction_velocity": "optimal_fiber_length/s",
    "activation_time_constant": "s",
    "deactivation_time_constant": "s",
    "time_scale": "s",
}
"""Unit of a property in `muscles.csv`; every other one is a pure number, written [1]."""


def document_paths(build: Build, model: Model) -> DocumentPaths | None:
    """Return the paths of a model's muscles, ligaments and path actuators, after `tie`; None: it has none.

    A path that depends on a coordinate by a function that is no polynomial is noted, and so are all others
    with it: the model then keeps its fitted tendons.
    """
    found, values = described(model, model.pulling, lambda name: build.bodies[name].name)
    driven: list[Driven] = []
    for value in values:
        one = _driven(build, value)
        if one is None:
            rule = f"a point depends on {value[1]!r} by a function that is no polynomial; tendons are fitted"
            build.note("/forceset", rule)
            return None
        driven.append(one)
    if not found.paths:
        return None
    return DocumentPaths(found, tuple(driven))


def _driven(build: Build, value: Value) -> Driven | None:
    """Return the joint that a value depends on, None for none, and how; None if that is no polynomial."""
    function, free = reduced(build.model, *value)
    if free is None or free not in build.carriers:
        return None, (Constant(default_of(build.model, function, free)).pieces,)
    chain = curves(function)
    joint, scale = build.carriers[free]
    if chain is None:
        return None
    return joint, chain if scale == 1 else (Linear(1 / scale).pieces, *chain)


def passive_forces(build: Build, has_paths: bool) -> PassiveForces | None:
    """Return what pushes joints back and what ligaments pull, after `tie`; None: nothing does.

    A ligament whose curve is no polynomial is noted; MuJoCo's spring is to stand for it.

    Args:
        build: The build.
        has_paths: Whether ligaments run over the document's paths; else springs are to stand for all.
    """
    model = build.model
    limits = tuple(_limit(build, item) for item in model.limit_forces if item.coordinate in build.carriers)
    ligaments = [_ligament(build, item) for item in model.ligaments.values()] if has_paths else []
    pulling = tuple(ligament for ligament in ligaments if ligament is not None)
    pushes = tuple(
        JointPush(*build.carriers[item.coordinate], item.formula)
        for item in model.coordinate_formulas
        if item.coordinate in build.carriers
    )
    apart = (item for item in model.bushings if not is_of_joint(build, item))
    bushings = tuple(bushing_of(item, lambda name: build.bodies[name].name) for item in apart)
    body_pushes = tuple(
        BodyPush(
            build.bodies[item.body].name,
            build.bodies[GROUND].name,
            *axes_and_origin(item.frame),
            item.force_in_ground,
            item.point_in_ground,
            item.formulas,
        )
        for item in model.prescribed_forces
    )
    found = PassiveForces(limits, pulling, pushes=pushes, bushings=bushings, body_pushes=body_pushes)
    return found if found.acts else None


def _limit(build: Build, item: CoordinateLimitForce) -> JointLimit:
    """Return a limit along the joint that shows its coordinate: joint = scale coordinate."""
    joint, scale = build.carriers[item.coordinate]
    way = 1 if scale > 0 else -1
    (low, high), (low_stiffness, high_stiffness) = item.limits[::way], item.stiffness[::way]
    return JointLimit(
        joint,
        scale * low,
        scale * high,
        low_stiffness / scale**2,
        high_stiffness / scale**2,
        item.damping / scale**2,
        abs(scale) * max(item.transition, LEAST_TRANSITION),
    )


def _ligament(build: Build, item: Ligament) -> TendonSpring | None:
    """Return a ligament; None where its curve is no polynomial."""
    chain = curves(item.force)
    if chain is None:
        rule = "its curve is no polynomial; it is the spring of plain MuJoCo"
        build.note(f"/forceset/{item.name}", rule)
        return None
    return TendonSpring(item.name, item.resting_length, item.dissipation, item.damping, chain, item.formula)


def document_contacts(build: Build, model: Model) -> DocumentContacts | None:
    """Return what touches what in a document; None: nothing does, or a force names no geometry of the model.

    Args:
        build: The build; its bodies have the frames of the document's.
        model: The document.
    """
    try:
        pairs = contact_pairs(model)
    except ValueError as error:
        build.note("/contactgeometryset", str(error))
        return None
    found = tuple(SurfacePair.of(pair, lambda name: build.bodies[name].name) for pair in pairs)
    return DocumentContacts(found) if found else None


def muscle_table(muscles: Iterable[HillMuscle]) -> str:
    """Return the content of `muscles.csv`: the exact Hill parameters of muscles, as the model states them.

    One row per muscle. The header names each column and its unit, such as `max_isometric_force [N]`, under
    OpenSim's property names; the numbers of a nested curve as `ForceVelocityCurve.isometric_slope [1]`.
    Numbers have all their digits, switches are 0 or 1, and what a class does not have stays empty. A curve
    that the file holds as a function is a JSON list of its class and its fields in order (functions.py).
    """
    rows = list(muscles)
    values = dict.fromkeys(name for muscle in rows for name in muscle.values)
    shapes = dict.fromkeys(name for muscle in rows for name in muscle.functions)
    text = io.StringIO(newline="")
    table = csv.writer(text)
    table.writerow(["name", "class", *(f"{name} [{_unit(name)}]" for name in values), *shapes])
    for muscle in rows:
        numbers = [repr(float(muscle.values[name])) if name in muscle.values else "" for name in values]
        splines = [_encode(muscle.functions[name]) if name in muscle.functions else "" for name in shapes]
        table.writerow([muscle.name, muscle.kind, *numbers, *splines])
    return text.getvalue()


def _unit(name: str) -> str:
    """Return the unit of a property, which may stand in a nested object."""
    return UNITS.get(name.rpartition(".")[2], "1")


def _encode(function: Function) -> str:
    """Return a function as JSON: class and fields in order, nested functions alike."""

    def nested(value: object) -> object:
        if dataclasses.is_dataclass(value):
            fields = (getattr(value, field.name) for field in dataclasses.fields(value))
            return [type(value).__name__, *(nested(field) for field in fields)]
        return value

    return json.dumps(nested(function))

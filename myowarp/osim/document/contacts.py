"""Contact forces of a document: what touches what, and which of these pairs have a force in OpenSim.

Stiffness is E, the plane strain modulus. Of two surfaces k_i = E_i^(2/3) acts in series, dissipation is mixed
as each gives way, and friction is the harmonic mean. Pairs on one body do nothing to motion and are left out,
as are those for which OpenSim has no contact: two half spaces, and meshes in a HuntCrossleyForce.

Source: OpenSim 4.6, classes of the elements' names; Simbody's HuntCrossleyForce, ElasticFoundationForce and
CollisionDetectionAlgorithm.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

from myowarp.osim.document.elements import ContactForce, ContactParameters, Shape
from myowarp.osim.document.model import Loss, Model

ROUND = ("plane", "sphere", "ellipsoid")
"""Kinds of shapes that touch by Hertz's law."""

TYPES = ("SmoothSphereHalfSpaceForce", "HuntCrossleyForce")
"""OpenSim's classes of contact forces that are read."""


@dataclass(frozen=True)
class Material:
    """Material of the surfaces of a contact force; as `laws.forces.hunt_crossley.ContactMaterial`."""

    smooth: bool
    stiffness: float
    share: float
    dissipation: float
    static_friction: float
    dynamic_friction: float
    viscous_friction: float
    transition_velocity: float
    constant_contact_force: float
    hertz_smoothing: float
    hunt_crossley_smoothing: float


@dataclass(frozen=True, eq=False)
class Pair:
    """Two contact geometries on two bodies that may touch; a half space is the first."""

    force: str
    """Name of the contact force."""
    first: Shape
    second: Shape
    material: Material


def contact_pairs(model: Model) -> list[Pair]:
    """Return the pairs of surfaces that may touch, of all contact forces that act.

    Raises:
        ValueError: A force names a contact geometry that the model has not, or one of another kind.
    """
    return [pair for force in model.contact_forces for pair in _pairs(model, force)]


def resting(model: Model) -> Model:
    """Return a model in which no contact force acts; each is a loss."""
    losses = tuple(
        Loss(
            f"/forceset/{force.name}",
            f"{force.type} left out; --contact opensim has it act",
            code=force.type,
            effect="contact",
            names=frozenset(name for part in force.parameters for name in part.geometries),
        )
        for force in model.contact_forces
    )
    return replace(model, contact_forces=(), notes=(*model.notes, *losses))


def _pairs(model: Model, force: ContactForce) -> Iterator[Pair]:
    """Yield the pairs of surfaces of a contact force."""
    shapes = {shape.name: shape for shape in model.shapes if shape.contact}
    surfaces: list[tuple[Shape, ContactParameters]] = []
    for part in force.parameters:
        for name in part.geometries:
            if name not in shapes:
                raise ValueError(
                    f"{model.source}: {force.type} {force.name!r} names the contact geometry {name!r}, which "
                    f"the model has not; it has {', '.join(shapes) or 'none'}"
                )
            surfaces.append((shapes[name], part))
    for (first, one), (second, two) in combinations(surfaces, 2):
        kinds = {first.kind, second.kind}
        if first.body == second.body or kinds == {"plane"} or not kinds <= set(ROUND):
            continue
        if second.kind == "plane":
            first, one, second, two = second, two, first, one
        if material := _material(force, one, two):
            yield Pair(force.name, first, second, material)


def _material(force: ContactForce, one: ContactParameters, two: ContactParameters) -> Material | None:
    """Return what two surfaces are made of; None: nothing pushes them apart."""
    first, second = one.stiffness ** (2 / 3), two.stiffness ** (2 / 3)
    if not first * second:
        return None
    share = second / (first + second)
    smoothing = force.smoothing or (0.0, 0.0, 0.0)
    return Material(
        smooth=bool(force.smoothing),
        stiffness=first * share,
        share=share,
        dissipation=one.dissipation * share + two.dissipation * (1 - share),
        static_friction=_harmonic(one.static_friction, two.static_friction),
        dynamic_friction=_harmonic(one.dynamic_friction, two.dynamic_friction),
        viscous_friction=_harmonic(one.viscous_friction, two.viscous_friction),
        transition_velocity=force.transition_velocity,
        constant_contact_force=smoothing[0],
        hertz_smoothing=smoothing[1],
        hunt_crossley_smoothing=smoothing[2],
    )


def _harmonic(one: float, two: float) -> float:
    """Return the harmonic mean of two numbers that are not below 0."""
    return 2 * one * two / (one + two) if one or two else 0.0

"""Contact as OpenSim computes it that a model brings along: the text `contacts`, `contacts.json` of a folder.

It has the pairs of surfaces that may touch, on the bodies of the MuJoCo model (`laws.forces.contact`). They
act where they are asked for (`contact="opensim"`), in place of MuJoCo's contact of the same geometry.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable
from typing import Any, Self

import mujoco
import numpy as np
import warp as wp

from myowarp.kernels.structs import struct_array
from myowarp.laws.forces.contact import Contact
from myowarp.laws.forces.contact_shapes import ELLIPSOID, HALF_SPACE, SPHERE
from myowarp.osim.bundle.paths import frozen
from myowarp.osim.bundle.text import Sidecar
from myowarp.osim.document.contacts import Material, Pair

STEADY = 0.5
"""Step times frequency; from 2 on a spring is not stable."""

KINDS = {"plane": HALF_SPACE, "sphere": SPHERE, "ellipsoid": ELLIPSOID}


@dataclasses.dataclass(frozen=True)
class Surface:
    """A surface on a body; as `laws.forces.contact.ContactSurface`."""

    name: str
    body: str
    kind: str
    rotation: tuple[tuple[float, ...], ...]
    origin: tuple[float, ...]
    size: tuple[float, ...]


@dataclasses.dataclass(frozen=True)
class SurfacePair:
    """Two surfaces that may touch; as `laws.forces.contact.Contact`.

    Attributes:
        force: Name of the contact force.
        first: A surface; if one is a half space, that.
        second: Another one.
        material: Of both.
    """

    force: str
    first: Surface
    second: Surface
    material: Material

    @classmethod
    def of(cls, pair: Pair, body: Callable[[str], str] = lambda name: name) -> Self:
        """Return a pair of a document, on bodies of other names."""
        first, second = (
            Surface(
                shape.name,
                body(shape.body),
                shape.kind,
                tuple(map(tuple, shape.frame.rotation.tolist())),
                tuple(shape.frame.position.tolist()),
                tuple((np.ones(3) * shape.size).tolist()),
            )
            for shape in (pair.first, pair.second)
        )
        return cls(pair.force, first, second, pair.material)


def contact_table(pairs: Iterable[SurfacePair], number: Callable[[str], int]) -> wp.array:
    """Return pairs on the current device, of what numbers their bodies."""
    rows = []
    for pair in pairs:
        surfaces = (
            (number(one.body), KINDS[one.kind], one.rotation, one.origin, one.size)
            for one in (pair.first, pair.second)
        )
        rows.append((*surfaces, dataclasses.astuple(pair.material)))
    return struct_array(Contact, rows)


@dataclasses.dataclass(frozen=True)
class DocumentContacts(Sidecar):
    """Contact of an OpenSim document in terms of a MuJoCo model.

    Attributes:
        pairs: Surfaces that may touch.
    """

    NAME, FILE = "contacts", "contacts.json"
    KEYS = "'pairs'"
    pairs: tuple[SurfacePair, ...] = ()

    @classmethod
    def from_entry(cls, entry: Any) -> Self:
        """Return what parsed JSON says; see `Sidecar.from_entry`."""
        return cls(tuple(_pair(pair) for pair in entry["pairs"]))

    def as_json(self) -> str:
        """Return the text."""
        return json.dumps({"pairs": [dataclasses.asdict(pair) for pair in self.pairs]})

    def check(self, model: mujoco.MjModel) -> None:
        """Raise ValueError if it names what a model has not."""
        self.check_named("body", self.bodies_apart, {model.body(i).name for i in range(model.nbody)})

    def longest_step(self, model: mujoco.MjModel) -> float:
        """Return the longest physics step that the springs of contacts stand [s]; `STEADY` of 1 / frequency.

        Of each pair it is that of its Hertz spring under the weight of the model, with the inertia that its
        bodies have in the model's first pose. Friction and dissipation are integrated implicitly.
        """
        weight = float(model.body_mass.sum() * np.linalg.norm(model.opt.gravity))
        return min((STEADY / _frequency(pair, model, weight) for pair in self.pairs), default=np.inf)

    @property
    def bodies_apart(self) -> Iterable[str]:
        """Names of bodies that need frames of their own."""
        return {surface.body for pair in self.pairs for surface in (pair.first, pair.second)}


def _frequency(pair: SurfacePair, model: mujoco.MjModel, weight: float) -> float:
    """Return sqrt(df/dd / mass) of a contact that carries a weight [N], in rad/s."""
    sizes = [1 / min(one.size) for one in (pair.first, pair.second) if one.kind != "plane"]
    hertz = 4 / 3 * pair.material.stiffness**1.5 * sum(sizes) ** -0.5
    slope = 1.5 * hertz ** (2 / 3) * weight ** (1 / 3)
    lightness = sum(model.body(one.body).invweight0[0] for one in (pair.first, pair.second))
    return max(float(np.sqrt(slope * lightness)), 1e-9)


def _pair(entry: Any) -> SurfacePair:
    """Return what an entry says.

    Raises:
        ValueError: A number cannot be computed with.
    """
    surfaces = [Surface(**frozen(entry[side])) for side in ("first", "second")]
    material = Material(**entry["material"])
    numbers = [*dataclasses.astuple(material)]
    for surface in surfaces:
        if surface.kind not in KINDS:
            raise ValueError(f"a surface must be one of {', '.join(KINDS)}, got {surface.kind!r}")
        numbers += [*np.ravel(surface.rotation), *surface.origin, *surface.size]
        if not min(surface.size) > 0:
            raise ValueError(f"surface {surface.name!r} must have a size above 0")
    if not np.isfinite(np.array(numbers, float)).all() or not material.transition_velocity > 0:
        raise ValueError(f"contact {entry['force']!r} needs finite numbers, a transition velocity above 0")
    return SurfacePair(entry["force"], surfaces[0], surfaces[1], material)

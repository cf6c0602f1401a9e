"""Muscle paths that a model brings along: the text `paths`, which `myowarp convert` writes as `paths.json`.

It names points, wrap objects, and how moving and conditional points depend on joints. Tendons of these names
then run as OpenSim's paths do (`coordinates.own_paths`).
"""

import dataclasses
import json
from collections.abc import Iterable
from typing import Any, Self

import mujoco
import numpy as np

from myowarp.laws.paths.path import MOST_VARIABLES
from myowarp.laws.paths.tables import (
    KINDS,
    METHODS,
    TURNS,
    OsimPath,
    OsimPaths,
    Over,
    Polynomial,
    Via,
    WrapSurface,
)
from myowarp.laws.pieces import Pieces
from myowarp.osim.bundle.couplings import driven, entry_of
from myowarp.osim.bundle.text import Sidecar, scalar_joints

WRAP_SITE, WRAP_JOINT = mujoco.mjtWrap.mjWRAP_SITE.value, mujoco.mjtWrap.mjWRAP_JOINT.value

Driven = tuple[str | None, tuple[Pieces, ...]]
"""A value: the joint that it depends on, None for none, and the curves that are applied to it in turn."""


@dataclasses.dataclass(frozen=True)
class DocumentPaths(Sidecar):
    """Paths of an OpenSim document in terms of a MuJoCo model.

    Attributes:
        paths: The paths, by name of the tendon.
        values: What they depend on.
        guard: As in `PathMemory`.
        exact: As in `PathMemory`.
    """

    NAME, FILE = "paths", "paths.json"
    KEYS = "'guard', 'exact', 'values', 'surfaces' and 'paths'"
    paths: OsimPaths
    values: tuple[Driven, ...]
    guard: float = TURNS
    exact: bool = False

    @property
    def bodies_apart(self) -> Iterable[str]:
        """Bodies that paths are fixed to."""
        return self.paths.bodies

    @classmethod
    def from_entry(cls, entry: Any) -> Self:
        """Return what parsed JSON says; see `Sidecar.from_entry`."""
        surfaces = {name: WrapSurface(**frozen(surface)) for name, surface in entry["surfaces"].items()}
        paths = {
            name: OsimPath(
                tuple(Via(**frozen(point)) for point in path["points"]),
                tuple(Over(**frozen(wrap)) for wrap in path["wraps"]),
                Polynomial(**frozen(path["polynomial"])) if path.get("polynomial") else None,
            )
            for name, path in entry["paths"].items()
        }
        values = tuple(map(driven, entry["values"]))
        found = cls(OsimPaths(paths, surfaces), values, float(entry["guard"]), bool(entry["exact"]))
        _check(found)
        return found

    def as_json(self) -> str:
        """Return the text."""
        values = [entry_of(*value) for value in self.values]
        surfaces = {name: dataclasses.asdict(surface) for name, surface in self.paths.surfaces.items()}
        paths = {name: dataclasses.asdict(path) for name, path in self.paths.paths.items()}
        chosen = {"guard": self.guard, "exact": self.exact}
        return json.dumps({**chosen, "values": values, "surfaces": surfaces, "paths": paths})

    def check(self, model: mujoco.MjModel) -> None:
        """Raise ValueError if it names what a model has not, or leaves a tendon out that wraps."""
        tendons = [model.tendon(i).name for i in range(model.ntendon)]
        leading = [of for of, _ in self.values if of is not None]
        self.check_named("body", self.paths.bodies, [model.body(b).name for b in range(model.nbody)])
        self.check_named("hinge or slide", leading, scalar_joints(model))
        self.check_named("tendon", self.paths.paths, tendons)
        for tendon in range(model.ntendon):
            name = model.tendon(tendon).name
            sites = is_of(model, tendon, WRAP_SITE) or is_of(model, tendon, WRAP_JOINT)
            if name not in self.paths.paths and not sites:
                raise ValueError(
                    f"the paths of the model must name tendon {name!r}, which wraps; they do not"
                )


def frozen(entry: dict[str, Any]) -> dict[str, Any]:
    """Return an entry with tuples in place of lists."""

    def tupled(value: Any) -> Any:
        return tuple(map(tupled, value)) if isinstance(value, list) else value

    return {name: tupled(value) for name, value in entry.items()}


def _check(said: DocumentPaths) -> None:
    """Raise ValueError if the kernel would read beside its tables, or compute with what is no number."""
    if not said.guard >= 0:
        raise ValueError(f"guard must be at least 0, got {said.guard}")
    for name, surface in said.paths.surfaces.items():
        numbers = np.array([*surface.position, *surface.size, *np.ravel(surface.rotation)], float)
        if surface.kind not in KINDS or surface.axis not in (0, 1, 2) or surface.sign not in (-1, 0, 1):
            raise ValueError(f"surface {name!r} has a kind, axis or sign that does not exist")
        if numbers.shape != (15,) or not np.isfinite(numbers).all() or min(surface.size) < 0:
            raise ValueError(f"surface {name!r} needs position, rotation and sizes, finite and not negative")
    for name, path in said.paths.paths.items():
        if path.polynomial is not None:
            _check_polynomial(name, path.polynomial, len(said.values))
            continue
        if len(path.points) < 2:
            raise ValueError(f"path {name!r} needs at least 2 points, got {len(path.points)}")
        for point in path.points:
            numbers = np.array(
                [*point.location, *point.rest, *point.range, *np.ravel(point.rotation or ())], float
            )
            if len(numbers) not in (8, 17) or not np.isfinite(numbers[:6]).all() or np.isnan(numbers).any():
                raise ValueError(f"path {name!r} has a point whose numbers are not as they must be")
            if not all(-1 <= number < len(said.values) for number in (*point.values, point.condition)):
                raise ValueError(f"path {name!r} has a point that depends on a value that does not exist")
        for wrap in path.wraps:
            if wrap.surface not in said.paths.surfaces or wrap.method not in METHODS:
                raise ValueError(f"path {name!r} wraps over a surface, or by a method, that does not exist")
            if not (0 <= wrap.first < len(path.points) and 0 <= wrap.last < len(path.points)):
                raise ValueError(f"path {name!r} wraps between points that it has not")


def _check_polynomial(name: str, polynomial: Polynomial, values: int) -> None:
    """Raise ValueError if a length that is a polynomial cannot be computed."""
    count, terms = len(polynomial.values), len(polynomial.coefficients)
    if not 1 <= count <= MOST_VARIABLES or not all(0 <= number < values for number in polynomial.values):
        raise ValueError(f"path {name!r} needs 1 to {MOST_VARIABLES} variables that exist, got {count}")
    powers = np.array(polynomial.powers, float)
    if powers.shape != (terms, count) or terms < 1 or not ((powers >= 0) & (powers % 1 == 0)).all():
        raise ValueError(f"path {name!r} needs a whole power from 0 of every variable in every term")
    if not np.isfinite(np.array(polynomial.coefficients, float)).all():
        raise ValueError(f"path {name!r} needs finite coefficients")


def is_of(model: mujoco.MjModel, tendon: int, kind: int) -> bool:
    """Whether a tendon consists of things of one kind."""
    first = model.tendon_adr[tendon]
    return bool((model.wrap_type[first : first + model.tendon_num[tendon]] == kind).all())

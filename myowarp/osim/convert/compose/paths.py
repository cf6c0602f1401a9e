"""The paths of a `Model` in terms of the converted model: the sidecar `paths.json`."""

import dataclasses

from myowarp.laws.paths.tables import TURNS, OsimPaths
from myowarp.laws.pieces import line
from myowarp.osim.body.described import Value, described
from myowarp.osim.bundle.paths import DocumentPaths, Driven
from myowarp.osim.convert.compose.geometry import Build, default_of, reduced
from myowarp.osim.document.functions import curves
from myowarp.osim.document.model import Model, Note, pulling


def document_paths(build: Build, model: Model, guard: float = TURNS) -> DocumentPaths | None:
    """Return the paths of a model's muscles, ligaments and path actuators, after `tie`; None: it has none.

    A path that depends on a coordinate by a function that is no polynomial is noted, and so are all others
    with it: the model then keeps its fitted tendons.
    """
    found, values = described(model, pulling(model))
    driven: list[Driven] = []
    for value in values:
        one = _driven(build, value)
        if one is None:
            rule = f"a point depends on {value[1]!r} by a function that is no polynomial; tendons are fitted"
            build.notes.append(Note("/forceset", rule))
            return None
        driven.append(one)
    if not found.paths:
        return None
    return DocumentPaths(
        _renamed(found, {name: body.name for name, body in build.bodies.items()}), tuple(driven), guard
    )


def _driven(build: Build, value: Value) -> Driven | None:
    """Return the joint that a value depends on, None for none, and how; None if that is no polynomial."""
    function, free = reduced(build.model, *value)
    if free is None or free not in build.carriers:
        return None, (line(0.0, default_of(build.model, function, free)),)
    chain = curves(function)
    joint, scale = build.carriers[free]
    if chain is None:
        return None
    return joint, chain if scale == 1 else (line(1 / scale), *chain)


def _renamed(paths: OsimPaths, bodies: dict[str, str]) -> OsimPaths:
    """Return the same paths with MuJoCo's names of bodies."""
    surfaces = {
        name: dataclasses.replace(surface, body=bodies[surface.body])
        for name, surface in paths.surfaces.items()
    }
    named = {
        name: dataclasses.replace(
            path,
            points=tuple(dataclasses.replace(point, body=bodies[point.body]) for point in path.points),
        )
        for name, path in paths.paths.items()
    }
    return OsimPaths(named, surfaces)

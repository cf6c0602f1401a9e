"""Forces of a model beside muscles: springs and limits of coordinates, bushings, ligaments, path springs.

The laws are those of the simulation (`laws.forces`). A coordinate that follows another one pushes that one
with its slope. OpenSim's inverse dynamics and static optimisation have these forces act, too; what acts there
and not here is named (`left_out`), and what a set-up file excludes is taken out of the model (`without`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp

from myowarp.kernels.launch import launch
from myowarp.kernels.structs import struct_array
from myowarp.laws.expressions import Programs, Variables, programs, run
from myowarp.laws.forces.bushing import BodyMotion, Bushing, Wrench
from myowarp.laws.forces.coordinate_limit import CoordinateLimit, limit_damping, limit_spring
from myowarp.laws.forces.ligament import Ligament, ligament_tension
from myowarp.laws.pieces import evaluated
from myowarp.osim.body.described import bushing_of
from myowarp.osim.body.moment_arm import coordinates_between, leading
from myowarp.osim.body.muscle_paths import muscle_paths
from myowarp.osim.body.skeleton import Bones, Placement, Skeleton
from myowarp.osim.bundle.forces import bushing_table, ligament_table
from myowarp.osim.document.elements import LEAST_TRANSITION
from myowarp.osim.document.functions import IDENTITY, Function
from myowarp.osim.document.model import GROUND, Loss, Model, Note
from myowarp.process import listed, warn_once

LISTED = 4
"""Coordinates that are named of what is left out."""

wp.set_module_options({"enable_backward": False})


@wp.struct
class CoordinateSpring:
    """A linear spring and damper on a coordinate: f = -k (q - rest) - c dq/dt.

    Attributes:
        address: Number of its coordinate among those that something acts on.
        stiffness: k [N m/rad or N/m].
        rest: [rad or m].
        damping: c [N m s/rad or N s/m].
    """

    address: int
    stiffness: wp.float64
    rest: wp.float64
    damping: wp.float64


@wp.struct
class ModelForces:
    """Forces of a model on coordinates and between bodies.

    Attributes:
        coordinates: Those that something acts on, as functions of independent ones.
        limits: Limits of coordinates; their address is a number in `coordinates`.
        springs: Springs of coordinates.
        bushings: Between bodies.
        pushed: Numbers in `coordinates` of those that formulas of value and speed push.
        formulas: First those, then those of bushings and ligaments.
    """

    coordinates: Skeleton
    limits: wp.array[CoordinateLimit]
    springs: wp.array[CoordinateSpring]
    bushings: wp.array[Bushing]
    pushed: wp.array[int]
    formulas: Programs


@wp.func
def push_coordinates(
    worldid: int,
    acting: ModelForces,
    values: wp.array2d[wp.float64],
    speeds: wp.array2d[wp.float64],
    passive: wp.array2d[wp.float64],
):
    """Add f dq/du of limits and springs of coordinates q to what acts along the independent u."""
    for i in range(acting.limits.shape[0]):
        limit = acting.limits[i]
        k = acting.coordinates.free[limit.address]
        if k >= 0:
            q = evaluated(acting.coordinates.functions, limit.address, values[worldid, k])
            rate = q[1] * speeds[worldid, k]
            force = limit_spring(limit, q[0]) - limit_damping(limit, q[0]) * rate
            passive[worldid, k] += q[1] * force
    for i in range(acting.springs.shape[0]):
        spring = acting.springs[i]
        k = acting.coordinates.free[spring.address]
        if k >= 0:
            q = evaluated(acting.coordinates.functions, spring.address, values[worldid, k])
            rate = q[1] * speeds[worldid, k]
            force = -spring.stiffness * (q[0] - spring.rest) - spring.damping * rate
            passive[worldid, k] += q[1] * force
    for i in range(acting.pushed.shape[0]):
        address = acting.pushed[i]
        k = acting.coordinates.free[address]
        if k >= 0:
            q = evaluated(acting.coordinates.functions, address, values[worldid, k])
            at = Variables()
            at[0] = q[0]
            at[1] = q[1] * speeds[worldid, k]
            passive[worldid, k] += q[1] * run(acting.formulas, i, at)


@wp.func
def motion_of(
    worldid: int, body: int, skeleton: Skeleton, speeds: wp.array2d[wp.float64], placement: Placement
) -> BodyMotion:
    """Return where a body is and how it moves; -1 is ground."""
    one, found = wp.float64(1.0), BodyMotion()
    found.rotation = wp.diag(wp.vec3d(one, one, one))
    if body >= 0:
        found.rotation = placement.rotation[worldid, body]
        found.origin = placement.origin[worldid, body]
    carried = int(body)
    while carried >= 0:
        for move in range(skeleton.first[carried], skeleton.first[carried + 1]):
            k = skeleton.free[move]
            if k >= 0:
                found.turn += speeds[worldid, k] * placement.turn[worldid, move]
                found.shift += speeds[worldid, k] * placement.shift[worldid, move]
        carried = skeleton.parent[carried]
    return found


@wp.func
def along_moves(
    worldid: int,
    body: int,
    sign: wp.float64,
    wrench: Wrench,
    skeleton: Skeleton,
    placement: Placement,
    passive: wp.array2d[wp.float64],
):
    """Add what a wrench times a sign on a body does along independent coordinates."""
    carried = int(body)
    while carried >= 0:
        for move in range(skeleton.first[carried], skeleton.first[carried + 1]):
            k = skeleton.free[move]
            if k >= 0:
                passive[worldid, k] += sign * wp.dot(placement.turn[worldid, move], wrench.torque)
                passive[worldid, k] += sign * wp.dot(placement.shift[worldid, move], wrench.force)
        carried = skeleton.parent[carried]


@wp.kernel(enable_backward=False)
def pull_ligaments(
    # Params:
    ligaments: wp.array[Ligament],
    formulas: Programs,
    # In:
    spring: wp.array2d[wp.float64],
    length: wp.array2d[wp.float64],
    velocity: wp.array2d[wp.float64],
    # Out:
    tension: wp.array2d[wp.float64],
):
    """T of ligaments and path springs [N]."""
    worldid, i = wp.tid()
    tension[worldid, i] = ligament_tension(
        ligaments[i], formulas, spring[worldid, i], length[worldid, i], velocity[worldid, i]
    )


@dataclass(frozen=True, eq=False)
class Acting:
    """Forces of a model beside muscles.

    Attributes:
        tables: What kernels read.
        any: Whether these have anything.
        ligaments: Names of what pulls along a path.
        rows: Their laws.
        curves: Tension at rest of each [N] over length / resting length.
    """

    tables: ModelForces
    any: bool
    ligaments: tuple[str, ...]
    rows: wp.array
    curves: tuple[Function, ...]


def acts(model: Model) -> bool:
    """Whether anything acts in a model beside muscles and motors."""
    on_coordinates = model.limit_forces or model.coordinate_springs or model.coordinate_formulas
    return bool(on_coordinates or model.bushings or model.ligaments)


def left_out(model: Model) -> str:
    """Return what acts in OpenSim beside muscles and not here, with the coordinates whose moments it changes.

    Constraints that close loops are among it: the tools of OpenSim hold them. It is one sentence; "": nothing
    is left out.
    """
    lost = [note for note in model.notes if isinstance(note, Loss) and note.effect in ("force", "contact")]
    said = [_lost(model, note) for note in lost] + _open(model)
    return f"left out, though OpenSim has it act: {'; '.join(said)}" if said else ""


def open_loops(model: Model) -> str:
    """Return which constraints angles need not obey here, and do in OpenSim; "": there are none."""
    said = _open(model)
    return f"these hold no angles here, and do in OpenSim: {'; '.join(said)}" if said else ""


def _open(model: Model) -> list[str]:
    """Return the constraints that close loops, of classes that nobody reads, too, with their coordinates."""
    lost = [note for note in model.notes if isinstance(note, Loss) and note.effect == "motion"]
    said = [_lost(model, note) for note in lost]
    for item in model.constraints:
        on = leading(model, coordinates_between(model, item.bodies))
        said.append(f"{item.kind} constraint {item.name!r} ({_on(on)})")
    return said


def _lost(model: Model, note: Loss) -> str:
    """Return class, name and coordinates of what is left out."""
    moved: Iterable[str | None] = note.names & set(model.coordinates)
    if not moved:
        shapes = {shape.name: shape.body for shape in model.shapes if shape.contact}
        bodies = [name for name in (*model.bodies, GROUND) if name in note.names]
        bodies += [body for name, body in shapes.items() if name in note.names]
        moved = coordinates_between(model, bodies if len(set(bodies)) > 1 else [*bodies, GROUND])
    return f"{note.code} {note.path.rpartition('/')[2]!r} ({_on(leading(model, moved))})"


def _on(coordinates: Sequence[str]) -> str:
    """Return the first coordinates of some, and how many more there are, or that none is known."""
    return listed(coordinates, LISTED) or "on which coordinates is not known"


def without(model: Model, names: Iterable[str]) -> tuple[Model, list[str]]:
    """Return a model without some forces, named as OpenSim's `forces_to_exclude` names them.

    Args:
        model: The model.
        names: Of forces, or All, Actuators and Muscles in letters of any size. External loads stay.

    Returns:
        The model, and the names that are neither.
    """
    wanted = [name for name in names if name.upper() not in ("ACTUATORS", "MUSCLES")]
    every = "ALL" in {name.upper() for name in wanted}

    def stays(name: str) -> bool:
        return not every and name not in wanted

    def place(note: Note) -> str:
        return note.path.rpartition("/")[2]

    kinds = (
        *("limit_forces", "coordinate_springs", "coordinate_formulas", "bushings", "prescribed_forces"),
        "contact_forces",
    )
    motors = ("coordinate_actuators", "path_actuators", "body_actuators")
    left: dict[str, Any] = {
        kind: tuple(one for one in getattr(model, kind) if stays(one.name)) for kind in kinds
    }
    left["ligaments"] = {name: one for name, one in model.ligaments.items() if stays(name)}
    left["notes"] = tuple(note for note in model.notes if not isinstance(note, Loss) or stays(place(note)))
    there = {one.name for kind in (*kinds, *motors) for one in getattr(model, kind)}
    there |= {*model.ligaments, *model.muscles, *map(place, model.notes)}
    return replace(model, **left), [] if every else [name for name in wanted if name not in there]


@lru_cache(maxsize=8)
def acting_in(bones: Bones) -> Acting:
    """Return what acts in a model beside muscles, on the bones' device; what is left out is logged once."""
    model = bones.model
    if sentence := left_out(model):
        warn_once(f"{model.source.name}: {sentence}")
    on = [item.coordinate for item in model.limit_forces]
    on += [item.coordinate for item in model.coordinate_springs]
    pushed = range(len(on), len(on) + len(model.coordinate_formulas))
    on += [item.coordinate for item in model.coordinate_formulas]
    formulas = [item.formula for item in model.coordinate_formulas]
    limits = [
        (number, 0, *item.limits, *item.stiffness, item.damping, max(item.transition, LEAST_TRANSITION))
        for number, item in enumerate(model.limit_forces)
    ]
    springs = [
        (len(limits) + number, item.stiffness, item.rest, item.damping)
        for number, item in enumerate(model.coordinate_springs)
    ]
    ligaments = tuple(model.ligaments.values())
    tables = ModelForces()
    with wp.ScopedDevice(bones.device):
        tables.coordinates = bones.values_of([(IDENTITY, name) for name in on])
        tables.limits, tables.springs = (
            struct_array(CoordinateLimit, limits),
            struct_array(CoordinateSpring, springs),
        )
        tables.bushings = bushing_table(map(bushing_of, model.bushings), bones.number, formulas)
        rows = ligament_table(ligaments, range(len(ligaments)), formulas)
        tables.pushed = wp.array(np.array(pushed, np.int32), dtype=int)
        tables.formulas = programs(formulas)
    curves = tuple(ligament.force for ligament in ligaments)
    return Acting(tables, bool(on or model.bushings), tuple(model.ligaments), rows, curves)


def ligament_pulls(bones: Bones, values: np.ndarray, speeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return tensions of ligaments and path springs [N], and what these do along coordinates [N m] or [N].

    Args:
        bones: The model.
        values: Of the independent coordinates [rad] or [m], shape (frames, coordinates).
        speeds: Their derivatives by time.

    Returns:
        Arrays of shape (frames, ligaments) and (frames, coordinates).
    """
    acting = acting_in(bones)
    if not acting.ligaments:
        return np.zeros((len(values), 0)), np.zeros(values.shape)
    paths = muscle_paths(bones, values, speeds, acting.ligaments)
    rest = [ligament.resting_length for ligament in bones.model.ligaments.values()]
    shares = (paths.length / rest).T
    spring = np.stack([curve.value(x) for curve, x in zip(acting.curves, shares, strict=True)], axis=1)
    with wp.ScopedDevice(bones.device):
        tension = wp.empty(paths.length.shape, dtype=wp.float64)
        launch(
            pull_ligaments,
            paths.length.shape,
            ligaments=acting.rows,
            formulas=acting.tables.formulas,
            spring=wp.array(spring, dtype=wp.float64),
            length=wp.array(paths.length, dtype=wp.float64),
            velocity=wp.array(paths.velocity, dtype=wp.float64),
            tension=tension,
        )
        found = tension.numpy().copy()
    return found, np.einsum("nm,nmk->nk", found, paths.moment_arm)

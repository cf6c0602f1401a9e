"""The bones of an OpenSim model on the device: where bodies are, what moves them, what forces that takes.

One world is one frame of a recording. A coordinate that follows another one moves its bodies along the one
that it follows, by the document's own functions; so only independent coordinates are left. Everything is
float64 and in ground's axes, and velocities and forces are those at ground's origin, so that bodies add
without shifts:

    motion of a hinge (axis w, v = point x w), of a slide (0, v = axis), times the slope of its function
    weighted points of a body: sum w, sum w p, sum w (p . p - p p^T)
    normal matrix: H_jk = s_j^T I s_k with I of all that both move

With markers as points the matrix is that of Gauss and Newton, with masses it is the mass matrix.

Source: composite bodies and inverse dynamics by two recursions, Featherstone, *Rigid Body Dynamics
Algorithms* (2008), chapters 5 and 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from myowarp.kernels.structs import struct_of, zeros_of
from myowarp.laws.pieces import Pieces, PieceTables, evaluated, piece_tables
from myowarp.osim.document.contacts import resting
from myowarp.osim.document.functions import Function, curves
from myowarp.osim.document.model import GROUND, Model
from myowarp.osim.document.read.model import read_model
from myowarp.process import check_on_cpu, start_warp

HINGE, SLIDE = 0, 1

wp.set_module_options({"enable_backward": False})


@wp.struct
class Skeleton:
    """A model, parents first; body i hangs on body `parent[i]` (-1: ground) by its joint.

    Attributes:
        parent: Number of the body that carries it.
        frame_rotation: Axes of the joint's frame in the parent.
        frame_origin: Its origin there [m].
        back_rotation: Axes of the body in the joint's moved frame.
        back_origin: Origin of the body there [m].
        mass: [kg].
        center: Mass centre, in the body [m].
        inertia: About the mass centre, in the body [kg m^2].
        first: First move of the joint; its last one is before that of the next body.
        kind: `HINGE` or `SLIDE`, of each move.
        axis: Unit vector in the frame that earlier moves carried along.
        free: Number of the independent coordinate that moves it, -1 for none.
        functions: Of the coordinate, of each move.
        gravity: [m/s^2].
    """

    parent: wp.array[int]
    frame_rotation: wp.array[wp.mat33d]
    frame_origin: wp.array[wp.vec3d]
    back_rotation: wp.array[wp.mat33d]
    back_origin: wp.array[wp.vec3d]
    mass: wp.array[wp.float64]
    center: wp.array[wp.vec3d]
    inertia: wp.array[wp.mat33d]
    first: wp.array[int]
    kind: wp.array[int]
    axis: wp.array[wp.vec3d]
    free: wp.array[int]
    functions: PieceTables
    gravity: wp.vec3d


@wp.struct
class Placement:
    """Places and axes of the bodies and joints' moves of all worlds.

    Attributes:
        rotation: Axes of bodies, (num_worlds, num_bodies).
        origin: Origins of bodies [m].
        point: Where the frame of a move is before it [m], (num_worlds, num_moves).
        direction: Its axis.
        turn: Rotation by the coordinate at unit speed.
        shift: Velocity at ground's origin at unit speed.
        slope: Of the function by the coordinate.
        bend: Its second derivative.
    """

    rotation: wp.array2d[wp.mat33d]
    origin: wp.array2d[wp.vec3d]
    point: wp.array2d[wp.vec3d]
    direction: wp.array2d[wp.vec3d]
    turn: wp.array2d[wp.vec3d]
    shift: wp.array2d[wp.vec3d]
    slope: wp.array2d[wp.float64]
    bend: wp.array2d[wp.float64]


@wp.func
def about(axis: wp.vec3d, angle: wp.float64) -> wp.mat33d:
    """Return the rotation about a unit axis [rad]."""
    one = wp.float64(1.0)
    cross = wp.skew(axis)
    half = wp.sin(angle / wp.float64(2.0))
    eye = wp.diag(wp.vec3d(one, one, one))
    return eye + wp.sin(angle) * cross + wp.float64(2.0) * half * half * (cross * cross)


@wp.func
def place(worldid: int, skeleton: Skeleton, values: wp.array2d[wp.float64], row: int, placement: Placement):
    """Place all bodies of a world at the coordinates of a row."""
    one = wp.float64(1.0)
    for body in range(skeleton.parent.shape[0]):
        parent = skeleton.parent[body]
        rotation = wp.diag(wp.vec3d(one, one, one))
        origin = wp.vec3d()
        if parent >= 0:
            rotation = placement.rotation[worldid, parent]
            origin = placement.origin[worldid, parent]
        origin += rotation * skeleton.frame_origin[body]
        rotation = rotation * skeleton.frame_rotation[body]
        for move in range(skeleton.first[body], skeleton.first[body + 1]):
            free = skeleton.free[move]
            x = wp.float64(0.0)
            if free >= 0:
                x = values[row, free]
            curve = evaluated(skeleton.functions, move, x)
            direction = rotation * skeleton.axis[move]
            placement.point[worldid, move] = origin
            placement.direction[worldid, move] = direction
            placement.slope[worldid, move] = curve[1]
            placement.bend[worldid, move] = curve[2]
            if skeleton.kind[move] == HINGE:
                placement.turn[worldid, move] = curve[1] * direction
                placement.shift[worldid, move] = curve[1] * wp.cross(origin, direction)
                rotation = rotation * about(skeleton.axis[move], curve[0])
            else:
                placement.turn[worldid, move] = wp.vec3d()
                placement.shift[worldid, move] = curve[1] * direction
                origin += curve[0] * direction
        placement.origin[worldid, body] = origin + rotation * skeleton.back_origin[body]
        placement.rotation[worldid, body] = rotation * skeleton.back_rotation[body]


@wp.func
def station(worldid: int, body: int, location: wp.vec3d, placement: Placement) -> wp.vec3d:
    """Return where a point of a body is in ground [m]; body -1 is ground."""
    if body < 0:
        return location
    return placement.origin[worldid, body] + placement.rotation[worldid, body] * location


def put(values: Sequence[Any] | np.ndarray, kind: Any) -> wp.array:
    """Return an array on the current device."""
    return wp.array(np.array(values), dtype=kind)


def _ends(counts: Sequence[int]) -> np.ndarray:
    """Return where groups of these sizes begin and end."""
    return np.cumsum([0, *counts], dtype=np.int32)


class Bones:
    """A model on a device.

    Attributes:
        model: The model.
        coordinates: Names of independent coordinates, in the order of columns.
        bodies: Numbers of bodies; ground is -1.
        skeleton: What kernels read.
    """

    @classmethod
    def read(
        cls,
        path: Path,
        device: Any = "cpu",
        markers: Path | None = None,
        function_paths: Path | None = None,
        contact: bool = False,
    ) -> Bones:
        """Return the bones of an OpenSim document.

        Args:
            path: The document, .osim.
            device: Where they are.
            markers: An OpenSim `MarkerSet`, in place of the model's markers of the same names.
            function_paths: A set of `FunctionBasedPath`, in place of the paths of the muscles that it names.
            contact: Whether its contact forces act, beside loads from outside.

        Raises:
            ValueError: A file is not what it should be, or a marker is on no body.
            OSError: A file cannot be read.
        """
        model = read_model(path, markers, function_paths)
        return cls(model if contact else resting(model), device)

    def __init__(self, model: Model, device: Any = "cpu") -> None:
        """Put a model on a device.

        Raises:
            ValueError: The device is not the CPU.
            NotImplementedError: A function of a joint is no piecewise polynomial.
        """
        check_on_cpu("recorded motions", device)
        self.model, self.coordinates = model, tuple(model.independent)
        joints = list(model.joints.values())
        self.bodies = {GROUND: -1} | {joint.child: number for number, joint in enumerate(joints)}
        bodies = [model.bodies[joint.child] for joint in joints]
        moves = [move for joint in joints for move in joint.moves]
        backs = [joint.child_frame.inverse() for joint in joints]
        tensor = [body.inertia[[0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(3, 3) for body in bodies]

        start_warp()
        with wp.ScopedDevice(device):
            self.device = wp.get_device()
            s = self.skeleton = self.values_of([(move.function, move.coordinate) for move in moves])
            s.parent = put([self.bodies[joint.parent] for joint in joints], int)
            s.frame_rotation = put([joint.parent_frame.rotation for joint in joints], wp.mat33d)
            s.frame_origin = put([joint.parent_frame.position for joint in joints], wp.vec3d)
            s.back_rotation = put([back.rotation for back in backs], wp.mat33d)
            s.back_origin = put([back.position for back in backs], wp.vec3d)
            s.mass = put([body.mass for body in bodies], wp.float64)
            s.center = put([body.mass_center for body in bodies], wp.vec3d)
            s.inertia = put(
                [one * (body.mass > 0) for one, body in zip(tensor, bodies, strict=True)], wp.mat33d
            )
            s.first = put(_ends([len(joint.moves) for joint in joints]), int)
            s.kind = put([HINGE if move.kind == "hinge" else SLIDE for move in moves], int)
            s.axis = put([move.axis for move in moves], wp.vec3d)
            s.gravity = wp.vec3d(*model.gravity)

    def values_of(self, functions: Sequence[tuple[Function, str | None]]) -> Skeleton:
        """Return functions of coordinates in the fields `free` and `functions` of a skeleton, by number.

        Raises:
            NotImplementedError: A function is no piecewise polynomial.
        """
        chains, frees = zip(*(self._chain(*one) for one in functions), strict=True) if functions else ((), ())
        with wp.ScopedDevice(self.device):
            return struct_of(Skeleton, free=np.array(frees, int), functions=piece_tables(chains))

    def _chain(self, function: Function, coordinate: str | None) -> tuple[tuple[Pieces, ...], int]:
        """Return a function as functions of an independent coordinate, and the coordinate's number."""
        name, chain = coordinate, curves(function)
        while name is not None and name in self.model.couplers and chain is not None:
            coupler = self.model.couplers[name]
            inner = curves(coupler.function)
            name, chain = coupler.independent, None if inner is None else inner + chain
        if chain is None:
            raise NotImplementedError(
                f"coordinate {coordinate!r} moves a body by a function that is no piecewise polynomial; "
                "motions are computed for polynomials, splines and lines"
            )
        if name is None or name not in self.coordinates:
            at = 0.0 if name is None else self.model.coordinates[name].default
            return (Pieces((0.0,), ((at,),)), *chain), -1
        return chain, self.coordinates.index(name)

    def number(self, body: str) -> int:
        """Return the number of a body.

        Raises:
            ValueError: The model has none of this name.
        """
        if body not in self.bodies:
            raise ValueError(f"body {body!r} unknown; available: {', '.join(self.bodies)}")
        return self.bodies[body]

    def placement(self, num_worlds: int) -> Placement:
        """Allocate where bodies will be."""
        by_body = (num_worlds, len(self.bodies) - 1)
        by_move = (num_worlds, self.skeleton.kind.shape[0])
        with wp.ScopedDevice(self.device):
            return zeros_of(Placement, by_move, rotation=by_body, origin=by_body)

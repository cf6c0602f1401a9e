"""Arrays of mujoco-warp's Data as structs, for kernels of ours that do a part of the engine's step."""

from typing import Any

import warp as wp
from mujoco_warp import JointType
from mujoco_warp._src.types import vec5

JOINTS = {kind.name: int(kind) for kind in JointType}
"""Kinds of joints, as constants of native functions."""


@wp.struct
class ContactPool:
    """The contacts of all worlds; fields are those of the engine's `Contact`, and their number."""

    dist: wp.array[float]
    pos: wp.array[wp.vec3]
    frame: wp.array[wp.mat33]
    includemargin: wp.array[float]
    friction: wp.array[vec5]
    solref: wp.array[wp.vec2]
    solreffriction: wp.array[wp.vec2]
    solimp: wp.array[vec5]
    dim: wp.array[int]
    geom: wp.array[wp.vec2i]
    efc_address: wp.array2d[int]
    worldid: wp.array[int]
    type: wp.array[int]
    geomcollisionid: wp.array[int]
    adhesion: wp.array[float]
    nacon: wp.array[int]


@wp.struct
class ConstraintRows:
    """Constraint rows of all worlds, `Data.efc`; J is dense where `J_rownnz` has no columns."""

    J_rownnz: wp.array2d[int]
    J_rowadr: wp.array2d[int]
    J_colind: wp.array3d[int]
    J: wp.array3d[float]
    type: wp.array2d[int]
    id: wp.array2d[int]
    pos: wp.array2d[float]
    margin: wp.array2d[float]
    D: wp.array2d[float]
    vel: wp.array2d[float]
    aref: wp.array2d[float]
    frictionloss: wp.array2d[float]


@wp.struct
class InertiaRows:
    """Addresses of M's lower triangle: a row holds the dofs above its own, and ends with it."""

    M_rownnz: wp.array[int]
    M_rowadr: wp.array[int]
    M_colind: wp.array[int]


def filled(kind: Any, *sources: Any) -> Any:
    """Return a struct of a kind; each field is the attribute of that name of the first object that has it.

    A field that none has, and that is a struct, is filled likewise.
    """
    struct = kind()
    for name, field in kind.vars.items():
        owner = next((source for source in sources if hasattr(source, name)), None)
        inner = owner is None and isinstance(field.type, type(kind))
        setattr(struct, name, filled(field.type, *sources) if inner else getattr(owner or sources[0], name))
    return struct


def any_of(*arrays: Any) -> bool:
    """Whether anything in these arrays, of Warp or of NumPy, is not zero."""
    return any((array.numpy() if isinstance(array, wp.array) else array).any() for array in arrays)

"""The tendons of a model as a program for `muscle_path_kernel`, and the arrays that it runs on."""

import math
from typing import Any, ClassVar

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.definitions.body import POINT_JOINTS
from myowarp.engine.stage import Launches, Stage
from myowarp.engine.stages.arrays import any_of, filled
from myowarp.engine.stages.muscle_path_kernel import (
    CYLINDER,
    SPHERE,
    STRAIGHT,
    Drive,
    Path,
    PathOp,
    PathProgram,
    Pose,
    Transmission,
    muscle_path,
)
from myowarp.engine.stepped import Stepped
from myowarp.kernels.lanes import block_scratch
from myowarp.kernels.launch import launch
from myowarp.kernels.structs import struct_array

_WRAP = mujoco.mjtWrap
_KINDS = {_WRAP.mjWRAP_SPHERE.value: SPHERE, _WRAP.mjWRAP_CYLINDER.value: CYLINDER}
_SITE, _PULLEY = _WRAP.mjWRAP_SITE.value, _WRAP.mjWRAP_PULLEY.value
_TENDON = mujoco.mjtTrn.mjTRN_TENDON.value
_JOINT = (mujoco.mjtTrn.mjTRN_JOINT.value, mujoco.mjtTrn.mjTRN_JOINTINPARENT.value)


def _drives_others(stepped: Stepped) -> bool:
    """Whether an actuator is neither on a tendon nor on a joint."""
    on_joint = np.isin(stepped.oracle.actuator_trntype, _JOINT)
    return not np.all(on_joint | (stepped.oracle.actuator_trntype == _TENDON))


def _drives_quaternions(stepped: Stepped) -> bool:
    """Whether an actuator is on a ball or free joint."""
    model = stepped.oracle
    on_joint = np.isin(model.actuator_trntype, _JOINT)
    return not np.all(np.isin(model.jnt_type[model.actuator_trnid[on_joint, 0]], POINT_JOINTS))


PATH_OBSTACLES = {
    "no tendons": lambda stepped: not stepped.oracle.ntendon,
    "a tendon that is a sum of joint angles": lambda stepped: bool(
        np.any(stepped.oracle.wrap_type == _WRAP.mjWRAP_JOINT)
    ),
    "an actuator that is neither on a tendon nor on a joint": _drives_others,
    "an actuator on a ball or free joint": _drives_quaternions,
}
"""Features of a model that a path program cannot express."""


class MusclePaths:
    """The tendons and actuators of all worlds, followed in one launch.

    `launch` takes the place of mujoco-warp's `tendon`, `transmission` and actuator velocities. Positions of
    sites, sizes of geoms and gears are read from the model in every launch, so they may differ from world to
    world; the length of what stays within one body is computed here if the sites are those of all worlds.

    Attributes:
        program: The tendons.
        pose: What the kernel reads of `mujoco_warp.Data`.
        transmission: What it writes.
        arrays: All that has a row for each world.
    """

    def __init__(self, host: mujoco.MjModel, model: mjw.Model, data: mjw.Data) -> None:
        """Compile the tendons of `host`, from which `model` was made; all arrays stay those of `data`."""
        self._host, self._fixed_sites = host, model.site_pos.shape[0] == 1
        self._ops: list[tuple[Any, ...]] = []
        self._crossings: list[tuple[int, int]] = []
        self._data, self._dim = data, (data.nworld, host.ntendon) if data.qpos.device.is_cuda else (1, 1)
        moved = [self._moved(actuator) for actuator in range(host.nu)]
        sizes = np.array([len(dofs) for dofs in moved], dtype=int)
        rows = np.cumsum(sizes) - sizes
        paths: list[tuple[Any, ...]] = []
        drives: list[tuple[Any, ...]] = []
        for tendon in range(host.ntendon):
            first_op, first_drive = len(self._ops), len(drives)
            fixed_length = self._compile(tendon)
            pulled = (host.actuator_trntype == _TENDON) & (host.actuator_trnid[:, 0] == tendon)
            drives += [(actuator, rows[actuator], -1, -1) for actuator in np.flatnonzero(pulled)]
            row, num_dofs = host.ten_J_rowadr[tendon], host.ten_J_rownnz[tendon]
            paths.append((fixed_length, first_op, len(self._ops), row, num_dofs, first_drive, len(drives)))
        first_joint_drive = len(drives)
        for actuator in np.flatnonzero(np.isin(host.actuator_trntype, _JOINT)):
            joint = host.actuator_trnid[actuator, 0]
            drives.append((actuator, rows[actuator], host.jnt_qposadr[joint], host.jnt_dofadr[joint]))

        self.program = PathProgram()
        with wp.ScopedDevice(data.qpos.device):
            self.program.paths = struct_array(Path, paths)
            self.program.ops = struct_array(PathOp, self._ops)
            self.program.drives = struct_array(Drive, drives)
            self.program.crossings = wp.array(np.array(self._crossings).reshape(-1, 2), dtype=wp.vec2i)
            self.program.dofs = wp.array(host.ten_J_colind, dtype=int)
        self.program.first_joint_drive, self.program.num_moments = first_joint_drive, int(sizes.sum())
        for name in ("site_pos", "geom_size", "actuator_gear"):
            setattr(self.program, name, getattr(model, name))
        self.pose, self.transmission = filled(Pose, data), filled(Transmission, data)
        model_arrays = self.program.site_pos, self.program.geom_size, self.program.actuator_gear
        self.arrays = *model_arrays, self.pose, self.transmission
        self.scratch = block_scratch(data.qpos.device, *self.arrays)
        columns = np.zeros(data.moment_colind.shape[1], dtype=int)
        columns[: sizes.sum()] = np.concatenate([*moved, ()])
        layout = {"moment_rownnz": sizes, "moment_rowadr": rows, "moment_colind": columns}
        with wp.ScopedDevice(data.qpos.device):
            self._layout = {
                name: wp.array(np.tile(row, (data.nworld, 1)), dtype=int) for name, row in layout.items()
            }
        self.write_layout()

    def write_layout(self) -> None:
        """Say where `actuator_moment` has what."""
        for name, rows in self._layout.items():
            wp.copy(getattr(self._data, name), rows)

    def _moved(self, actuator: int) -> np.ndarray:
        """Return the dofs that an actuator acts on."""
        host, target = self._host, self._host.actuator_trnid[actuator, 0]
        if host.actuator_trntype[actuator] != _TENDON:
            return host.jnt_dofadr[[target]]
        row = host.ten_J_rowadr[target]
        return host.ten_J_colind[row : row + host.ten_J_rownnz[target]]

    def _compile(self, tendon: int) -> float:
        """Append the segments of a tendon; returns the length of those that are fixed [m]."""
        host, scale, fixed_length = self._host, 1.0, 0.0
        at = host.tendon_adr[tendon]
        last = at + host.tendon_num[tendon] - 1
        kinds, objects = host.wrap_type, host.wrap_objid
        while at < last:
            if kinds[at] == _PULLEY:
                scale = 1.0 / host.wrap_prm[at]
                at += 1
            elif kinds[at + 1] == _PULLEY:
                at += 1
            elif kinds[at + 1] == _SITE:
                near, far = objects[at], objects[at + 1]
                if self._fixed_sites and host.site_bodyid[near] == host.site_bodyid[far]:
                    fixed_length += scale * math.dist(host.site_pos[far], host.site_pos[near])
                else:
                    self._add(tendon, STRAIGHT, near, far, scale)
                at += 1
            else:
                kind, side = _KINDS[int(kinds[at + 1])], round(host.wrap_prm[at + 1])
                self._add(tendon, kind, objects[at], objects[at + 2], scale, objects[at + 1], side)
                at += 2
        return fixed_length

    def _add(
        self, tendon: int, kind: int, near: int, far: int, scale: float, geom: int = 0, side: int = -1
    ) -> None:
        """Append a segment between two sites."""
        host = self._host
        near_body, far_body = host.site_bodyid[near], host.site_bodyid[far]
        middle_body = near_body if kind == STRAIGHT else host.geom_bodyid[geom]
        side_body = host.site_bodyid[side] if side >= 0 else 0
        ends = ((near_body, far_body), (near_body, middle_body), (middle_body, far_body))
        links = [self._link(tendon, *bodies) for bodies in ends]
        self._ops.append((kind, near, near_body, far, far_body, geom, side, side_body, scale, *links))

    def _link(self, tendon: int, near_body: int, far_body: int) -> tuple[int, ...]:
        """Append the dofs that move one of two bodies against the other; returns the fields of a `Link`."""
        host, spans = self._host, [len(self._crossings)]
        first = host.ten_J_rowadr[tendon]
        dofs = host.ten_J_colind[first : first + host.ten_J_rownnz[tendon]].tolist()
        near, far = self._chain(near_body), self._chain(far_body)
        for moving in (near - far, far - near):
            self._crossings += [(dof, first + dofs.index(dof)) for dof in sorted(moving)]
            spans.append(len(self._crossings))
        return host.body_rootid[near_body], host.body_rootid[far_body], *spans

    def _chain(self, body: int) -> set[int]:
        """Return the dofs that move a body."""
        host, dofs = self._host, set[int]()
        while body:
            first = host.body_dofadr[body]
            dofs.update(range(first, first + host.body_dofnum[body]))
            body = host.body_parentid[body]
        return dofs

    def launch(self) -> None:
        """Launch `muscle_path`; body poses, `geom_xpos` and `cdof` have to be those of `qpos`."""
        launch(muscle_path, self._dim, self, threads=self._dim[1])


def _has_site_equality(stepped: Stepped) -> bool:
    return bool(np.any(stepped.oracle.eq_objtype == mujoco.mjtObj.mjOBJ_SITE))


class MusclePath(Stage):
    """The paths of all tendons, what actuators make of them, and their velocities.

    It writes all that the engine's stages write and later ones read, in the engine's layout, so muscles,
    limits of tendons, motors and conditions see no difference.
    """

    REPLACES = ("tendon", "transmission", "velocity")
    SPARES = frozenset({"_site_local_to_global"})  # read by paths, else by tasks alone, after the step
    ON_CUDA = True
    OBSTACLES: ClassVar = {
        "the model has paths of its own": lambda stepped: stepped.paths is not None,
        "an equality between sites": _has_site_equality,
        **PATH_OBSTACLES,
    }

    def __init__(self, stepped: Stepped) -> None:
        """Write the program of the paths."""
        super().__init__(stepped)
        if any_of(stepped.model.tendon_damping, stepped.model.tendon_dampingpoly):
            self.replaces = ("tendon", "transmission")  # damping needs the tendons' own velocities
        with wp.ScopedDevice(stepped.device):
            self.paths = MusclePaths(stepped.oracle, stepped.model, stepped.data)

    def launcher(self, stages: tuple[Stage, ...], mask: wp.array | None = None) -> Launches:
        """Return nothing to launch where the launch of the rigid bodies follows the paths, too."""
        if any("kinematics" in stage.replaces for stage in stages):
            return lambda model, data: None
        return self.launch

    def begin(self) -> None:
        """Put the moments' layout right, which the engine's own step on CUDA leaves in any order."""
        if self.paths.transmission.actuator_moment.device.is_cuda:
            self.paths.write_layout()

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Follow all paths."""
        self.paths.launch()

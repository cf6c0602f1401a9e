"""Springs and dampers that a model brings along: OpenSim's limits of coordinates, and its ligaments.

What a model's text says (`osim.bundle.forces`) acts as passive forces, along joints and along the moment
arms of tendons. The damping of limits is written into the model in each step, so that integrators take it in
implicitly. Springs and dampers that stand for these forces in plain MuJoCo are off.
"""

from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.kernels.launch import launch
from myowarp.kernels.structs import struct_array
from myowarp.laws.forces.coordinate_limit import CoordinateLimit, limit_damping, limit_spring
from myowarp.laws.forces.ligament import Ligament, ligament_tension
from myowarp.laws.pieces import PieceTables, evaluated, piece_tables
from myowarp.osim.bundle.forces import PassiveForces


@wp.kernel(enable_backward=False)
def damp_limits(
    # Params:
    limits: wp.array[CoordinateLimit],
    steady: wp.array[float],
    # Data in:
    qpos_in: wp.array2d[float],
    # Out:
    dof_damping: wp.array2d[float],
):
    """dof_damping = that of the joint, and c (S_low + S_high) of each of its limits."""
    worldid = wp.tid()
    for i in range(limits.shape[0]):
        dof_damping[worldid, limits[i].dof] = steady[limits[i].dof]
    for i in range(limits.shape[0]):
        limit = limits[i]
        more = float(limit_damping(limit, wp.float64(qpos_in[worldid, limit.address])))
        dof_damping[worldid, limit.dof] = dof_damping[worldid, limit.dof] + more


@wp.kernel(enable_backward=False)
def push_and_pull(
    # Model:
    ten_J_rownnz: wp.array[int],
    ten_J_rowadr: wp.array[int],
    ten_J_colind: wp.array[int],
    # Params:
    limits: wp.array[CoordinateLimit],
    ligaments: wp.array[Ligament],
    curves: PieceTables,
    # Data in:
    qpos_in: wp.array2d[float],
    ten_length_in: wp.array2d[float],
    ten_velocity_in: wp.array2d[float],
    ten_J_in: wp.array2d[float],
    # Data out:
    qfrc_passive_out: wp.array2d[float],
):
    """qfrc_passive += springs of limits - J' T of ligaments."""
    worldid = wp.tid()
    for i in range(limits.shape[0]):
        limit = limits[i]
        push = float(limit_spring(limit, wp.float64(qpos_in[worldid, limit.address])))
        qfrc_passive_out[worldid, limit.dof] = qfrc_passive_out[worldid, limit.dof] + push
    for i in range(ligaments.shape[0]):
        ligament = ligaments[i]
        tendon = ligament.tendon
        length = wp.float64(ten_length_in[worldid, tendon])
        spring = evaluated(curves, i, length / ligament.resting_length)[0]
        velocity = wp.float64(ten_velocity_in[worldid, tendon])
        tension = float(ligament_tension(ligament, spring, length, velocity))
        first = ten_J_rowadr[tendon]
        for k in range(first, first + ten_J_rownnz[tendon]):
            dof = ten_J_colind[k]
            qfrc_passive_out[worldid, dof] = qfrc_passive_out[worldid, dof] - tension * ten_J_in[worldid, k]


class OwnForces:
    """The springs and dampers of a model, in all worlds."""

    def __init__(self, acting: PassiveForces, host: mujoco.MjModel, model: mjw.Model, data: mjw.Data) -> None:
        """Write tables on the current Warp device, and switch off what stands for these forces in MuJoCo."""
        limits: list[tuple[Any, ...]] = []
        for limit in acting.limits:
            joint = host.joint(limit.joint)
            limits.append((joint.qposadr[0], joint.dofadr[0], *list(vars(limit).values())[1:]))
        self.limits = struct_array(CoordinateLimit, limits)
        self.ligaments = struct_array(
            Ligament,
            [
                (host.tendon(g.tendon).id, g.resting_length, g.dissipation, g.damping)
                for g in acting.ligaments
            ],
        )
        self.curves = piece_tables(ligament.curves for ligament in acting.ligaments)
        springs = [host.tendon(name).id for name in acting.springs]
        for name in ("tendon_stiffness", "tendon_stiffnesspoly") if springs else ():
            values = getattr(model, name)
            numbers = values.numpy()
            numbers[:, springs] = 0.0
            values.assign(numbers)
        damping = model.dof_damping.numpy()
        for name, amount in acting.dampers.items():
            dof = host.joint(name).dofadr[0]
            damping[:, dof] -= amount
        self.steady = wp.array(damping[0], dtype=float)
        model.dof_damping = wp.array(np.tile(damping[0], (data.nworld, 1)), dtype=float)
        self.launch_damping(model, data)

    def launch_damping(self, model: mjw.Model, data: mjw.Data) -> None:
        """Write the damping of limits into `dof_damping`."""
        if self.limits.size:
            launch(damp_limits, data.nworld, self, data, dof_damping=model.dof_damping)

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Add springs of limits and tensions of ligaments to `qfrc_passive`."""
        launch(push_and_pull, data.nworld, self, model, data)

    def launch_implicit(self, model: mjw.Model, data: mjw.Data, directions: wp.array) -> None:
        """Add nothing: what damps is `dof_damping`."""


def forces_of(host: mujoco.MjModel, model: mjw.Model, data: mjw.Data) -> OwnForces | None:
    """Return the forces that a model brings along, on the current Warp device; None: it brings none."""
    acting = PassiveForces.of(host)
    return None if acting is None else OwnForces(acting, host, model, data)

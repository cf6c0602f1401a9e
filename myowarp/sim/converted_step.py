"""Our physics step on a converted model, as its check takes it (`osim.convert.check.engines`)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from myowarp.coordinates.free_coordinates import FreeCoordinates
from myowarp.coordinates.step import step_of
from myowarp.definitions.body import BODIES, Body
from myowarp.definitions.task import Column, RewardTerm, TaskSpec
from myowarp.disk import model_digest
from myowarp.engine.compile import compile_kernels, quiet
from myowarp.osim.bundle.coordinate_map import CoordinateMap
from myowarp.osim.bundle.couplings import couplings
from myowarp.osim.convert.check.engines import OFF, Joints, States
from myowarp.sim.build import compile_scene, stepped_of

Array = np.ndarray

WORLDS = 64
"""States that our step takes at once."""


@dataclass(frozen=True, kw_only=True)
class Nothing(TaskSpec):
    """A body of which nothing is asked."""

    program: ClassVar[type] = type(None)

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add nothing."""

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        """Return nothing."""
        return ()

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        """Return nothing."""
        return ()


class OurStep:
    """MyoWarp in float32 on the CPU: joints that follow do so exactly (`coordinates.free_coordinates`).

    Attributes:
        exact: Whether they do; else equalities hold them, and a line was logged.
    """

    def __init__(self, coordinates: CoordinateMap, spec: mujoco.MjSpec) -> None:
        """Compile the step of a spec, which loses all that does not act here.

        Args:
            coordinates: Of the model.
            spec: The model; it is changed.
        """
        for element in (*spec.actuators, *spec.tendons, *spec.geoms, *spec.meshes):
            spec.delete(element)
        spec.option.disableflags |= OFF
        # What the file says is for MuJoCo C; mujoco-warp has dense Jacobians of up to 60 joints only.
        spec.option.jacobian = mujoco.mjtJacobian.mjJAC_AUTO
        host = spec.compile()
        body = f"check_{model_digest(host)[:16]}"
        if body not in BODIES:
            BODIES.add(body, Body(spec.copy, ()))
        start = tuple(host.key_qpos[0]) if host.nkey else ()
        task = Nothing(
            name="check",
            body=body,
            num_substeps=1,
            horizon=1,
            start_pose=start,
            physics_dt=host.opt.timestep,
            integrator="IMPLICITFAST",
        )
        with quiet():
            self.scene = compile_scene(task, WORLDS, device="cpu")
            step = step_of(stepped_of(self.scene))
            self.step: Callable[[], None] = step.launches()
            compile_kernels(self.step, self.scene.device)
        self.joints = Joints(coordinates, self.scene.oracle)
        self.coordinates = step if isinstance(step, FreeCoordinates) else None
        self.exact = self.coordinates is not None or not couplings(self.scene.oracle)
        self.gravity = self.scene.model.opt.gravity.numpy().copy()  # on the CPU it is the array itself

    def accelerations(self, states: States) -> Array:
        """Return u'', from the physics step."""
        return np.concatenate([self.joints.coordinates(part) for part, _ in self._stepped(states)])

    def inertia(self, values: Array) -> Array | None:
        """Return the mass matrix along the coordinates, as the step has it."""
        if not self.exact:
            return None
        still = np.zeros_like(values)
        found = np.concatenate([M for _, M in self._stepped(States(values, still, still))])
        joints, order = self.joints, np.argsort(np.argsort(self.joints.joint))
        M, scale = np.zeros((len(values), len(joints.moving), len(joints.moving))), joints.scale
        places = np.flatnonzero(joints.moving)
        M[:, places[:, None], places] = found[:, order][:, :, order] * scale[:, None] * scale
        return M

    def _stepped(self, states: States) -> list[tuple[Array, Array]]:
        """Return qacc and the mass matrix along free joints, in their order, of all states in parts."""
        data, parts, rows = self.scene.data, [], self.joints.state(states)
        self.scene.model.opt.gravity.assign(self.gravity * states.gravity)
        for first in range(0, len(states.values), WORLDS):
            chosen = np.minimum(np.arange(first, first + WORLDS), len(states.values) - 1)
            for array, row in zip((data.qpos, data.qvel, data.qfrc_applied), rows, strict=True):
                array.assign(row[chosen])
            data.qacc_warmstart.zero_()
            with quiet():
                self.step()
            count = min(WORLDS, len(states.values) - first)
            parts.append((data.qacc.numpy()[:count].astype(float), self._inertia(rows[0][chosen])[:count]))
        return parts

    def _inertia(self, qpos: Array) -> Array:
        """Return the mass matrix of the last step, from qpos (WORLDS, nv); shape (WORLDS, free, free)."""
        if self.coordinates is not None:
            packed = self.coordinates.free.data.M.numpy().reshape(WORLDS, -1)
            number = self.joints.joint.size
            row, column = np.tril_indices(number)
        else:
            model, packed = self.scene.model, self.scene.data.M.numpy().reshape(WORLDS, -1)
            number = self.scene.oracle.nv
            row = np.repeat(np.arange(number), model.M_rownnz.numpy())
            packed, column = packed[:, : len(row)], model.M_colind.numpy()[: len(row)]
        M = np.zeros((WORLDS, number, number))
        M[:, row, column] = M[:, column, row] = packed[:, : len(row)]
        triples = None if self.coordinates is None else self.coordinates.triples
        if triples is None:
            return M
        # The step has angular velocities w = A u' of these hinges (`coordinates.hinge_triples`).
        A = np.tile(np.eye(number), (WORLDS, 1, 1))
        for (first, _, third), address, zero in zip(
            triples.coordinate.numpy(), triples.address.numpy(), triples.zero.numpy(), strict=True
        ):
            tilt = qpos[:, address[1]] - zero[1]
            A[:, first, third], A[:, third, third] = np.sin(tilt), np.cos(tilt)
        return A.transpose(0, 2, 1) @ M @ A

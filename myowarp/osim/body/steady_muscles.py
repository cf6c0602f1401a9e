"""Muscles of a document held steady: tendon force where fiber and tendon agree, of many frames at once.

The law is that of `laws.muscles.hill_law`, in float64, with the velocity of the path and a tendon that
keeps its length. Classes that the law does not know, with curves of splines, are solved in NumPy.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from myowarp.kernels.batching import batched
from myowarp.kernels.launch import launch
from myowarp.kernels.structs import struct_of
from myowarp.laws.curves import CurveTables64
from myowarp.laws.muscles.hill_law import (
    MILLARD,
    OPENSIM_LAWS,
    SCHUTTE_CLASS,
    HillMuscle64,
    along_tendon,
    equilibrium,
    fiber_pull,
    steady_equilibrium,
)
from myowarp.laws.muscles.hill_parameters import COMMON, DEFAULTS, LAWS, hill_parameters
from myowarp.osim.body.hill_muscle import HillMuscle, known

KINDS = {kind: law for kind, law in OPENSIM_LAWS.items() if kind != SCHUTTE_CLASS}
"""Law of each class that is solved on the device."""

TOLERANCE = wp.constant(wp.float64(1e-12))
"""A step of Newton's method [lengths of fiber and tendon] that changes nothing."""

wp.set_module_options({"enable_backward": False})


@wp.kernel(enable_backward=False)
def steady_muscles(
    # Params:
    muscles: wp.array[HillMuscle64],
    tables: CurveTables64,
    slack: wp.array2d[wp.float64],
    # In:
    column: wp.array[int],
    activation: wp.array2d[wp.float64],
    length: wp.array2d[wp.float64],
    velocity: wp.array2d[wp.float64],
    before: wp.array2d[wp.float64],
    per_step: wp.float64,
    # Out:
    along: wp.array2d[wp.float64],
    pull: wp.array2d[wp.vec2d],
):
    """(F_max f_T, its slope by the path's velocity) and z in equilibrium at (a, L, V).

    Held steady, the force is 0 where the path is shorter than tendon and fiber.

    The slope is 0 in an elastic tendon that is held steady. With steps a second above 0 the fiber comes from
    its length before, and the tendon stretches meanwhile.
    Newton's method begins at the z that is there, which is 0 where none is known.
    """
    worldid, i = wp.tid()
    k = column[i]
    zero = wp.float64(0.0)
    m = muscles[i]
    m.tendon_slack_length *= slack[batched(worldid, slack.shape[0]), k]
    a, path = activation[worldid, k], length[worldid, k]
    free = path - m.tendon_slack_length
    z = wp.max(free, m.shortest_fiber)
    force = zero
    by_velocity = zero
    if m.rigid == 1:
        fiber_force = fiber_pull(m, tables, a, wp.float64(1.0), z, velocity[worldid, k], zero, zero)
        force = fiber_force[0]
        by_velocity = fiber_force[2]
    elif per_step > zero:
        fiber = before[worldid, k]
        start = along_tendon(m, fiber) + velocity[worldid, k] / per_step
        found = equilibrium(m, tables, a, wp.float64(1.0), path, zero, fiber, per_step, start, TOLERANCE)
        z, force = found[0], found[1]
        if found[2] > zero and found[3] > zero:
            by_velocity = found[2] * found[3] / (found[2] + found[3]) / per_step
    elif free > m.shortest_fiber:
        near = along[worldid, k]
        found = steady_equilibrium(m, tables, a, wp.float64(1.0), path, velocity[worldid, k], near, TOLERANCE)
        z, force = found[0], found[1]
    along[worldid, k] = z
    pulls = free > m.shortest_fiber or (per_step > zero and m.rigid == 0)
    if not pulls or force <= zero:
        force = zero
        by_velocity = zero
    pull[worldid, k] = m.max_isometric_force * wp.vec2d(force, by_velocity)


class SteadyMuscles:
    """Muscles on a device.

    Attributes:
        muscles: Their parameters, in the order of columns, each with equations that are known.
    """

    def __init__(self, muscles: Iterable[HillMuscle], device: Any = "cpu") -> None:
        """Put muscles on a device."""
        self.muscles = [known(muscle)[0] for muscle in muscles]
        self._device = wp.get_device(device)
        laws = [KINDS.get(muscle.kind, -1) for muscle in self.muscles]
        self._column = np.array([k for k, law in enumerate(laws) if law >= 0], np.int32)
        self._others = [k for k, law in enumerate(laws) if law < 0]
        rows = np.zeros(len(laws), HillMuscle64.numpy_dtype())
        tables, spans = np.zeros((1, 2, 2)), np.zeros((1, 2))
        for law in set(laws) - {-1}:
            own = [k for k in self._column if laws[k] == law]
            values = {name: np.array([self.muscles[k].values.get(name, default) for k in own])
                      for name, default in _properties(law).items()}  # fmt: skip
            found, *curves = hill_parameters(law, values, real=wp.float64)
            rows[own] = found[0]
            if law == MILLARD:
                tables, spans = curves
        with wp.ScopedDevice(self._device):
            self._muscles = wp.array(rows[self._column], dtype=HillMuscle64)
            self._tables = struct_of(CurveTables64, values=tables, spans=spans)

    def at(
        self,
        activation: ArrayLike,
        length: np.ndarray,
        velocity: np.ndarray,
        slack: ArrayLike = 1.0,
        near: np.ndarray | None = None,
        before: np.ndarray | None = None,
        dt: float = 0.0,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the force in each tendon [N], the fiber's length along it [m], and the slope of the force.

        The slope is that by the path's velocity [N s/m], of a step, and of rigid tendons.

        Args:
            activation: [1], which broadcasts to (frames, muscles).
            length: Of muscle and tendon [m], shape (frames, muscles).
            velocity: Its velocity [m/s], lengthening > 0.
            slack: Factors on tendon slack lengths, which broadcast to (frames, muscles).
            near: Lengths of fibers to begin at, of another activation.
            before: Fiber lengths from which a step of `dt` leads here [m]; None: muscles are held steady.
                Tendons of classes with splines do not stretch meanwhile.
            dt: Of the step [s].
        """
        active = np.broadcast_to(np.asarray(activation, float), length.shape)
        factor = np.atleast_2d(np.asarray(slack, float))
        factor = np.broadcast_to(factor, (len(factor), length.shape[1]))
        with wp.ScopedDevice(self._device):
            along = wp.array(np.zeros(length.shape) if near is None else near, dtype=wp.float64)
            pull = wp.zeros(length.shape, dtype=wp.vec2d)
            launch(
                steady_muscles,
                (len(length), len(self._column)),
                muscles=self._muscles,
                tables=self._tables,
                slack=wp.array(factor, dtype=wp.float64),
                column=wp.array(self._column, dtype=int),
                activation=wp.array(active, dtype=wp.float64),
                length=wp.array(length, dtype=wp.float64),
                velocity=wp.array(velocity, dtype=wp.float64),
                before=wp.array(length if before is None else before, dtype=wp.float64),
                per_step=0.0 if before is None else 1.0 / dt,
                along=along,
                pull=pull,
            )
            fiber, force, slope = along.numpy(), pull.numpy()[..., 0].copy(), pull.numpy()[..., 1].copy()
        for k in self._others:
            muscle = self.muscles[k]
            own = np.broadcast_to(factor[:, k], len(length)) * muscle.values["tendon_slack_length"]
            fiber[:, k], force[:, k] = muscle.steady(active[:, k], length[:, k], velocity[:, k], own)
            force[:, k] *= muscle.values["max_isometric_force"]
        return force, fiber, slope


def _properties(law: int) -> dict[str, float]:
    """Return the properties that a law reads, with what stands for those that a muscle has not."""
    own = {name: default for name, (_, default, _, _) in LAWS[law].items()}
    return {**dict.fromkeys(COMMON, 0.0), **own, **DEFAULTS[law]}

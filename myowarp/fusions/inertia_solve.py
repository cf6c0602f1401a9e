"""The integrator's linear system along the kinematic tree, see `kernels/inertia_solve.py`."""

import contextlib
from collections.abc import Iterator
from unittest import mock

import mujoco_warp as mjw
import warp as wp
from mujoco_warp._src import smooth

from myowarp.fusions import FUSIONS, Fusion
from myowarp.kernels.engine_arrays import InertiaRows, filled
from myowarp.kernels.inertia_solve import solve_inertia
from myowarp.scene import Scene


@FUSIONS.register("inertia_solve")
class InertiaSolve(Fusion):
    """(M + h D) qacc = force by one sparse factorisation; the engine's are dense."""

    @classmethod
    def obstacle(cls, scene: Scene) -> str | None:
        """Return why the system cannot be solved so, None if it can."""
        model = scene.model
        if not scene.device.is_cpu:
            return "the device is not the CPU"
        if all(tile.elemid.size == 0 for tile in model.M_tiles):
            return "the matrix has small blocks only, for which the engine has unrolled code"
        address, size = model.M_rowadr.numpy(), model.M_rownnz.numpy()
        rows = [model.M_colind.numpy()[a : a + n].tolist() for a, n in zip(address, size, strict=True)]
        if any(rows[dof] != row[: i + 1] for row in rows for i, dof in enumerate(row)):
            return "a row of the inertia matrix does not begin with the rows above it"
        return None

    def __init__(self, scene: Scene) -> None:
        """Allocate the factor."""
        self._factor = wp.zeros_like(scene.data.M)

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Solve by our kernel wherever nobody reads the engine's factor afterwards."""
        stock = smooth.factor_solve_i

        def factor_solve(
            model: mjw.Model,
            data: mjw.Data,
            M: wp.array2d[float],
            L: wp.array2d[float],
            D: wp.array2d[float],
            x: wp.array2d[float],
            y: wp.array2d[float],
        ) -> None:
            if L is data.qLD or M.shape != self._factor.shape:
                stock(model, data, M, L, D, x, y)
                return
            inertia, factor = filled(InertiaRows, model), self._factor
            wp.launch(solve_inertia, dim=data.nworld, inputs=[inertia, M, y], outputs=[factor, x])

        with mock.patch.object(smooth, "factor_solve_i", factor_solve):
            yield

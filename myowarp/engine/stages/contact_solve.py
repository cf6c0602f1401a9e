"""The constraint solver as one kernel, see `kernels/contact_solve.py`."""

import contextlib
from collections.abc import Iterator
from unittest import mock

import mujoco_warp as mjw
import warp as wp
from mujoco_warp._src import solver
from mujoco_warp._src.types import DisableBit, EnableBit, IntegratorType

from myowarp.engine.stages import FUSIONS, Fusion
from myowarp.engine.stages.arrays import ConstraintRows, InertiaRows, filled
from myowarp.engine.stages.contact_solve_kernel import (
    VECTOR,
    RowCounts,
    SolverOptions,
    SolverResult,
    solver_kernel,
)
from myowarp.spec.scene import Scene

MAX_DOFS = 40
MAX_ROWS = 512  # with MAX_DOFS 100 KB of stack


@FUSIONS.register("contact_solve")
class ContactSolve(Fusion):
    """Newton's method for all constraints of a world in one thread; `Data.qacc_smooth` is not computed."""

    @classmethod
    def obstacle(cls, scene: Scene) -> str | None:
        """Return why the solver cannot be used, None if it can."""
        opt, data = scene.model.opt, scene.data
        obstacles = {
            "the device is not the CPU": not scene.device.is_cpu,
            "the solver is not Newton's": opt.solver != mjw.SolverType.NEWTON,
            "the friction cone is not pyramidal": opt.cone != mjw.ConeType.PYRAMIDAL,
            "the integrator is the discrete one": opt.integrator == IntegratorType.DISCRETE,
            "noslip iterations are on": opt.noslip_iterations > 0,
            "sleeping is on": bool(opt.enableflags & EnableBit.SLEEP),
            "warm starts are off": bool(opt.disableflags & DisableBit.WARMSTART),
            "the solver makes no iterations": opt.iterations < 1,
            f"degrees of freedom are not 1 to {MAX_DOFS}": not 0 < scene.model.nv <= MAX_DOFS,
            f"constraint rows are not 1 to {MAX_ROWS}": not 0 < data.njmax <= MAX_ROWS,
        }
        return next((reason for reason, holds in obstacles.items() if holds), None)

    def __init__(self, scene: Scene) -> None:
        self._options = scene.model.opt

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Have `mujoco_warp.step` launch our solver; it needs no acceleration without constraints."""
        with (
            mock.patch.object(solver, "solve", launch_solve),
            mock.patch.object(self._options, "run_qacc_smooth", False),
        ):
            yield


def launch_solve(model: mjw.Model, data: mjw.Data) -> None:
    """Solve the constraints of all worlds, as `mujoco_warp._src.solver.solve` does."""
    inertia, options = filled(InertiaRows, model), filled(SolverOptions, model.opt)
    counts, rows, result = filled(RowCounts, data), filled(ConstraintRows, data.efc), SolverResult()
    result.niter, result.overflow = data.solver_niter, data.overflow
    result.force, result.state, result.Ma = data.efc.force, data.efc.state, data.efc.Ma
    solve_constraints = solver_kernel(-(-model.nv // VECTOR) * VECTOR)
    wp.launch(
        solve_constraints,
        dim=data.nworld,
        inputs=[inertia, options, data.M, data.qfrc_smooth, data.qacc_warmstart, counts, rows],
        outputs=[data.qacc, data.qfrc_constraint, result],
    )

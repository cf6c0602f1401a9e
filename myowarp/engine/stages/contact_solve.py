"""Constraint forces: Newton's method, a world at a time or worlds in lanes, on the CPU device.

Acceleration `x` minimises `1/2 (x - a)' M (x - a) + sum_i s_i(J_i x - aref_i)`, with `a` the acceleration
without constraints and `s_i` quadratic where row i pulls and linear or zero where it does not (MuJoCo
documentation, Computation, "Primal problem"). The steps and stopping tests are mujoco-warp's; its dozen
launches an iteration become plain loops over small dense arrays on the stack (`contact_solve.cpp`). The
Hessian changes only by the rows whose state flipped, and is factorised again only then. The line search is
exact, in double precision.

Where the rows are ours, too, a contact is its frame: what normal, tangents and turns are along the dofs of
its two bodies' chains is computed here, once. Edges of the friction pyramid are sums of them: their values,
their forces, and their share of the Hessian, J' C J with a small C.

Where every row is a limit of one dof, as in a body that touches nothing, the Hessian has the zeros of M, and
worlds go through the same method in lanes (`limit_solve.cpp`): there are no rows to multiply by.
"""

from functools import cache, partial
from pathlib import Path
from typing import Any, ClassVar

import mujoco_warp as mjw
import warp as wp
from mujoco_warp import DisableBit, OverflowType

from myowarp.engine.stage import Launches, Stage
from myowarp.engine.stages.arrays import ConstraintRows, ContactPool, InertiaRows, filled
from myowarp.engine.stages.constraint_rows import frames_in_solver
from myowarp.engine.stages.contact_rows import FRAME, KinematicTree
from myowarp.engine.stepped import Stepped
from myowarp.kernels.lanes import at_namespace_level, block_scratch, native_kernel
from myowarp.kernels.launch import launch

VECTOR = 8  # floats that one instruction adds
MAX_STACK = 2**20  # bytes that a world may take; threads have 8 MB on Linux, and more on macOS
SOURCE = Path(__file__).with_suffix(".cpp").read_text()
FILES = tuple(map(Path(__file__).with_name, ("factor.cpp", "limit_solve.cpp")))
FLAGS = {
    "ITERATIONS_OVERFLOW": int(OverflowType.ITERATIONS),
    "LINE_SEARCH_OVERFLOW": int(OverflowType.LS_ITERATIONS),
}


@wp.struct
class SolverOptions:
    """When to stop."""

    tolerance: wp.array[float]
    iterations: int
    ls_iterations: int


@wp.struct
class RowCounts:
    """Rows of each world: equalities, friction losses, limits, all."""

    ne: wp.array[int]
    nf: wp.array[int]
    nl: wp.array[int]
    nefc: wp.array[int]


@wp.struct
class SolverResult:
    """Results of the solve in `Data`."""

    niter: wp.array[int]
    overflow: wp.array[int]
    force: wp.array2d[float]
    state: wp.array2d[int]
    Ma: wp.array2d[float]


def solver_result(data: mjw.Data) -> Any:
    """Return where a solve leaves its results."""
    result = SolverResult()
    result.niter, result.overflow = data.solver_niter, data.overflow
    result.force, result.state, result.Ma = data.efc.force, data.efc.state, data.efc.Ma
    return result


@wp.struct
class MovingContacts:
    """Sources of the frames of contacts; `in_solver`: rows of contacts are last, and have no Jacobian."""

    tree: KinematicTree
    contacts: ContactPool
    subtree_com: wp.array2d[wp.vec3]
    cdof: wp.array2d[wp.spatial_vector]
    in_solver: bool


@wp.struct
class InLanes:
    """Memory of a block, the limits of each world's dofs, and which worlds are solved with them alone."""

    scratch: wp.array[float]
    limits: wp.array2d[wp.vec2]
    solved: wp.array[bool]


LIMITS_ALONE = """{
    const int n = qacc_out.shape[1];
    auto* of_worlds = (lanes::Limit*)memory.limits.data;
    for (int world = 0; world < memory.solved.shape[0]; ++world)
        memory.solved.data[world] = lanes::has_limits_only(counts, rows, world, n, of_worlds + world * n);
    lanes::for_blocks(qacc_out.shape[0], memory.solved.data, memory.scratch.data, [&](auto& block) {
        lanes::solve_limits_block(block, inertia, options, M_in, qfrc_smooth_in, qacc_warmstart_in, of_worlds,
                                  rows, qacc_out, qfrc_constraint_out, result);
    });
}
"""
"""Solves the worlds whose rows couple no dofs, a block after the other, and notes which."""


@cache
def solver_kernel(width: int) -> Any:
    """Return the kernel `solve_constraints` for at most `width` degrees of freedom, a multiple of VECTOR.

    It walks through the worlds by itself: a call for each would copy its arguments, which takes long.
    """
    constants = {"WIDTH": width, **FLAGS}

    @native_kernel(
        at_namespace_level(*FILES, **FLAGS),
        does="".join(f"constexpr int {name} = {value};\n" for name, value in constants.items())
        + LIMITS_ALONE
        + "auto &tree = moving.tree; auto &contacts = moving.contacts;\n"
        + "auto &subtree_com = moving.subtree_com; auto &cdof = moving.cdof;\n"
        + f"{FRAME}for (int world = 0; world < memory.solved.shape[0]; ++world) {{\n{SOURCE}}}\n",
        module=f"{__name__}.of_{width}_dofs",
    )
    def solve_constraints(
        # Params:
        inertia: InertiaRows,
        options: SolverOptions,
        # Data in:
        M_in: wp.array2d[float],
        qfrc_smooth_in: wp.array2d[float],
        qacc_warmstart_in: wp.array2d[float],
        # In:
        memory: InLanes,
        counts: RowCounts,
        rows: ConstraintRows,
        moving: MovingContacts,
        # Data out:
        qacc_out: wp.array2d[float],
        qfrc_constraint_out: wp.array2d[float],
        # Out:
        result: SolverResult,
    ):
        """M qacc = qfrc_smooth + J' force, force = -s'(J qacc - aref)."""

    return solve_constraints


@wp.func_native("""
    const float *one = &wp::index(applied, world, 0), *two = &wp::index(passive, world, 0);
    const float *three = &wp::index(actuator, world, 0), *minus = &wp::index(bias, world, 0);
    float* to = &wp::index(sum, world, 0);
    for (int dof = 0; dof < sum.shape[1]; ++dof)
        to[dof] = two[dof] - minus[dof] + one[dof] + three[dof];
""")
def sum_of_world(
    world: int,
    applied: wp.array2d[float],
    passive: wp.array2d[float],
    actuator: wp.array2d[float],
    bias: wp.array2d[float],
    sum: wp.array2d[float],
):
    """Sum the forces of a world, by whole vectors."""
    ...


@wp.kernel(enable_backward=False)
def sum_forces(
    # Data in:
    qfrc_applied_in: wp.array2d[float],
    qfrc_passive_in: wp.array2d[float],
    qfrc_actuator_in: wp.array2d[float],
    qfrc_bias_in: wp.array2d[float],
    # Data out:
    qfrc_smooth_out: wp.array2d[float],
):
    """qfrc_smooth = qfrc_passive - qfrc_bias + qfrc_applied + qfrc_actuator."""
    worldid = wp.tid()
    sum_of_world(worldid, qfrc_applied_in, qfrc_passive_in, qfrc_actuator_in, qfrc_bias_in, qfrc_smooth_out)


def width_of(num_dofs: int) -> int:
    """Return a number of degrees of freedom in whole vectors."""
    return -(-num_dofs // VECTOR) * VECTOR


def stack_of(num_dofs: int, num_rows: int) -> int:
    """Return the bytes of stack that a world takes: three matrices, J, ten vectors of its rows, frames."""
    width = width_of(num_dofs)
    return 4 * (3 * width * width + num_rows * (width + 10 + 16 + width // 32))


class ContactSolve(Stage):
    """Newton's method for all constraints of a world in one thread.

    `Data.qacc_smooth` is not computed. Forces in `Data.xfrc_applied` do not act: the simulation applies none.
    """

    REPLACES = ("acceleration", "solve")
    OBSTACLES: ClassVar = {
        "the solver is not Newton's": lambda stepped: stepped.model.opt.solver != mjw.SolverType.NEWTON,
        "the friction cone is not pyramidal": lambda stepped: (
            stepped.model.opt.cone != mjw.ConeType.PYRAMIDAL
        ),
        "noslip iterations are on": lambda stepped: stepped.model.opt.noslip_iterations > 0,
        "warm starts are off": lambda stepped: bool(stepped.model.opt.disableflags & DisableBit.WARMSTART),
        "the solver makes no iterations": lambda stepped: stepped.model.opt.iterations < 1,
        "nothing moves, or no row has a place": lambda stepped: not (stepped.model.nv and stepped.data.njmax),
        "matrices and rows are more than a thread's stack holds": lambda stepped: (
            stack_of(stepped.model.nv, stepped.data.njmax) > MAX_STACK
        ),
    }

    def __init__(self, stepped: Stepped) -> None:
        """Allocate the memory of a block, and of what is noted of worlds."""
        super().__init__(stepped)
        data = stepped.data
        self.memory = InLanes()
        self.memory.solved = wp.zeros(data.nworld, dtype=bool, device=stepped.device)
        self.memory.limits = wp.empty(data.qvel.shape, dtype=wp.vec2, device=stepped.device)
        self.memory.scratch = block_scratch(stepped.device, data.M, data.M, data.efc.Ma, *[data.qvel] * 16)

    def launcher(self, stages: tuple[Stage, ...], mask: wp.array | None = None) -> Launches:
        """Return a launch that computes the frames of contacts, if the rows are ours."""
        return partial(self.launch, in_solver=frames_in_solver(stages))

    def launch(self, model: mjw.Model, data: mjw.Data, in_solver: bool = False) -> None:
        """Sum the forces, then solve the constraints of all worlds."""
        launch(sum_forces, data.nworld, data)
        self.solve(model, data, in_solver)

    def solve(self, model: mjw.Model, data: mjw.Data, in_solver: bool = False) -> None:
        """Solve the constraints of all worlds, as `mujoco_warp.solve` does; see `MovingContacts`."""
        moving = MovingContacts()
        moving.tree, moving.contacts = filled(KinematicTree, model), filled(ContactPool, data.contact, data)
        moving.subtree_com, moving.cdof, moving.in_solver = data.subtree_com, data.cdof, in_solver
        solve_constraints = solver_kernel(width_of(model.nv))
        launch(
            solve_constraints,
            1,
            data,
            self,
            inertia=filled(InertiaRows, model),
            options=filled(SolverOptions, model.opt),
            counts=filled(RowCounts, data),
            rows=filled(ConstraintRows, data.efc),
            moving=moving,
            result=solver_result(data),
        )

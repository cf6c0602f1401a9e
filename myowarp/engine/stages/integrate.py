"""The end of a physics step, worlds in lanes: implicit velocities, positions, time, on the CPU device.

(M - h dF/dv) qacc = Ma, with F the damping of joints and, for MuJoCo's integrator `implicitfast`, the
actuators (MuJoCo documentation, Computation, "Numerical integration"). A dof's row of M holds nothing but the
dofs that carry it, and elimination from the tips on fills in nothing more (Featherstone, Rigid Body Dynamics
Algorithms, 2008, section 6.5): for a hand a tenth of the operations of a dense Cholesky factorisation. What
an actuator couples across branches of the tree has no place in M and stays explicit, as in the engine.
"""

from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp import BiasType, DisableBit, GainType, IntegratorType, OverflowType
from mujoco_warp._src.forward import _advance, implicit_free_body
from mujoco_warp._src.types import vec10

from myowarp.engine.stage import Stage
from myowarp.engine.stages.arrays import JOINTS, InertiaRows, any_of, filled
from myowarp.engine.stepped import Stepped
from myowarp.kernels.lanes import at_namespace_level, block_scratch, native_kernel
from myowarp.kernels.launch import launch

FILES = tuple(map(Path(__file__).with_name, ("factor.cpp", "integrate.cpp")))
FLAGS = {
    "AFFINE": BiasType.AFFINE,
    "NEFC_OVERFLOW": OverflowType.NEFC,
    "BROADPHASE_OVERFLOW": OverflowType.BROADPHASE,
    "NARROWPHASE_OVERFLOW": OverflowType.NARROWPHASE,
}
CONSTANTS = JOINTS | {name: int(value) for name, value in FLAGS.items()}


@wp.struct
class Parts:
    """Parts of a launch; the two are separate where the engine has to do something between them.

    Attributes:
        timestep: [s], shape (1,) or (num_worlds,).
        implicit_actuators: Whether actuators are integrated implicitly too.
        solve: Whether to write the accelerations.
        advance: Whether to move the state with them.
    """

    timestep: wp.array[float]
    implicit_actuators: bool
    solve: bool
    advance: bool


@wp.struct
class VelocityForces:
    """Forces that depend on velocity; fields are those of the engine's `Model` and `Data`."""

    dof_damping: wp.array2d[float]
    dof_dampingpoly: wp.array2d[wp.vec2]
    actuator_biastype: wp.array[int]
    actuator_biasprm: wp.array2d[vec10]
    actuator_forcelimited: wp.array[bool]
    actuator_forcerange: wp.array2d[wp.vec2]
    M_elemid: wp.array2d[int]
    body_dofadr: wp.array[int]
    body_freeadr: wp.array[int]
    actuator_force: wp.array2d[float]
    moment_rownnz: wp.array2d[int]
    moment_rowadr: wp.array2d[int]
    moment_colind: wp.array2d[int]
    actuator_moment: wp.array2d[float]


@wp.struct
class JointAddresses:
    """Addresses of the joints' state; fields are those of the engine's `Model`."""

    jnt_type: wp.array[int]
    jnt_qposadr: wp.array[int]
    jnt_dofadr: wp.array[int]


@wp.struct
class Usage:
    """Used and allocated sizes of the engine's arrays; fields are those of `Data`."""

    nefc: wp.array[int]
    ncollision: wp.array[int]
    nacon: wp.array[int]
    njmax: int
    naconmax: int


@wp.struct
class StepState:
    """Results of a step; fields are those of the engine's `Data`."""

    qpos: wp.array2d[float]
    qvel: wp.array2d[float]
    qacc_warmstart: wp.array2d[float]
    time: wp.array[float]
    overflow: wp.array[int]


@native_kernel(
    at_namespace_level(*FILES, **CONSTANTS),
    does="""
    lanes::for_blocks(qacc_in.shape[0], nullptr, scratch.data, [&](auto& block) {
        lanes::end_block(block, parts, inertia, joints, M_in, Ma_in, qacc_in, forces, usage, acceleration,
                         state);
    });
    """,
)
def integrate(
    # Model:
    inertia: InertiaRows,
    joints: JointAddresses,
    # Params:
    parts: Parts,
    # Data in:
    M_in: wp.array2d[float],
    Ma_in: wp.array2d[float],
    qacc_in: wp.array2d[float],
    # In:
    scratch: wp.array[float],
    forces: VelocityForces,
    usage: Usage,
    # Out:
    acceleration: wp.array2d[float],
    state: StepState,
):
    """acceleration = (M - h dF/dv)^-1 Ma; qvel += h acceleration; qpos += h qvel; time += h."""


def _is_implicit(stepped: Stepped) -> bool:
    return bool(stepped.model.opt.integrator == IntegratorType.IMPLICITFAST)


def _has_explicit_forces(stepped: Stepped) -> bool:
    """Whether damping, or what `implicitfast` takes in of actuators, is switched off."""
    off = DisableBit.DAMPER | (DisableBit.ACTUATION if _is_implicit(stepped) else DisableBit.EULERDAMP)
    return bool(stepped.model.opt.disableflags & off)


def _rows_begin_alike(model: mjw.Model) -> bool:
    """Whether each row of M is the row of the dof above and its own dof."""
    address, size = model.M_rowadr.numpy(), model.M_rownnz.numpy()
    rows = [model.M_colind.numpy()[a : a + n].tolist() for a, n in zip(address, size, strict=True)]
    return all(rows[dof] == row[: i + 1] for row in rows for i, dof in enumerate(row))


def _where_implicit(holds: Callable[[mjw.Model], bool]) -> Callable[[Stepped], bool]:
    """Return a condition on models that counts where forces are integrated implicitly."""
    return lambda stepped: _is_implicit(stepped) and holds(stepped.model)


VELOCITY_GAINS = (GainType.AFFINE, GainType.MUSCLE, GainType.DCMOTOR)
UNKNOWN_SLOPES = {
    "a gain may depend on velocity": _where_implicit(
        lambda model: any_of(np.isin(model.actuator_gaintype.numpy(), VELOCITY_GAINS))
    ),
    "there are DC motors": _where_implicit(
        lambda model: any_of(model.actuator_biastype.numpy() == BiasType.DCMOTOR)
    ),
    "forces are limited at tendons or joints": _where_implicit(
        lambda model: any_of(model.tendon_actfrclimited, model.jnt_actfrclimited)
    ),
    "tendons are damped": _where_implicit(
        lambda model: any_of(model.tendon_damping, model.tendon_dampingpoly)
    ),
    "a fluid resists": _where_implicit(lambda model: bool(model.has_fluid)),
}
"""Forces whose derivative by velocity the engine takes in and we do not compute."""


class Integrate(Stage):
    """The integrators Euler and `implicitfast`.

    Attributes:
        acceleration: What the state is advanced with [rad/s^2, m/s^2], shape (num_worlds, nv).
    """

    REPLACES = ("integrate",)
    OBSTACLES: ClassVar = {
        "the integrator is neither Euler nor implicitfast": lambda stepped: (
            stepped.model.opt.integrator not in (IntegratorType.EULER, IntegratorType.IMPLICITFAST)
        ),
        "nothing moves": lambda stepped: stepped.model.nv == 0,
        "a row of the inertia matrix does not begin with the rows above it": lambda stepped: (
            not _rows_begin_alike(stepped.model)
        ),
        "forces are integrated explicitly": _has_explicit_forces,
        "actuators damp joints or tendons": lambda stepped: any_of(
            stepped.model.actuator_damping, stepped.model.actuator_dampingpoly
        ),
        "there are plastic springs": lambda stepped: bool(stepped.model.nplastic),
        "overflows are to be printed": lambda stepped: bool(stepped.model.opt.warn_overflow),
        **UNKNOWN_SLOPES,
    }

    def __init__(self, stepped: Stepped) -> None:
        """Allocate the accelerations; `Data.qacc` stays the solver's."""
        super().__init__(stepped)
        data = stepped.data
        self.acceleration = wp.zeros_like(data.qvel)
        forces, state = filled(VelocityForces, stepped.model, data), filled(StepState, data)
        inertias = data.M, data.M, data.qvel, data.qvel, data.qvel
        self._scratch = block_scratch(stepped.device, forces, state, state, *inertias)

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """End the step of all worlds, as `mujoco_warp.euler` and `mujoco_warp.implicit` do."""
        implicit = model.opt.integrator == IntegratorType.IMPLICITFAST
        # The engine has a formula of its own for free bodies, and advances the states of actuators.
        free = implicit and model.body_freeadr.size > 0
        stateful = model.na > 0 or model.nhistory > 0
        self.advance(model, data, implicit, advance=not (free or stateful))
        if free:
            implicit_free_body(model, data, data.efc.Ma, self.acceleration, solve=True)
        if stateful:
            _advance(model, data, self.acceleration)
        elif free:
            self.advance(model, data, implicit, solve=False)

    def advance(
        self, model: mjw.Model, data: mjw.Data, implicit: bool, solve: bool = True, advance: bool = True
    ) -> None:
        """Compute accelerations, advance the state with them, or both; see `Parts`."""
        parts = Parts()
        parts.timestep, parts.implicit_actuators = model.opt.timestep, implicit
        parts.solve, parts.advance = solve, advance
        launch(
            integrate,
            1,
            data,
            data.efc,
            scratch=self._scratch,
            inertia=filled(InertiaRows, model),
            joints=filled(JointAddresses, model),
            parts=parts,
            forces=filled(VelocityForces, model, data),
            usage=filled(Usage, data),
            acceleration=self.acceleration,
            state=filled(StepState, data),
        )

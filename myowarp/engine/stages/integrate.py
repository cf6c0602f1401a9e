"""The end of a physics step in one thread a world: implicit velocities, positions, time, on the CPU device.

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
from mujoco_warp import BiasType, DisableBit, GainType, IntegratorType, JointType, OverflowType
from mujoco_warp._src.forward import _advance, implicit_free_body
from mujoco_warp._src.math import quat_integrate
from mujoco_warp._src.types import vec10

from myowarp.engine.stage import Stage
from myowarp.engine.stages.arrays import InertiaRows, any_of, filled
from myowarp.engine.stepped import Stepped
from myowarp.kernels.batching import batched
from myowarp.kernels.launch import launch

MAX_DOFS, MAX_ENTRIES = 512, 2**15  # 132 KB of stack; M of 255 dofs in a row
SOURCE = f"""
constexpr int AFFINE = {int(BiasType.AFFINE)}, MAX_DOFS = {MAX_DOFS}, MAX_ENTRIES = {MAX_ENTRIES};
{Path(__file__).with_name("integrate.cpp").read_text()}"""

NEFC_OVERFLOW = wp.constant(int(OverflowType.NEFC))
BROADPHASE_OVERFLOW = wp.constant(int(OverflowType.BROADPHASE))
NARROWPHASE_OVERFLOW = wp.constant(int(OverflowType.NARROWPHASE))
FREE, BALL = wp.constant(int(JointType.FREE)), wp.constant(int(JointType.BALL))


@wp.struct
class Parts:
    """What a launch does; the two parts are separate where the engine has to do something between them.

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
    """Where the state of joints is; fields are those of the engine's `Model`."""

    jnt_type: wp.array[int]
    jnt_qposadr: wp.array[int]
    jnt_dofadr: wp.array[int]


@wp.struct
class Usage:
    """How much of the engine's arrays is used, and how much there is; fields are those of `Data`."""

    nefc: wp.array[int]
    ncollision: wp.array[int]
    nacon: wp.array[int]
    njmax: int
    naconmax: int


@wp.struct
class StepState:
    """What a step leaves; fields are those of the engine's `Data`."""

    qpos: wp.array2d[float]
    qvel: wp.array2d[float]
    qacc_warmstart: wp.array2d[float]
    time: wp.array[float]
    overflow: wp.array[int]


@wp.func_native(SOURCE)
def solve_motion(
    world: int,
    timestep: float,
    implicit_actuators: bool,
    inertia: InertiaRows,
    forces: VelocityForces,
    M: wp.array[float],
    Ma: wp.array[float],
    qvel: wp.array[float],
    acceleration: wp.array[float],
):
    """acceleration = (M - h dF/dv)^-1 Ma, in one world."""


@wp.func
def turn(qpos: wp.array[float], first: int, qvel: wp.array[float], dof: int, timestep: float):
    """quat = quat exp(h qvel / 2), for the quaternion in `qpos` from `first` on."""
    quat = wp.quat(qpos[first], qpos[first + 1], qpos[first + 2], qpos[first + 3])
    quat = quat_integrate(quat, wp.vec3(qvel[dof], qvel[dof + 1], qvel[dof + 2]), timestep)
    for i in range(4):
        qpos[first + i] = quat[i]


@wp.func
def move(joints: JointAddresses, qpos: wp.array[float], qvel: wp.array[float], timestep: float):
    """qpos = qpos + h qvel, on the joints' manifolds."""
    for joint in range(joints.jnt_type.shape[0]):
        kind, first, dof = joints.jnt_type[joint], joints.jnt_qposadr[joint], joints.jnt_dofadr[joint]
        if kind == BALL:
            turn(qpos, first, qvel, dof, timestep)
        elif kind == FREE:
            for i in range(3):
                qpos[first + i] = qpos[first + i] + timestep * qvel[dof + i]
            turn(qpos, first + 3, qvel, dof + 3, timestep)
        else:
            qpos[first] = qpos[first] + timestep * qvel[dof]


@wp.func
def overflow_bits(usage: Usage, worldid: int) -> int:
    """Return which of the engine's arrays were too small."""
    bits = int(0)
    if usage.nefc[worldid] > usage.njmax:
        bits |= NEFC_OVERFLOW
    if usage.ncollision[0] > usage.naconmax:
        bits |= BROADPHASE_OVERFLOW
    if usage.nacon[0] > usage.naconmax:
        bits |= NARROWPHASE_OVERFLOW
    return bits


@wp.kernel(enable_backward=False)
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
    forces: VelocityForces,
    usage: Usage,
    # Out:
    acceleration: wp.array2d[float],
    state: StepState,
):
    """acceleration = (M - h dF/dv)^-1 Ma; qvel += h acceleration; qpos += h qvel; time += h."""
    worldid = wp.tid()
    timestep = parts.timestep[batched(worldid, parts.timestep.shape[0])]
    qvel, change = state.qvel[worldid], acceleration[worldid]
    if parts.solve:
        solve_motion(
            worldid,
            timestep,
            parts.implicit_actuators,
            inertia,
            forces,
            M_in[worldid],
            Ma_in[worldid],
            qvel,
            change,
        )
    if parts.advance:
        qacc, warmstart = qacc_in[worldid], state.qacc_warmstart[worldid]
        for dof in range(qvel.shape[0]):
            qvel[dof] = qvel[dof] + timestep * change[dof]
            warmstart[dof] = qacc[dof]
        move(joints, state.qpos[worldid], qvel, timestep)
        state.time[worldid] = state.time[worldid] + timestep
        state.overflow[worldid] = state.overflow[worldid] | overflow_bits(usage, worldid)


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
        f"degrees of freedom are not 1 to {MAX_DOFS}": lambda stepped: not 0 < stepped.model.nv <= MAX_DOFS,
        f"the inertia matrix has more than {MAX_ENTRIES} entries": lambda stepped: (
            stepped.data.M.shape[1] > MAX_ENTRIES
        ),
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
        self.acceleration = wp.zeros_like(stepped.data.qvel)

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
            data.nworld,
            data,
            data.efc,
            inertia=filled(InertiaRows, model),
            joints=filled(JointAddresses, model),
            parts=parts,
            forces=filled(VelocityForces, model, data),
            usage=filled(Usage, data),
            acceleration=self.acceleration,
            state=filled(StepState, data),
        )

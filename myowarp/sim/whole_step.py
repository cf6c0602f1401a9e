"""A physics step as one launch, for a body that touches nothing: each thread steps a world.

The sources are those that serve lanes (`rigid_body.py` and the stages after it); a lane is a thread, and what
it computes lies beside what the others compute (`strided.cpp`), as CUDA reads memory. Nothing of a step then
waits for another launch, or for the slowest world. On the CPU worlds go one after the other, which is slower
than lanes and has their bits. It is used where it is named, `stages=(WholeStep,)`: no GPU has run it yet.
"""

from types import SimpleNamespace
from typing import Any, ClassVar

import mujoco_warp as mjw
import warp as wp
from mujoco_warp import DisableBit, IntegratorType

from myowarp.definitions.muscle import Anatomy, MuscleResults
from myowarp.engine.inertia import vec10
from myowarp.engine.stage import Stage
from myowarp.engine.stages import contact_solve, integrate, muscle_path_kernel, rigid_body
from myowarp.engine.stages.affine_actuators import FILE as ACTUATORS
from myowarp.engine.stages.affine_actuators import ActuatorMoments, Actuators, AffineActuators
from myowarp.engine.stages.arrays import ConstraintRows, InertiaRows, any_of, filled
from myowarp.engine.stages.constraint_rows import ConstraintRows as RowStage
from myowarp.engine.stages.contact_rows import RowOptions
from myowarp.engine.stages.contact_solve import (
    ContactSolve,
    RowCounts,
    SolverOptions,
    SolverResult,
    solver_result,
    sum_of_world,
)
from myowarp.engine.stages.integrate import Integrate, JointAddresses, Parts, StepState, Usage, VelocityForces
from myowarp.engine.stages.joint_rows import JointConstraints, JointState, write_limits
from myowarp.engine.stages.muscle_path import MusclePath, MusclePaths
from myowarp.engine.stages.muscle_path_kernel import PathProgram, Transmission
from myowarp.engine.stages.rigid_body import BodyMotion, Pose, RigidBodies, RigidBody, Switches
from myowarp.engine.stages.row_places import RowPlaces
from myowarp.engine.stepped import Stepped
from myowarp.kernels.lanes import STRIDED, arrays_of, at_namespace_level, row_floats
from myowarp.kernels.launch import launch
from myowarp.models.muscles import mujoco_native
from myowarp.models.muscles.mujoco import MujocoMuscle, MujocoMuscleParams

STRIDE = 32
"""Worlds that lie beside each other, as in `strided.cpp`."""

FILES = (
    STRIDED,
    rigid_body.FILE,
    muscle_path_kernel.FILE,
    *mujoco_native.FILES,
    ACTUATORS,
    *contact_solve.FILES,
    *(file for file in integrate.FILES if file not in contact_solve.FILES),
)


@wp.struct
class Fixed:
    """Constants of a step; the worlds' own fields are in their stages' structs.

    Attributes:
        sites: Whose poses are computed: none.
        implicitness: See `MuscleModel`; so is the next.
        midstep: Whether muscles pull with the activation in the middle of the step.
        clamp_controls: Whether controls are kept in their range.
    """

    bodies: RigidBodies
    switches: Switches
    sites: wp.array[int]
    program: PathProgram
    params: MujocoMuscleParams
    anatomy: Anatomy
    implicitness: float
    midstep: bool
    actuators: Actuators
    clamp_controls: bool
    inertia: InertiaRows
    stopping: SolverOptions
    parts: Parts
    addresses: JointAddresses
    forces: VelocityForces


@wp.struct
class Moving:
    """State and results of the worlds."""

    end: StepState
    pose: Pose
    motion: BodyMotion
    transmission: Transmission
    activation: wp.array2d[float]
    results: MuscleResults
    moments: ActuatorMoments
    ctrl: wp.array2d[float]
    actuator_biasprm: wp.array2d[vec10]
    actuator_force: wp.array2d[float]
    qfrc_applied: wp.array2d[float]
    qfrc_actuator: wp.array2d[float]
    qfrc_smooth: wp.array2d[float]
    qfrc_constraint: wp.array2d[float]
    qacc: wp.array2d[float]
    result: SolverResult
    usage: Usage
    acceleration: wp.array2d[float]


@wp.struct
class Memory:
    """Memory in which threads compute.

    Attributes:
        scratch: Of all worlds, those of a warp beside each other.
        floats: Of a world.
        limits: Of each world's dofs, shape (num_worlds, nv).
    """

    scratch: wp.array[float]
    floats: int
    limits: wp.array2d[wp.vec2]


@wp.func_native(at_namespace_level(*FILES, **contact_solve.FLAGS, **integrate.CONSTANTS))
def declare_whole_step(thread: int):
    """Declare the templates of all stages."""
    ...


BLOCK = """
#ifdef __CUDACC__  // all threads note the same
    __shared__ lanes::Held held[lanes::MOST_HELD];
#else
    lanes::Held held[lanes::MOST_HELD];
#endif
    lanes::Block<lanes::Strided> block(world, memory.scratch.data, memory.floats, held);
"""


@wp.func_native(
    BLOCK
    + """
    auto &qpos = moving.end.qpos, &qvel = moving.end.qvel;
    auto& moments = moving.moments;
    lanes::move_block(block, fixed.bodies, fixed.switches, fixed.sites, qpos, qvel, moving.pose,
                      moving.motion);
    lanes::follow_block(block, 0, 1, fixed.program, qpos, qvel, moving.pose, moving.motion,
                        moving.transmission);
    lanes::contract_block(block, fixed.params, fixed.anatomy, fixed.parts.timestep, fixed.midstep,
                          fixed.implicitness, moving.ctrl, moments.actuator_length,
                          moments.actuator_velocity, moving.activation, moving.results,
                          moving.actuator_biasprm);
    lanes::actuate_block(block, fixed.actuators, fixed.clamp_controls, moments, moving.ctrl,
                         moving.actuator_force, moving.qfrc_actuator);
"""
)
def pull_world(world: int, memory: Memory, fixed: Fixed, moving: Moving):
    """Move bodies, follow paths, and let muscles and motors pull."""
    ...


@wp.func_native(
    BLOCK
    + """
    const int n = moving.qacc.shape[1];
    auto* limits = (lanes::Limit*)memory.limits.data;
    lanes::has_limits_only(counts, rows, world, n, limits + world * n);
    lanes::solve_limits_block(block, fixed.inertia, fixed.stopping, moving.motion.M, moving.qfrc_smooth,
                              moving.end.qacc_warmstart, limits, rows, moving.qacc,
                              moving.qfrc_constraint, moving.result);
    lanes::end_block(block, fixed.parts, fixed.inertia, fixed.addresses, moving.motion.M, moving.result.Ma,
                     moving.qacc, fixed.forces, moving.usage, moving.acceleration, moving.end);
"""
)
def end_world(
    world: int,
    memory: Memory,
    fixed: Fixed,
    counts: RowCounts,
    rows: ConstraintRows,
    moving: Moving,
):
    """Solve the limits, and advance the state."""
    ...


@wp.kernel(enable_backward=False)
def step_worlds(
    # Params:
    fixed: Fixed,
    joints: JointConstraints,
    options: RowOptions,
    # In:
    memory: Memory,
    joint_state: JointState,
    counts: RowCounts,
    # Out:
    places: RowPlaces,
    rows: ConstraintRows,
    moving: Moving,
):
    """A physics step of a world: all forces, M qacc = qfrc_smooth + J' force, next state."""
    worldid = wp.tid()
    declare_whole_step(worldid)
    pull_world(worldid, memory, fixed, moving)
    sum_of_world(
        worldid,
        moving.qfrc_applied,
        moving.motion.qfrc_passive,
        moving.qfrc_actuator,
        moving.motion.qfrc_bias,
        moving.qfrc_smooth,
    )
    places.ne[worldid] = 0
    places.nf[worldid] = 0
    places.nl[worldid] = 0
    places.nefc[worldid] = 0
    places.jtdaj_nblock[worldid] = 0
    places.efc_nnz[worldid] = 0
    write_limits(joints, options, joint_state, worldid, places, rows)
    end_world(worldid, memory, fixed, counts, rows, moving)


def _ends_apart(stepped: Stepped) -> bool:
    """Whether the engine does a part of the step's end; see `Integrate.launch`."""
    model = stepped.model
    free = model.opt.integrator == IntegratorType.IMPLICITFAST and model.body_freeadr.size > 0
    return bool(free or model.na > 0 or model.nhistory > 0)


def _sees_contacts(stepped: Stepped) -> bool:
    return bool(stepped.data.naconmax > 0 or stepped.ground is not None)


class WholeStep(Stage):
    """All that a step computes of a body whose only constraints are limits of joints."""

    REPLACES = (
        *("kinematics", "com_pos", "com_vel", "tendon", "crb", "collision", "make_constraint"),
        *("transmission", "velocity", "passive", "rne", "control", "actuation"),
        *("acceleration", "solve", "integrate"),
    )
    ON_CUDA = True
    OBSTACLES: ClassVar = {
        "contacts are looked for": _sees_contacts,
        "there are constraints other than limits of joints": lambda stepped: bool(
            stepped.oracle.neq
            or any_of(stepped.oracle.dof_frictionloss, stepped.oracle.tendon_frictionloss)
            or any_of(stepped.oracle.tendon_limited)
        ),
        "the muscles are not MuJoCo's": lambda stepped: not isinstance(stepped.muscles, MujocoMuscle),
        "conditions act": lambda stepped: stepped.muscles.individual,
        "the model has forces of its own": lambda stepped: stepped.forces is not None,
        "more than joints makes passive forces": rigid_body.others_are_passive,
        "the engine ends the step": _ends_apart,
        **{
            reason: holds
            for stage in (RigidBody, MusclePath, AffineActuators, RowStage, ContactSolve, Integrate)
            for reason, holds in stage.OBSTACLES.items()
        },
    }

    def __init__(self, stepped: Stepped) -> None:
        """Allocate the memory of all threads."""
        super().__init__(stepped)
        model, data = stepped.model, stepped.data
        self._stepped, self.result = stepped, solver_result(data)
        with wp.ScopedDevice(stepped.device):
            self.paths = MusclePaths(stepped.oracle, model, data)
            self.efc_nnz = wp.zeros(data.nworld, dtype=int)
            self.acceleration = wp.zeros_like(data.qvel)
            self.sites = wp.zeros(0, dtype=int)
            self.memory = Memory()
            entries, dofs = data.M.shape[1], data.qvel.shape[1]
            taken = 2 * entries + 16 * dofs + 1  # by solver and integrator, beside rows of arrays
            self.memory.floats = taken + self._floats(self.fixed(model), self.moving(model))
            warps = -(-data.nworld // STRIDE)
            self.memory.scratch = wp.empty(warps * STRIDE * self.memory.floats, dtype=float)
            self.memory.limits = wp.empty(data.qvel.shape, dtype=wp.vec2)

    def fixed(self, model: mjw.Model) -> Any:
        """Return what the model says now."""
        off, switches, parts = model.opt.disableflags, Switches(), Parts()
        switches.dynamics = True
        switches.has_gravity = not off & DisableBit.GRAVITY
        switches.has_springs = not off & DisableBit.SPRING
        switches.has_dampers = not off & DisableBit.DAMPER
        if self._stepped.remaining is not None:
            switches.remaining = self._stepped.remaining
        parts.timestep, parts.solve, parts.advance = model.opt.timestep, True, True
        parts.implicit_actuators = model.opt.integrator == IntegratorType.IMPLICITFAST
        clamp = not off & DisableBit.CLAMPCTRL
        given = SimpleNamespace(switches=switches, parts=parts, clamp_controls=clamp)
        owners = model, model.opt, self._stepped.data, self._stepped.muscles
        return filled(Fixed, given, self, self.paths, *owners)

    def moving(self, model: mjw.Model) -> Any:
        """Return state and results."""
        data = self._stepped.data
        return filled(Moving, self, data, data.efc, self._stepped.muscles, model)

    def _floats(self, *owners: Any) -> int:
        """Return how many floats the rows of one world have in arrays that have a row for each."""
        arrays = {array.ptr: array for owner in owners for array in arrays_of(owner)}
        number = self._stepped.data.nworld
        return row_floats(*(array for array in arrays.values() if array.shape[0] == number))

    def begin(self) -> None:
        """Put the moments' layout right, which the engine's own step leaves in any order."""
        self.paths.write_layout()

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Step all worlds."""
        launch(
            step_worlds,
            data.nworld,
            self,
            block_dim=STRIDE,  # a warp: few worlds, too, reach all multiprocessors
            fixed=self.fixed(model),
            joints=filled(JointConstraints, model),
            options=filled(RowOptions, model.opt),
            joint_state=filled(JointState, data),
            counts=filled(RowCounts, data),
            places=filled(RowPlaces, data, data.efc, self),
            rows=filled(ConstraintRows, data.efc),
            moving=self.moving(model),
        )

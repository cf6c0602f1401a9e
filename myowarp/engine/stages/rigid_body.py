"""Rigid bodies: all that follows from positions and velocities alone, worlds in lanes, on the CPU device.

Poses along the tree, composite inertias, the joint-space inertia M, the bias force c of
`M qacc + c = forces` and the passive forces of joints (Featherstone, Rigid Body Dynamics Algorithms, 2008,
chapters 4 to 6; motions are about the centre of mass of their tree, MuJoCo documentation, Computation). The
engine makes twenty launches of this, most of which do little more than read what the last one wrote.
"""

from functools import partial
from pathlib import Path
from typing import ClassVar

import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp import DisableBit, JointType
from mujoco_warp._src.types import vec10

from myowarp.engine.stage import Launches, Stage
from myowarp.engine.stages.arrays import JOINTS, any_of, filled
from myowarp.engine.stages.muscle_path import MusclePath, MusclePaths
from myowarp.engine.stages.muscle_path_kernel import FILE as PATH_FILE
from myowarp.engine.stages.muscle_path_kernel import PathProgram, Transmission
from myowarp.engine.stepped import Stepped
from myowarp.kernels.lanes import at_namespace_level, block_scratch, native_kernel
from myowarp.kernels.launch import launch

FILE = Path(__file__).with_suffix(".cpp")


@wp.struct
class RigidBodies:
    """Bodies, joints, and what is fixed to them; fields are those of the engine's `Model` and `Option`."""

    gravity: wp.array[wp.vec3]
    body_parentid: wp.array[int]
    body_rootid: wp.array[int]
    body_weldid: wp.array[int]
    body_mocapid: wp.array[int]
    body_jntnum: wp.array[int]
    body_jntadr: wp.array[int]
    body_pos: wp.array2d[wp.vec3]
    body_quat: wp.array2d[wp.quat]
    body_ipos: wp.array2d[wp.vec3]
    body_iquat: wp.array2d[wp.quat]
    body_mass: wp.array2d[float]
    body_subtreemass: wp.array2d[float]
    body_inertia: wp.array2d[wp.vec3]
    jnt_type: wp.array[int]
    jnt_qposadr: wp.array[int]
    jnt_dofadr: wp.array[int]
    jnt_pos: wp.array2d[wp.vec3]
    jnt_axis: wp.array2d[wp.vec3]
    jnt_stiffness: wp.array2d[float]
    jnt_stiffnesspoly: wp.array2d[wp.vec2]
    dof_bodyid: wp.array[int]
    dof_parentid: wp.array[int]
    dof_armature: wp.array2d[float]
    dof_damping: wp.array2d[float]
    dof_dampingpoly: wp.array2d[wp.vec2]
    qpos0: wp.array2d[float]
    qpos_spring: wp.array2d[float]
    M_rownnz: wp.array[int]
    M_rowadr: wp.array[int]
    geom_bodyid: wp.array[int]
    geom_pos: wp.array2d[wp.vec3]
    geom_quat: wp.array2d[wp.quat]
    site_bodyid: wp.array[int]
    site_pos: wp.array2d[wp.vec3]
    site_quat: wp.array2d[wp.quat]


@wp.struct
class Switches:
    """Parts that are computed, and those that every physics step of a control step writes.

    Attributes:
        dynamics: Whether to compute more than poses of bodies and of some sites.
        has_gravity: Whether gravity acts.
        has_springs: Whether springs act.
        has_dampers: Whether dampers act.
        has_contacts: Whether contacts are looked for, which takes poses and motions.
        remaining: Physics steps left in the control step, shape (1,); in the last, all is written that others
            read after it. Empty: in each.
    """

    dynamics: bool
    has_gravity: bool
    has_springs: bool
    has_dampers: bool
    has_contacts: bool
    remaining: wp.array[int]


@wp.struct
class Pose:
    """Places of bodies, geoms and sites; fields are those of the engine's `Data`."""

    mocap_pos: wp.array2d[wp.vec3]
    mocap_quat: wp.array2d[wp.quat]
    xpos: wp.array2d[wp.vec3]
    xquat: wp.array2d[wp.quat]
    xmat: wp.array2d[wp.mat33]
    xipos: wp.array2d[wp.vec3]
    ximat: wp.array2d[wp.mat33]
    xanchor: wp.array2d[wp.vec3]
    xaxis: wp.array2d[wp.vec3]
    geom_xpos: wp.array2d[wp.vec3]
    geom_xmat: wp.array2d[wp.mat33]
    site_xpos: wp.array2d[wp.vec3]
    site_xmat: wp.array2d[wp.mat33]


@wp.struct
class BodyMotion:
    """Inertias, velocities and forces; fields are those of the engine's `Data`."""

    subtree_com: wp.array2d[wp.vec3]
    cinert: wp.array2d[vec10]
    crb: wp.array2d[vec10]
    cdof: wp.array2d[wp.spatial_vector]
    cdof_dot: wp.array2d[wp.spatial_vector]
    cvel: wp.array2d[wp.spatial_vector]
    cacc: wp.array2d[wp.spatial_vector]
    cfrc_int: wp.array2d[wp.spatial_vector]
    M: wp.array2d[float]
    qfrc_bias: wp.array2d[float]
    qfrc_spring: wp.array2d[float]
    qfrc_damper: wp.array2d[float]
    qfrc_passive: wp.array2d[float]


@native_kernel(
    at_namespace_level(FILE, **JOINTS),
    at_namespace_level(PATH_FILE),
    does="""
    lanes::for_blocks(qpos_in.shape[0], mask.data, scratch.data, [&](auto& block) {
        lanes::move_block(block, bodies, switches, sites, qpos_in, qvel_in, pose_out, motion_out);
        if (program.paths.shape[0] > 0)
            lanes::follow_block(block, 0, 1, program, qpos_in, qvel_in, pose_out, motion_out, transmission);
    });
    """,
)
def move_bodies(
    # Model:
    bodies: RigidBodies,
    # Params:
    switches: Switches,
    # Data in:
    qpos_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    # In:
    scratch: wp.array[float],
    sites: wp.array[int],
    mask: wp.array[bool],
    program: PathProgram,
    # Data out:
    pose_out: Pose,
    motion_out: BodyMotion,
    # Out:
    transmission: Transmission,
):
    """x = x(qpos), M = sum_b J_b' I_b J_b, c = sum_b J_b' (I_b a_b + v_b x I_b v_b) with qacc = 0."""


def _springy_quaternions(stepped: Stepped) -> bool:
    """Whether a ball or free joint has a spring."""
    model = stepped.model
    quaternions = np.isin(model.jnt_type.numpy(), (JointType.FREE, JointType.BALL))
    springs = (model.jnt_stiffness, model.jnt_stiffnesspoly)
    return any_of(*(spring.numpy()[:, quaternions] for spring in springs))


def others_are_passive(stepped: Stepped) -> bool:
    """Whether more than joints makes passive forces."""
    model = stepped.model
    tendons = (
        model.tendon_stiffness,
        model.tendon_stiffnesspoly,
        model.tendon_damping,
        model.tendon_dampingpoly,
    )
    others = model.has_fluid or model.flg_adhesion or model.callback.passive is not None
    return bool(others or any_of(*tendons, model.body_gravcomp))


READERS = {"tendon", "transmission", "passive", "make_constraint", "acceleration", "solve", "integrate"}
"""Places of a step where the engine's own functions read poses and motions; ours read few."""


class RigidBody(Stage):
    """All that a step computes from positions and velocities alone, or only poses.

    Within a step only the engine's own tendons and rows read sites; where the tendons are ours, only
    `refresh` brings sites up to date.
    """

    REPLACES = ("kinematics", "com_pos", "crb", "com_vel", "passive", "rne")
    OBSTACLES: ClassVar = {
        "nothing moves": lambda stepped: stepped.model.nv == 0,
        "a ball or free joint has a spring": _springy_quaternions,
        "a joint is plastic": lambda stepped: any_of(stepped.model.jnt_plasticadr.numpy() >= 0),
        "actuators have armature or damping": lambda stepped: any_of(
            stepped.model.actuator_armature,
            stepped.model.actuator_damping,
            stepped.model.actuator_dampingpoly,
        ),
    }

    def __init__(self, stepped: Stepped) -> None:
        """Note which sites the task reads, and whether joints are all that passive forces come from."""
        super().__init__(stepped)
        model = stepped.model
        self._stepped = stepped
        self._task_sites = wp.array(stepped.sites, dtype=int, device=stepped.device)
        self._all_sites = wp.array(np.arange(model.nsite), dtype=int, device=stepped.device)
        self._no_sites = wp.zeros(0, dtype=int, device=stepped.device)
        bodies, data = filled(RigidBodies, model, model.opt), stepped.data
        self._arrays = bodies, filled(Pose, data), filled(BodyMotion, data), data.qpos, data.qvel
        self._scratch = block_scratch(stepped.device, *self._arrays)
        self._every = wp.ones(stepped.data.nworld, dtype=bool, device=stepped.device)
        if others_are_passive(stepped):
            self.replaces = tuple(place for place in self.REPLACES if place != "passive")

    def launcher(self, stages: tuple[Stage, ...], mask: wp.array | None = None) -> Launches:
        """Return a launch that follows paths, too, if they are ours; then nobody else reads sites."""
        mask = self._every if mask is None else mask
        ours = {place for stage in stages for place in stage.replaces}
        remaining = self._stepped.remaining if ours >= READERS else None
        paths = next((stage.paths for stage in stages if isinstance(stage, MusclePath)), None)
        if paths is not None:
            self._scratch = block_scratch(paths.scratch.device, *self._arrays, *paths.arrays)
        sites = self._no_sites if paths else self._all_sites
        known = {"mask": mask, "sites": sites, "paths": paths, "remaining": remaining}
        return partial(self._launch, dynamics=True, **known)

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Compute all that follows from positions and velocities."""
        self._launch(model, data, self._every, self._all_sites, dynamics=True)

    def refresh(self, model: mjw.Model, data: mjw.Data, mask: wp.array | None) -> bool:
        """Compute where bodies and the task's sites are: what tasks read of `mujoco_warp.kinematics`.

        Args:
            model: The engine's model.
            data: The engine's data.
            mask: Worlds whose positions have changed, shape (num_worlds,) bool; None: all.
        """
        self._launch(model, data, self._every if mask is None else mask, self._task_sites, dynamics=False)
        return True

    def _launch(
        self,
        model: mjw.Model,
        data: mjw.Data,
        mask: wp.array,
        sites: wp.array,
        dynamics: bool,
        paths: MusclePaths | None = None,
        remaining: wp.array | None = None,
    ) -> None:
        """Launch our kernel, which walks through the worlds by itself."""
        disabled, switches = model.opt.disableflags, Switches()
        switches.dynamics, switches.has_contacts = dynamics, data.naconmax > 0
        if remaining is not None:
            switches.remaining = remaining
        switches.has_gravity = not disabled & DisableBit.GRAVITY
        switches.has_springs = not disabled & DisableBit.SPRING
        switches.has_dampers = not disabled & DisableBit.DAMPER
        launch(
            move_bodies,
            1,
            data,
            bodies=filled(RigidBodies, model, model.opt),
            switches=switches,
            scratch=self._scratch,
            sites=sites,
            mask=mask,
            program=paths.program if paths else PathProgram(),
            pose=filled(Pose, data),
            motion=filled(BodyMotion, data),
            transmission=paths.transmission if paths else Transmission(),
        )

"""Kinematics, inertia, bias and passive forces in one launch, see `kernels/rigid_body.py`."""

import contextlib
from collections.abc import Iterator
from unittest import mock

import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp._src import passive, smooth
from mujoco_warp._src.types import DisableBit, EnableBit, IntegratorType, JointType

from myowarp.engine.idle import pruned
from myowarp.engine.stages import FUSIONS, Fusion
from myowarp.engine.stages.arrays import filled
from myowarp.engine.stages.rigid_body_kernel import BodyMotion, Pose, RigidBodies, Switches, move_bodies
from myowarp.kernels.batching import num_threads
from myowarp.spec.scene import Scene

OTHER_POSES = frozenset(
    {
        "_kinematics_branch",
        "_compute_body_matrices",
        "_compute_body_inertial_frames",
        "_geom_local_to_global",
    }
)
"""What the engine's `kinematics` launches besides the poses of sites."""


@FUSIONS.register("rigid_body")
class RigidBodyFusion(Fusion):
    """All that a step computes from positions and velocities alone, and poses for who asks for no more.

    Sites are left to the engine within a step, where a muscle path fusion may know that nobody reads them.
    """

    @classmethod
    def obstacle(cls, scene: Scene) -> str | None:
        """Return why it cannot be used, None if it can."""
        model, opt = scene.model, scene.model.opt
        quaternions = np.isin(model.jnt_type.numpy(), (JointType.FREE, JointType.BALL))
        springs = [field.numpy()[:, quaternions] for field in (model.jnt_stiffness, model.jnt_stiffnesspoly)]
        actuated = (model.actuator_armature, model.actuator_damping, model.actuator_dampingpoly)
        obstacles = {
            "the device is not the CPU": not scene.device.is_cpu,
            "nothing moves": model.nv == 0,
            "a ball or free joint has a spring": any(spring.any() for spring in springs),
            "a joint is plastic": bool((model.jnt_plasticadr.numpy() >= 0).any()),
            "actuators have armature or damping": any(array.numpy().any() for array in actuated),
            "there are flexes": model.nflex > 0,
            "the integrator is the discrete one": opt.integrator == IntegratorType.DISCRETE,
            "sleeping is on": bool(opt.enableflags & EnableBit.SLEEP),
        }
        return next((reason for reason, holds in obstacles.items() if holds), None)

    def __init__(self, scene: Scene) -> None:
        """Note which sites the task reads, and whether joints are all that passive forces come from."""
        model, sites = scene.model, [scene.site_id(name) for name in scene.spec.sites]
        self._sites = wp.array(sites, dtype=int, device=scene.device)
        self._every = wp.ones(scene.data.nworld, dtype=bool, device=scene.device)
        springs = (model.tendon_stiffness, model.tendon_stiffnesspoly)
        dampers = (model.tendon_damping, model.tendon_dampingpoly)
        others = model.has_fluid or model.flg_adhesion or model.callback.passive is not None
        self._stock_kinematics = smooth.kinematics
        forces = (*springs, *dampers, model.body_gravcomp)
        self._joints_alone = not (others or any(array.numpy().any() for array in forces))

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Launch our kernel as the engine's kinematics, and nothing where it has done the work."""
        stock_passive = passive.passive

        def add_other_passive(model: mjw.Model, data: mjw.Data) -> None:
            with pruned(frozenset({"_spring_damper_dof_passive"})):
                stock_passive(model, data)

        with (
            mock.patch.object(smooth, "kinematics", self._launch_bodies),
            mock.patch.object(smooth, "com_pos"),
            mock.patch.object(smooth, "crb"),
            mock.patch.object(smooth, "com_vel"),
            mock.patch.object(smooth, "rne"),
            mock.patch.object(passive, "passive", mock.Mock() if self._joints_alone else add_other_passive),
        ):
            yield

    def launch_poses(self, model: mjw.Model, data: mjw.Data, mask: wp.array | None = None) -> None:
        """Compute where bodies and the task's sites are: what tasks read of `mujoco_warp.kinematics`.

        Args:
            model: The engine's model.
            data: The engine's data.
            mask: Worlds whose positions have changed, shape (num_worlds,) bool; None: all.
        """
        self._launch(model, data, self._every if mask is None else mask, dynamics=False)

    def _launch_bodies(self, model: mjw.Model, data: mjw.Data) -> None:
        """Compute all that follows from positions and velocities."""
        self._launch(model, data, self._every, dynamics=True)
        with pruned(OTHER_POSES):
            self._stock_kinematics(model, data)

    def _launch(self, model: mjw.Model, data: mjw.Data, mask: wp.array, dynamics: bool) -> None:
        """Launch our kernel, which walks through the worlds by itself."""
        bodies, switches = filled(RigidBodies, model, model.opt), Switches()
        disabled, sites = model.opt.disableflags, self._sites
        threads = num_threads(data.qpos.device, data.nworld)
        switches.dynamics = dynamics
        switches.has_gravity = not disabled & DisableBit.GRAVITY
        switches.has_springs = not disabled & DisableBit.SPRING
        switches.has_dampers = not disabled & DisableBit.DAMPER
        wp.launch(
            move_bodies,
            dim=threads,
            inputs=[bodies, switches, data.qpos, data.qvel, threads, sites, mask],
            outputs=[filled(Pose, data), filled(BodyMotion, data)],
        )

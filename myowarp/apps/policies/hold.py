"""The policy "hold": a proportional controller of the joints, a reference that needs no training.

    u_m = clip(gain sum_j r_mj / max_i |r_mi| (e_j - lead dq_j/dt), 0, 1)

with the joint error e [rad], the joint velocity dq/dt, and muscle m's moment arm r_mj about joint j in the
middle of the joint ranges; with one joint that is the moment arm's sign. A muscle that pulls towards the
target is excited in proportion to the error, its antagonist rests. There is no integral part and no model of
gravity: a weak, tired or loaded limb comes to rest short of its target, by the more the weaker it is.

It shows what a condition does; it does not solve tasks well. A healthy elbow comes within 0.04 rad of its
target on average and always succeeds; a hand, where muscles cross many joints, never does (error 1.6 rad
with "hold", 2.8 rad at rest).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import mujoco
import numpy as np

from myowarp.definitions.body import POINT_JOINTS
from myowarp.kernels.action import action_of
from myowarp.osim.bundle.couplings import follow

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene
    from myowarp.definitions.task import TaskSpec
    from myowarp.tasks.pose import PoseTask

GAIN = 2.0  # excitation per rad
LEAD = 0.05  # s; with 0.1 s and a healthy elbow the delay of the muscles makes it tremble
LEAST_ARM = 1e-9  # m; a muscle with less moves no joint


def check_hold(spec: TaskSpec) -> None:
    """Raise ValueError if a task does not observe joint errors."""
    if "pose_err" not in [column.name for column in spec.columns(1, 1, 1)]:
        raise ValueError(
            f"policy 'hold' follows joint errors, which task {spec.key!r} of family {spec.family!r} does "
            "not observe; use it in pose tasks"
        )


def moment_arms(model: mujoco.MjModel) -> np.ndarray:
    """Return the moment arms [m] of all actuators in the middle of the joint ranges, shape (nu, nv)."""
    data = mujoco.MjData(model)
    joints = np.isin(model.jnt_type, POINT_JOINTS)
    data.qpos[model.jnt_qposadr[joints]] = model.jnt_range[joints].mean(axis=1)
    follow(model, data.qpos)
    mujoco.mj_fwdPosition(model, data)
    moment = np.zeros((model.nu, model.nv))
    mujoco.mju_sparse2dense(
        moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    return -moment


class Hold:
    """The controller of all worlds of a pose task.

    Attributes:
        directions: Moment arms over the muscle's largest, shape (num_targets, num_muscles).
    """

    def __init__(self, scene: Scene) -> None:
        """Find the moment arms.

        Raises:
            ValueError: The task is no pose task, or its body has no muscles.
        """
        check_hold(scene.spec)
        if not scene.muscles.names:
            raise ValueError(f"policy 'hold' drives muscles; the body of task {scene.spec.key!r} has none")
        model = scene.oracle
        dofs = model.jnt_dofadr[cast("PoseTask", scene.spec).target_joints(model)]
        arms = moment_arms(model)[np.ix_(scene.muscles.actuator_id, dofs)]
        self.directions = (arms / np.maximum(np.abs(arms).max(axis=1, keepdims=True), LEAST_ARM)).T
        self._velocities, self._errors = model.nq + dofs, model.nq + model.nv + np.arange(len(dofs))
        self._actuator_id, self._control_dt = scene.muscles.actuator_id, scene.control_dt
        self._num_actions, self._linear = scene.num_actions, scene.spec.linear_excitation

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Return actions (num_worlds, num_actions) for observations of a pose task; motors do nothing."""
        velocity, error = obs[:, self._velocities] / self._control_dt, obs[:, self._errors]
        drive = GAIN * (error - LEAD * velocity) @ self.directions
        action = np.zeros((len(obs), self._num_actions), dtype=np.float32)
        action[:, self._actuator_id] = action_of(drive, self._linear)
        return action

"""The policy "muscle-control": activations whose torques lead to a posture or to points, without training.

In every control step, for every world,

    v' = clip(way / T, -v_max, v_max)                                 wanted velocity
    tau = M (v' - v) / T_v + D v' + bias - passive                    torque of the muscles for it
    a = argmin |W (R F_1 a + R F_0 - tau)|^2 + ridge |a|^2,           lowest <= a <= highest
    u = act + (a - act) / (1 - exp(-dt / tau_a))                      excitation that gets there in dt

with the mass matrix M, joint damping D, gravity and centripetal torques, torques of passive springs, moment
arms R, tension F_0 at rest and F_1 more at full activation, of each muscle on its present path. W weighs each
torque by the velocity that it would change. Followers by equalities move with their leaders. The way of a
pose task is q_target - q, that of a reach task the least change of the coordinates that brings the tips to
their targets: J^T (J J^T + softness)^-1 (targets - tips), with their Jacobian J.

The law is greedy, and a limb that many muscles cross has more equilibria than one: the straight way of an
open hand ends in a wrong one. So an episode begins with the muscles that bend and spread the limb
(`Body.approach`), fully excited for `APPROACH` seconds, the others at rest. Contacts and limits are not
looked at.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import mujoco
import numpy as np

from myowarp.definitions.body import BODIES
from myowarp.definitions.muscle import muscle_index
from myowarp.kernels.action import action_of, excitation
from myowarp.kernels.bounded_least_squares import BoundedLeastSquares
from myowarp.osim.bundle.couplings import couplings, jacobian
from myowarp.sim.present import tension_at
from myowarp.tasks.reach import ReachProgram

if TYPE_CHECKING:
    from myowarp.definitions.task import TaskSpec
    from myowarp.sim.simulation import Simulation
    from myowarp.tasks.pose import PoseProgram

APPROACH = 0.52  # s
REACH = 0.25  # s, T: the time in which the way that is left would be made
REACTION = 0.05  # s, T_v: the time in which the wanted velocity is reached
MOST_SPEED = 8.0  # v_max; rad/s or m/s
SOFTNESS = 1e-5  # m^2 / rad^2, of the way to points near straight limbs
MOST_HELD = 6  # times that joints are found at their limits
RIDGE = 1e-5  # of activations; rad^2/s^2 or m^2/s^2
LEAST_DAMPING = 1e-3  # N m s/rad: a joint with less counts as one with that
"""The first two are chosen by success in 128 random postures of the hand; the others hardly change it."""


def check_muscle_control(spec: TaskSpec) -> None:
    """Raise ValueError if a task asks neither for a posture nor for tips at points."""
    if not {"pose_err", "reach_err"} & {column.name for column in spec.columns(1, 1, 1)}:
        raise ValueError(
            f"policy 'muscle-control' follows errors of joints or tips, which task {spec.key!r} of family "
            f"{spec.family!r} does not observe; use it in pose and reach tasks"
        )


class MuscleControl:
    """Actions that bring all worlds to a posture, or their tips to points.

    Attributes:
        goal: Posture to reach, shape (num_worlds, nq); set anew to go another way. None: what the task asks.
        model: The model in which ways and torques are found.
        data: The world that is looked at.
        ties: Followers by equalities, and their leaders.
        problems: The weighted problem of each world, with its activations.
    """

    goal: np.ndarray | None = None

    def __init__(self, sim: Simulation) -> None:
        """Allocate the problems of all worlds.

        Raises:
            ValueError: The task has neither joint targets nor target points, or its body no muscles.
        """
        scene = sim.scene
        check_muscle_control(scene.spec)
        muscles = scene.muscles
        if not muscles.names:
            raise ValueError(
                f"policy 'muscle-control' drives muscles; the body of task {scene.spec.key!r} has none"
            )
        self._sim, self.model, self.data = sim, scene.oracle, mujoco.MjData(scene.oracle)
        if (
            isinstance(sim.shards[0].program, ReachProgram)
            and mujoco.mjtJoint.mjJNT_FREE in self.model.jnt_type
        ):
            raise ValueError(
                f"policy 'muscle-control' moves limbs of a fixed body, not that of task {scene.spec.key!r}, "
                "which can fall"
            )
        self.ties = couplings(self.model)
        first = BODIES[scene.spec.body].approach
        self._approach = np.zeros(scene.num_actions, dtype=np.float32)
        self._approach[muscles.actuator_id] = -1.0
        self._approach[muscles.actuator_id[[muscle_index(name, muscles.names) for name in first]]] = 1.0
        self._approach_steps = round(APPROACH / scene.control_dt) if first else 0
        self._tension_at = [tension_at(shard.scene) for shard in sim.shards]
        shape = scene.num_worlds, self.model.nv, len(muscles.names)
        self.problems = BoundedLeastSquares(*shape, ridge=RIDGE)
        self.problems.lower.fill_(excitation(-1.0, scene.spec.linear_excitation))
        self.problems.upper.fill_(excitation(1.0, scene.spec.linear_excitation))

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Return actions (num_worlds, num_actions) of the step that comes; motors do nothing."""
        sim, muscles = self._sim, self._sim.scene.muscles
        passive = np.concatenate([tension(0.0) for tension in self._tension_at])
        active = np.concatenate([tension(1.0) for tension in self._tension_at]) - passive
        activation = muscles.activation.numpy()
        matrix, right = self._torques(active, passive)
        problems = self.problems
        problems.matrix.assign(matrix)
        problems.right.assign(right)
        problems.x.assign(activation.astype(float))
        problems.solve()
        wanted = problems.x.numpy()
        scale = 0.5 + 1.5 * np.clip(activation, 0.0, 1.0)
        rise, fall = muscles.activation_time_constant.numpy(), muscles.deactivation_time_constant.numpy()
        lag = np.where(wanted > activation, rise * scale, fall / scale)
        lead = -np.expm1(-sim.scene.control_dt / np.maximum(lag, 1e-9))
        action = np.zeros((len(obs), sim.scene.num_actions), dtype=np.float32)
        drive = activation + (wanted - activation) / lead
        action[:, muscles.actuator_id] = action_of(drive, sim.scene.spec.linear_excitation)
        begins = sim.episode.step_count.numpy() < self._approach_steps
        return np.where(begins[:, None], self._approach, action)

    def _torques(self, active: np.ndarray, passive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return W R F_1, shape (num_worlds, nv, num_muscles), and W (tau - R F_0), (num_worlds, nv)."""
        sim, model, data, muscles = self._sim, self.model, self.data, self._sim.scene.muscles
        qpos, qvel = sim.scene.data.qpos.numpy(), sim.scene.data.qvel.numpy()
        path = muscles.anatomy.path.numpy()
        matrix, right = np.zeros((*active.shape[:1], model.nv, active.shape[1])), np.zeros(qvel.shape)
        moment, mass = np.zeros((model.nu, model.nv)), np.zeros((model.nv, model.nv))
        leads, all_slopes, _ = jacobian(model, self.ties, qpos.astype(float))
        for world, slopes in enumerate(all_slopes):
            data.qpos[:], data.qvel[:] = qpos[world], qvel[world]
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mju_sparse2dense(
                moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
            )
            mujoco.mj_fullM(model, data, mass)
            wanted = slopes @ np.clip(self.way(world, leads, slopes) / REACH, -MOST_SPEED, MOST_SPEED)
            change = wanted - data.qvel
            torque = mass @ change / REACTION + model.dof_damping * change
            torque += data.qfrc_bias - data.qfrc_passive
            arms = -moment[path[world % len(path)]].T  # tension pulls against the rise of length
            weight = 1.0 / (slopes.T @ (model.dof_damping[:, None] * slopes)).diagonal().clip(LEAST_DAMPING)
            matrix[world, : len(leads)] = weight[:, None] * (slopes.T @ (arms * active[world]))
            right[world, : len(leads)] = weight * (slopes.T @ (torque - arms @ passive[world]))
        return matrix, right

    def way(self, world: int, leads: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Return the change of the leading coordinates to where a world is to go, shape (num_leads,).

        Args:
            world: The world, whose bodies `data` has.
            leads: Degrees of freedom that lead, shape (num_leads,).
            slopes: Change of all degrees of freedom with theirs, shape (nv, num_leads).
        """
        shard = next(s for s in self._sim.shards if world < s.scene.worlds.first + s.num_worlds)
        program, row = shard.program, world - shard.scene.worlds.first
        if self.goal is None and isinstance(program, ReachProgram):
            return self._way_of_tips(program.target.numpy()[row], program.spec.tips, leads, slopes)
        goal = cast("PoseProgram", program).goal_pose(row) if self.goal is None else self.goal[world]
        way = np.zeros(self.model.nv)
        mujoco.mj_differentiatePos(self.model, way, 1.0, self.data.qpos, np.asarray(goal, dtype=float))
        return way[leads]

    def _way_of_tips(
        self, target: np.ndarray, tips: tuple[str, ...], leads: np.ndarray, slopes: np.ndarray
    ) -> np.ndarray:
        """Return the least change that brings tips to their targets, to first order.

        Coordinates that would leave their range go to its limit, and the others make up for it.
        """
        model, data, joints = self.model, self.data, self.model.dof_jntid[leads]
        arms, error = np.zeros((len(target), model.nv)), target.astype(float)
        for i, tip in enumerate(tips):
            rows, site = slice(3 * i, 3 * i + 3), model.site(tip).id
            mujoco.mj_jacSite(model, data, arms[rows], None, site)
            error[rows] -= data.site_xpos[site]
        led, room = arms @ slopes, model.jnt_range[joints].T - data.qpos[model.jnt_qposadr[joints]]
        room[:, model.jnt_limited[joints] == 0] = np.array([[-np.inf], [np.inf]])
        way, held = np.zeros(len(leads)), np.zeros(len(leads), dtype=bool)
        for _ in range(MOST_HELD):
            free, rest = led[:, ~held], error - led[:, held] @ way[held]
            way[~held] = free.T @ np.linalg.solve(free @ free.T + SOFTNESS * np.eye(len(rest)), rest)
            out = (way < room[0]) | (way > room[1])
            way = np.clip(way, *room)
            if not (out & ~held).any():
                break
            held |= out
        return way

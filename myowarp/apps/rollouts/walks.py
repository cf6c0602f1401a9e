"""Walks of a policy: what every world did in its first episode, with the forces of the ground on both feet.

States and tensions of muscles are those that the simulation led to. What they do to the bones is found anew
by MuJoCo in float64: ground's forces, and joint moments, which are all generalised forces at a joint but
inertia, gravity and ground: muscles and devices, springs, dampers and stops, and what the joint's couplings
pass on, such as the kneecap's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from rich.console import Console

from myowarp.apps.rollouts.episodes import Episodes, are_one
from myowarp.apps.rollouts.run import Act, Step, Watcher, progress, run
from myowarp.definitions.scene import Scene
from myowarp.motion.gait import side_of
from myowarp.motion.strides import JOINTS, SIDES, Walk, muscle_groups
from myowarp.motion.trial_walk import flexion
from myowarp.sim.economy import free_root
from myowarp.sim.signals import Signals
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import get_state, set_state

RATE = "bhargava2004_per_kg"
PUSHED_EVERY = 2.0
"""From a push to the next one [s]."""
CONTACTS = range(int(mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS), 1 << 8)


@dataclass(frozen=True, eq=False)
class Walks:
    """Walks of the worlds.

    Attributes:
        walks: One of every world whose episode no fault ended; a single one where all are the same.
        one_episode: Whether they are: nothing is drawn.
        faults: Episodes that a fault ended.
    """

    walks: tuple[Walk, ...]
    one_episode: bool
    faults: int


class Seen(Watcher):
    """Keeps what the first episode of every world leads to, a row a step."""

    def __init__(self, sim: Simulation, signals: Signals) -> None:
        self._sim, self._signals = sim, signals
        self._ended = np.zeros(sim.num_worlds, dtype=bool)
        self.rows: dict[str, list[np.ndarray]] = {}
        self.length = np.zeros(sim.num_worlds, dtype=int)

    def see(self, step: Step) -> None:
        """Keep a step."""
        own, force = self._signals, self._sim.scene.data.actuator_force.numpy().copy()
        force[:, self._sim.scene.muscles.actuator_id] = -own.muscles.force.numpy()
        seen = {"qpos": own.qpos, "qvel": own.qvel, "rate": own.whole_body[RATE]}
        row = {name: array.numpy().copy() for name, array in seen.items()}
        row |= {"activation": own.muscles.activation.numpy().copy(), "force": force}
        for name, array in row.items():
            self.rows.setdefault(name, []).append(array)
        self.length += ~self._ended
        self._ended |= step.ended

    def of(self, world: int) -> dict[str, np.ndarray]:
        """Return what a world led to, (steps, ...) by name."""
        steps = int(self.length[world])
        return {name: np.array([row[world] for row in rows[:steps]]) for name, rows in self.rows.items()}


def walks_of(sim: Simulation, act: Act, console: Console | None = None) -> Walks:
    """Let a policy walk for one episode in every world.

    Args:
        sim: The worlds, with autoreset in the same step.
        act: The policy.
        console: Where progress is drawn.

    Raises:
        ValueError: The body has no two legs, or the ground is not level.
    """
    legs = Legs(sim.scene)
    seen, episodes = Seen(sim, Signals(sim)), Episodes(sim.num_worlds)
    with progress("Walking", "steps", sim.horizon, console) as bar:
        run(sim, act, sim.horizon, seen, episodes, bar, until=lambda: bool(episodes.ended_once.all()))
    found = episodes.first()
    same = are_one(sim.setup, found["length"], found["return"])
    sound = np.flatnonzero(found["fault"] == 0)[: 1 if same else None]
    walks = tuple(legs.walk(seen.of(int(world)), bool(found["failed"][world])) for world in sound)
    return Walks(walks, same, int(np.count_nonzero(found["fault"])))


class Pushes(Watcher):
    """Pushes all worlds at a beat: the whole body gets a velocity more, in a random level direction."""

    def __init__(self, sim: Simulation, size: float, every: float = PUSHED_EVERY) -> None:
        """Find the root.

        Args:
            sim: The worlds.
            size: Of the velocity [m/s].
            every: From a push to the next one [s].

        Raises:
            ValueError: The body has no free root.
        """
        model, self._sim, self._size = sim.scene.oracle, sim, size
        if (root := free_root(model)) < 0:
            raise ValueError(f"a push needs a body with a free root; that of {sim.scene.spec.key!r} has none")
        self._dof = int(model.jnt_dofadr[model.jnt_qposadr == root][0])
        self._every = max(1, round(every / sim.scene.control_dt))
        self._random = np.random.default_rng(sim.setup.seed)

    def see(self, step: Step) -> None:
        """Push where it is time."""
        if step.number % self._every:
            return
        state = get_state(self._sim)
        angle = self._random.uniform(0.0, 2.0 * np.pi, self._sim.num_worlds)
        push = self._size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        state.arrays["data.qvel"][:, self._dof : self._dof + 2] += push
        set_state(self._sim, state)


@dataclass(frozen=True)
class Pushed:
    """Episodes under pushes.

    Attributes:
        size: Of a push [m/s].
        episodes: Number of them, without those that a fault ended.
        falls: Those that ended with a fall.
        seconds: Time of all of them together [s].
    """

    size: float
    episodes: int
    falls: int
    seconds: float


def pushed(sim: Simulation, act: Act, size: float, console: Console | None = None) -> Pushed:
    """Let a policy walk for one episode in every world while it is pushed.

    Raises:
        ValueError: The body has no free root.
    """
    pushes, episodes = Pushes(sim, size), Episodes(sim.num_worlds)
    with progress("Pushing", "steps", sim.horizon, console) as bar:
        run(sim, act, sim.horizon, pushes, episodes, bar, until=lambda: bool(episodes.ended_once.all()))
    found = episodes.first()
    sound = found["fault"] == 0
    time = float(found["length"][sound].sum() * sim.scene.control_dt)
    return Pushed(size, int(sound.sum()), int(found["failed"][sound].sum()), time)


class Legs:
    """Both legs of a scene in MuJoCo, posed as they were.

    Attributes:
        model: The scene's, float64.
        data: Of the last pose.
    """

    def __init__(self, scene: Scene) -> None:
        """Find joints and feet.

        Raises:
            ValueError: There are no two legs, or the ground is not level, or muscles have paths of their own.
        """
        model, task = scene.oracle, scene.spec.key
        joints = [f"{one}_{side}" for one in JOINTS.values() for side in SIDES]
        feet = [f"calcn_{side}" for side in SIDES]
        wanted = {mujoco.mjtObj.mjOBJ_JOINT: joints, mujoco.mjtObj.mjOBJ_BODY: feet}
        lacks = [n for kind, own in wanted.items() for n in own if mujoco.mj_name2id(model, kind, n) < 0]
        if lacks:
            raise ValueError(f"a walk needs both legs, of which task {task!r} has no {', '.join(lacks)}")
        if scene.paths is not None or scene.forces is not None:
            raise ValueError(
                f"a walk is scored with muscle paths and forces of MuJoCo; task {task!r} has those of "
                "OpenSim, so convert its model without them"
            )
        if scene.ground is not None:
            raise ValueError(f"a walk is scored on level ground; task {task!r} has a height field")
        self.model, self.data, self._dt = model, mujoco.MjData(model), scene.control_dt
        self._groups = muscle_groups(scene.muscles.names)
        self._feet = {side: int(model.body(f"calcn_{side}").id) for side in SIDES}
        self._root = int(model.body_rootid[self._feet["r"]])
        sides = [side_of(model.body(int(body)).name)[1] for body in model.geom_bodyid]
        grounded = model.body_weldid[model.geom_bodyid] == 0
        self._side = ["ground" if on else side for on, side in zip(grounded, sides, strict=True)]

    def walk(self, seen: dict[str, np.ndarray], fell: bool) -> Walk:
        """Return the walk of an episode, from the arrays of `Seen`."""
        model = self.model
        mass = float(model.body_subtreemass[self._root])
        posed = [self.pose(*row) for row in zip(seen["qpos"], seen["qvel"], seen["force"], strict=True)]
        center, feet, up, moment = (np.array(column) for column in zip(*posed, strict=True))
        curves: dict[str, np.ndarray] = {}
        for joint, coordinate in JOINTS.items():
            for side in SIDES:
                one = model.joint(f"{coordinate}_{side}")
                sign = flexion(*one.range) if joint == "knee" else 1.0
                angle = seen["qpos"][:, one.qposadr[0]].astype(float)
                curves[f"{joint}_angle_{side}"] = sign * np.degrees(angle)
                curves[f"{joint}_moment_{side}"] = -sign * moment[:, one.dofadr[0]] / mass
        for group, muscles in self._groups.items():
            curves[group] = seen["activation"][:, muscles].astype(float).mean(axis=1)
        time = self._dt * np.arange(1.0, len(center) + 1.0)
        by_side = {side: (feet[:, k], up[:, k]) for k, side in enumerate(SIDES)}
        rate = seen["rate"].astype(float)
        return Walk(
            mass=mass,
            time=time,
            center=center,
            foot={side: foot for side, (foot, _) in by_side.items()},
            curves=curves,
            force_time=time,
            force={side: force for side, (_, force) in by_side.items()},
            metabolic_rate=rate if np.isfinite(rate).all() else None,
            fell=fell,
        )

    def pose(
        self, qpos: np.ndarray, qvel: np.ndarray, force: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return mass centre, level places of heels, vertical forces on the feet and all joint moments.

        Args:
            qpos: Configuration.
            qvel: Velocity.
            force: Of all actuators, of muscles minus their tension [N].

        Returns:
            Shapes (3,) and (2, 2) [m], (2,) [N], and (nv,) [N m]; right before left.
        """
        model, data = self.model, self.data
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        arms = np.zeros((model.nu, model.nv))
        mujoco.mju_sparse2dense(
            arms, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
        data.qfrc_actuator[:] = force @ arms  # in place of MuJoCo's own muscles
        mujoco.mj_fwdAcceleration(model, data)
        mujoco.mj_fwdConstraint(model, data)
        moment = data.qfrc_actuator + data.qfrc_passive
        if data.nefc:
            within = np.where(np.isin(data.efc_type, CONTACTS), 0.0, data.efc_force)
            passed = np.zeros(model.nv)
            mujoco.mj_mulJacTVec(model, data, passed, within)
            moment = moment + passed
        up = dict.fromkeys(SIDES, 0.0)
        for side, pressed in self._pressed():
            up[side] += pressed
        feet = [data.xpos[body, :2].copy() for body in self._feet.values()]
        return data.subtree_com[self._root].copy(), np.array(feet), np.array(list(up.values())), moment

    def _pressed(self) -> Iterator[tuple[str, float]]:
        """Yield the side and the vertical force of the ground of each contact with it [N]."""
        wrench = np.zeros(6)
        for number in range(self.data.ncon):
            contact = self.data.contact[number]
            sides = [self._side[int(geom)] for geom in contact.geom]
            if sides.count("ground") != 1:
                continue
            second = sides[0] == "ground"
            if (side := sides[second]) in SIDES:
                mujoco.mj_contactForce(self.model, self.data, number, wrench)
                upwards = float(contact.frame.reshape(3, 3)[:, 2] @ wrench[:3])
                yield side, upwards if second else -upwards

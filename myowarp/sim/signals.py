"""Signals of the muscles of every world: activation, force, length, velocity, power, metabolic rate.

    signals = Signals(env.sim)  # arrays (num_worlds, num_muscles), filled in every step from here on
    env.step(actions)
    signals.muscles.force.numpy()[world, signals.names.index("BIClong")]

All signals of a step belong to one state: the one that the step led to, before what ended is reset. After a
reset that was asked for, or `set_state`, they are those of the state that the worlds are in then. Length and
velocity are recomputed from it, and force is what the muscle model gives for them and the activation,
with the strength and transmission that the conditions set for that step. MuJoCo's own `actuator_force` after
a step is that of the last physics step's begin, 2 ms older than `qpos`. The excitation is the one that was
held throughout the step.

    myowarp rollout myoElbowPose1D6MRandom-v0 --signals run.parquet
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from myowarp.definitions.body import BODIES, POINT_JOINTS
from myowarp.kernels.launch import launch
from myowarp.kernels.reset import masked_copy
from myowarp.process import with_build_lock
from myowarp.sim.metabolics import LAWS, WHOLE_BODY_UNITS, Metabolics, MuscleRates, moved_mass
from myowarp.sim.present import present_muscles

if TYPE_CHECKING:
    from myowarp.sim.shard import Shard
    from myowarp.sim.simulation import Simulation

UNITS = {
    "activation": "1",
    "excitation": "1",
    "force": "N",
    "length": "m",
    "velocity": "m/s",
    "power": "W",
    **dict.fromkeys(LAWS, "W"),
}
"""Signals of every muscle, with their units."""

JOINT_UNITS = {"angle": "rad, slides m", "angular_velocity": "rad/s, slides m/s"}
"""Signals of every joint that is a hinge or a slide."""


@wp.struct
class MuscleSignals:
    """Signals of all muscles; arrays (num_worlds, num_muscles).

    Attributes:
        activation: Activation [1].
        excitation: What the muscle was told, after the conditions [1].
        force: Tension that the tendon transmits [N], >= 0.
        length: Musculotendon length [m].
        velocity: Its rate [m/s], lengthening > 0.
        power: -force velocity [W]; > 0 while the muscle does work on the limb.
        bhargava2004: Metabolic rate, heat and work of the fibers [W]; NaN where the muscle model does not
            tell what its fibers do.
        umberger2010: The same after another law [W].
    """

    activation: wp.array2d[float]
    excitation: wp.array2d[float]
    force: wp.array2d[float]
    length: wp.array2d[float]
    velocity: wp.array2d[float]
    power: wp.array2d[float]
    bhargava2004: wp.array2d[float]
    umberger2010: wp.array2d[float]


@wp.kernel(enable_backward=False)
def read_muscles(
    # Params:
    actuator_id: wp.array[int],
    # Data in:
    ctrl_in: wp.array2d[float],
    # In:
    activation: wp.array2d[float],
    tension: wp.array2d[float],
    length: wp.array2d[float],
    velocity: wp.array2d[float],
    rates: MuscleRates,
    everywhere: bool,
    mask: wp.array[bool],
    # Out:
    muscles: MuscleSignals,
):
    """Copy the muscle model's results, everywhere or in the worlds of the mask; power = -tension velocity."""
    worldid, muscleid = wp.tid()
    if not (everywhere or mask[worldid]):
        return
    muscles.activation[worldid, muscleid] = activation[worldid, muscleid]
    muscles.excitation[worldid, muscleid] = ctrl_in[worldid, actuator_id[muscleid]]
    muscles.force[worldid, muscleid] = tension[worldid, muscleid]
    muscles.length[worldid, muscleid] = length[worldid, muscleid]
    muscles.velocity[worldid, muscleid] = velocity[worldid, muscleid]
    muscles.power[worldid, muscleid] = -tension[worldid, muscleid] * velocity[worldid, muscleid]
    muscles.bhargava2004[worldid, muscleid] = rates.bhargava2004[worldid, muscleid]
    muscles.umberger2010[worldid, muscleid] = rates.umberger2010[worldid, muscleid]


class Signals:
    """Signals of a simulation, filled in every step; the trajectory stays the same, bit for bit.

    Attributes:
        names: Muscle names.
        actuator_id: Actuator of each muscle, shape (num_muscles,).
        groups: Group of each muscle, "" where none is known (`Body.groups`).
        muscles: The signals, arrays (num_worlds, num_muscles).
        whole_body: Metabolic rates of the whole body, basal rate included, in W and in W/kg, by name in
            `myowarp.sim.metabolics.WHOLE_BODY_UNITS`, shape (num_worlds,).
        body_mass: Mass of the limbs and trunk that muscles move [kg].
        info: What conditions show of their state, by name, (num_worlds,) or (num_worlds, num_muscles).
        joint_names: Names of the hinges and slides.
        qpos: Configuration, shape (num_worlds, nq); `joint_angles` picks the named joints.
        qvel: Velocity, shape (num_worlds, nv).
        valid: Whether the world was stepped and is healthy, shape (num_worlds,); other rows mean nothing.
        step_count: Control steps since the episode began, the present one included, shape (num_worlds,).
        episode: Number of the episode since the world was seeded, from 1 on, shape (num_worlds,).
    """

    @with_build_lock
    def __init__(self, sim: Simulation) -> None:
        """Allocate the arrays and add their kernels to the step.

        Raises:
            ValueError: The body has no muscles.
        """
        scene = sim.scene
        self.sim, self.names = sim, scene.muscles.names
        if not self.names:
            raise ValueError(f"signals are those of muscles; the body of task {scene.spec.key!r} has none")
        self.groups = tuple(map(BODIES[scene.spec.body].group_of, self.names))
        oracle = scene.oracle
        joints = [j for j in range(oracle.njnt) if oracle.jnt_type[j] in POINT_JOINTS]
        self.joint_names = tuple(oracle.joint(j).name for j in joints)
        self._joint_qpos, self._joint_dof = oracle.jnt_qposadr[joints], oracle.jnt_dofadr[joints]
        with wp.ScopedDevice(scene.device):
            self.muscles = MuscleSignals()
            for name in UNITS:
                setattr(self.muscles, name, wp.zeros_like(scene.muscles.activation))
            self.actuator_id = wp.array(scene.muscles.actuator_id, dtype=int)
            copies = {name: wp.zeros_like(array) for name, array in _sources(sim, sim.info).items()}
            copies |= {name: wp.zeros(sim.num_worlds, dtype=float) for name in WHOLE_BODY_UNITS}
        self.info = {name: copies[name] for name in sim.info}
        self.whole_body = {name: copies[name] for name in WHOLE_BODY_UNITS}
        self.body_mass = moved_mass(scene.oracle)
        self.qpos, self.qvel, self.valid = copies["qpos"], copies["qvel"], copies["valid"]
        self.step_count, self.episode = copies["step_count"], copies["episode"]
        for shard in sim.shards:
            own, muscles = shard.scene.worlds.own, MuscleSignals()
            for name in UNITS:
                setattr(muscles, name, getattr(self.muscles, name)[own])
            self._attach(shard, muscles, {name: array[own] for name, array in copies.items()})

    @property
    def joint_angles(self) -> np.ndarray:
        """Angles of hinges [rad] and positions of slides [m], shape (num_worlds, num_joints); host."""
        return self.qpos.numpy()[:, self._joint_qpos]

    @property
    def joint_velocities(self) -> np.ndarray:
        """Their rates [rad/s, m/s], shape (num_worlds, num_joints); host."""
        return self.qvel.numpy()[:, self._joint_dof]

    def _attach(self, shard: Shard, muscles: MuscleSignals, copies: dict[str, wp.array]) -> None:
        """Add to a shard's step: bring path and force of the muscles to the present state, copy the rest."""
        scene, data = shard.scene, shard.scene.data
        with wp.ScopedDevice(scene.device):
            metabolics = Metabolics(scene)
        compute, sources = present_muscles(scene), _sources(shard, shard.shown) | metabolics.whole_body

        def observe(mask: wp.array | None) -> None:
            compute()
            metabolics.launch()
            where: dict[str, Any] = {"everywhere": mask is None, "mask": mask, "muscles": muscles}
            launch(read_muscles, muscles.force.shape, self, data, scene.muscles, metabolics, **where)
            for name, source in sources.items():
                # What was reset just now is valid, whatever the last step found.
                known = mask if mask is not None and name == "valid" else source
                masked_copy(mask, known, copies[name])

        shard.attach(observe)


def _sources(sim: Simulation | Shard, shown: dict[str, wp.array]) -> dict[str, wp.array]:
    """Return the arrays that are copied as they are, with those that the conditions show."""
    return {
        "qpos": sim.scene.data.qpos,
        "qvel": sim.scene.data.qvel,
        "valid": sim.masks.live,
        "step_count": sim.episode.step_count,
        "episode": sim.scene.keys.episode,
    } | shown

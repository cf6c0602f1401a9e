"""The policy of a gait file: reflexes that excite the muscles of two legs (`myowarp.laws.reflexes`).

    gait_of(scaled, Delays(), {"source": "by hand"}).save(Path("walk.json"))
    myowarp rollout myoLegWalk-v0 --policy walk.json

In every control step, for every world, on the device: what the body senses, as it arrives after the delays
of its nerves, what the reflexes make of it, and an excitation for each group of muscles. A delay lasts the
control steps that are over within it; acting in control steps adds half of one on average. The load of a
foot is what its contacts press with. Muscles of the leg that are in no group rest.

Groups and scales of the parameters are those of MyoSuite 2.12.2, besides toe flexors and extensors with the
soleus and the dorsiflexors, and rotators of the hip.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import warp as wp

from myowarp.disk import in_place
from myowarp.engine.compile import compile_kernels, quiet
from myowarp.engine.graph import Graph
from myowarp.kernels.action import action_of
from myowarp.kernels.launch import launch
from myowarp.laws.reflexes import GROUPS, Phase, Reflexes, Senses, real, stimulate_legs
from myowarp.process import warn_once

if TYPE_CHECKING:
    from myowarp.sim.shard import Shard
    from myowarp.sim.simulation import Simulation

FORMAT = 1
SUFFIX = ".json"
SIDES = "rl"
MUSCLES = {
    "HAB": "sart glmed1 glmed2 glmin2 glmin3",
    "HAD": "addbrev addlong addmagDist addmagIsch addmagMid addmagProx grac",
    "HFL": "psoas iliacus",
    "GLU": "glmax1 glmax2 glmax3 glmed3",
    "HAM": "semimem semiten bflh",
    "RF": "recfem",
    "VAS": "vasint vaslat vasmed",
    "BFSH": "bfsh",
    "GAS": "gaslat gasmed",
    "SOL": "soleus perbrev perlong tibpost fdl fhl",
    "TA": "tibant edl ehl",
    "HIR": "tfl glmin1",
    "HER": "piri",
}
"""Muscles of each group, without their side."""

FELT = ("RF", "VAS", "GAS", "SOL")  # groups whose forces are sensed
NUM_FORCES = 2 * len(FELT)
Forces = wp.types.vector(length=NUM_FORCES, dtype=wp.float64)
JOINTS = ("hip_flexion", "hip_adduction", "knee_angle", "ankle_angle", "hip_rotation")
FOOT = "talus"  # body that carries the foot
GRAVITY = 9.81  # m/s^2
PYRAMIDAL = wp.constant(int(mujoco.mjtCone.mjCONE_PYRAMIDAL))

DEGREE = np.pi / 180.0
SCALES = {
    "pitch": (0.0, 10.0 * DEGREE),
    "leg_angle": (55.0 * DEGREE, 20.0 * DEGREE),
    "leg_angle_speed": (0.0, 2.0 * DEGREE),
    "leg_stops": (0.0, 5.0 * DEGREE),
    "knee_flexed": (120.0 * DEGREE, 20.0 * DEGREE),
    "knee_landing": (160.0 * DEGREE, 15.0 * DEGREE),
    "knee_straight": (165.0 * DEGREE, 10.0 * DEGREE),
    "ankle": (60.0 * DEGREE, 20.0 * DEGREE),
    **{"hfl_pitch": (0.0, 2.0), "hfl_pitch_rate": (0.0, 1.0)},
    **{"hfl_leg": (0.0, 1.0), "hfl_leg_rate": (0.0, 0.1), "hfl_rest": (0.0, 1.0)},
    **{"glu_pitch": (0.0, 2.0), "glu_pitch_rate": (0.0, 0.5)},
    **{"glu_leg": (0.0, 1.0), "glu_leg_rate": (0.0, 0.1), "glu_rest": (0.0, 0.5)},
    **{"ham_glu": (0.0, 1.0), "ham_stop": (0.0, 2.0)},
    **{"rf_force": (0.0, 0.3), "rf_knee_rate": (0.0, 0.1)},
    **{"vas_force": (0.0, 1.0), "vas_straight": (0.0, 2.0), "vas_rest": (0.0, 0.3)},
    **{"bfsh_straight": (0.0, 2.0), "bfsh_leg_rate": (0.0, 0.2), "bfsh_flex": (0.0, 2.0)},
    **{"bfsh_knee_rate": (0.0, 1.0), "bfsh_leg": (0.0, 1.0)},
    **{"bfsh_ham": (0.0, 2.0), "ham_alone": (0.0, 0.3), "bfsh_rest": (0.0, 2.0)},
    **{"gas_force": (0.0, 1.2), "sol_force": (0.0, 1.2), "ta_ankle": (0.0, 2.0), "ta_sol": (0.0, 0.5)},
    "roll": (0.0, 5.0 * DEGREE),
    "leg_spread": (60.0 * DEGREE, 20.0 * DEGREE),
    "leg_spread_speed": (0.0, 10.0 * DEGREE),
    **{"hab_roll": (0.0, 10.0), "hab_roll_rate": (0.0, 1.0), "hab_leg": (0.0, 2.0)},
    **{"had_roll": (0.0, 2.0), "had_roll_rate": (0.0, 0.3), "had_leg": (0.0, 2.0)},
    **{"rotation": (0.0, 1.0), "rotation_rate": (0.0, 0.1)},
}
"""Value of a parameter that is scaled to 0, and what 1 adds, in the order of `Reflexes`."""


def unscaled(scaled: np.ndarray) -> np.ndarray:
    """Return values of parameters, whose order is that of `SCALES`, from scaled ones, shape (..., 48)."""
    zero, one = np.array(list(SCALES.values())).T
    return zero + one * np.asarray(scaled, dtype=float)


@dataclass(frozen=True)
class Delays:
    """From senses to muscles and back [s].

    Attributes:
        hip: Of trunk and hip.
        knee: Of the knee and its muscles.
        foot: Of ankle and sole and their muscles.
    """

    hip: float = 0.005
    knee: float = 0.010
    foot: float = 0.020

    def steps(self, control_dt: float) -> tuple[int, int, int]:
        """Return them in whole control steps of a duration [s]."""
        found = [int(delay / control_dt + 1e-9) for delay in (self.hip, self.knee, self.foot)]
        return found[0], found[1], found[2]


@dataclass(frozen=True)
class Gait:
    """Reflexes of a body.

    Attributes:
        parameters: Values by name in `SCALES` [rad, s, 1].
        delays: Of the nerves; Geyer and Herr's (2010) by default.
        provenance: How it was found.
    """

    parameters: Mapping[str, float]
    delays: Delays = Delays()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def values(self) -> np.ndarray:
        """Parameters in the order of `SCALES`, shape (48,)."""
        return np.array([self.parameters[name] for name in SCALES])

    @property
    def conditions(self) -> tuple[str, ...]:
        """Conditions of the worlds in which it was searched, such as the support of the pelvis."""
        search = self.provenance.get("search")
        return tuple(search.get("conditions", ())) if isinstance(search, dict) else ()

    def save(self, path: Path) -> None:
        """Write it as JSON.

        Raises:
            OSError: The file cannot be written.
        """
        plain = {"format": FORMAT, "parameters": dict(self.parameters), "delays": vars(self.delays)}
        with in_place(path) as scratch:
            scratch.write_text(json.dumps(plain | {"provenance": dict(self.provenance)}, indent=1) + "\n")


def gait_of(scaled: np.ndarray, delays: Delays, provenance: Mapping[str, Any]) -> Gait:
    """Return a gait with scaled parameters, shape (48,)."""
    return Gait(dict(zip(SCALES, unscaled(scaled).tolist(), strict=True)), delays, provenance)


def check_conditions(name: str, gait: Gait, sim: Simulation) -> None:
    """Say once if a gait, called by some name, was searched in other conditions than these worlds have."""
    here = tuple(condition for condition in sim.setup.conditions or () if isinstance(condition, str))
    if gait.conditions != here:
        there, now = (", ".join(conditions) or "none" for conditions in (gait.conditions, here))
        warn_once(f"gait {name!r} was searched with conditions {there} and walks with {now}")


def is_gait(name: str) -> bool:
    """Return whether a policy's name is a gait file."""
    return Path(name).suffix.lower() == SUFFIX


def read_gait(path: Path) -> Gait:
    """Return the gait of a file.

    Raises:
        ValueError: It is no gait.
        OSError: It cannot be read.
    """
    try:
        plain = json.loads(path.read_text())
        parameters = {name: float(plain["parameters"][name]) for name in SCALES}
        delays = Delays(**{name: float(value) for name, value in plain["delays"].items()})
        if plain["format"] != FORMAT or plain["parameters"].keys() != SCALES.keys():
            raise KeyError("parameters")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f"policy {str(path)!r} must be a gait: JSON with format {FORMAT}, {len(SCALES)} parameters and "
            f"delays; got {error!r}"
        ) from None
    numbers = [*parameters.values(), *vars(delays).values()]
    if not np.isfinite(numbers).all() or min(vars(delays).values()) < 0.0:
        raise ValueError(f"policy {str(path)!r} must have finite parameters and delays of at least 0 s")
    return Gait(parameters, delays, plain.get("provenance", {}))


@wp.kernel(enable_backward=False)
def weigh_feet(
    # Model:
    opt_cone: int,
    # Params:
    foot_of_geom: wp.array[int],
    per_weight: float,
    # Data in:
    nacon_in: wp.array[int],
    contact_geom_in: wp.array[wp.vec2i],
    contact_dim_in: wp.array[int],
    contact_worldid_in: wp.array[int],
    contact_efc_address_in: wp.array2d[int],
    efc_force_in: wp.array2d[float],
    # Out:
    load: wp.array2d[float],
):
    """load[world, foot] += normal force of the contact / weight."""
    conid = wp.tid()
    if conid >= nacon_in[0]:
        return
    geoms, worldid = contact_geom_in[conid], contact_worldid_in[conid]
    first, second = foot_of_geom[geoms[0]], foot_of_geom[geoms[1]]
    if first == second:
        return
    rows = int(1)
    if opt_cone == PYRAMIDAL and contact_dim_in[conid] > 1:
        rows = 2 * (contact_dim_in[conid] - 1)
    force = float(0.0)
    for i in range(rows):
        address = contact_efc_address_in[conid, i]
        if address >= 0 and address < efc_force_in.shape[1]:
            force += efc_force_in[worldid, address]
    wp.atomic_add(load, worldid, wp.max(first, second), force * per_weight)


@wp.func
def sense_trunk(turn: wp.quat, qvel: wp.array[float]) -> Senses:
    """Senses of a trunk with the turn R; those of the legs are 0.

    With ahead = R x, left = R y, up = R z: pitch = -asin(ahead_z), roll = atan2(left_z, up_z), and speeds
    along and across the horizontal part of ahead.
    """
    ahead = wp.quat_rotate(turn, wp.vec3(1.0, 0.0, 0.0))
    left = wp.quat_rotate(turn, wp.vec3(0.0, 1.0, 0.0))
    up = wp.quat_rotate(turn, wp.vec3(0.0, 0.0, 1.0))
    heading = wp.normalize(wp.vec2(ahead[0], ahead[1]))
    velocity = wp.vec2(qvel[0], qvel[1])
    s = Senses()
    s.pitch = real(-wp.asin(wp.clamp(ahead[2], -1.0, 1.0)))
    s.roll = real(wp.atan2(left[2], up[2]))
    s.roll_rate = real(qvel[3])
    s.pitch_rate = real(qvel[4])
    s.speed_ahead = real(wp.dot(heading, velocity))
    s.speed_left = real(heading[0] * velocity[1] - heading[1] * velocity[0])
    return s


@wp.kernel(enable_backward=False)
def sense_legs(
    # Params:
    address: wp.array2d[int],
    dof: wp.array2d[int],
    force_share: wp.array2d[float],
    # Data in:
    qpos_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    # In:
    tension: wp.array2d[float],
    load: wp.array2d[float],
    step_count: wp.array[int],
    # Out:
    senses: wp.array2d[Senses],
):
    """Senses of the present state; at the begin of an episode the straighter leg bears the weight."""
    worldid = wp.tid()
    turn = wp.normalize(
        wp.quat(qpos_in[worldid, 4], qpos_in[worldid, 5], qpos_in[worldid, 6], qpos_in[worldid, 3])
    )
    s = sense_trunk(turn, qvel_in[worldid])
    straight, right_angle = real(wp.pi), real(wp.half_pi)
    hip, hip_rate, spread, ankle = wp.vec2d(), wp.vec2d(), wp.vec2d(), wp.vec2d()
    knee, knee_rate, weight = wp.vec2d(), wp.vec2d(), wp.vec2d()
    rotation, rotation_rate = wp.vec2d(), wp.vec2d()
    for leg in range(2):
        hip[leg] = straight - real(qpos_in[worldid, address[leg, 0]])
        hip_rate[leg] = -real(qvel_in[worldid, dof[leg, 0]])
        spread[leg] = right_angle + real(qpos_in[worldid, address[leg, 1]])
        knee[leg] = straight - real(qpos_in[worldid, address[leg, 2]])
        knee_rate[leg] = -real(qvel_in[worldid, dof[leg, 2]])
        ankle[leg] = right_angle - real(qpos_in[worldid, address[leg, 3]])
        rotation[leg] = real(qpos_in[worldid, address[leg, 4]])
        rotation_rate[leg] = real(qvel_in[worldid, dof[leg, 4]])
        weight[leg] = real(load[worldid, leg])
    if step_count[worldid] == 0:  # contacts are still those of another episode
        for leg in range(2):
            weight[leg] = wp.where(knee[leg] > knee[1 - leg], real(1.0), real(0.0))
    forces = Forces()
    for m in range(tension.shape[1]):
        for row in range(wp.static(NUM_FORCES)):
            forces[row] += real(force_share[row, m] * tension[worldid, m])
    s.hip = hip
    s.hip_rate = hip_rate
    s.spread = spread
    s.ankle = ankle
    s.knee = knee
    s.knee_rate = knee_rate
    s.rotation = rotation
    s.rotation_rate = rotation_rate
    s.load = weight
    s.rf_force = wp.vec2d(forces[0], forces[4])
    s.vas_force = wp.vec2d(forces[1], forces[5])
    s.gas_force = wp.vec2d(forces[2], forces[6])
    s.sol_force = wp.vec2d(forces[3], forces[7])
    senses[worldid, step_count[worldid] % senses.shape[1]] = s


class _Legs:
    """The senses of a shard's worlds; attributes are arguments of the kernels above."""

    def __init__(self, shard: Shard, lag: tuple[int, int, int], reflexes: wp.array) -> None:
        """Find joints, muscles and feet, and record the launches.

        Raises:
            ValueError: The body has no two such legs under a free root.
        """
        scene, model = shard.scene, shard.scene.oracle
        names = scene.muscles.names
        try:
            joints = [[model.joint(f"{joint}_{side}") for joint in JOINTS] for side in SIDES]
            feet = [model.body(f"{FOOT}_{side}").id for side in SIDES]
            felt = [
                [names.index(f"{muscle}_{side}") for muscle in MUSCLES[group].split()]
                for side in SIDES
                for group in FELT
            ]
            if model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
                raise KeyError("free root")
        except (KeyError, ValueError) as error:
            raise ValueError(
                f"a gait moves two legs under a free root; the body of task {scene.spec.key!r} has none "
                f"({str(error.args[0]).splitlines()[0]})"
            ) from None
        self.shard, self.num_worlds = shard, scene.num_worlds
        self.address = wp.array([[joint.qposadr[0] for joint in leg] for leg in joints], dtype=int)
        self.dof = wp.array([[joint.dofadr[0] for joint in leg] for leg in joints], dtype=int)
        strength = scene.muscles.geometry().max_isometric_force
        share = np.zeros((len(felt), len(names)), dtype=np.float32)
        for row, muscles in enumerate(felt):
            share[row, muscles] = 1.0 / (len(muscles) * strength[0, muscles])
        self.force_share = wp.array(share, dtype=float)
        self.foot_of_geom = wp.array([_foot(model, int(body), feet) for body in model.geom_bodyid], dtype=int)
        self.per_weight = 1.0 / (GRAVITY * float(model.body_mass.sum()))
        self.load = wp.zeros((self.num_worlds, 2), dtype=float)
        self.senses = wp.zeros((self.num_worlds, max(lag) + 1), dtype=Senses)
        self.phase = wp.zeros((self.num_worlds, 2), dtype=Phase)
        self.stimulation = wp.zeros((self.num_worlds, 2, len(GROUPS)), dtype=real)
        self.lag, self.reflexes = wp.vec3i(*lag), reflexes
        compile_kernels(self._launch, scene.device)
        self._graph = Graph(self._launch, scene.device)

    def stimulate(self) -> np.ndarray:
        """Return what the groups of both legs are told now, shape (num_worlds, 2, 13)."""
        self._graph.launch()
        return np.asarray(self.stimulation.numpy())

    def _launch(self) -> None:
        """Weigh, sense, and stimulate."""
        shard, data = self.shard, self.shard.scene.data
        self.load.zero_()
        launch(
            weigh_feet,
            data.naconmax,
            self,
            data,
            opt_cone=int(shard.scene.model.opt.cone),
            contact_geom=data.contact.geom,
            contact_dim=data.contact.dim,
            contact_worldid=data.contact.worldid,
            contact_efc_address=data.contact.efc_address,
            efc_force=data.efc.force,
        )
        launch(sense_legs, self.num_worlds, self, data, shard.scene.muscles, shard.episode)
        launch(stimulate_legs, (self.num_worlds, 2), self, shard.episode)


def _foot(model: mujoco.MjModel, body: int, feet: Sequence[int]) -> int:
    """Return which foot a body belongs to, 0 the right one, -1 none."""
    while body > 0:
        if body in feet:
            return feet.index(body)
        body = int(model.body_parentid[body])
    return -1


def _rows(values: np.ndarray, shard: Shard) -> np.ndarray:
    """Return the rows of a shard, or the one of all worlds, as the device has them, shape (1 or n,)."""
    kind: Any = Reflexes
    own = shard.scene.worlds.own if len(values) > 1 else slice(1)
    return np.ascontiguousarray(values[own], dtype=float).view(kind.numpy_dtype())[:, 0]


class ReflexControl:
    """Actions of reflexes; worlds may have gaits of their own.

    Attributes:
        legs: Senses and stimulation of both legs, for each shard's worlds.
    """

    def __init__(self, values: np.ndarray, delays: Delays, sim: Simulation) -> None:
        """Find senses and muscles.

        Args:
            values: Parameters in the order of `SCALES`, shape (1 or num_worlds, 48).
            delays: Of all worlds.
            sim: The simulation whose muscles are excited.

        Raises:
            ValueError: The body has no two legs, or there are neither 1 nor num_worlds gaits.
        """
        if values.shape not in ((1, len(SCALES)), (sim.num_worlds, len(SCALES))):
            raise ValueError(
                f"gaits must have shape (1 or {sim.num_worlds}, {len(SCALES)}), got {values.shape}"
            )
        self._sim, scene = sim, sim.scene
        lag = delays.steps(scene.control_dt)
        with quiet(), wp.ScopedDevice(scene.device):
            self.legs = [
                _Legs(shard, lag, wp.array(_rows(values, shard), dtype=Reflexes)) for shard in sim.shards
            ]
        place = {
            f"{muscle}_{side}": leg * len(GROUPS) + group
            for leg, side in enumerate(SIDES)
            for group, name in enumerate(GROUPS)
            for muscle in MUSCLES[name].split()
        }
        names, muscles = scene.muscles.names, scene.muscles.actuator_id
        told = [m for m, name in enumerate(names) if name in place]
        self._group = np.array([place[names[m]] for m in told])
        self._actuator, self._linear = muscles[told], scene.spec.linear_excitation
        self._rest = np.zeros((sim.num_worlds, scene.num_actions), dtype=np.float32)
        self._rest[:, muscles] = action_of(np.zeros(len(muscles)), self._linear)

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Return actions (num_worlds, num_actions) of the step that comes; motors do nothing."""
        told = np.concatenate([legs.stimulate() for legs in self.legs]).reshape(self._sim.num_worlds, -1)
        action = self._rest.copy()
        action[:, self._actuator] = action_of(told[:, self._group], self._linear)
        return action

    def change(self, values: np.ndarray) -> None:
        """Give all worlds other parameters, of the shape of those that there are."""
        for legs in self.legs:
            legs.reflexes.assign(_rows(values, legs.shard))

    def copy(self, source: int, target: int) -> None:
        """Let a world have felt what another one of its shard has, and be in its phase."""
        for legs in self.legs:
            own = legs.shard.scene.worlds.own
            if own.start <= source < own.stop and own.start <= target < own.stop:
                for array in (legs.senses, legs.phase):
                    rows, size = (target - own.start, source - own.start), array.shape[1]
                    wp.copy(array, array, rows[0] * size, rows[1] * size, size)

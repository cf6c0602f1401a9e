"""Tendon transfer: a muscle is rerouted to pull in place of a lost one.

    affected:   the donor pulls along another path; the lost muscle transmits nothing

Muscles and path are facts of the body (`Body.transfer`): in the hand the index finger's second extensor, EIP,
goes to the thumb in place of EPL. The muscle keeps its activation, its strength and its place among actions
and observations. Its fibers are fitted to the new path as MuJoCo fits every muscle: their operating range
spans the lengths that the path takes over the ranges of the joints, so optimal fiber length and tendon slack
length change with the route.

Source: Caggiano et al. (2022), arXiv:2205.13600. MyoSuite's own `myoReaf...` tasks move a command and no
tendon: `reafferentation`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.body import Transfer, fact_for
from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase
from myowarp.definitions.muscle import Anatomy, BiasParams, affine_bias, muscle_index
from myowarp.definitions.parameter import Clock, Curve, Parameter, Value, value_of
from myowarp.kernels.launch import launch

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene
    from myowarp.definitions.task import TaskSpec

ACTUATOR, TENDON = "transferred", "transferred_tendon"  # their names in the model

SCAN = 17
"""Angles per joint that `path_range` tries; 129 change the hand's range by 0.02 mm of 49 mm."""


@dataclass(frozen=True, eq=False)
class TendonTransfer(Condition):
    """The donor pulls in place of the lost muscle, which is gone.

    Attributes:
        affected: Whether a world has the transfer: from 0.5 on; 0 is healthy. A `Ramp` is surgery at a time.
    """

    PHASE = Phase.TRANSMISSION
    WRITES = ("the path of the transferred muscle",)
    NEUTRAL: ClassVar = {"affected": 0.0}
    TITLE = "tendon transfer"
    LABELS: ClassVar = {"affected": "operated"}
    scene_key = (ACTUATOR,)
    undriven = (ACTUATOR,)  # the donor drives it

    affected: Value = 1.0

    def check(self, spec: TaskSpec) -> None:
        """Raise ValueError if the body names no muscles for it."""
        transfer_of(spec.body)

    def edit(self, spec: mujoco.MjSpec, body: str) -> None:
        """Add the new path, and an actuator on it that is idle until the donor drives it."""
        tendon = spec.add_tendon(name=TENDON)
        for element in transfer_of(body).path:
            if len(element) == 1:
                tendon.wrap_site(*element)
            else:
                tendon.wrap_geom(*element)
        actuator = spec.add_actuator(name=ACTUATOR, target=TENDON)
        actuator.trntype = mujoco.mjtTrn.mjTRN_TENDON
        actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
        actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.gainprm = actuator.biasprm = np.zeros(10)

    def bind(self, scene: Scene, clock: Clock) -> TendonTransferEffect:
        """Find the muscles and both ranges of lengths."""
        return TendonTransferEffect(scene, clock, affected_parameter("tendon_transfer", self.affected, scene))


def transfer_of(body: str, what: str = "have a tendon transfer") -> Transfer:
    """Return the muscles of a body that a transfer is about; raises ValueError if it has none."""
    transfer: Transfer = fact_for(what, body, "transfer")
    return transfer


def affected_parameter(name: str, value: Value, scene: Scene) -> Parameter:
    """Return the parameter `affected` of a condition: one number a world, 0..1."""
    return Parameter(f"{name} affected", value, scene, (), neutral=0.0, low=0.0, high=1.0)


@wp.func
def is_affected(curve: Curve, clock: Clock, worldid: int) -> bool:
    """Return whether a world is affected now: from a value of 0.5 on."""
    return value_of(curve, clock, worldid, 0) >= 0.5


def path_range(model: mujoco.MjModel, tendon: int) -> tuple[float, float]:
    """Return the least and the greatest length [m] of a tendon over the ranges of the joints that move it.

    One joint after the other is set to the best of `SCAN` angles, until none makes it better. This is the
    range that MuJoCo's `mj_setLengthRange` looks for by pulling; in the hand its simulation diverges.
    """
    data = mujoco.MjData(model)
    first, count = model.ten_J_rowadr[tendon], model.ten_J_rownnz[tendon]
    joints = np.unique(model.dof_jntid[model.ten_J_colind[first : first + count]])
    angles = {}
    for joint in joints[model.jnt_limited[joints] != 0]:
        low, high = model.jnt_range[joint]
        angles[model.jnt_qposadr[joint]] = np.linspace(low, high, SCAN)

    def length(qpos: np.ndarray) -> float:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        return float(data.ten_length[tendon])

    def extreme(sign: float) -> float:
        best, qpos, before = sign * length(model.qpos0), model.qpos0.copy(), -np.inf
        while best > before:
            before = best
            for address, values in angles.items():
                trial = qpos.copy()
                for trial[address] in values:
                    if sign * length(trial) > best:
                        best, qpos = sign * length(trial), trial.copy()
        return sign * best

    return extreme(-1.0), extreme(1.0)


@wp.struct
class Route:
    """A muscle and the path that it pulls.

    Attributes:
        donor: Muscle that is rerouted.
        lost: Muscle that is gone.
        own: Actuator on the donor's own path.
        transferred: Actuator on its new path.
        affected: Whether a world has the transfer.
    """

    donor: int
    lost: int
    own: int
    transferred: int
    affected: Curve


@wp.kernel(enable_backward=False)
def reroute(
    # Params:
    route: Route,
    # In:
    clock: Clock,
    # Out:
    anatomy: Anatomy,
    affected: wp.array[bool],
    healthy: wp.array[bool],
    actuator_biasprm: wp.array2d[BiasParams],
):
    """path[donor] = transferred or own, the other one idle; transmission[lost] = 0 where affected."""
    worldid = wp.tid()
    moved = is_affected(route.affected, clock, worldid)
    if moved:
        anatomy.transmission[worldid, route.lost] = 0.0
    anatomy.path[worldid, route.donor] = wp.where(moved, route.transferred, route.own)
    # What pulled in the step before has to let go.
    actuator_biasprm[worldid, wp.where(moved, route.own, route.transferred)] = affine_bias(0.0, 0.0, 0.0)
    affected[worldid] = moved
    healthy[worldid] = not moved


class TendonTransferEffect(Effect):
    """A tendon transfer in a scene.

    Attributes:
        length_range: Least and greatest length [m] of the new path.
        own_length_range: Those of the donor's own path, from the model.
    """

    def __init__(self, scene: Scene, clock: Clock, parameter: Parameter) -> None:
        self.scene, self.clock, self.parameter, self.drawn = scene, clock, parameter, (parameter,)
        oracle, muscles = scene.oracle, scene.muscles
        self.route = Route()
        transfer = transfer_of(scene.spec.body)
        self.route.donor = muscle_index(transfer.donor, muscles.names)
        self.route.lost = muscle_index(transfer.lost, muscles.names)
        self.route.own = int(muscles.actuator_id[self.route.donor])
        self.route.transferred = oracle.actuator(ACTUATOR).id
        self.route.affected = parameter.curve
        self.length_range = path_range(oracle, oracle.tendon(TENDON).id)
        self.own_length_range = tuple(oracle.actuator_lengthrange[self.route.own])
        self.affected = wp.zeros(scene.num_worlds, dtype=bool)
        self.healthy = wp.ones(scene.num_worlds, dtype=bool)

    def act(self) -> None:
        """Launch `reroute`, and fit the fibers to the path."""
        scene, muscles = self.scene, self.scene.muscles
        launch(reroute, scene.num_worlds, self, muscles, scene.model)
        muscles.set_length_range(self.route.donor, self.length_range, self.affected)
        muscles.set_length_range(self.route.donor, self.own_length_range, self.healthy)


CONDITIONS.add("tendon_transfer", TendonTransfer)

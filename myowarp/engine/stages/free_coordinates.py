"""Joints that follow others exactly: what is integrated are the coordinates u that follow none.

With q = g(u), each joint a function of one coordinate, velocities are J u' and accelerations J u'' + a, where
J = dg/du has one entry in a row and a_i = g_i'' u'^2 (`models.couplings`). What acts on joints acts on
coordinates by J':

    M_r u'' = J'(forces - M a) + (row J)' f,    row J u'' = aref - row a,    M_r = J' M J

(d'Alembert's principle; Featherstone, Rigid Body Dynamics Algorithms, 2008, section 3.2.) Nothing but g holds
the joints that follow: they have no equalities and do not drift; their bodies weigh what the document says.
The free coordinates are a scene of their own, a chain of slides, whose inertia, forces and rows are written
here; the solver and the integrator, ours or the engine's, see no difference.
"""

import copy
import dataclasses
from typing import Any, ClassVar

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp import IntegratorType

from myowarp.definitions.scene import Scene
from myowarp.engine.stage import Launches, Stage, not_exact
from myowarp.engine.stages.arrays import InertiaRows, any_of, filled
from myowarp.engine.stages.hinge_triples import (
    Bodies,
    LimitRows,
    straighten_dynamics,
    straighten_rows,
    straighten_speeds,
    triple_tables,
    triples_of,
    turn_triples,
)
from myowarp.kernels.batching import batched
from myowarp.kernels.launch import launch
from myowarp.models.couplings import (
    NOTHING,
    POINT_JOINTS,
    REGULAR,
    Coupling,
    Exact,
    couplings,
    exact,
    jacobian,
    regularity,
)

SAME_MASS = 1e-9  # relative; a body that has taken in others, or was made heavier, keeps its mass


@wp.struct
class Followers:
    """How joints follow coordinates; pieces are those of `models.couplings.Pieces`.

    Attributes:
        joint: Joint that shows each coordinate, shape (num_coordinates,).
        coordinate: That each joint follows, shape (nv,).
        first_curve: Of each joint, and the number of all, shape (nv + 1,).
        first_piece: Of each curve, and the number of all, shape (num_curves + 1,).
        breaks: Where pieces begin, shape (num_pieces,).
        coefficients: Ascending in powers of the distance from there, shape (num_pieces, num_terms).
    """

    joint: wp.array[int]
    coordinate: wp.array[int]
    first_curve: wp.array[int]
    first_piece: wp.array[int]
    breaks: wp.array[float]
    coefficients: wp.array2d[float]


@wp.struct
class Coordinates:
    """State of the free coordinates; fields are those of the engine's `Data`."""

    qpos: wp.array2d[float]
    qvel: wp.array2d[float]
    qacc: wp.array2d[float]
    qacc_warmstart: wp.array2d[float]


@wp.struct
class Moments:
    """What actuators do along all joints; fields are those of the engine's `Data`."""

    moment_rownnz: wp.array2d[int]
    moment_rowadr: wp.array2d[int]
    moment_colind: wp.array2d[int]
    actuator_moment: wp.array2d[float]


@wp.struct
class Damping:
    """What slows down joints; fields are those of the engine's `Model`."""

    dof_damping: wp.array2d[float]
    dof_dampingpoly: wp.array2d[wp.vec2]


@wp.struct
class RowJacobian:
    """Constraint rows; fields are those of the engine's `Data.efc`; J is dense where `J_rownnz` is empty."""

    J_rownnz: wp.array2d[int]
    J_rowadr: wp.array2d[int]
    J_colind: wp.array3d[int]
    J: wp.array3d[float]
    aref: wp.array2d[float]


@wp.struct
class Reduced:
    """Where what acts along the free coordinates is written; fields are those of `Data` and `Model`."""

    M: wp.array2d[float]
    qfrc_applied: wp.array2d[float]
    dof_damping: wp.array2d[float]
    actuator_moment: wp.array2d[float]


@wp.func
def shown(followers: Followers, joint: int, u: float) -> wp.vec3:
    """Return the value of a joint, its slope and its second derivative by the coordinate u."""
    value, slope, bend = float(u), float(1.0), float(0.0)
    for curve in range(followers.first_curve[joint], followers.first_curve[joint + 1]):
        piece, end = int(followers.first_piece[curve]), followers.first_piece[curve + 1]
        while piece + 1 < end and value >= followers.breaks[piece + 1]:
            piece += 1
        d = value - followers.breaks[piece]
        f, df, half_ddf = float(0.0), float(0.0), float(0.0)
        for k in range(followers.coefficients.shape[1] - 1, -1, -1):
            half_ddf = half_ddf * d + df
            df = df * d + f
            f = f * d + followers.coefficients[piece, k]
        bend = 2.0 * half_ddf * slope * slope + df * bend
        slope = df * slope
        value = f
    return wp.vec3(value, slope, bend)


@wp.kernel(enable_backward=False)
def follow_coordinates(
    # Params:
    followers: Followers,
    # Data in:
    qacc_warmstart_in: wp.array2d[float],
    # Data out:
    qpos_out: wp.array2d[float],
    qvel_out: wp.array2d[float],
    # Out:
    free: Coordinates,
    slopes: wp.array2d[float],
    excess: wp.array2d[float],
):
    """u = q of the joints that show it; q = g(u), q' = J u'; slopes = J, excess = g'' u'^2."""
    worldid = wp.tid()
    for i in range(followers.joint.shape[0]):
        joint = followers.joint[i]
        free.qpos[worldid, i] = qpos_out[worldid, joint]
        free.qvel[worldid, i] = qvel_out[worldid, joint]
        free.qacc_warmstart[worldid, i] = qacc_warmstart_in[worldid, joint]
    for joint in range(followers.coordinate.shape[0]):
        i = followers.coordinate[joint]
        speed = free.qvel[worldid, i]
        g = shown(followers, joint, free.qpos[worldid, i])
        qpos_out[worldid, joint] = g[0]
        qvel_out[worldid, joint] = g[1] * speed
        slopes[worldid, joint] = g[1]
        excess[worldid, joint] = g[2] * speed * speed


@wp.kernel(enable_backward=False)
def reduce_dynamics(
    # Params:
    followers: Followers,
    inertia: InertiaRows,
    damping: Damping,
    # Data in:
    M_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    qfrc_applied_in: wp.array2d[float],
    qfrc_passive_in: wp.array2d[float],
    qfrc_actuator_in: wp.array2d[float],
    qfrc_bias_in: wp.array2d[float],
    # In:
    slopes: wp.array2d[float],
    excess: wp.array2d[float],
    # Out:
    reduced: Reduced,
):
    """M_r = J' M J, forces_r = J'(forces - M a), damping_r = J' dF/dv J; every joint has one entry in J."""
    worldid = wp.tid()
    for k in range(reduced.M.shape[1]):
        reduced.M[worldid, k] = 0.0
    for i in range(reduced.qfrc_applied.shape[1]):
        reduced.qfrc_applied[worldid, i] = 0.0
        reduced.dof_damping[worldid, i] = 0.0
    linear = batched(worldid, damping.dof_damping.shape[0])
    more = batched(worldid, damping.dof_dampingpoly.shape[0])
    for row in range(slopes.shape[1]):
        p, s, a = followers.coordinate[row], slopes[worldid, row], excess[worldid, row]
        force = qfrc_applied_in[worldid, row] + qfrc_passive_in[worldid, row]
        force += qfrc_actuator_in[worldid, row] - qfrc_bias_in[worldid, row]
        speed, rise = wp.abs(qvel_in[worldid, row]), damping.dof_dampingpoly[more, row]
        drag = damping.dof_damping[linear, row] + speed * (2.0 * rise[0] + 3.0 * speed * rise[1])
        reduced.dof_damping[worldid, p] += s * s * drag
        first = inertia.M_rowadr[row]
        for k in range(inertia.M_rownnz[row]):
            column, m = inertia.M_colind[first + k], M_in[worldid, first + k]
            o, t = followers.coordinate[column], slopes[worldid, column]
            high, low = wp.max(p, o), wp.min(p, o)
            # Below the diagonal of M stands one of two equal entries; on that of M_r both fall.
            both = wp.where(column != row and high == low, 2.0, 1.0)
            reduced.M[worldid, high * (high + 1) // 2 + low] += both * s * t * m
            force -= m * excess[worldid, column]
            if column != row:
                reduced.qfrc_applied[worldid, o] -= t * m * a
        reduced.qfrc_applied[worldid, p] += s * force


@wp.kernel(enable_backward=False)
def reduce_rows(
    # Params:
    followers: Followers,
    # Data in:
    nefc_in: wp.array[int],
    # In:
    moments: Moments,
    slopes: wp.array2d[float],
    excess: wp.array2d[float],
    rows: RowJacobian,
    # Out:
    free_rows: RowJacobian,
    reduced: Reduced,
):
    """row_r = row J, aref_r = aref - row a; moment_r = moment J."""
    worldid = wp.tid()
    number = followers.joint.shape[0]
    for row in range(wp.min(nefc_in[worldid], rows.aref.shape[1])):
        for i in range(number):
            free_rows.J[worldid, row, i] = 0.0
        target = rows.aref[worldid, row]
        count, sparse = slopes.shape[1], rows.J_rownnz.shape[1] > 0
        if sparse:
            count = rows.J_rownnz[worldid, row]
        for k in range(count):
            joint, entry = int(k), float(0.0)
            if sparse:
                joint = rows.J_colind[worldid, 0, rows.J_rowadr[worldid, row] + k]
                entry = rows.J[worldid, 0, rows.J_rowadr[worldid, row] + k]
            else:
                entry = rows.J[worldid, row, k]
            if entry != 0.0:
                free_rows.J[worldid, row, followers.coordinate[joint]] += entry * slopes[worldid, joint]
                target -= entry * excess[worldid, joint]
        free_rows.aref[worldid, row] = target
    for k in range(reduced.actuator_moment.shape[1]):
        reduced.actuator_moment[worldid, k] = 0.0
    for actuator in range(moments.moment_rownnz.shape[1]):
        first = moments.moment_rowadr[worldid, actuator]
        for k in range(first, first + moments.moment_rownnz[worldid, actuator]):
            joint = moments.moment_colind[worldid, k]
            place = actuator * number + followers.coordinate[joint]
            reduced.actuator_moment[worldid, place] += (
                moments.actuator_moment[worldid, k] * slopes[worldid, joint]
            )


@wp.kernel(enable_backward=False)
def expand_coordinates(
    # Params:
    followers: Followers,
    # In:
    free: Coordinates,
    slopes: wp.array2d[float],
    excess: wp.array2d[float],
    # Data out:
    qpos_out: wp.array2d[float],
    qvel_out: wp.array2d[float],
    qacc_out: wp.array2d[float],
    qacc_warmstart_out: wp.array2d[float],
):
    """q = g(u), q' = J u' after the step; q'' = J u'' + a, of its beginning."""
    worldid = wp.tid()
    for joint in range(followers.coordinate.shape[0]):
        i = followers.coordinate[joint]
        g = shown(followers, joint, free.qpos[worldid, i])
        qpos_out[worldid, joint] = g[0]
        qvel_out[worldid, joint] = g[1] * free.qvel[worldid, i]
        acceleration = slopes[worldid, joint] * free.qacc[worldid, i] + excess[worldid, joint]
        qacc_out[worldid, joint] = acceleration
        qacc_warmstart_out[worldid, joint] = acceleration


def tables(model: mujoco.MjModel, ties: list[Coupling]) -> Followers:
    """Return how the joints of a model follow, on the current Warp device."""
    chains = {tie.joint: tie for tie in ties}
    free = [joint for joint in range(model.njnt) if joint not in chains]
    # One that follows nothing follows the first coordinate, by a constant.
    coordinate = [
        free.index(chains[joint].driver) if joint in chains and chains[joint].driver >= 0 else 0
        for joint in range(model.njnt)
    ]
    for number, joint in enumerate(free):
        coordinate[joint] = number
    lists = [chains[joint].curves if joint in chains else () for joint in range(model.njnt)]
    curves = [curve for chain in lists for curve in chain]
    terms = max((len(row) for curve in curves for row in curve.coefficients), default=1)
    coefficients = [
        (*row, *[0.0] * (terms - len(row))) for curve in curves for row in curve.coefficients
    ] or [(0.0,)]
    breaks = [place for curve in curves for place in curve.breaks] or [0.0]
    followers = Followers()
    followers.joint, followers.coordinate = wp.array(free, dtype=int), wp.array(coordinate, dtype=int)
    followers.first_curve = wp.array(np.cumsum([0, *map(len, lists)]), dtype=int)
    followers.first_piece = wp.array(np.cumsum([0, *(len(curve.breaks) for curve in curves)]), dtype=int)
    followers.breaks, followers.coefficients = (
        wp.array(breaks, dtype=float),
        wp.array(np.array(coefficients), dtype=float),
    )
    return followers


def document_masses(model: mujoco.MjModel, said: Exact) -> None:
    """Give bodies their masses in the document, and joints that follow no inertia of their own, in place."""
    for name, (mass, inertia) in said.bodies.items():
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
        same = body >= 0 and abs(model.body_mass[body] - mass) <= SAME_MASS * mass
        if body >= 0 and (same or mass == 0):
            model.body_mass[body], model.body_inertia[body] = mass, inertia
            model.body_gravcomp[body] *= mass > 0
    model.body_subtreemass[:] = model.body_mass
    for body in range(model.nbody - 1, 0, -1):
        model.body_subtreemass[model.body_parentid[body]] += model.body_subtreemass[body]
    for joint in said.curves:
        model.dof_armature[model.joint(joint).dofadr] = 0.0
    model.dof_simplenum[:] = 0  # MuJoCo keeps the inertia of bodies that stand alone


def inertia_of(
    model: mujoco.MjModel, ties: list[Coupling], qpos: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return M_r, shape (n, n), and J, shape (nv, n), in a pose, in float64."""
    data, M = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_crb(model, data)
    mujoco.mj_fullM(model, data, M)
    _, J, _ = jacobian(model, ties, qpos)
    return J.T @ M @ J, J


def document_model(scene: Scene) -> mujoco.MjModel:
    """Return the scene's model with the masses of the document, host."""
    model, said = copy.copy(scene.oracle), exact(scene.oracle)
    document_masses(model, NOTHING if said is None else said)
    return model


def _massless(scene: Scene) -> bool:
    """Whether a coordinate moves nothing that has a mass."""
    start = scene.qpos_start.numpy().astype(float)
    M, _ = inertia_of(document_model(scene), couplings(scene.oracle), start)
    return regularity(M) < REGULAR


def chain_of_slides(model: mjw.Model, number: int) -> mujoco.MjModel:
    """Return a model with so many coordinates, any two of which share inertia, and actuators of a number."""
    spec = mujoco.MjSpec()
    body = spec.worldbody
    for index in range(number):
        body = body.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0), explicitinertial=True)
        body.add_joint(name=str(index), type=mujoco.mjtJoint.mjJNT_SLIDE)
    for _ in range(model.nactuator):
        spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target="0")
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    return spec.compile()


SHARED = (
    *("time", "overflow", "nefc", "ne", "nf", "nl", "nacon", "ncollision", "solver_niter"),
    *("ctrl", "act", "act_dot", "actuator_length", "actuator_velocity", "actuator_force"),
)
"""Arrays of `Data` that both scenes have in common."""
SHARED_ROWS = ("type", "id", "pos", "margin", "D", "vel", "frictionloss", "force", "state")
"""The same of `Data.efc`."""


def free_scene(scene: Scene, number: int) -> Scene:
    """Return a scene with so many coordinates; its rows are the scene's, but for their Jacobian."""
    full, worlds = scene.model, scene.data.nworld
    chain = chain_of_slides(full, number)
    model = mjw.put_model(chain)
    sizes = scene.capacity
    data = mjw.make_data(chain, nworld=worlds, nconmax=sizes.contacts, njmax=sizes.rows)
    for name in vars(full):
        if name.startswith("actuator_") and name not in ("actuator_trntype", "actuator_trnid"):
            setattr(model, name, getattr(full, name))
    model.opt = full.opt
    model.dof_damping = wp.zeros((worlds, number), dtype=float)
    for holder, source, names in ((data, scene.data, SHARED), (data.efc, scene.data.efc, SHARED_ROWS)):
        for name in names:
            setattr(holder, name, getattr(source, name))
    places = np.tile(np.arange(full.nactuator), (worlds, 1))
    data.moment_rownnz = wp.full((worlds, full.nactuator), number, dtype=int)
    data.moment_rowadr = wp.array(places * number, dtype=int)
    columns = np.tile(np.arange(number), (worlds, full.nactuator))
    data.moment_colind = wp.array(columns, dtype=int)
    data.actuator_moment = wp.zeros((worlds, full.nactuator * number), dtype=float)
    return dataclasses.replace(scene, oracle=chain, model=model, data=data)


def _implicitly(scene: Scene, *arrays: Any) -> bool:
    """Whether these are not all zero, and forces are integrated implicitly."""
    return scene.model.opt.integrator != IntegratorType.EULER and any_of(*arrays)


class FreeCoordinates(Stage):
    """Coordinates that follow none, for the places from `reduce` on.

    It is no other way to the engine's step but another step, where the model asks for it; other stages are
    compared with the engine's in its company.
    """

    inner: Scene
    REPLACES = ("follow", "reduce", "expand")
    ON_CUDA = True
    OBSTACLES: ClassVar = {
        "nothing is free": lambda scene: scene.oracle.njnt <= len(couplings(scene.oracle)),
        "a joint is a ball or free": lambda scene: not np.isin(scene.oracle.jnt_type, POINT_JOINTS).all(),
        "joints follow each other in a ring": lambda scene: bool(
            {tie.joint for tie in couplings(scene.oracle)} & {tie.driver for tie in couplings(scene.oracle)}
        ),
        "a joint follows twice": lambda scene: (
            len({tie.joint for tie in couplings(scene.oracle)}) < len(couplings(scene.oracle))
        ),
        "the friction cone is elliptic": lambda scene: scene.model.opt.cone != mjw.ConeType.PYRAMIDAL,
        "noslip iterations are on": lambda scene: scene.model.opt.noslip_iterations > 0,
        "the integrator takes in all of dF/dv": lambda scene: (
            scene.model.opt.integrator == IntegratorType.IMPLICIT
        ),
        "actuators have a state in the engine": lambda scene: scene.model.na > 0 or scene.model.nhistory > 0,
        "actuators damp joints or tendons": lambda scene: any_of(
            scene.model.actuator_damping, scene.model.actuator_dampingpoly
        ),
        "tendons are damped implicitly": lambda scene: _implicitly(
            scene, scene.model.tendon_damping, scene.model.tendon_dampingpoly
        ),
        "forces are limited at tendons or joints, and implicit": lambda scene: _implicitly(
            scene, scene.model.tendon_actfrclimited, scene.model.jnt_actfrclimited
        ),
        "a fluid resists": lambda scene: bool(scene.model.has_fluid),
        "the model's masses leave a coordinate without inertia": _massless,
        "there are plastic springs": lambda scene: bool(scene.model.nplastic),
    }

    @classmethod
    def obstacle(cls, scene: Scene) -> str | None:
        """Return why joints follow by equalities here; a line is logged where the model asks for more."""
        said = exact(scene.oracle)
        if said is None or not (couplings(scene.oracle) or said.turns_otherwise):
            return "the model does not ask for it"
        reason = super().obstacle(scene)
        if reason is not None:
            not_exact(reason)
        return reason

    def __init__(self, scene: Scene) -> None:
        """Take equalities and light bodies out of the scene's model, and make the coordinates' scene."""
        super().__init__(scene)
        ties, host = couplings(scene.oracle), document_model(scene)
        M, J = inertia_of(host, ties, scene.qpos_start.numpy().astype(float))
        # What a unit of force along a joint does to it: decides how soft limits and friction are.
        host.dof_invweight0[:] = np.einsum("ij,ji->i", J, np.linalg.solve(M, J.T))
        masses = ("body_mass", "body_inertia", "body_subtreemass", "body_gravcomp", "dof_armature")
        for name in (*masses, "dof_invweight0"):
            array, values = getattr(scene.model, name), getattr(host, name)
            array.assign(np.broadcast_to(values, array.numpy().shape))
        others = [i for i in scene.model.eq_jnt_adr.numpy() if not host.eq_active0[i]]
        with wp.ScopedDevice(scene.device):
            scene.model.eq_jnt_adr = wp.array(others, dtype=int)
            self.followers = tables(host, ties)
            self.inner = free_scene(scene, self.followers.joint.shape[0])
            self.slopes, self.excess = wp.zeros_like(scene.data.qvel), wp.zeros_like(scene.data.qvel)
            found = triples_of(host, ties)
            self.triples = triple_tables(host, found, self.followers.coordinate.numpy()) if found else None
            self.directions = wp.zeros(scene.data.qvel.shape, dtype=wp.spatial_vector)

    def launches(self, replaced: frozenset[str]) -> dict[str, Launches]:
        """Return what comes first in a step, before the accelerations, and last."""
        return {"follow": self.follow, "reduce": self.reduce, "expand": self.expand}

    def follow(self, model: mjw.Model, data: mjw.Data) -> None:
        """Read the coordinates, and put all joints where they belong."""
        launch(
            follow_coordinates,
            data.nworld,
            data,
            self,
            free=filled(Coordinates, self.inner.data),
        )
        if self.triples is not None:
            free = self.inner.data
            launch(
                straighten_speeds,
                (free.nworld, self.triples.joint.shape[0]),
                self,
                positions=free.qpos,
                speeds=free.qvel,
                accelerations=free.qacc_warmstart,
            )

    def reduce(self, model: mjw.Model, data: mjw.Data) -> None:
        """Write inertia, forces, damping, moment arms and rows along the coordinates."""
        inner = self.inner
        reduced = filled(Reduced, inner.data, inner.model)
        if self.triples is not None:
            launch(straighten_dynamics, data.nworld, data, self, bodies=filled(Bodies, model, data))
        launch(
            reduce_dynamics,
            data.nworld,
            data,
            self,
            inertia=filled(InertiaRows, model),
            damping=filled(Damping, model),
            reduced=reduced,
        )
        launch(
            reduce_rows,
            data.nworld,
            data,
            self,
            moments=filled(Moments, data),
            rows=filled(RowJacobian, data.efc),
            free_rows=filled(RowJacobian, inner.data.efc),
            reduced=reduced,
        )
        if self.triples is not None:
            moments = reduced.actuator_moment.reshape((data.nworld, -1, inner.data.qvel.shape[1]))
            launch(
                straighten_rows,
                data.nworld,
                data,
                self,
                model.opt,
                rows=filled(LimitRows, inner.data.efc),
                positions=inner.data.qpos,
                J=inner.data.efc.J,
                actuator_moment=moments,
            )

    def expand(self, model: mjw.Model, data: mjw.Data) -> None:
        """Put all joints where the coordinates are now."""
        if self.triples is not None:
            free = self.inner.data
            launch(
                turn_triples,
                (free.nworld, self.triples.joint.shape[0]),
                data,
                model.opt,
                self,
                positions=free.qpos,
                speeds=free.qvel,
                accelerations=free.qacc,
            )
        launch(
            expand_coordinates,
            data.nworld,
            data,
            self,
            free=filled(Coordinates, self.inner.data),
        )

    launch = follow

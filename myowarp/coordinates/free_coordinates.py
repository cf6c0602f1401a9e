"""Joints that follow others exactly: what is integrated are the coordinates u that follow none.

With q = g(u), each joint a function of one coordinate, velocities are J u' and accelerations J u'' + a, where
J = dg/du has one entry in a row and a_i = g_i'' u'^2 (`couplings`). What acts on joints acts on coordinates
by J':

    M_r u'' = J'(forces - M a) + (row J)' f,    row J u'' = aref - row a,    M_r = J' M J

(d'Alembert's principle; Featherstone, Rigid Body Dynamics Algorithms, 2008, section 3.2.) Nothing but g holds
the joints that follow: they have no equalities and do not drift; their bodies weigh what the document says.
A ball or free joint follows none and is followed by none: its u' are the velocities of its dofs. The free
coordinates are a model of their own, a chain of slides and balls, whose inertia, forces and rows are written
here (`reduction`); the solver and the integrator, ours or the engine's, see no difference. A body that floats
alone is integrated with the others, without the engine's implicit gyroscopic term.
"""

import copy
import dataclasses
from collections.abc import Callable
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp import IntegratorType

from myowarp.coordinates.hinge_triples import (
    Bodies,
    LimitRows,
    straighten_dynamics,
    straighten_rows,
    straighten_speeds,
    triple_tables,
    triples_of,
    turn_triples,
)
from myowarp.coordinates.loops import close_loops, loop_factors
from myowarp.coordinates.reduction import (
    Acting,
    Coordinates,
    Damping,
    Followers,
    Moments,
    Reduced,
    RowJacobian,
    expand_coordinates,
    follow_coordinates,
    reduce_dynamics,
    reduce_rows,
)
from myowarp.coordinates.reduction_lanes import reduce_blocks
from myowarp.engine.stage import Obstacles, Stage, first_reason
from myowarp.engine.stages.arrays import InertiaRows, any_of, filled
from myowarp.engine.step import MOTION, Step
from myowarp.engine.stepped import Stepped
from myowarp.engine.verify import set_state
from myowarp.kernels.lanes import block_scratch
from myowarp.kernels.launch import launch
from myowarp.kernels.structs import struct_of
from myowarp.laws.pieces import packed
from myowarp.osim.bundle.couplings import (
    NOTHING,
    REGULAR,
    Coupling,
    Couplings,
    couplings,
    jacobian,
    regularity,
)
from myowarp.osim.bundle.loops import loop_rows

SAME_MASS = 1e-9  # relative; a body that has taken in others, or was made heavier, keeps its mass
MOST_DENSE = 60  # columns of J that mujoco-warp holds densely
BALL, FREE = mujoco.mjtJoint.mjJNT_BALL.value, mujoco.mjtJoint.mjJNT_FREE.value
HINGE, SLIDE = mujoco.mjtJoint.mjJNT_HINGE.value, mujoco.mjtJoint.mjJNT_SLIDE.value
DOFS = {BALL: 3, FREE: 6}
LINKS = {HINGE: (SLIDE,), SLIDE: (SLIDE,), BALL: (BALL,), FREE: (SLIDE, SLIDE, SLIDE, BALL)}
"""Kind of a joint: the joints of a chain that move as it does."""


def tables(model: mujoco.MjModel, ties: list[Coupling]) -> Followers:
    """Return how the degrees of freedom of a model follow, on the current Warp device."""
    chains = {int(model.jnt_dofadr[tie.joint]): tie for tie in ties}
    free = [dof for dof in range(model.nv) if dof not in chains]
    # One that follows nothing follows the first coordinate, by a constant.
    coordinate = [
        free.index(model.jnt_dofadr[chains[dof].driver]) if dof in chains and chains[dof].driver >= 0 else 0
        for dof in range(model.nv)
    ]
    for number, dof in enumerate(free):
        coordinate[dof] = number
    joints = [joint for joint in range(model.njnt) if model.jnt_dofadr[joint] not in chains]
    ends = np.append(model.jnt_qposadr, model.nq)
    places = np.concatenate([np.arange(ends[joint], ends[joint + 1]) for joint in joints])
    kinds, address = model.jnt_type[model.dof_jntid], model.jnt_qposadr[model.dof_jntid]
    shown = address[np.array(free)[coordinate]]
    position = np.where(np.isin(kinds, (BALL, FREE)), -1, np.searchsorted(places, shown))
    lists = [chains[dof].curves if dof in chains else () for dof in range(model.nv)]
    return struct_of(
        Followers,
        place=places,
        dof=free,
        coordinate=coordinate,
        position=position,
        address=address,
        **packed(lists),
    )


def document_masses(model: mujoco.MjModel, said: Couplings) -> None:
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


def document_model(oracle: mujoco.MjModel) -> mujoco.MjModel:
    """Return a model with the masses of the document."""
    model, said = copy.copy(oracle), Couplings.of(oracle)
    document_masses(model, NOTHING if said is None else said)
    return model


def _massless(stepped: Stepped) -> bool:
    """Whether a coordinate moves nothing that has a mass."""
    start = stepped.qpos_start.numpy().astype(float)
    M, _ = inertia_of(document_model(stepped.oracle), couplings(stepped.oracle), start)
    return regularity(M) < REGULAR


def chain(model: mujoco.MjModel, ties: list[Coupling]) -> mujoco.MjModel:
    """Return a model of the free coordinates, any two of which share inertia, with the model's actuators."""
    tied = {tie.joint for tie in ties}
    free = [joint for joint in range(model.njnt) if joint not in tied]
    kinds = [link for joint in free for link in LINKS[model.jnt_type[joint]]]
    spec = mujoco.MjSpec()
    body = spec.worldbody
    for index, kind in enumerate(kinds):
        body = body.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0), ipos=(1.0, 1.0, 1.0), explicitinertial=True)
        body.add_joint(name=str(index), type=mujoco.mjtJoint(kind))
    for _ in range(model.nu):
        spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target="0")
    links = spec.compile()
    dense = links.nv <= MOST_DENSE
    links.opt.jacobian = getattr(mujoco.mjtJacobian, "mjJAC_DENSE" if dense else "mjJAC_SPARSE")
    return links


SHARED = (
    *("time", "overflow", "nefc", "ne", "nf", "nl", "nacon", "ncollision", "solver_niter"),
    *("ctrl", "act", "act_dot", "actuator_length", "actuator_velocity", "actuator_force"),
)
"""Arrays of `Data` that all joints and the free coordinates have in common."""
SHARED_ROWS = (
    *("type", "id", "pos", "margin", "D", "vel", "frictionloss", "force", "state"),
    *("jtdaj_adr", "jtdaj_nrow", "jtdaj_nblock"),
)
"""The same of `Data.efc`; the last say which neighbours have the same columns, where J is sparse."""


def free_data(host: mujoco.MjModel, worlds: int, contacts: int, rows: int) -> mjw.Data:
    """Return the engine's arrays for a chain of free coordinates."""
    data = mjw.make_data(host, nworld=worlds, nconmax=contacts, njmax=rows, njmax_nnz=rows * host.nv)
    data.moment_rownnz, data.moment_rowadr, data.moment_colind = full_rows(worlds, host.nu, host.nv)
    data.actuator_moment = wp.zeros((worlds, host.nu * host.nv), dtype=float)
    return data


def free_part(stepped: Stepped, ties: list[Coupling]) -> Stepped:
    """Return what steps the free coordinates; its rows are those of all joints, but for their Jacobian."""
    full, worlds = stepped.model, stepped.data.nworld
    host = chain(stepped.oracle, ties)
    model, number = mjw.put_model(host), host.nv
    most = stepped.data.njmax
    data = free_data(host, worlds, stepped.data.naconmax // worlds, most)
    for name in vars(full):
        if name.startswith("actuator_") and name not in ("actuator_trntype", "actuator_trnid"):
            setattr(model, name, getattr(full, name))
    model.opt = full.opt
    model.dof_damping = wp.zeros((worlds, number), dtype=float)
    for holder, source, names in ((data, stepped.data, SHARED), (data.efc, stepped.data.efc, SHARED_ROWS)):
        for name in names:
            setattr(holder, name, getattr(source, name))
    if model.is_sparse:
        efc = data.efc
        efc.J_rownnz, efc.J_rowadr, columns = full_rows(worlds, most, number)
        efc.J_colind = columns.reshape((worlds, 1, most * number))
    return dataclasses.replace(stepped, oracle=host, model=model, data=data)


def full_rows(worlds: int, rows: int, number: int) -> tuple[wp.array, wp.array, wp.array]:
    """Return sizes, beginnings and columns of the rows of sparse matrices in which nothing is left out."""
    begins, columns = np.arange(rows) * number, np.tile(np.arange(number), rows)
    return (
        wp.full((worlds, rows), number, dtype=int),
        wp.array(np.tile(begins, (worlds, 1)), dtype=int),
        wp.array(np.tile(columns, (worlds, 1)), dtype=int),
    )


def _implicitly(stepped: Stepped, *arrays: Any) -> bool:
    """Whether these are not all zero, and forces are integrated implicitly."""
    return stepped.model.opt.integrator != IntegratorType.EULER and any_of(*arrays)


OBSTACLES: Obstacles = {
    "nothing is free": lambda stepped: stepped.oracle.njnt <= len(couplings(stepped.oracle)),
    "joints follow each other in a ring": lambda stepped: bool(
        {tie.joint for tie in couplings(stepped.oracle)} & {tie.driver for tie in couplings(stepped.oracle)}
    ),
    "a joint follows twice": lambda stepped: (
        len({tie.joint for tie in couplings(stepped.oracle)}) < len(couplings(stepped.oracle))
    ),
    "the friction cone is elliptic": lambda stepped: stepped.model.opt.cone != mjw.ConeType.PYRAMIDAL,
    "noslip iterations are on": lambda stepped: stepped.model.opt.noslip_iterations > 0,
    "the integrator takes in all of dF/dv": lambda stepped: (
        stepped.model.opt.integrator == IntegratorType.IMPLICIT
    ),
    "actuators have a state in the engine": lambda stepped: (
        stepped.model.na > 0 or stepped.model.nhistory > 0
    ),
    "actuators damp joints or tendons": lambda stepped: any_of(
        stepped.model.actuator_damping, stepped.model.actuator_dampingpoly
    ),
    "tendons are damped implicitly": lambda stepped: _implicitly(
        stepped, stepped.model.tendon_damping, stepped.model.tendon_dampingpoly
    ),
    "forces are limited at tendons or joints, and implicit": lambda stepped: _implicitly(
        stepped, stepped.model.tendon_actfrclimited, stepped.model.jnt_actfrclimited
    ),
    "a fluid resists": lambda stepped: bool(stepped.model.has_fluid),
    "the model's masses leave a coordinate without inertia": _massless,
    "there are plastic springs": lambda stepped: bool(stepped.model.nplastic),
}
"""Features that free coordinates lack, beside `engine.step.UNCOVERED`."""


class FreeCoordinates(Step):
    """The step of the coordinates that follow none.

    It replaces the engine's step by another one; stages are verified within it.

    Attributes:
        free: The free coordinates, for the places of `MOTION`.
        followers: How all joints follow them.
        triples: Hinges that turn like a ball; None: there are none.
        loops: Scratch of loops that hold exactly; None: there are none.
        reduction: The kernel that writes what acts along the coordinates, and its threads.
    """

    @staticmethod
    def obstacle(stepped: Stepped) -> str | None:
        """Return why joints cannot follow exactly, None if they can."""
        return first_reason(OBSTACLES, stepped)

    def __init__(self, stepped: Stepped) -> None:
        """Take equalities and light bodies out of the model, and make one of the free coordinates."""
        super().__init__(stepped)
        ties, host = couplings(stepped.oracle), document_model(stepped.oracle)
        M, J = inertia_of(host, ties, stepped.qpos_start.numpy().astype(float))
        # What a unit of force along a dof does to it: decides how soft limits and friction are.
        host.dof_invweight0[:] = np.einsum("ij,ji->i", J, np.linalg.solve(M, J.T))
        for joint in np.flatnonzero(np.isin(host.jnt_type, (BALL, FREE))):  # the mean of three, as MuJoCo's
            for first in range(
                host.jnt_dofadr[joint], host.jnt_dofadr[joint] + DOFS[host.jnt_type[joint]], 3
            ):
                host.dof_invweight0[first : first + 3] = host.dof_invweight0[first : first + 3].mean()
        masses = ("body_mass", "body_inertia", "body_subtreemass", "body_gravcomp", "dof_armature")
        for name in (*masses, "dof_invweight0"):
            array, values = getattr(stepped.model, name), getattr(host, name)
            array.assign(np.broadcast_to(values, array.numpy().shape))
        others = [i for i in stepped.model.eq_jnt_adr.numpy() if not host.eq_active0[i]]
        with wp.ScopedDevice(stepped.device):
            stepped.model.eq_jnt_adr = wp.array(others, dtype=int)
            self.followers, self.free = tables(host, ties), free_part(stepped, ties)
            self.slopes, self.excess = wp.zeros_like(stepped.data.qvel), wp.zeros_like(stepped.data.qvel)
            found = triples_of(host, ties)
            self.triples = triple_tables(host, found, self.followers) if found else None
        if found:  # it reads poses and motions in each physics step
            self.stepped = dataclasses.replace(stepped, remaining=None)
            self.directions = wp.zeros(stepped.data.qvel.shape, dtype=wp.spatial_vector)
        reduced = filled(Reduced, self.free.data, self.free.model)
        read = filled(Acting, stepped.data), filled(Moments, stepped.data), filled(Damping, stepped.model)
        self.scratch = block_scratch(stepped.device, *read, self.slopes, self.excess, reduced)
        self.in_lanes = stepped.device.is_cpu
        rows = self.free.data.efc
        # A sparse J here has all columns in each row.
        shape = stepped.data.nworld, -1, self.free.oracle.nv
        self._rows = filled(RowJacobian, rows)
        self._rows.J = rows.J.reshape(shape) if self.free.model.is_sparse else rows.J
        self.loops = None
        if looped := loop_rows(host):
            with wp.ScopedDevice(stepped.device):
                self.loops = loop_factors(stepped.data.nworld, looped, self.free.oracle.nv)

    def at(self, place: str) -> Stepped:
        """Return what a place steps: all joints until what acts is known, then the free coordinates."""
        return self.free if place in MOTION else self.stepped

    def places(self, stages: tuple[Stage, ...]) -> dict[str, Callable[[], None]]:
        """Return what is launched, place by place."""
        places = self.bound(self.stage_launches(stages))
        places.pop("implicit", None)  # it is done along the directions of `reduce`
        forces = {place: launches for place, launches in places.items() if place not in MOTION}
        motion = {place: launches for place, launches in places.items() if place in MOTION}
        return {"follow": self.follow, **forces, "reduce": self.reduce, **motion, "expand": self.expand}

    def motion(self, controls: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states by steps of ours, each from the start, all at once; see `Step.motion`.

        Bodies may be too light for MuJoCo C. A motion that ends beyond all numbers is the start.
        """
        stepped, step, worlds = self.stepped, self.launches(), self.stepped.data.nworld
        muscles = stepped.muscles.sample_state(np.random.default_rng(0))
        muscles["activation"][:] = 0.0
        start, rest = stepped.qpos_start.numpy(), np.zeros(stepped.oracle.nv)
        qpos, qvel = (np.tile(values, (len(controls), 1)) for values in (start, rest))
        for first in range(0, len(controls), worlds):
            chosen = np.resize(np.arange(first, min(first + worlds, len(controls))), worlds)
            still = np.tile(start, (worlds, 1)), np.tile(rest, (worlds, 1))
            set_state(stepped, (*still, controls[chosen], muscles))
            for number in range(1, int(numbers[chosen].max()) + 1):
                step()
                ends = numbers[chosen] == number
                if ends.any():
                    now = stepped.data.qpos.numpy()[ends], stepped.data.qvel.numpy()[ends]
                    finite = np.isfinite(np.concatenate(now, axis=1)).all(axis=1)
                    reached = chosen[ends][finite]
                    qpos[reached], qvel[reached] = now[0][finite], now[1][finite]
        return qpos, qvel

    def follow(self) -> None:
        """Read the coordinates, and put all joints where they belong."""
        data, free = self.stepped.data, self.free.data
        launch(follow_coordinates, data.nworld, data, self, free=filled(Coordinates, free))
        if self.triples is not None:
            launch(
                straighten_speeds,
                (free.nworld, self.triples.joint.shape[0]),
                self,
                positions=free.qpos,
                speeds=free.qvel,
                accelerations=free.qacc_warmstart,
            )

    def reduce(self) -> None:
        """Write inertia, forces, damping, moment arms and rows along the coordinates."""
        model, data, free = self.stepped.model, self.stepped.data, self.free
        reduced = filled(Reduced, free.data, free.model)
        if self.triples is not None:
            launch(straighten_dynamics, data.nworld, data, self, bodies=filled(Bodies, model, data))
        if self.stepped.forces is not None:
            directions = data.cdof if self.triples is None else self.directions
            self.stepped.forces.launch_implicit(model, data, directions)
        arguments = {
            "inertia": filled(InertiaRows, model),
            "damping": filled(Damping, model),
            "acting": filled(Acting, data),
            "moments": filled(Moments, data),
            "reduced": reduced,
        }
        if self.in_lanes:
            launch(reduce_blocks, 1, self, **arguments)
        else:
            launch(reduce_dynamics, data.nworld, self, **arguments)
        launch(
            reduce_rows,
            data.nworld,
            data,
            self,
            rows=filled(RowJacobian, data.efc),
            free_rows=self._rows,
        )
        if self.triples is not None:
            launch(
                straighten_rows,
                data.nworld,
                data,
                self,
                model.opt,
                rows=filled(LimitRows, free.data.efc),
                positions=free.data.qpos,
                J=self._rows.J,
                actuator_moment=reduced.actuator_moment.reshape((data.nworld, -1, free.oracle.nv)),
            )
        if self.loops is not None:
            launch(
                close_loops,
                data.nworld,
                data,
                M=reduced.M,
                qfrc_applied=reduced.qfrc_applied,
                factors=self.loops,
                free_rows=self._rows,
                D=data.efc.D,
                qacc_warmstart=free.data.qacc_warmstart,
            )

    def expand(self) -> None:
        """Put all joints where the coordinates are now."""
        data, free = self.stepped.data, self.free.data
        if self.triples is not None:
            launch(
                turn_triples,
                (free.nworld, self.triples.joint.shape[0]),
                data,
                self.stepped.model.opt,
                self,
                positions=free.qpos,
                speeds=free.qvel,
                accelerations=free.qacc,
            )
        launch(expand_coordinates, data.nworld, data, self, free=filled(Coordinates, free))

"""The physics step as a list of stages, each the engine's function or one of ours.

`ORDER` is `mujoco_warp.step` without what `UNCOVERED` lists: positions, velocities, muscles, forces,
accelerations, next state (MuJoCo documentation, Computation, "Forward dynamics"). `mujoco_warp.step` itself
stays the reference; it runs where no stage of ours is used, and where a model has what `UNCOVERED` lists.

One place has moved. mujoco-warp 4.0.0 computes velocities of bodies after the rows of constraints, although
those of welds and connects read them (the derivative of their Jacobian): it takes those of the step before.
In MuJoCo C they are those of the step, and in `ORDER`, the reference for models with such equalities.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import partial

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.definitions.forces import Forces
from myowarp.definitions.ground import Ground
from myowarp.definitions.paths import Paths
from myowarp.engine.idle import pruned
from myowarp.engine.patch import engine_kernels_alone, one_thread
from myowarp.engine.stage import STAGES, Launches, Obstacles, Stage, first_reason, load, or_the_engines
from myowarp.engine.stepped import Stepped
from myowarp.kernels.launch import launch


@wp.kernel(enable_backward=False)
def path_velocities(
    # Model:
    ten_J_rownnz: wp.array[int],
    ten_J_rowadr: wp.array[int],
    ten_J_colind: wp.array[int],
    # Data in:
    qvel_in: wp.array2d[float],
    ten_J_in: wp.array2d[float],
    moment_rownnz_in: wp.array2d[int],
    moment_rowadr_in: wp.array2d[int],
    moment_colind_in: wp.array2d[int],
    actuator_moment_in: wp.array2d[float],
    # Data out:
    ten_velocity_out: wp.array2d[float],
    actuator_velocity_out: wp.array2d[float],
):
    """Velocity of a tendon: J qvel; of an actuator: moment qvel."""
    worldid = wp.tid()
    for tendon in range(ten_J_rownnz.shape[0]):
        velocity = float(0.0)
        first = ten_J_rowadr[tendon]
        for i in range(first, first + ten_J_rownnz[tendon]):
            velocity += ten_J_in[worldid, i] * qvel_in[worldid, ten_J_colind[i]]
        ten_velocity_out[worldid, tendon] = velocity
    for actuator in range(actuator_velocity_out.shape[1]):
        speed = float(0.0)
        begin = moment_rowadr_in[worldid, actuator]
        for i in range(begin, begin + moment_rownnz_in[worldid, actuator]):
            speed += actuator_moment_in[worldid, i] * qvel_in[worldid, moment_colind_in[worldid, i]]
        actuator_velocity_out[worldid, actuator] = speed


def _velocity(model: mjw.Model, data: mjw.Data) -> None:
    launch(path_velocities, data.nworld, model, data)


def _velocity_along(paths: Paths, model: mjw.Model, data: mjw.Data) -> None:
    _velocity(model, data)
    paths.launch_velocity(model, data)


def _implicitly(forces: Forces, model: mjw.Model, data: mjw.Data) -> None:
    forces.launch_implicit(model, data, data.cdof)


def _control(model: mjw.Model, data: mjw.Data) -> None:
    if model.callback.control is not None:
        model.callback.control(model, data)


def _acceleration(model: mjw.Model, data: mjw.Data) -> None:
    mjw.fwd_acceleration(model, data, factorize=True)


def _integrate(model: mjw.Model, data: mjw.Data) -> None:
    (mjw.euler if model.opt.integrator == mjw.IntegratorType.EULER else mjw.implicit)(model, data)


FORCES: dict[str, Launches] = {
    # What follows from positions, and velocities of bodies:
    "kinematics": mjw.kinematics,
    "com_pos": mjw.com_pos,
    "com_vel": mjw.com_vel,
    "camlight": mjw.camlight,
    "tendon": mjw.tendon,
    "crb": mjw.crb,
    "collision": mjw.collision,
    "make_constraint": mjw.make_constraint,
    "transmission": mjw.transmission,
    # And from the other velocities:
    "velocity": _velocity,
    "passive": mjw.passive,
    "rne": mjw.rne,
    # Muscles, and what conditions do to them:
    "control": _control,
    "actuation": mjw.fwd_actuation,
}
"""Places that compute all that acts, from the state."""

MOTION: dict[str, Launches] = {
    "acceleration": _acceleration,
    "solve": mjw.solve,
    "integrate": _integrate,
}
"""Places that make the next state of it."""

ORDER = FORCES | MOTION

PATHS = frozenset({"kinematics", "com_pos", "com_vel", "tendon", "transmission", "velocity"})
"""Places that compute bodies, paths and their velocities."""

INTEGRATORS = (mjw.IntegratorType.EULER, mjw.IntegratorType.IMPLICIT, mjw.IntegratorType.IMPLICITFAST)

UNCOVERED: Obstacles = {
    "tendons or actuators have armature": lambda stepped: bool(
        stepped.oracle.tendon_armature.any() or stepped.oracle.actuator_armature.any()
    ),
    "there are sensors": lambda stepped: stepped.oracle.nsensor > 0,
    "there are flexes": lambda stepped: stepped.oracle.nflex > 0,
    "sleeping is on": lambda stepped: bool(stepped.model.opt.enableflags & mjw.EnableBit.SLEEP),
    "energy is computed": lambda stepped: bool(stepped.model.opt.enableflags & mjw.EnableBit.ENERGY),
    "actuation is off": lambda stepped: bool(stepped.model.opt.disableflags & mjw.DisableBit.ACTUATION),
    "the integrator takes several evaluations, or is the discrete one": lambda stepped: (
        stepped.model.opt.integrator not in INTEGRATORS
    ),
    "the user makes the contacts": lambda stepped: not stepped.model.opt.run_collision_detection,
    "the user has sensors": lambda stepped: stepped.model.callback.sensor is not None,
    "body accelerations are asked for": lambda stepped: bool(stepped.model.opt.run_rne_postconstraint),
}
"""Parts of `mujoco_warp.step` besides `ORDER`."""


def uncovered(stepped: Stepped) -> str | None:
    """Return why a step cannot be a list of stages, None if it can."""
    return first_reason(UNCOVERED, stepped)


def holds_bodies(stepped: Stepped) -> bool:
    """Return whether equalities hold bodies or sites together, as welds and connects do."""
    kinds = (mujoco.mjtEq.mjEQ_CONNECT.value, mujoco.mjtEq.mjEQ_WELD.value)
    return bool(np.isin(stepped.oracle.eq_type, kinds).any())


def _then(first: Launches, second: Launches) -> Launches:
    def launch_both(model: mjw.Model, data: mjw.Data) -> None:
        first(model, data)
        second(model, data)

    return launch_both


def stage_launches(
    stages: Iterable[Stage],
    paths: Paths | None = None,
    forces: Forces | None = None,
    ground: Ground | None = None,
    mask: wp.array | None = None,
) -> dict[str, Launches]:
    """Return what the physics step launches, place by place: stages of ours, and what a model brings.

    In worlds outside of a mask, shape (num_worlds,) bool, stages may do nothing.
    """
    places, stages = dict(ORDER), tuple(stages)
    if paths is not None:
        places["tendon"] = paths.launch
        places["velocity"] = partial(_velocity_along, paths)
    for stage in stages:
        first, *others = stage.replaces
        places[first] = stage.launcher(stages, mask)
        for place in others:
            del places[place]
    if ground is not None:
        places["collision"] = _then(places["collision"], ground.launch)
    if forces is None:
        return places
    ordered: dict[str, Launches] = {"damping": forces.launch_damping}
    for place, launches in places.items():
        if place == "control":
            ordered["forces"] = forces.launch
            ordered["implicit"] = partial(_implicitly, forces)
        ordered[place] = launches
    return ordered


class Step:
    """A physics step; stages of ours do some of its places.

    Attributes:
        stepped: What it steps.
    """

    def __init__(self, stepped: Stepped) -> None:
        self.stepped = stepped

    def at(self, place: str) -> Stepped:
        """Return what a place of `ORDER` steps."""
        return self.stepped

    def follow(self) -> None:
        """Put joints that follow others exactly to where these are; here none does."""

    def stages(self, kinds: Iterable[str | type[Stage]] = STAGES) -> tuple[Stage, ...]:
        """Return the stages of these names or classes that the step can use, in their order."""
        found: list[Stage] = []
        for name in kinds if uncovered(self.stepped) is None else ():
            kind = load(name) if isinstance(name, str) else name
            with or_the_engines(str(name)):  # a field of its model or data may be gone
                if kind is not None and kind.obstacle(at := self.at(kind.REPLACES[0])) is None:
                    found.append(kind(at))
        return tuple(found)

    def same(self, stages: Iterable[Stage]) -> tuple[Stage, ...]:
        """Return stages of the kinds that the step of another part of the worlds uses."""
        return tuple(type(stage)(self.at(stage.REPLACES[0])) for stage in stages)

    def places(self, stages: tuple[Stage, ...]) -> dict[str, Callable[[], None]]:
        """Return what is launched, place by place; without stages of ours, `mujoco_warp.step`.

        That takes velocities of the step before into welds and connects; there it is `ORDER`.
        """
        own = stages or self.stepped.paths or self.stepped.forces or self.stepped.ground
        in_order = own or (holds_bodies(self.stepped) and uncovered(self.stepped) is None)
        return self.bound(self.stage_launches(stages) if in_order else {"step": mjw.step})

    def stage_launches(self, stages: Iterable[Stage], mask: wp.array | None = None) -> dict[str, Launches]:
        """Return what is launched, place by place, with some stages of ours and what the model brings."""
        stepped = self.stepped
        return stage_launches(stages, stepped.paths, stepped.forces, stepped.ground, mask)

    def bound(self, launches: Mapping[str, Launches]) -> dict[str, Callable[[], None]]:
        """Return launches with what their places step."""
        return {
            place: partial(launch_stage, self.at(place).model, self.at(place).data)
            for place, launch_stage in launches.items()
        }

    def launches(
        self,
        stages: Iterable[Stage] = (),
        idle: frozenset[str] = frozenset(),
        only: frozenset[str] | None = None,
        mask: wp.array | None = None,
    ) -> Callable[[], None]:
        """Return a function that launches one physics step.

        Args:
            stages: Stages of ours, what `stages` or `same` returned.
            idle: Kernels of the engine's own stages to leave out, by name.
            only: Places of `ORDER` to launch; None: all.
            mask: Worlds for which the places of `only` are wanted, shape (num_worlds,) bool; None: all.
        """
        stages = tuple(stages)
        idle = idle.union(*(stage.SPARES for stage in stages))
        if only is None:
            places = tuple(self.places(stages).values())
        else:
            # Without the others, all is written that they would not read; what would move the state is left.
            motion = frozenset(MOTION) - only
            stages = tuple(
                stage
                for stage in stages
                if only.intersection(stage.replaces) and not motion.intersection(stage.replaces)
            )
            bound = self.bound(self.stage_launches(stages, mask))
            places = tuple(launch_place for place, launch_place in bound.items() if place in only)

        def step() -> None:
            with pruned(idle), one_thread(self.stepped.device), engine_kernels_alone():
                for launch_place in places:
                    launch_place()

        return step

    def motion(self, controls: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states to verify this step in: each some steps of MuJoCo C after the one before.

        Args:
            controls: Of each state, shape (num_states, nu).
            numbers: Of steps before it, shape (num_states,).

        Returns:
            Positions, shape (num_states, nq), and velocities, (num_states, nv).
        """
        host = self.stepped.oracle
        data, found = mujoco.MjData(host), []
        data.qpos[:] = self.stepped.qpos_start.numpy()
        for control, number in zip(controls, numbers, strict=True):
            data.ctrl[:] = control
            mujoco.mj_step(host, data, int(number))
            found.append((data.qpos.copy(), data.qvel.copy()))
        qpos, qvel = (np.array(values) for values in zip(*found, strict=True))
        return qpos, qvel

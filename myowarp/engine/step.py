"""The physics step as a list of stages, each the engine's function or one of ours.

`ORDER` is `mujoco_warp.step` without what `UNCOVERED` lists: positions, velocities, muscles, forces,
accelerations, next state (MuJoCo documentation, Computation, "Forward dynamics"), and three places where
nothing happens but by a stage of ours. `mujoco_warp.step` itself stays the reference; it runs where no stage
of ours is used, and where a model has what `UNCOVERED` lists.
"""

from collections.abc import Callable, Iterable

import mujoco_warp as mjw
import warp as wp

from myowarp.definitions.scene import Scene
from myowarp.engine.idle import pruned
from myowarp.engine.patch import engine_kernels_alone, one_thread
from myowarp.engine.stage import INNER, Launches, Obstacles, Stage, first_reason
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


def _control(model: mjw.Model, data: mjw.Data) -> None:
    if model.callback.control is not None:
        model.callback.control(model, data)


def _acceleration(model: mjw.Model, data: mjw.Data) -> None:
    mjw.fwd_acceleration(model, data, factorize=True)


def _integrate(model: mjw.Model, data: mjw.Data) -> None:
    (mjw.euler if model.opt.integrator == mjw.IntegratorType.EULER else mjw.implicit)(model, data)


def _nothing(model: mjw.Model, data: mjw.Data) -> None:
    """Launch nothing: a place for stages that the engine has no counterpart of."""


ORDER: dict[str, Launches] = {
    # Joints that follow others exactly (`stages.free_coordinates`):
    "follow": _nothing,
    # What follows from positions:
    "kinematics": mjw.kinematics,
    "com_pos": mjw.com_pos,
    "camlight": mjw.camlight,
    "tendon": mjw.tendon,
    "crb": mjw.crb,
    "collision": mjw.collision,
    "make_constraint": mjw.make_constraint,
    "transmission": mjw.transmission,
    # And from velocities:
    "velocity": _velocity,
    "com_vel": mjw.com_vel,
    "passive": mjw.passive,
    "rne": mjw.rne,
    # Muscles, and what conditions do to them:
    "control": _control,
    # Forces, acceleration, next state:
    "actuation": mjw.fwd_actuation,
    "reduce": _nothing,
    "acceleration": _acceleration,
    "solve": mjw.solve,
    "integrate": _integrate,
    "expand": _nothing,
}

INTEGRATORS = (mjw.IntegratorType.EULER, mjw.IntegratorType.IMPLICIT, mjw.IntegratorType.IMPLICITFAST)

UNCOVERED: Obstacles = {
    "tendons or actuators have armature": lambda scene: bool(
        scene.oracle.tendon_armature.any() or scene.oracle.actuator_armature.any()
    ),
    "there are sensors": lambda scene: scene.oracle.nsensor > 0,
    "there are flexes": lambda scene: scene.oracle.nflex > 0,
    "sleeping is on": lambda scene: bool(scene.model.opt.enableflags & mjw.EnableBit.SLEEP),
    "energy is computed": lambda scene: bool(scene.model.opt.enableflags & mjw.EnableBit.ENERGY),
    "actuation is off": lambda scene: bool(scene.model.opt.disableflags & mjw.DisableBit.ACTUATION),
    "the integrator takes several evaluations, or is the discrete one": lambda scene: (
        scene.model.opt.integrator not in INTEGRATORS
    ),
    "the user makes the contacts": lambda scene: not scene.model.opt.run_collision_detection,
    "the user has sensors": lambda scene: scene.model.callback.sensor is not None,
    "body accelerations are asked for": lambda scene: bool(scene.model.opt.run_rne_postconstraint),
}
"""What `mujoco_warp.step` does besides `ORDER`."""


def uncovered(scene: Scene) -> str | None:
    """Return why a scene's step cannot be a list of stages, None if it can."""
    return first_reason(UNCOVERED, scene)


def stage_launches(stages: Iterable[Stage]) -> dict[str, Launches]:
    """Return what the physics step launches, place by place, with some stages of ours."""
    places, stages = dict(ORDER), tuple(stages)
    replaced = frozenset(place for stage in stages for place in stage.replaces)
    for stage in stages:
        launches = stage.launches(replaced)
        for place in set(stage.replaces) - set(launches):
            del places[place]
        places |= launches
    for inner in (stage.inner for stage in stages if stage.inner is not None):
        places |= {place: _within(inner, places[place]) for place in INNER if place in places}
    return places


def _within(inner: Scene, launch_stage: Launches) -> Launches:
    """Return launches that step another scene."""
    return lambda model, data: launch_stage(inner.model, inner.data)


def physics_step(
    scene: Scene, stages: Iterable[Stage] = (), idle: frozenset[str] = frozenset()
) -> Callable[[], None]:
    """Return a function that launches one physics step of a scene.

    Args:
        scene: The scene.
        stages: Stages of ours; without any it is `mujoco_warp.step`.
        idle: Kernels of the engine's own stages to leave out, by name.
    """
    stages = tuple(stages)
    launches = tuple(stage_launches(stages).values()) if stages else (mjw.step,)

    def step() -> None:
        with pruned(idle), one_thread(scene.device), engine_kernels_alone():
            for launch_stage in launches:
                launch_stage(scene.model, scene.data)

    return step

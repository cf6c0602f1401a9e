"""Scenes: from a task to a compiled model with all arrays allocated."""

import math
import re
from collections.abc import Callable, Iterable
from functools import lru_cache, partial
from importlib import metadata
from pathlib import Path
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.coordinates.own_contacts import acting_on
from myowarp.coordinates.own_paths import paths_of
from myowarp.coordinates.step import data_beside
from myowarp.definitions.body import BODIES, Body
from myowarp.definitions.condition import Condition, resolve
from myowarp.definitions.muscle import MUSCLES, MuscleModel, muscle_names
from myowarp.definitions.muscle_table import MuscleTable
from myowarp.definitions.registry import is_integer
from myowarp.definitions.scene import Scene
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import PHYSICS, PhysicsPreset, TaskSpec
from myowarp.definitions.worlds import Worlds
from myowarp.disk import cached, files_digest, is_ours, model_bytes, model_from_bytes, version
from myowarp.engine.arena import Arena
from myowarp.engine.ground import height_field
from myowarp.engine.replaced import replaced
from myowarp.engine.slim import slim
from myowarp.engine.step import uncovered
from myowarp.engine.stepped import Stepped
from myowarp.kernels.action import MOTOR, MUSCLE
from myowarp.kernels.random import new_keys
from myowarp.osim.bundle.couplings import NOTHING
from myowarp.osim.bundle.loops import settled
from myowarp.process import start_warp, warn_once, with_build_lock
from myowarp.sim.capacity import calibrate
from myowarp.sim.memory import check_memory

STATE_FIELDS = (
    *("time", "qpos", "qvel", "act", "history", "plastic", "qacc_warmstart", "ctrl", "qfrc_applied"),
    *("eq_active", "mocap_pos", "mocap_quat", "userdata"),
)
"""Arrays of `mjw.Data` that the engine carries from one step to the next, and those that only users write."""

RESULT_FIELDS = (
    "overflow",
    *("xpos", "xquat", "xmat", "xipos", "ximat", "xanchor", "xaxis", "geom_xpos", "geom_xmat", "cam_xpos"),
    *("cam_xmat", "light_xpos", "light_xdir", "subtree_com", "cvel", "qacc", "act_dot", "ten_length"),
    *("actuator_length", "actuator_velocity", "actuator_force", "qfrc_bias", "qfrc_passive"),
    *("qfrc_actuator", "qfrc_constraint", "sensordata"),
)
"""Further arrays of `mjw.Data` with a row for each world that are of use outside of the engine.

Arrays that only the engine reads stay with the part: cores that write side by side take cache lines from
each other, which costs 64 elbows up to 7 % of a step. So do arrays that our stages do not write, such as the
poses of all sites: it would be old.
"""

MOST_STEPS = 2**31 - 1  # in an episode: the device counts in int32
MOST_WORLDS = 2**31 - 1  # likewise
MANY_DOFS = 200  # of a model that is slow: chains of 300 bodies and 100 loose spheres took 70 s to start
DEVICE = re.compile(r"cpu|cuda(:[0-9]{1,3})?")
ROUNDING = 1e-6  # of a physics step; control steps are no exact multiples in binary


def full_spec(spec: TaskSpec, conditions: tuple[Condition, ...] = ()) -> mujoco.MjSpec:
    """Return the editable full model of a task: the body and what task and conditions add."""
    body = BODIES[spec.body].build()
    body.option.timestep = spec.physics_dt
    spec.edit(body)
    for condition in sorted(conditions, key=lambda condition: bool(condition.undriven)):
        condition.edit(body, spec.body)  # actuators that the policy does not command come last
    return body


JOINT_SIZES = {mujoco.mjtJoint.mjJNT_FREE: (7, 6), mujoco.mjtJoint.mjJNT_BALL: (4, 3)}
"""Numbers of a joint's position and velocity; others have one each."""


def sizes_of(spec: TaskSpec) -> tuple[int, int, int, int]:
    """Return nq, nv, na and nu of a task's model, which is not compiled for them."""
    body = full_spec(spec)
    positions, velocities = zip(*(JOINT_SIZES.get(joint.type, (1, 1)) for joint in body.joints), strict=True)
    states = sum(actuator.dyntype != mujoco.mjtDyn.mjDYN_NONE for actuator in body.actuators)
    return sum(positions), sum(velocities), states, len(body.actuators)


@lru_cache(maxsize=1)
def _slim_spec(
    spec: TaskSpec, conditions: tuple[Condition, ...], body: Body, exact: bool = False
) -> mujoco.MjSpec:
    """Return the slim spec of a task; shared by the two models that are compiled from it."""
    small = slim(full_spec(spec, conditions), spec.sites)
    if exact and any(held.type == mujoco.mjtEq.mjEQ_JOINT for held in small.equalities):
        NOTHING.put_into(small)
    return small


def _dense(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a model that MuJoCo C steps with a dense Jacobian, which it chooses below 60 degrees of freedom.

    4.0.0 factorises sparse Hessians wrongly (mended in 4.0.1).
    """
    if mujoco.mj_isSparse(model):
        model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    return model


def slim_model(spec: TaskSpec, conditions: tuple[Condition, ...] = (), exact: bool = False) -> mujoco.MjModel:
    """Return the slim model of a task with MuJoCo's built-in muscles.

    Where `exact`, joints that follow others ask to do so without springs (`osim.bundle.couplings`).
    """
    return _dense(_slim_spec(spec, conditions, BODIES[spec.body], exact).copy().compile())


def stateless_model(
    spec: TaskSpec, conditions: tuple[Condition, ...] = (), exact: bool = False
) -> mujoco.MjModel:
    """Return the slim model with every muscle made a stateless AFFINE actuator (see `MuscleModel`)."""
    small = _slim_spec(spec, conditions, BODIES[spec.body], exact).copy()
    for actuator in small.actuators:
        if actuator.dyntype == mujoco.mjtDyn.mjDYN_MUSCLE:
            actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
            actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
            actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            actuator.gainprm = np.zeros(10)
            actuator.biasprm = np.zeros(10)
            actuator.actlimited = False
    return small.compile()


def full_model(spec: TaskSpec, conditions: tuple[Condition, ...] = ()) -> mujoco.MjModel:
    """Return the unslimmed model of a task, for pictures and comparisons."""
    return _dense(full_spec(spec, conditions).compile())


def source_digest(more: Iterable[Path] = ()) -> str:
    """Return a digest of our code that a scene depends on, and of more files: an edit renews what is kept."""
    package = Path(__file__).parents[1]
    files = [Path(__file__), package / "engine/slim.py", package / "definitions/parameter.py", *more]
    files += [*sorted(package.glob("tasks/*.py")), *sorted(package.glob("models/bodies/*.py"))]
    files += sorted(package.glob("models/conditions/*.py"))
    return files_digest(files)


@with_build_lock
def _cached_model(
    spec: TaskSpec,
    conditions: tuple[Condition, ...],
    make: Callable[[TaskSpec, tuple[Condition, ...], bool], mujoco.MjModel],
    exact: bool = False,
) -> mujoco.MjModel:
    """Return `make(spec, conditions, exact)`, through the disk cache if all of it is ours.

    User code may depend on anything: on files that it reads, on fields that no key names.
    """
    edits = tuple(condition for condition in conditions if condition.scene_key)
    if not is_ours(type(spec), BODIES[spec.body].build, *map(type, conditions)):
        return make(spec, conditions, exact)
    key = (spec.scene_key, *(condition.scene_key for condition in edits))
    return cached(
        (make.__name__, key, exact, source_digest()),
        make=lambda: make(spec, edits, exact),
        save=model_bytes,
        load=model_from_bytes,
    )


def oracle_model(
    spec: TaskSpec, conditions: tuple[Condition, ...] = (), exact: bool = False
) -> mujoco.MjModel:
    """Return `slim_model` through the disk cache."""
    return _cached_model(spec, conditions, slim_model, exact)


def num_substeps_of(spec: TaskSpec, preset: PhysicsPreset, muscle: str = "mujoco") -> int:
    """Return the number of physics steps in a control step; `muscle` is the muscle model's name."""
    if preset.coarse:
        longest = min(spec.coarse_step.dt, MUSCLES[muscle].coarse_step)
        return math.ceil(spec.control_dt / longest - ROUNDING)
    return spec.num_substeps


def set_physics(
    spec: TaskSpec, preset: PhysicsPreset, models: Iterable[mujoco.MjModel], muscle: str = "mujoco"
) -> int:
    """Set integrator and step of models to a preset's; returns the physics steps in a control step."""
    num_substeps = num_substeps_of(spec, preset, muscle)
    for model in models:
        model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{preset.integrator or spec.integrator}")
        model.opt.timestep = spec.control_dt / num_substeps
    return num_substeps


def new_muscles(
    muscle: MuscleTable, model: mujoco.MjModel, worlds: Worlds, spec: TaskSpec, preset: PhysicsPreset
) -> MuscleModel:
    """Return the muscles of a model, on the current Warp device, set to a preset.

    Raises:
        ValueError: A parameter does not fit, or the muscle model's state is not what it says.
    """
    names = muscle_names(model)
    given = muscle.over(BODIES[spec.body].muscles, names, worlds)
    muscles = MUSCLES[muscle.model](model, worlds.number, given)
    muscles.midstep = preset.midstep
    explicit = (preset.integrator or spec.integrator) == "EULER"
    muscles.implicitness = spec.coarse_step.implicitness if preset.coarse else float(not explicit)
    shape = worlds.number, len(names)
    for name, state in muscles.state.items():
        if state.dtype is not wp.float32 or state.shape[:2] != shape:
            raise ValueError(
                f"state {name!r} of muscle model {muscle.model!r} must be float32 of shape "
                f"{shape} or more dimensions, got {state.dtype.__name__} of shape {state.shape}"
            )
    return muscles


def checked_num_worlds(num_worlds: int, name: str = "num_worlds") -> int:
    """Return the number of worlds, which its caller calls by some name, as a plain integer.

    Raises:
        ValueError: It is no positive integer.
    """
    if not is_integer(num_worlds) or num_worlds < 1:
        raise ValueError(f"{name} must be a positive integer, got {num_worlds!r}")
    return int(num_worlds)


def checked_horizon(horizon: int, name: str = "horizon") -> int:
    """Return the number of control steps in an episode, which its caller calls by some name.

    Raises:
        ValueError: It is no positive integer, or more than the device counts.
    """
    if not is_integer(horizon) or horizon < 1:
        raise ValueError(f"{name} must be a positive integer, got {horizon!r}")
    if horizon > MOST_STEPS:
        raise ValueError(f"{name} must be at most {MOST_STEPS}, got {horizon}")
    return int(horizon)


def actuator_kinds(model: mujoco.MjModel) -> np.ndarray:
    """Return MUSCLE or MOTOR for each actuator, shape (nu,)."""
    return np.where(model.actuator_dyntype == mujoco.mjtDyn.mjDYN_MUSCLE, int(MUSCLE), int(MOTOR))


def _action_kinds(model: mujoco.MjModel, spec: TaskSpec) -> np.ndarray:
    """Return how actions become controls, shape (nu,): MUSCLE by the sigmoid, MOTOR linearly."""
    return np.full(model.nu, int(MOTOR)) if spec.linear_excitation else actuator_kinds(model)


def _put_model(spec: TaskSpec, stepped: mujoco.MjModel, batch_sizes: dict[str, int]) -> mjw.Model:
    """Put the stepped model of a task on the current Warp device.

    Two boxes touch where MuJoCo C's closed form says; of the engine's flags this one is about nothing else.

    Raises:
        ValueError: The engine does not simulate something in it.
    """
    stepped.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_NATIVECCD
    try:
        model = mjw.put_model(stepped, batch_sizes=batch_sizes)
    except NotImplementedError as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"task {spec.key!r} cannot be simulated; mujoco-warp says: {reason}") from error
    model.opt.warn_overflow = False
    return model


def compile_scene(setup: Setup | TaskSpec, num_worlds: int | Worlds, **fields: Any) -> Scene:
    """Build everything that a task needs on a device.

    Args:
        setup: What the worlds are; shards, rank, horizon and seed are not the scene's.
        num_worlds: Number of worlds to step together, >= 1, or those of a part of them.
        **fields: Fields of `Setup`, in place of those of `setup`.

    Raises:
        ValueError: An argument is out of its range, or the device does not exist.
    """
    setup = Setup.of(setup, **fields).finished()
    setup.check()
    spec, physics, conditions = setup.spec, str(setup.physics), resolve(setup.conditions or (), setup.spec)
    worlds = num_worlds if isinstance(num_worlds, Worlds) else Worlds.all(checked_num_worlds(num_worlds))
    where = resolve_device(setup.device)

    exact = PHYSICS[physics].coarse
    oracle = oracle_model(spec, conditions, exact)
    stepped = _cached_model(spec, conditions, stateless_model, exact)
    num_substeps = set_physics(spec, PHYSICS[physics], (oracle, stepped), setup.muscles.model)
    start = settled(oracle, spec.start(oracle))
    if oracle.nv >= MANY_DOFS:
        warn_once(
            f"task {spec.key!r} is large ({oracle.nbody} bodies, {oracle.nv} degrees of freedom): its first "
            "start takes a minute or more, and each physics step up to a tenth of a second"
        )
    capacity = calibrate(oracle, start, spec.least_contacts)

    def make_data(number: int) -> mjw.Data:
        return mjw.make_data(stepped, nworld=number, nconmax=capacity.contacts, njmax=capacity.rows)

    def all_data(number: int) -> tuple[mjw.Data | wp.array | None, ...]:
        data = make_data(number)
        beside = data_beside(oracle, number, capacity.contacts, capacity.rows)
        if where.is_cpu:  # whose stages are ours
            return data, beside
        return data, beside, *Arena(partial(mjw.step, mjw.put_model(stepped), data), where).blocks

    check_memory(all_data, spec.world_bytes, worlds.total, where)
    # The engine reads its packages' versions from their files each time that a model is put.
    with wp.ScopedDevice(where), replaced(metadata, "version", version):
        batched = {"actuator_biasprm", *spec.batched}.union(*(c.batched for c in conditions))
        model = _put_model(spec, stepped, dict.fromkeys(sorted(batched), worlds.number))
        data = make_data(worlds.number)
        muscles = new_muscles(setup.muscles, oracle, worlds, spec, PHYSICS[physics])
        if conditions:
            muscles.individualize()
        scene = Scene(
            spec=spec,
            worlds=worlds,
            num_substeps=num_substeps,
            num_actions=oracle.nu - sum(len(condition.undriven) for condition in conditions),
            oracle=oracle,
            model=model,
            data=data,
            muscles=muscles,
            keys=new_keys(worlds.number),
            qpos_start=wp.array(start, dtype=float),
            reset=str(setup.reset),
            actuator_kind=wp.array(_action_kinds(oracle, spec), dtype=int),
            capacity=capacity,
            batched=frozenset(batched),
            device=where,
            paths=paths_of(oracle, model, data),
            forces=acting_on(oracle, model, data),
        )
        if uncovered(stepped_of(scene)) is None:
            scene.ground = height_field(oracle, model)
        _adopt_arrays(scene, individual=bool(conditions))
    return scene


def stepped_of(scene: Scene) -> Stepped:
    """Return what the physics step of a scene steps."""
    return Stepped(
        oracle=scene.oracle,
        model=scene.model,
        data=scene.data,
        muscles=scene.muscles,
        sites=tuple(scene.site_id(name) for name in scene.spec.sites),
        qpos_start=scene.qpos_start,
        num_substeps=scene.num_substeps,
        batched=scene.batched,
        paths=scene.paths,
        forces=scene.forces,
        ground=scene.ground,
    )


def _adopt_arrays(scene: Scene, individual: bool) -> None:
    """Name the arrays that engine, muscles and random numbers share with other shards, and the state."""
    data, model, muscles = scene.data, scene.model, scene.muscles
    for name in STATE_FIELDS:
        scene.adopt("data", data, (name,), state=getattr(data, name).size > 0)
    scene.adopt("data", data, RESULT_FIELDS, state=False)
    scene.adopt("model", model, sorted(scene.spec.batched))
    scene.adopt("model", model, ("actuator_biasprm",), state=False)
    scene.adopt("condition.model", model, sorted(scene.batched - {"actuator_biasprm", *scene.spec.batched}))
    scene.adopt("muscles", muscles, (*muscles.STATE, *muscles.RESULTS))
    scene.adopt("keys", scene.keys)
    if individual:
        scene.adopt("condition.anatomy", muscles.anatomy)


def check_device_name(device: object) -> None:
    """Raise ValueError for what is a Warp device's name on no machine; None and "" leave the device open."""
    if device not in (None, "") and not DEVICE.fullmatch(str(device)):
        raise ValueError(f"device must be cpu, cuda or cuda:N, got {device!r}")


@with_build_lock
def resolve_device(device: str | None) -> wp.Device:
    """Return the Warp device called `device`, the preferred one for None.

    Raises:
        ValueError: No such device here; the message lists those there are.
    """
    missing = start_warp()
    if device is None:
        return wp.get_preferred_device()
    known = [d.alias for d in wp.get_devices()]
    if str(device) == "cuda" and wp.is_cuda_available():
        return wp.get_device("cuda")
    if str(device) not in known:
        why = _why_no_cuda(missing) if str(device).startswith("cuda") else ""
        there = ", ".join(known) + (f" ({why})" if why else "")
        raise ValueError(f"device {str(device)!r} is not available; available: {there}")
    return wp.get_device(str(device))


def _why_no_cuda(missing: str) -> str:
    """Return why there is no such device, as far as it is known; `missing` is what Warp has said."""
    driver, toolkit = wp.get_cuda_driver_version(), wp.get_cuda_toolkit_version()
    if driver is None or toolkit is None or driver >= (toolkit[0], 0):
        return missing
    has, needs = ".".join(map(str, driver)), f"{toolkit[0]}.0"
    return f"Warp needs an NVIDIA driver of CUDA {needs} or newer, got {has}; update the driver"

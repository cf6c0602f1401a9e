"""A model from a file, MJCF such as `myowarp convert` writes, as a body and as a pose task.

The task asks for a random pose of the joints that the actuators move. Joints that an equality ties to others
follow, exactly if `couplings.json` lies beside the file, and a root that nothing holds falls. Episodes start
from the first keyframe, if there is one. Physics `parity` is the file's own time step and integrator.
"""

import re
from pathlib import Path

import mujoco
import numpy as np

from myowarp.disk import model_digest
from myowarp.models.couplings import POINT_JOINTS, ask, couplings, exact, follow
from myowarp.spec.body import BODIES, Body
from myowarp.spec.task import TASKS
from myowarp.tasks.pose import PoseTask
from myowarp.tasks.pose_ids import ELBOW_NEAR
from myowarp.tasks.variants import Variant, find_variant

CONTROL_DT = 0.02  # s, about, as in upstream's tasks
EPISODE_STEPS = 100
SPAN = np.pi / 4  # rad to both sides of the start, for targets of a hinge without range
MOVED = 1e-9  # m or 1: greater moment arms are no rounding
NUM_POSES = 16  # in which a joint is looked at for moment arms
COUPLINGS = "couplings.json"  # beside the model's file; see `myowarp.models.couplings`
STEPPED = ("EULER", "IMPLICITFAST")  # integrators; others call the muscles more than once in a step


def find_task(task: str | None, model: Path | None) -> Variant:
    """Return what an id stands for, or the pose task of a model's file.

    Raises:
        ValueError: Both are given or neither is, there is no such id, or the file is unsuitable.
    """
    if (task is None) == (model is None):
        got = "neither" if task is None else f"{task!r} and {str(model)!r}"
        raise ValueError(f"what to run is a task id or --model with an MJCF file, one of them; got {got}")
    return find_variant(task) if task is not None else Variant(pose_task(Path(str(model))).key)


def read_body(path: Path, tips: tuple[str, ...] = ()) -> str:
    """Register the model of a file as a body, once; motors without a control range get -1 to 1.

    Args:
        path: MJCF.
        tips: Names of the sites that tasks show or steer.

    Returns:
        Name in `BODIES`; it holds a digest of the compiled model, meshes and includes included, because
        compiled scenes are kept by name.

    Raises:
        ValueError: The file is no model that MuJoCo reads, or has actuators that we cannot step.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        for actuator in spec.actuators:
            if actuator.dyntype == mujoco.mjtDyn.mjDYN_NONE and not np.any(actuator.ctrlrange):
                actuator.ctrlrange = (-1.0, 1.0)
        model = spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"model {str(path)!r} must be an MJCF file; MuJoCo says: {reason}") from error
    _check(model, path)
    if (beside := path.with_name(COUPLINGS)).is_file():
        try:
            ask(spec, beside.read_text())
            exact(model := spec.compile())
        except ValueError as error:
            raise ValueError(f"file {str(beside)!r} must belong to {path.name}: {error}") from error
    title = re.sub(r"[^A-Za-z0-9]+", "_", spec.modelname).strip("_")
    name = "_".join((title, model_digest(model)[:8], *tips))
    if name not in BODIES:
        BODIES.add(name, Body(spec.copy, tips))
    return name


def _check(model: mujoco.MjModel, path: Path) -> None:
    """Raise ValueError if the model has nothing to act with, or something that we cannot step."""
    if not model.nu:
        raise ValueError(f"model {str(path)!r} has no actuators; a policy needs muscles or motors")
    integrator = mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_")
    if integrator not in STEPPED:
        raise ValueError(
            f"model {str(path)!r} has integrator {integrator}; muscles need one of {', '.join(STEPPED)}"
        )
    kinds = zip(model.actuator_dyntype, model.actuator_gaintype, model.actuator_biastype, strict=True)
    muscle = (mujoco.mjtDyn.mjDYN_MUSCLE, mujoco.mjtGain.mjGAIN_MUSCLE, mujoco.mjtBias.mjBIAS_MUSCLE)
    for index, kind in enumerate(kinds):
        if kind[0] != mujoco.mjtDyn.mjDYN_NONE and kind != muscle:
            name = model.actuator(index).name or str(index)
            raise ValueError(
                f"model {str(path)!r} has actuator {name!r} with a state that is no MuJoCo muscle; what runs "
                "are MuJoCo's muscles, and actuators without state"
            )


def pose_task(path: Path) -> PoseTask:
    """Register the pose task of a model's file, once.

    Raises:
        ValueError: The file is unsuitable (`read_body`), or its actuators move no joint.
    """
    body = read_body(path)
    model = BODIES[body].build().compile()
    joints = np.array(_moved_joints(model))
    if not joints.size:
        raise ValueError(f"model {str(path)!r} has no free hinge or slide that its actuators move")
    start = (model.key_qpos[0] if model.nkey else model.qpos0).copy()
    if exact(model) is not None:
        follow(model, start)
    around = start[model.jnt_qposadr[joints], None] + (-SPAN, SPAN)
    bounds = model.jnt_range[joints]
    low, high = np.where(bounds[:, :1] < bounds[:, 1:], bounds, around).T
    task = PoseTask(
        name=body,
        body=body,
        num_substeps=max(1, round(CONTROL_DT / model.opt.timestep)),
        horizon=EPISODE_STEPS,
        doc=f"Bring the {len(joints)} joints that the actuators of {path.name} move to a random pose.",
        physics_dt=model.opt.timestep,
        integrator=mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_"),
        target_low=tuple(low.tolist()),
        target_high=tuple(high.tolist()),
        near=ELBOW_NEAR * float(np.sqrt(len(joints))),
        far=2.0 * float(np.linalg.norm(high - low)),
        joints=tuple(joints.tolist()),
        start_pose=tuple(start.tolist()),
    )
    if task.key not in TASKS:
        TASKS.add(task.key, task)
    return task


def _moved_joints(model: mujoco.MjModel) -> list[int]:
    """Return the hinges, and the slides with a range, that an actuator moves and no equality ties."""
    data, random = mujoco.MjData(model), np.random.default_rng(0)
    low, high = np.where(model.jnt_range[:, :1] < model.jnt_range[:, 1:], model.jnt_range, (-SPAN, SPAN)).T
    scalar = np.isin(model.jnt_type, POINT_JOINTS)
    arm, moment = np.zeros(model.nv), np.zeros((model.nu, model.nv))
    for _ in range(NUM_POSES):
        data.qpos[model.jnt_qposadr[scalar]] = random.uniform(low, high)[scalar]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mju_sparse2dense(
            moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
        arm = np.maximum(arm, np.abs(moment).max(axis=0))
    moved = arm[model.jnt_dofadr] > MOVED
    ties = couplings(model)
    for tie in reversed(ties):
        if tie.driver >= 0:
            moved[tie.driver] |= moved[tie.joint]
    wide = (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE) | (model.jnt_range[:, 0] < model.jnt_range[:, 1])
    tied = {tie.joint for tie in ties}
    return [j for j in np.flatnonzero(moved & scalar & wide).tolist() if j not in tied]

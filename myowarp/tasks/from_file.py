"""A model as a pose or reach task: a file, MJCF such as `myowarp convert` writes, or a body of the package.

Targets are those of joints that the actuators move, or of sites. Physics `parity` is the file's own time step
and integrator.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, cast

import mujoco
import numpy as np

from myowarp.definitions.body import POINT_JOINTS
from myowarp.definitions.registry import check_choice
from myowarp.definitions.setup import CONTACTS
from myowarp.definitions.task import MOST_SUBSTEPS, TaskSpec, register, split_key
from myowarp.models.bodies.from_file import OPENSIM, register_body
from myowarp.models.reachability import tip_positions
from myowarp.osim.bundle.couplings import couplings, follow
from myowarp.osim.bundle.loops import settled
from myowarp.sim.build import checked_horizon, full_model
from myowarp.tasks.extend import Reward, extend
from myowarp.tasks.pose import PoseTask
from myowarp.tasks.pose_ids import ELBOW_NEAR
from myowarp.tasks.reach import NEAR_PER_TIP, ReachTask

CONTROL_DT = 0.02  # s, about, as in upstream's tasks
EPISODE_STEPS = 100
SPAN = np.pi / 4  # rad to both sides of the start, for targets of a hinge without range
MOVED = 1e-9  # m or 1: greater moment arms are no rounding
NUM_POSES = 16  # in which a joint is looked at for moment arms
NUM_TARGETS = 1024  # points to reach
STEP_ROUNDING = 1e-6  # of a time step
KINDS = ("pose", "reach")


def pose_task(path: Path, stops: bool = True, contact: str = CONTACTS[0]) -> PoseTask:
    """Return the pose task of all joints that the actuators of a model move; it is registered.

    Args:
        path: As for `from_mjcf`.
        stops: As for `from_mjcf`.
        contact: As for `from_mjcf`.

    Raises:
        ValueError: The file is unsuitable (`register_body`), or its actuators move no joint.
    """
    return cast(PoseTask, from_mjcf(path, stops=stops, contact=contact))


def from_mjcf(
    path: str | Path,
    key: str | None = None,
    kind: str = "pose",
    *,
    targets: Iterable[str] | Mapping[str, Sequence[Any] | None] = (),
    horizon: int = EPISODE_STEPS,
    control_dt: float | None = None,
    keyframe: str | None = None,
    near: float | None = None,
    far: float | None = None,
    rewards: Mapping[str, Reward] | None = None,
    stops: bool = True,
    function_paths: str | Path | None = None,
    contact: str = CONTACTS[0],
    doc: str = "",
    replace: bool = False,
) -> TaskSpec:
    """Return a task on the model of a file, MJCF with muscles or motors; it is registered.

    Args:
        path: MJCF; includes and meshes are found from it. Or .osim, as for `from_osim`; or the name of a body
            of the package, such as "full_body".
        key: Id of the task, such as "myArmReach-v0"; None: from the model's name and content.
        kind: "pose" (bring joints to angles) or "reach" (bring sites to points).
        targets: Names of the joints, or of the sites; a mapping gives each its bounds: (low, high) [rad or
            m] of a joint, two points [m] of a site, in world coordinates. Without bounds the targets are
            within the joint's range, and where the sites are in random poses within the joints' ranges. A
            pose task without names is about all joints that the actuators move.
        horizon: Control steps in an episode.
        control_dt: Duration of a control step [s], a multiple of the file's time step; None: about 0.02.
        keyframe: Name of the keyframe from which episodes start; None: the first, else the model's zero.
        near: Error norm below which the task is solved [rad or m]; None: 0.175 rad times the square root of
            the number of joints, 0.0125 m times the number of sites.
        far: Error norm beyond which an episode fails; None: twice that between the farthest targets.
        rewards: New weights of terms and new terms, as in `extend`.
        stops: Whether joints stop at their ranges; in OpenSim's simulations coordinates do not. Targets stay
            those within the ranges.
        function_paths: Of an .osim, a file with a set of `FunctionBasedPath`, such as Moco's, in place of the
            paths of the muscles that it names.
        contact: Who computes contact: "mujoco", or "opensim" with the contact forces of the .osim file, which
            may be one that `myowarp convert` has converted.
        doc: One sentence: what the task asks for; "": what follows from the above.
        replace: Whether it may take the place of a task that is registered.

    Raises:
        ValueError: The file is unsuitable, or an argument is not as described; nothing was registered.
    """
    if not isinstance(path, (str, Path)):
        raise ValueError(f"path must be that of an MJCF file, got {path!r}")
    path = Path(path)
    check_choice("kind", kind, KINDS)
    if isinstance(targets, str):
        targets = (targets,)
    names = list(targets) if isinstance(targets, Iterable) else [targets]
    if not all(isinstance(name, str) for name in names):
        raise ValueError(f"targets must be names of joints or sites, got {targets!r}")
    for what, value in (("horizon", horizon), ("near", near), ("far", far), ("control_dt", control_dt)):
        if value is not None and not (_is_number(value) and 0 < value < np.inf):
            raise ValueError(f"{what} must be a positive number, got {value!r}")
    bounds = dict(targets) if isinstance(targets, Mapping) else dict.fromkeys(names)
    if not isinstance(stops, bool):
        raise ValueError(f"stops must be True or False, got {stops!r}")
    check_choice("contact", contact, CONTACTS)
    lengths = None if function_paths is None else Path(function_paths)
    body, model = register_body(path, tuple(bounds) if kind == "reach" else (), stops, lengths, contact)
    name, version = split_key(key) if key is not None else (body if kind == "pose" else f"{body}_{kind}", 0)
    start = _start(model, path, keyframe)
    common: dict[str, Any] = {
        "name": name,
        "version": version,
        "body": body,
        "horizon": checked_horizon(horizon),
        "physics_dt": model.opt.timestep,
        "num_substeps": _substeps(model.opt.timestep, control_dt),
        "integrator": mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_"),
        "start_pose": tuple(start.tolist()),
    }
    make = _pose if kind == "pose" else _reach
    task = make(_Given(model, path, start, bounds, near, far), common | {"doc": doc})
    if rewards:
        return extend(task, task.key, rewards=rewards, replace=replace)
    return register(task, replace=replace)


def from_osim(path: str | Path, key: str | None = None, kind: str = "pose", **options: Any) -> TaskSpec:
    """Return a task on a model of OpenSim as its file says, nothing fitted; it is registered.

    Joints follow couplers exactly, muscles run over OpenSim's own paths (`coordinates.own_paths`), and those
    that take the parameters of Hill muscles have the file's. A line is logged for what acts in OpenSim and
    not here; `myowarp convert` reports it in full, and writes a model for plain MuJoCo.

    Args:
        path: .osim of OpenSim 1.9 to 4.6.
        key: As for `from_mjcf`.
        kind: As for `from_mjcf`; sites are the model's markers.
        **options: As for `from_mjcf`; joints are those that show OpenSim's coordinates, and have their names
            where these turn or slide along one axis.

    Raises:
        ValueError: The file is unsuitable, or an argument is not as described; nothing was registered.
    """
    if not isinstance(path, (str, Path)) or Path(path).suffix.lower() != OPENSIM:
        raise ValueError(f"path must be that of an .osim file, got {path!r}")
    return from_mjcf(path, key, kind, **options)


def _is_number(value: object) -> bool:
    """Whether it is a number and no truth value."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def _start(model: mujoco.MjModel, path: Path, keyframe: str | None) -> np.ndarray:
    """Return the configuration from which episodes start, (nq,)."""
    names = [model.key(k).name for k in range(model.nkey)]
    if keyframe is not None and keyframe not in names:
        raise ValueError(
            f"model {str(path)!r} has no keyframe {keyframe!r}; it has {', '.join(names) or 'none'}"
        )
    chosen = names.index(keyframe) if keyframe is not None else 0
    return settled(model, model.key_qpos[chosen] if names else model.qpos0)


def _substeps(physics_dt: float, control_dt: float | None) -> int:
    """Return the physics steps in a control step."""
    if (asked := control_dt or CONTROL_DT) > MOST_SUBSTEPS * physics_dt:
        raise ValueError(
            f"control_dt must be at most {MOST_SUBSTEPS} of the file's time steps, {physics_dt:g} s each, "
            f"got {asked:g} s"
        )
    if control_dt is None:
        return max(1, round(CONTROL_DT / physics_dt))
    number = round(control_dt / physics_dt)
    if number < 1 or abs(number * physics_dt - control_dt) > STEP_ROUNDING * physics_dt:
        raise ValueError(
            f"control_dt must be a multiple of the file's time step, {physics_dt:g} s, got {control_dt:g} s"
        )
    return number


class _Given(NamedTuple):
    """Sources of a task's goals; as in `from_mjcf`."""

    model: mujoco.MjModel
    path: Path
    start: np.ndarray
    bounds: Mapping[str, Sequence[Any] | None]
    near: float | None
    far: float | None


def _pose(given: _Given, common: dict[str, Any]) -> TaskSpec:
    """Return the pose task of some joints, or of all that actuators move."""
    model, path, start, bounds, near, far = given
    moved = _moved_joints(model)
    if not moved:
        raise ValueError(f"model {str(path)!r} has no free hinge or slide that its actuators move")
    names = [model.joint(j).name for j in moved]
    for name in bounds:
        if name not in names:
            raise ValueError(
                f"model {str(path)!r} has no hinge or slide {name!r} that its actuators move and no equality "
                f"ties; it has {', '.join(names)}"
            )
    joints = np.array([moved[names.index(name)] for name in bounds] or moved)
    around = start[model.jnt_qposadr[joints], None] + (-SPAN, SPAN)
    limits = model.jnt_range[joints]
    span = np.where(limits[:, :1] < limits[:, 1:], limits, around)
    for row, (name, asked) in zip(span, bounds.items(), strict=False):
        if asked is not None:
            low, high = _bounds(f"joint {name!r}", asked, 1)[:, 0]
            if model.joint(name).limited[0] and (low < row[0] or high > row[1]):
                raise ValueError(
                    f"target of joint {name!r} must be within its range, {row[0]:g} to {row[1]:g}, "
                    f"got {low:g} to {high:g}"
                )
            row[:] = low, high
    low, high = span.T
    doc = f"Bring {len(joints)} joints of {path.name} to a random pose."
    return PoseTask(
        **common | {"doc": common["doc"] or doc},
        target_low=tuple(low.tolist()),
        target_high=tuple(high.tolist()),
        near=ELBOW_NEAR * float(np.sqrt(len(joints))) if near is None else near,
        far=2.0 * float(np.linalg.norm(np.maximum(abs(high - start[model.jnt_qposadr[joints]]), high - low)))
        if far is None
        else far,
        joints=tuple(joints.tolist()),
    )


def _reach(given: _Given, common: dict[str, Any]) -> TaskSpec:
    """Return the reach task of some sites."""
    model, path, start, bounds, near, far = given
    sites = [model.site(i).name for i in range(model.nsite)]
    for name in bounds or ("",):
        if name not in sites:
            raise ValueError(
                f"targets of kind 'reach' must be sites of model {str(path)!r}, got {name or 'none'}; "
                f"it has {', '.join(filter(None, sites)) or 'none'}"
            )
    bounded = [value is not None for value in bounds.values()]
    if any(bounded) and not all(bounded):
        raise ValueError("targets must give bounds for every site, or for none")
    tips = tuple(bounds)
    table = None
    if all(bounded):
        boxes = np.stack([_bounds(f"site {name!r}", box, 3) for name, box in bounds.items() if box], axis=1)
        low, high = boxes.reshape(2, -1)
    else:
        joints = _moved_joints(model)
        if not joints:
            raise ValueError(f"model {str(path)!r} has no free hinge or slide that its actuators move")
        table = Reachable(tuple(joints))
        points = table.points(model, tips, start)
        low, high = points.min(axis=0), points.max(axis=0)
    tip = tip_positions(model, tips, start[None])[0]
    widest = float(np.linalg.norm(np.maximum(np.maximum(abs(high - tip), abs(low - tip)), high - low)))
    return ReachTask(
        **common | {"doc": common["doc"] or f"Bring {', '.join(tips)} of {path.name} to random points."},
        center=tuple((0.5 * (low + high)).tolist()),
        low=tuple((0.5 * (low - high)).tolist()),
        high=tuple((0.5 * (high - low)).tolist()),
        far_per_tip=(2.0 * widest if far is None else far) / len(tips),
        near_per_tip=NEAR_PER_TIP if near is None else near / len(tips),
        table=table,
    )


def _bounds(what: str, given: Any, size: int) -> np.ndarray:
    """Return bounds of a target, shape (2, size).

    Raises:
        ValueError: They are no two finite points, the lower first.
    """
    try:
        bounds = np.asarray(given, dtype=float).reshape(2, size)
    except (TypeError, ValueError):
        bounds = np.full((2, size), np.nan)
    if not np.isfinite(bounds).all() or (bounds[0] > bounds[1]).any():
        kind = "numbers" if size == 1 else f"points of {size} numbers"
        raise ValueError(f"target of {what} must be two {kind}, low and high, got {given!r}")
    return bounds


@dataclass(frozen=True)
class Reachable:
    """Points that sites reach at once: where they are in random poses, a `table` of `ReachTask`.

    Attributes:
        joints: Ids of the joints that move, each uniformly within its range.
    """

    joints: tuple[int, ...]

    def __call__(self, spec: TaskSpec, tips: tuple[str, ...], *_: object) -> np.ndarray:
        """Return points [m], shape (NUM_TARGETS, 3 num_tips)."""
        model = full_model(spec)
        return self.points(model, tips, spec.start(model))

    def points(self, model: mujoco.MjModel, tips: tuple[str, ...], start: np.ndarray) -> np.ndarray:
        """Return points for a model and the configuration of what does not move."""
        joints = np.array(self.joints)
        address = model.jnt_qposadr[joints]
        around = start[address, None] + (-SPAN, SPAN)
        limits = model.jnt_range[joints]
        low, high = np.where(limits[:, :1] < limits[:, 1:], limits, around).T
        poses = np.tile(start, (NUM_TARGETS, 1))
        poses[:, address] = np.random.default_rng(0).uniform(low, high, (NUM_TARGETS, len(joints)))
        for pose in poses:
            follow(model, pose)
        return tip_positions(model, tips, poses)


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

"""Points that the tips of a body reach within its joint ranges, by batched inverse kinematics.

    residual(target) = min over q in [low, high] of |tips(q) - target|

with the norm over all 3 k coordinates of k tips, as the reach tasks score it. The Levenberg-Marquardt solver
of the library `newton` searches for the minimum from several starts; each answer is clamped to the joint
ranges and its tips are computed again by MuJoCo in double precision. So a residual is an upper bound that
the returned configuration attains: the search can call a reachable target unreachable, never the reverse.
Muscles, gravity and contacts are ignored.
"""

from typing import TYPE_CHECKING

import mujoco
import numpy as np
import warp as wp

if TYPE_CHECKING:
    import newton
    from newton import ik

NUM_STARTS = 4  # mid-range and 3 random ones; of 1000 poses of the hand one start misses 4, four miss 1
NUM_ITERATIONS = 25  # a solve; p95 of the excess over the minimum is then below 0.1 mm for the hand
POSITION_WEIGHT = 10.0  # 1/m; keeps the solver's absolute floor, 1e-8 of cost, below 10 micrometres
LIMIT_WEIGHTS = (1.0, 10.0)  # 1/rad; soft limits to pass through in the first solve, stiff in the second
SLIDE_WEIGHT = 10.0  # rad/m; a slide's limit over a hinge's, so that it is as stiff to a tip 0.1 m away
HINGE, SLIDE, BALL, FREE = (
    kind.value
    for kind in (
        mujoco.mjtJoint.mjJNT_HINGE,
        mujoco.mjtJoint.mjJNT_SLIDE,
        mujoco.mjtJoint.mjJNT_BALL,
        mujoco.mjtJoint.mjJNT_FREE,
    )
)
ROWS_TOGETHER = 2048  # targets times starts; 25 MB for the hand, and more rows are no faster


def reachable(
    model: mujoco.MjModel,
    tips: tuple[str, ...],
    targets: np.ndarray,
    num_starts: int = NUM_STARTS,
) -> tuple[np.ndarray, np.ndarray]:
    """Return how close the tips can come to each target, and where the joints are then.

    Runs on the CPU device whatever the machine has. All targets share their starts, so the answer for
    one does not depend on the others.

    Args:
        model: The body, full or slim; see `unsolved`.
        tips: Names of tip sites.
        targets: Target points [m], world coordinates, shape (num_targets, 3 num_tips).
        num_starts: Starts of the search for each target; the first one is mid-range.

    Returns:
        Smallest residual norm found [m], shape (num_targets,), and the configurations that attain it,
        shape (num_targets, nq).

    Raises:
        ValueError: A tip does not exist, or the targets have a wrong shape or are not finite.
        NotImplementedError: `unsolved` says why.
    """
    targets = np.asarray(targets, dtype=np.float64)
    _check(model, tips, targets)
    low, high = _search_box(model)
    starts = np.random.default_rng(0).uniform(low, high, (num_starts, model.nq))
    starts[0] = (low + high) / 2.0
    starts = _within_ranges(model, starts)
    residual, qpos = np.empty(len(targets)), np.empty((len(targets), model.nq))
    step = max(1, ROWS_TOGETHER // num_starts)
    for chunk in (slice(first, first + step) for first in range(0, len(targets), step)):
        wanted = np.repeat(targets[chunk], num_starts, axis=0)
        angles = np.tile(starts, (len(targets[chunk]), 1))
        angles = _within_ranges(model, _solve(model, tips, wanted, angles))
        distance = np.linalg.norm(tip_positions(model, tips, angles) - wanted, axis=1)
        best = np.nanargmin(distance.reshape(-1, num_starts), axis=1)
        rows = np.arange(0, len(wanted), num_starts) + best
        residual[chunk], qpos[chunk] = distance[rows], angles[rows]
    return residual, qpos


def tip_positions(model: mujoco.MjModel, tips: tuple[str, ...], qpos: np.ndarray) -> np.ndarray:
    """Return where the tips are [m], shape (num, 3 num_tips), for `qpos` of shape (num, nq)."""
    data = mujoco.MjData(model)
    sites = [model.site(tip).id for tip in tips]
    positions = np.empty((len(qpos), 3 * len(tips)))
    for position, configuration in zip(positions, qpos, strict=True):
        data.qpos[:] = configuration
        mujoco.mj_kinematics(model, data)
        position[:] = data.site_xpos[sites].ravel()
    return positions


def _check(model: mujoco.MjModel, tips: tuple[str, ...], targets: np.ndarray) -> None:
    """Raise what `reachable` declares."""
    if missing := sorted(set(tips) - {model.site(i).name for i in range(model.nsite)}):
        raise ValueError(f"site {missing[0]!r} unknown in this model; check the names of the tips")
    if targets.ndim != 2 or targets.shape[1] != 3 * len(tips) or not np.isfinite(targets).all():
        raise ValueError(
            f"targets must be finite with shape (num_targets, {3 * len(tips)}), three columns a tip; "
            f"got shape {targets.shape}"
        )
    if why := unsolved(model):
        raise NotImplementedError(why)


def unsolved(model: mujoco.MjModel) -> str:
    """Return why the joints of a model are not solved for; "": none follows another."""
    return "an equality constraint couples joints" if (model.eq_type == mujoco.mjtEq.mjEQ_JOINT).any() else ""


def _search_box(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return between what each entry of a configuration starts, shape (nq,) each."""
    low, high = np.full(model.nq, -1.0), np.full(model.nq, 1.0)  # quaternions, to be normalised
    for joint, kind in enumerate(model.jnt_type):
        at, range_ = model.jnt_qposadr[joint], model.jnt_range[joint]
        if kind == FREE:
            place = slice(at, at + 3)
            low[place], high[place] = model.qpos0[place] + model.stat.extent * np.array(((-1.0,), (1.0,)))
        elif kind != BALL:
            half = np.pi if kind == HINGE else model.stat.extent
            usual = model.qpos0[at] + half * np.array((-1.0, 1.0))
            low[at], high[at] = range_ if model.jnt_limited[joint] else usual
    return low, high


def _within_ranges(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """Return configurations (num, nq) with joints moved into their ranges, and quaternions normalised."""
    qpos = qpos.copy()
    for joint, kind in enumerate(model.jnt_type):
        at, (low, high) = model.jnt_qposadr[joint], model.jnt_range[joint]
        if kind in (BALL, FREE):
            first = at + 3 * (kind == FREE)
            turn = qpos[:, first : first + 4]
            turn *= np.where(turn[:, :1] < 0.0, -1.0, 1.0)
            sine = np.linalg.norm(turn[:, 1:], axis=1, keepdims=True)
            half = np.arctan2(sine, turn[:, :1])
            if kind == BALL and model.jnt_limited[joint]:
                half = np.minimum(half, high / 2.0)
            turn[:, 1:] *= np.sin(half) / np.maximum(sine, mujoco.mjMINVAL)
            turn[:, :1] = np.cos(half)
        elif model.jnt_limited[joint]:
            qpos[:, at] = np.clip(qpos[:, at], low, high)
    return qpos


def _solve(
    model: mujoco.MjModel,
    tips: tuple[str, ...],
    targets: np.ndarray,
    starts: np.ndarray,
) -> np.ndarray:
    """Return the configurations found from each start, perhaps slightly out of range."""
    from newton import ik  # takes a second to import, paid only by those who solve

    chain, links = _newton_chain(model)
    points = targets.astype(np.float32).reshape(len(targets), -1, 3)
    objectives = []
    for k, tip in enumerate(tips):
        link, frame = links[int(model.site(tip).bodyid[0])]
        offset = wp.transform_point(frame, wp.vec3(*model.site(tip).pos))
        aim = wp.array(points[:, k], dtype=wp.vec3, device="cpu")
        objectives.append(ik.IKObjectivePosition(link, offset, aim, weight=POSITION_WEIGHT))
    limits = _limits(model)
    solver = ik.IKSolver(
        chain, len(targets), [*objectives, *(limit for limit, _ in limits)], jacobian_mode="analytic"
    )
    places, zero = _newton_order(model)
    coordinates = wp.array((starts - zero)[:, places], dtype=wp.float32, device="cpu")
    for weight in LIMIT_WEIGHTS:
        for limit, scale in limits:
            limit.weight = scale * weight
        solver.step(coordinates, coordinates, NUM_ITERATIONS)
    found = np.empty_like(starts)
    found[:, places] = coordinates.numpy()
    return found + zero


def _limits(model: mujoco.MjModel) -> list[tuple["ik.IKObjectiveJointLimit", float]]:
    """Return what keeps joints in their ranges, hinges and slides apart, and how stiff each is."""
    from newton import ik

    limits = []
    for kind, scale in ((HINGE, 1.0), (SLIDE, SLIDE_WEIGHT)):
        bounds = np.tile((-np.inf, np.inf), (model.nv, 1))
        joints = np.flatnonzero((model.jnt_type == kind) & (model.jnt_limited > 0))
        zero = model.qpos0[model.jnt_qposadr[joints], None]
        bounds[model.jnt_dofadr[joints]] = model.jnt_range[joints] - zero
        if len(joints):
            arrays = (wp.array(bound, dtype=wp.float32, device="cpu") for bound in bounds.T)
            limits.append((ik.IKObjectiveJointLimit(*arrays), scale))
    return limits


def _newton_order(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return where Newton's coordinates are in MuJoCo's, and what they are counted from, shape (nq,) each.

    Newton's quaternions end with their real part; its hinges and slides are 0 at `qpos0`.
    """
    places, zero = np.arange(model.nq), model.qpos0.copy()
    for joint in np.flatnonzero(np.isin(model.jnt_type, (BALL, FREE))):
        at = model.jnt_qposadr[joint]
        last = at + (4 if model.jnt_type[joint] == BALL else 7)
        zero[at:last] = 0.0
        places[last - 4 : last] = last - 4 + np.array((1, 2, 3, 0))
    return places, zero


def _newton_chain(
    model: mujoco.MjModel,
) -> tuple["newton.Model", dict[int, tuple[int, wp.transform]]]:
    """Build the joints of a body for Newton, one link a joint.

    From the compiled model and not by Newton's MJCF import: joints keep their order, no file is needed,
    and nothing of the geometry.

    Returns:
        The chain, and for each MuJoCo body the link that carries it (-1: the world) and its frame there.
    """
    import newton

    builder = newton.ModelBuilder()
    links, joints = {0: (-1, wp.transform())}, []
    for body in range(1, model.nbody):
        link, frame = links[int(model.body_parentid[body])]
        w, x, y, z = model.body_quat[body]
        frame = frame * wp.transform(wp.vec3(*model.body_pos[body]), wp.quat(x, y, z, w))
        for j in model.body_jntadr[body] + np.arange(model.body_jntnum[body]):
            parent, link = link, builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3)))
            joints.append(_add_joint(builder, model, j, parent, link, frame))
            frame = wp.transform()
        links[body] = (link, frame)
    builder.add_articulation(joints)
    return builder.finalize(device="cpu"), links


def _add_joint(
    builder: "newton.ModelBuilder", model: mujoco.MjModel, j: int, parent: int, link: int, frame: wp.transform
) -> int:
    """Add a joint whose child is at `frame` in its parent at `qpos0`; return its number."""
    kind = model.jnt_type[j]
    if kind == FREE:
        return builder.add_joint_free(link, parent=parent)
    anchor = wp.transform(wp.vec3(*model.jnt_pos[j]), wp.quat_identity())
    frames = {"parent_xform": frame * anchor, "child_xform": anchor}
    if kind == BALL:
        return builder.add_joint_ball(parent, link, **frames)
    add = builder.add_joint_revolute if kind == HINGE else builder.add_joint_prismatic
    return add(parent, link, axis=wp.vec3(*model.jnt_axis[j]), **frames)

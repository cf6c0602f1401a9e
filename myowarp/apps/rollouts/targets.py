"""The share of a task's targets that can be met: a rule for each family.

Geometry alone is asked: joint ranges, the reach of the tips, and room for an object over the open hand of
the start. Muscles, gravity and time are not, so a share of postures is an upper bound of what a policy can
solve. A share of objects is none: a hand that moves makes room.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import mujoco
import numpy as np
import warp as wp

from myowarp.apps.rollouts.objects import host_model, object_bodies, overlaps, place
from myowarp.definitions.body import BODIES
from myowarp.definitions.task import Judgement, TaskSpec
from myowarp.models.reachability import unsolved
from myowarp.process import warn_once
from myowarp.sim.simulation import Simulation
from myowarp.tasks import baoding, pen_twirl
from myowarp.tasks.baoding import BaodingTask
from myowarp.tasks.hand_poses import as_in_myosuite_3
from myowarp.tasks.key_turn import KeyTurnTask
from myowarp.tasks.object_hold import ObjectHoldTask
from myowarp.tasks.pen_twirl import PenTwirlTask
from myowarp.tasks.pose import PoseProgram, PoseTask
from myowarp.tasks.reach import EXACT, ReachProgram, ReachTask

NUM_TARGETS = 256  # drawn; of those that are alike one is judged
OVERLAP = 5e-3  # m, overlap with the open hand that the hand can make room for
PHASES = 8  # of an episode, at which moving targets are judged
LIFTS = 15  # places above its start at which a pen is tried


@dataclass(frozen=True)
class Targets:
    """The share of the targets that can be met.

    Attributes:
        count: Different targets judged, of `NUM_TARGETS` draws.
        solvable: Share of the draws that can be met well enough to count as solved; None: see `why`.
        exact: Share of the draws that can be met exactly.
        worst: Largest miss that remains.
        unit: Unit of `worst`.
        rule: What the shares say.
        why: Why there are none, empty where there are.
        thumb_off: Largest distance [m] of the thumb tip in a target posture from where the hand has it for
            which the posture was published; None: the targets are no such postures.
    """

    count: int
    solvable: float | None
    exact: float | None
    worst: float | None
    unit: str
    rule: str
    why: str = ""
    thumb_off: float | None = None


def measure(sim: Simulation) -> Targets:
    """Return which share of a task's targets can be met; the simulation is reset many times."""
    for kind, rule in RULES.items():
        if isinstance(sim.scene.spec, kind):
            return rule(sim)
    return _none(f"there is no rule for family {sim.scene.spec.family!r}")


def in_reach(spec: TaskSpec, model: mujoco.MjModel, rows: np.ndarray) -> np.ndarray | None:
    """Return which targets can be met exactly, by joint ranges alone, (num_targets,) bool.

    Args:
        spec: The task.
        model: Its model.
        rows: Its `task.target`, shape (num_targets, size).

    Returns:
        None where the targets are neither joint angles nor points of tips, or, which a line says, points of
        a body for which reach is not solved.
    """
    different, number = np.unique(rows.astype(float), axis=0, return_inverse=True)
    try:
        judgement = spec.judge(model, different)
    except ValueError as why:
        warn_once(f"success over reachable targets of {spec.key} is left out: {why}")
        return None
    return None if judgement is None else judgement[1][number]


def _none(why: str) -> Targets:
    """Return that there is nothing to say."""
    return Targets(count=0, solvable=None, exact=None, worst=None, unit="", rule="", why=why)


def _judged(
    drawn: np.ndarray,
    judge: Callable[[np.ndarray], Judgement],
    unit: str,
    rule: str,
) -> Targets:
    """Judge every different row of `drawn` once; `judge` returns solvable, exact and the miss of each row."""
    rows, number = np.unique(drawn, axis=0, return_counts=True)
    solvable, exact, miss = judge(rows)
    can, well = (float(number[good].sum() / number.sum()) for good in (solvable, exact))
    return Targets(len(rows), can, well, float(miss.max()), unit, rule)


def _draws(sim: Simulation, read: Callable[[], np.ndarray]) -> np.ndarray:
    """Return what `read` returns, a row a world, in `NUM_TARGETS` worlds after resets."""
    rows: list[np.ndarray] = []
    while len(rows) < NUM_TARGETS:
        sim.reset()
        rows.extend(np.array(read()))
    return np.stack(rows[:NUM_TARGETS]).astype(float)


def _pose(sim: Simulation) -> Targets:
    """Targets against the joint ranges."""
    spec, program = sim.scene.spec, sim.shards[0].program
    assert isinstance(spec, PoseTask)
    assert isinstance(program, PoseProgram)
    rule = (
        f"solvable: some posture within the joint ranges is closer than {spec.near:.3g} rad, norm over all "
        "joints; exact: the target is within the ranges"
    )
    drawn = _draws(sim, program.target.numpy)
    found = _judged(drawn, partial(spec.judge, sim.scene.oracle), "rad", rule)
    if spec.body != "hand":
        return found
    return replace(found, thumb_off=_thumb_off(spec, np.unique(drawn, axis=0)))


def _thumb_off(spec: PoseTask, targets: np.ndarray) -> float:
    """Return `Targets.thumb_off` of hand postures, shape (num_targets, num_joints).

    They were published for the hand of MyoSuite 2, ours that touches. Its thumb has the axes of the hand of
    the pose tasks; version 0 has MyoSuite 3's values, two of them in each other's place.
    """
    models = [BODIES[name].build().compile() for name in (spec.body, "contact_hand")]
    posed = [mujoco.MjData(model) for model in models]
    worst = 0.0
    for target in targets:
        published = as_in_myosuite_3(tuple(target)) if spec.version == 0 else target
        place = []
        for model, data, qpos in zip(models, posed, (target, published), strict=True):
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            place.append(data.site("THtip_r").xpos.copy())
        worst = max(worst, float(np.linalg.norm(place[0] - place[1])))
    return worst


def _reach(sim: Simulation) -> Targets:
    """Targets against the tips' reach, by inverse kinematics."""
    spec, program = sim.scene.spec, sim.shards[0].program
    assert isinstance(spec, ReachTask)
    assert isinstance(program, ReachProgram)
    if why := unsolved(sim.scene.oracle):
        return _none(f"the tips' reach is not known: {why}")
    rule = (
        f"solvable: some posture within the joint ranges brings the tips closer than {1e3 * spec.near:.3g} "
        f"mm, norm over all tips as the task scores it; exact: closer than {1e3 * EXACT:.0f} mm"
    )
    judge = partial(spec.judge, sim.scene.oracle)
    return _judged(_draws(sim, program.target.numpy), judge, "m", rule)


def _key(sim: Simulation) -> Targets:
    """The goal angle against the range of the key's hinge."""
    model, spec, (key,) = sim.scene.oracle, sim.scene.spec, object_bodies(sim.scene)
    assert isinstance(spec, KeyTurnTask)
    joint = model.body_jntadr[key]
    if not model.jnt_limited[joint]:
        return _none(
            "the key's hinge has no range: it has every angle, and how fingers get it there is not asked"
        )
    goal = np.array([[spec.goal_angle]])
    miss = np.maximum(goal[:, 0] - model.jnt_range[joint, 1], 0.0)
    return _judged(goal, lambda rows: (miss == 0, miss == 0, miss), "rad", "the angle is in the key's range")


def _open_hand(sim: Simulation, world: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the host's model of a world with the hand as the task starts it."""
    model = host_model(sim.scene, world)
    data = mujoco.MjData(model)
    data.qpos[:] = sim.scene.spec.start(sim.scene.oracle)
    return model, data


def _placed(sim: Simulation, phases: int) -> np.ndarray:
    """Return how deep objects overlap the open hand, and each other, at their goals [m].

    The goals are those that the markers `<object>_target` show; those that move do so with the step count,
    over an episode in `phases` steps.

    Returns:
        Deepest overlaps with anything else and with each other, then the goals; a row for every phase of
        every world, of no more worlds than there are targets to judge; 2 + 3 num_goals columns.
    """
    scene, spec = sim.scene, sim.scene.spec
    objects = object_bodies(scene)
    step_count = wp.zeros(sim.num_worlds, dtype=int, device=scene.device)
    models = [_open_hand(sim, world) for world in range(min(sim.num_worlds, NUM_TARGETS))]
    rows: list[list[np.ndarray]] = [[] for _ in models]
    for phase in range(phases):
        step_count.fill_(1 + phase * spec.horizon // phases)
        with wp.ScopedDevice(scene.device):
            sim.shards[0].program.advance(step_count)
        for world, (model, data) in enumerate(models):
            goals = sim.shards[0].program.goal_markers(world)
            for marker, pos in goals.items():
                place(model, data, model.body(marker.removesuffix("_target")).id, pos)
            rows[world].append(np.concatenate([overlaps(model, data, objects), *goals.values()]))
    return np.concatenate(rows)


def _hold(sim: Simulation) -> Targets:
    """The object at its goal against the open hand."""

    def judge(rows: np.ndarray) -> Judgement:
        return rows[:, 0] < OVERLAP, rows[:, 0] < EXACT, rows[:, 0]

    rule = (
        f"solvable: at the goal the object overlaps the open hand by less than {1e3 * OVERLAP:.0f} mm; "
        f"exact: by less than {1e3 * EXACT:.0f} mm"
    )
    return _judged(_draws(sim, lambda: _placed(sim, 1)), judge, "m", rule)


def _baoding(sim: Simulation) -> Targets:
    """Both balls at their targets against the open hand and each other, over the episode."""
    near = float(baoding.NEAR)

    def judge(rows: np.ndarray) -> Judgement:
        deep = rows[:, :2]
        solvable = (deep[:, 0] < near) & (deep[:, 1] < 2.0 * near)
        return solvable, deep.max(axis=1) < EXACT, deep.max(axis=1)

    rule = (
        f"solvable: with both balls at their targets over the open hand no overlap is larger than the "
        f"{1e3 * near:.0f} mm that each ball may be off; exact: than {1e3 * EXACT:.0f} mm; at {PHASES} times"
    )
    return _judged(_draws(sim, lambda: _placed(sim, PHASES)), judge, "m", rule)


def _pen(sim: Simulation) -> Targets:
    """The pen, turned to the target orientation, against the open hand, where it starts and above."""
    model, data = _open_hand(sim, 0)
    (pen,) = object_bodies(sim.scene)
    highest = float(pen_twirl.DROPPED)
    lifts = np.linspace(0.0, highest, LIFTS, endpoint=False)

    def depth(quat: np.ndarray, lift: float) -> float:
        place(model, data, pen, np.add(pen_twirl.PEN_POS, (0.0, 0.0, lift)), quat)
        return overlaps(model, data, (pen,))[0]

    def judge(rows: np.ndarray) -> Judgement:
        deep = np.array([[depth(quat, lift) for lift in lifts] for quat in rows])
        return deep.min(axis=1) < OVERLAP, deep[:, 0] < EXACT, deep.min(axis=1)

    rule = (
        f"solvable: somewhere up to {1e3 * highest:.0f} mm above its start the pen has room for the target "
        f"orientation, overlap with the open hand below {1e3 * OVERLAP:.0f} mm; exact: at its start, "
        f"overlap below {1e3 * EXACT:.0f} mm"
    )
    return _judged(_draws(sim, lambda: sim.scene.data.mocap_quat.numpy()[:, 0]), judge, "m", rule)


RULES: dict[type[TaskSpec], Callable[[Simulation], Targets]] = {
    PoseTask: _pose,
    ReachTask: _reach,
    KeyTurnTask: _key,
    ObjectHoldTask: _hold,
    PenTwirlTask: _pen,
    BaodingTask: _baoding,
}
"""Family to its rule; every id of the family is covered."""

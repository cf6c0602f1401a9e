"""The reach ids: finger, hand and arm."""

from dataclasses import replace

from myowarp.definitions.task import task
from myowarp.tasks import reach_targets
from myowarp.tasks.pose_ids import OF_MOTORS, STRONGER
from myowarp.tasks.reach import ReachTask

FINGER_FAR, HAND_FAR, HAND_FAR_FIXED_V0 = 0.35, 0.075, 0.044  # m a tip; MyoSuite 3.0.0


@task("motorFingerReachFixed-v1", STRONGER, body="strong_motor_finger", **OF_MOTORS)
@task("motorFingerReachFixed-v0", body="motor_finger", **OF_MOTORS)
@task("myoFingerReachFixed-v0")
def finger_fixed() -> ReachTask:
    """Touch one point with the fingertip."""
    point, still = (0.2, 0.05, 0.2), (0.0, 0.0, 0.0)
    return ReachTask(body="finger", center=point, low=still, high=still, far_per_tip=FINGER_FAR)


@task("motorFingerReachRandom-v1", STRONGER, body="strong_motor_finger", **OF_MOTORS)
@task("motorFingerReachRandom-v0", body="motor_finger", **OF_MOTORS)
@task("myoFingerReachRandom-v0")
def finger_random() -> ReachTask:
    """Touch a point drawn anew each episode from the reachable part of a box."""
    return ReachTask(
        body="finger",
        center=(0.185, 0.0, 0.2),
        low=(-0.085, -0.1, -0.1),
        high=(0.085, 0.1, 0.1),
        far_per_tip=FINGER_FAR,
        table=reach_targets.sampled,
    )


HAND_CENTER = (
    *(-0.165, -0.537, 1.495),  # thumb
    *(-0.151, -0.547, 1.455),  # index
    *(-0.146, -0.547, 1.447),  # middle
    *(-0.148, -0.543, 1.445),  # ring
    *(-0.148, -0.528, 1.434),  # little
)  # m, world: the tips of the paper's start posture, every joint at mid-range
HAND_LOW = (-0.02, -0.04, -0.04) + 4 * (-0.04, -0.02, -0.01)
HAND_HIGH = (0.04, 0.02, 0.04) + 4 * (0.04, 0.02, 0.01)
STILL = (0.0,) * len(HAND_CENTER)


def bring_tips(low: tuple[float, ...], high: tuple[float, ...], far_per_tip: float = HAND_FAR) -> ReachTask:
    """Return the hand's task with targets between `low` and `high` around `HAND_CENTER` [m]."""
    return ReachTask(body="hand", center=HAND_CENTER, low=low, high=high, far_per_tip=far_per_tip)


@task("myoHandReachFixed-v0")
def hand_fixed_v0() -> ReachTask:
    """Bring all five fingertips to fixed points."""
    return bring_tips(STILL, STILL, HAND_FAR_FIXED_V0)


@task("myoHandReachFixed-v1")
def hand_fixed() -> ReachTask:
    """Bring all five fingertips to fixed points.

    The failure radius is that of the random task: in v0, as in MyoSuite 3.0.0, it was set for another start
    posture, and a resting hand fails at step 18.
    """
    return bring_tips(STILL, STILL)


@task("myoHandReachRandom-v0")
def hand_random_v0() -> ReachTask:
    """Bring all five fingertips to points drawn anew each episode."""
    return bring_tips(HAND_LOW, HAND_HIGH)


@task("myoHandReachRandom-v1")
def hand_random() -> ReachTask:
    """Bring all five fingertips to points drawn anew each episode, all within reach at once.

    In v0, as in MyoSuite 3.0.0, the tips cannot reach five in six targets at once: the best posture leaves
    the thumb up to 6 cm off.
    """
    return replace(bring_tips(HAND_LOW, HAND_HIGH), table=reach_targets.solved)


ARM_CENTER = (-0.175, -0.245, 1.405)  # m, world: in front of the chest
ARM_FAR_FIXED, ARM_FAR_RANDOM = 1.0, 1.3  # m; MyoSuite 3.0.0


def point_at(low: tuple[float, ...], high: tuple[float, ...], far: float) -> ReachTask:
    """Return the arm's task with a target between `low` and `high` around `ARM_CENTER` [m]."""
    return ReachTask(body="arm", center=ARM_CENTER, low=low, high=high, far_per_tip=far, horizon=150)


@task("myoArmReachFixed-v0")
def arm_fixed() -> ReachTask:
    """Bring the index fingertip of the whole arm to one point in front of the chest."""
    return point_at((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), ARM_FAR_FIXED)


@task("myoArmReachRandom-v0")
def arm_random() -> ReachTask:
    """Bring the index fingertip of the whole arm to a point drawn anew each episode."""
    return point_at((-0.175, -0.175, -0.425), (0.175, 0.175, 0.425), ARM_FAR_RANDOM)

"""The hand pose ids: a relaxed posture, the ten digits of American Sign Language, and anything between them.

Version 0 has MyoSuite 3.0.0's targets, version 1 the published ones (`hand_poses`).
"""

from myowarp.spec.task import task
from myowarp.tasks.hand_poses import DIGITS, RELAXED, as_in_myosuite_3, bounds
from myowarp.tasks.pose import PoseTask

THUMB_BASE = (
    "Thumb base angles belong to their axes; in v0, as in MyoSuite 3.0.0, they are swapped and put the thumb"
    " tip up to 48 mm off. The target stays within the joint ranges."
)


def hand_pose(low: tuple[float, ...], high: tuple[float, ...] | None = None) -> PoseTask:
    """Return the task of a posture, or of going from a random one to one between `low` and `high` [rad]."""
    random = high is not None
    return PoseTask(body="hand", target_low=low, target_high=high or low, near=0.7, random_start=random)


def sign_as_in_myosuite_3(digit: int) -> PoseTask:
    """Return the task of signing a digit, thumb base values swapped."""
    return hand_pose(as_in_myosuite_3(DIGITS[digit]))


def sign(digit: int) -> PoseTask:
    """Return the task of signing a digit."""
    return hand_pose(DIGITS[digit])


@task("myoHandPoseFixed-v0")
def hand_fixed_v0() -> PoseTask:
    """Move the hand to a relaxed posture."""
    return hand_pose(as_in_myosuite_3(RELAXED))


@task("myoHandPose0Fixed-v0")
def hand_0_v0() -> PoseTask:
    """Sign the digit 0 in American Sign Language."""
    return sign_as_in_myosuite_3(0)


@task("myoHandPose1Fixed-v0")
def hand_1_v0() -> PoseTask:
    """Sign the digit 1 in American Sign Language."""
    return sign_as_in_myosuite_3(1)


@task("myoHandPose2Fixed-v0")
def hand_2_v0() -> PoseTask:
    """Sign the digit 2 in American Sign Language."""
    return sign_as_in_myosuite_3(2)


@task("myoHandPose3Fixed-v0")
def hand_3_v0() -> PoseTask:
    """Sign the digit 3 in American Sign Language."""
    return sign_as_in_myosuite_3(3)


@task("myoHandPose4Fixed-v0")
def hand_4_v0() -> PoseTask:
    """Sign the digit 4 in American Sign Language."""
    return sign_as_in_myosuite_3(4)


@task("myoHandPose5Fixed-v0")
def hand_5_v0() -> PoseTask:
    """Sign the digit 5 in American Sign Language."""
    return sign_as_in_myosuite_3(5)


@task("myoHandPose6Fixed-v0")
def hand_6_v0() -> PoseTask:
    """Sign the digit 6 in American Sign Language."""
    return sign_as_in_myosuite_3(6)


@task("myoHandPose7Fixed-v0")
def hand_7_v0() -> PoseTask:
    """Sign the digit 7 in American Sign Language."""
    return sign_as_in_myosuite_3(7)


@task("myoHandPose8Fixed-v0")
def hand_8_v0() -> PoseTask:
    """Sign the digit 8 in American Sign Language."""
    return sign_as_in_myosuite_3(8)


@task("myoHandPose9Fixed-v0")
def hand_9_v0() -> PoseTask:
    """Sign the digit 9 in American Sign Language."""
    return sign_as_in_myosuite_3(9)


@task("myoHandPoseRandom-v0")
def hand_random_v0() -> PoseTask:
    """Move the hand from a random posture to one drawn between the ten digits."""
    return hand_pose(*bounds(tuple(map(as_in_myosuite_3, DIGITS))))


@task("myoHandPoseFixed-v1", THUMB_BASE)
def hand_fixed() -> PoseTask:
    """Move the hand to a relaxed posture."""
    within = [max(angle, 0.0) if joint == 9 else angle for joint, angle in enumerate(RELAXED)]
    return hand_pose(tuple(within))


@task("myoHandPose0Fixed-v1", THUMB_BASE)
def hand_0() -> PoseTask:
    """Sign the digit 0 in American Sign Language."""
    return sign(0)


@task("myoHandPose1Fixed-v1", THUMB_BASE)
def hand_1() -> PoseTask:
    """Sign the digit 1 in American Sign Language."""
    return sign(1)


@task("myoHandPose2Fixed-v1", THUMB_BASE)
def hand_2() -> PoseTask:
    """Sign the digit 2 in American Sign Language."""
    return sign(2)


@task("myoHandPose3Fixed-v1", THUMB_BASE)
def hand_3() -> PoseTask:
    """Sign the digit 3 in American Sign Language."""
    return sign(3)


@task("myoHandPose4Fixed-v1", THUMB_BASE)
def hand_4() -> PoseTask:
    """Sign the digit 4 in American Sign Language."""
    return sign(4)


@task("myoHandPose5Fixed-v1", THUMB_BASE)
def hand_5() -> PoseTask:
    """Sign the digit 5 in American Sign Language."""
    return sign(5)


@task("myoHandPose6Fixed-v1", THUMB_BASE)
def hand_6() -> PoseTask:
    """Sign the digit 6 in American Sign Language."""
    return sign(6)


@task("myoHandPose7Fixed-v1", THUMB_BASE)
def hand_7() -> PoseTask:
    """Sign the digit 7 in American Sign Language."""
    return sign(7)


@task("myoHandPose8Fixed-v1", THUMB_BASE)
def hand_8() -> PoseTask:
    """Sign the digit 8 in American Sign Language."""
    return sign(8)


@task("myoHandPose9Fixed-v1", THUMB_BASE)
def hand_9() -> PoseTask:
    """Sign the digit 9 in American Sign Language."""
    return sign(9)


@task("myoHandPoseRandom-v1", THUMB_BASE)
def hand_random() -> PoseTask:
    """Move the hand from a random posture to one drawn between the ten digits."""
    return hand_pose(*bounds(DIGITS))

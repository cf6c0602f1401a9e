"""The pose ids: finger, elbow, hand and torso.

Hand poses are a relaxed posture, the ten digits of American Sign Language, and anything between them; version
0 has MyoSuite 3.0.0's angles, version 1 the published ones (`hand_poses`).
"""

from dataclasses import replace
from typing import Any

import numpy as np

from myowarp.definitions.task import register, split_key, task
from myowarp.tasks.hand_poses import DIGITS, RELAXED, as_in_myosuite_3, bounds
from myowarp.tasks.pose import PoseTask

ELBOW_NEAR = 0.175  # rad
EXO_EFFORT_WEIGHT = 5.0  # of the muscles; the motor is free


STRONGER = "The motors have the gears of myo-sim 0.2.4, because those of version 0 are too weak."
OF_MOTORS: dict[str, Any] = {"num_substeps": 5, "horizon": 200}
"""Fields in which the finger with motors differs from that with muscles."""


@task("motorFingerPoseFixed-v1", STRONGER, body="strong_motor_finger", **OF_MOTORS)
@task("motorFingerPoseFixed-v0", body="motor_finger", **OF_MOTORS)
@task("myoFingerPoseFixed-v0")
def finger_fixed() -> PoseTask:
    """Bend the finger to one pose."""
    pose = (0.0, 0.0, 0.75, 0.75)
    return PoseTask(body="finger", target_low=pose, target_high=pose, near=0.35)


@task("motorFingerPoseRandom-v1", STRONGER, body="strong_motor_finger", **OF_MOTORS)
@task("motorFingerPoseRandom-v0", body="motor_finger", **OF_MOTORS)
@task("myoFingerPoseRandom-v0")
def finger_random() -> PoseTask:
    """Bend the finger to a pose drawn anew each episode."""
    return replace(finger_fixed(), target_low=(-0.2, -0.4, 0.1, 0.1), target_high=(0.2, 1.0, 1.0, 1.0))


def turn_elbow(low: float, high: float) -> PoseTask:
    """Return the task of turning the elbow from a random angle to one between `low` and `high` [rad]."""
    return PoseTask(body="elbow", target_low=(low,), target_high=(high,), near=ELBOW_NEAR, random_start=True)


@task("myoElbowPose1D6MFixed-v0")
def elbow_fixed() -> PoseTask:
    """Flex the elbow to 2 rad from a random angle."""
    return turn_elbow(2.0, 2.0)


@task("myoElbowPose1D6MRandom-v0")
def elbow_random() -> PoseTask:
    """Turn the elbow from a random angle to a random angle."""
    return turn_elbow(0.0, 2.27)


@task("myoElbowPose1D6MExoFixed-v0")
def elbow_exo_fixed() -> PoseTask:
    """Flex the elbow to 2 rad from a random angle, helped by a motor (action 0), with 0.1 kg in the hand."""
    return replace(turn_elbow(2.0, 2.0), body="elbow_exo", effort_weight=EXO_EFFORT_WEIGHT)


@task("myoElbowPose1D6MExoRandom-v0")
def elbow_exo_random() -> PoseTask:
    """Turn the elbow from a random to a random angle, helped by a motor (action 0), with 0.1 to 2 kg."""
    elbow = turn_elbow(0.0, 2.27)
    return replace(elbow, body="elbow_exo", effort_weight=EXO_EFFORT_WEIGHT, weight=(0.1, 2.0))


THUMB_BASE = (
    "Thumb base angles belong to their axes; in v0, as in MyoSuite 3.0.0, they are swapped and put the thumb"
    " tip up to 48 mm off. The target stays within the joint ranges."
)


def hand_pose(low: tuple[float, ...], high: tuple[float, ...] | None = None) -> PoseTask:
    """Return the task of a posture, or of going from a random one to one between `low` and `high` [rad]."""
    random = high is not None
    return PoseTask(body="hand", target_low=low, target_high=high or low, near=0.7, random_start=random)


def sign(key: str, digit: int, posture: tuple[float, ...], why: str = "") -> None:
    """Register the task of signing a digit; its doc ends with why this version exists."""
    name, version = split_key(key)
    doc = f"Sign the digit {digit} in American Sign Language. {why}".strip()
    register(replace(hand_pose(posture), name=name, version=version, doc=doc))


@task("myoHandPoseFixed-v0")
def hand_fixed_v0() -> PoseTask:
    """Move the hand to a relaxed posture."""
    return hand_pose(as_in_myosuite_3(RELAXED))


sign("myoHandPose0Fixed-v0", 0, as_in_myosuite_3(DIGITS[0]))
sign("myoHandPose1Fixed-v0", 1, as_in_myosuite_3(DIGITS[1]))
sign("myoHandPose2Fixed-v0", 2, as_in_myosuite_3(DIGITS[2]))
sign("myoHandPose3Fixed-v0", 3, as_in_myosuite_3(DIGITS[3]))
sign("myoHandPose4Fixed-v0", 4, as_in_myosuite_3(DIGITS[4]))
sign("myoHandPose5Fixed-v0", 5, as_in_myosuite_3(DIGITS[5]))
sign("myoHandPose6Fixed-v0", 6, as_in_myosuite_3(DIGITS[6]))
sign("myoHandPose7Fixed-v0", 7, as_in_myosuite_3(DIGITS[7]))
sign("myoHandPose8Fixed-v0", 8, as_in_myosuite_3(DIGITS[8]))
sign("myoHandPose9Fixed-v0", 9, as_in_myosuite_3(DIGITS[9]))


@task("myoHandPoseRandom-v0")
def hand_random_v0() -> PoseTask:
    """Move the hand from a random posture to one drawn between the ten digits."""
    return hand_pose(*bounds(tuple(map(as_in_myosuite_3, DIGITS))))


@task("myoHandPoseFixed-v1", THUMB_BASE)
def hand_fixed() -> PoseTask:
    """Move the hand to a relaxed posture."""
    within = [max(angle, 0.0) if joint == 9 else angle for joint, angle in enumerate(RELAXED)]
    return hand_pose(tuple(within))


sign("myoHandPose0Fixed-v1", 0, DIGITS[0], THUMB_BASE)
sign("myoHandPose1Fixed-v1", 1, DIGITS[1], THUMB_BASE)
sign("myoHandPose2Fixed-v1", 2, DIGITS[2], THUMB_BASE)
sign("myoHandPose3Fixed-v1", 3, DIGITS[3], THUMB_BASE)
sign("myoHandPose4Fixed-v1", 4, DIGITS[4], THUMB_BASE)
sign("myoHandPose5Fixed-v1", 5, DIGITS[5], THUMB_BASE)
sign("myoHandPose6Fixed-v1", 6, DIGITS[6], THUMB_BASE)
sign("myoHandPose7Fixed-v1", 7, DIGITS[7], THUMB_BASE)
sign("myoHandPose8Fixed-v1", 8, DIGITS[8], THUMB_BASE)
sign("myoHandPose9Fixed-v1", 9, DIGITS[9], THUMB_BASE)


@task("myoHandPoseRandom-v1", THUMB_BASE)
def hand_random() -> PoseTask:
    """Move the hand from a random posture to one drawn between the ten digits."""
    return hand_pose(*bounds(DIGITS))


def stand_upright(body: str) -> PoseTask:
    """Return the task of a torso that is to stay upright against its weight."""
    upright = (0.0,) * 18
    return PoseTask(
        body=body,
        target_low=upright,
        target_high=upright,
        near=0.25,
        far=np.pi,
        num_substeps=5,
        horizon=200,
    )


@task("myoTorsoPoseFixed-v0")
def torso_fixed() -> PoseTask:
    """Hold the torso upright."""
    return stand_upright("torso")


@task("myoTorsoExoPoseFixed-v0")
def torso_exo_fixed() -> PoseTask:
    """Hold the torso upright in an exosuit with two elastic straps."""
    return stand_upright("torso_exo")

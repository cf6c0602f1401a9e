"""The relocate ids: two phases, as MyoSuite has them (v0) and with an object that turns freely (v1)."""

from myowarp.definitions.task import task
from myowarp.tasks.relocate import OBJECT_START, RelocateTask

FINGERS = (
    *(0.332, 0.4114, -0.177165, -0.26182, 0.18852, 0.17017, 0.447735, 0.26707, 0.28278, -0.010472),
    *(0.0168535, 0.00701979, 0.09139, -0.06545, 0.243505, 0.337765, 0.23565, -0.101844, 0.000607067, 0.03142),
)
TRUNK_SIDE = (0.03876, 0.168055, 0.17281, -0.254074, -0.109975)
OVER_TABLE = (
    *(-0.022856, 0.00967764, -0.00968029, 0.10125, -0.00458344, 0.20262, 0.0828, -0.0168106, -0.2149),
    *(*TRUNK_SIDE, 1.11181, 0.92689, 0.106468, 0.0, *FINGERS, *OBJECT_START),
)
FURTHER_BENT = (
    *(-0.022856, 0.01113, -0.08268, 0.10125, -0.0494, 0.16578, 0.11868, -0.1932, -0.19648),
    *(*TRUNK_SIDE, 1.47485, 1.28822, 0.106468, -0.27489, *FINGERS, *OBJECT_START),
)
"""Starts of phase 1 and 2 [rad, m]; MyoSuite 3.0.0."""


FREE = (
    "The object has a free joint, its true inertia, and the friction that was drawn, and its turn against the"
    " bin is an angle; in v0, as in MyoSuite 3.0.0, it loses a direction of rotation where it lies on a side,"
    " its inertia is raised to 1e-4 kg m^2, and friction below the table's has no effect."
)


@task("myoChallengeRelocateP1-v1", FREE, free=True)
@task("myoChallengeRelocateP1-v0")
def first_phase() -> RelocateTask:
    """Carry a box from the table into a bin at a random place on it."""
    return RelocateTask(goal_low=(0.0, -0.35, 0.9), goal_high=(0.2, -0.1, 0.9), start_pose=OVER_TABLE)


@task("myoChallengeRelocateP2-v1", FREE, free=True)
@task("myoChallengeRelocateP2-v0")
def second_phase() -> RelocateTask:
    """Carry an object of random shape, mass, friction and place into a tilted bin at a random place."""
    return RelocateTask(
        goal_low=(0.0, -0.45, 0.9),
        goal_high=(0.3, -0.1, 1.05),
        angle=0.2,
        offset=0.01,
        object_low=(-0.1, -0.35, 1.0),
        object_high=(0.1, -0.15, 1.0),
        size=(0.015, 0.025),
        mass=(0.05, 0.2),
        friction=((0.8, 0.004, 0.00008), (1.2, 0.006, 0.00012)),
        start_pose=FURTHER_BENT,
    )

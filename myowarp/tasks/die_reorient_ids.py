"""The die ids: a trial and two phases, as MyoSuite has them (v0) and with a die that turns freely (v1)."""

import math

from myowarp.definitions.task import task
from myowarp.tasks.die_reorient import DieReorientTask

FREE = (
    "The die has a free joint, its true inertia, and the friction that was drawn, and its orientation is"
    " judged by the angle from the wanted one; in v0, as in MyoSuite 3.0.0, it loses a direction of rotation"
    " where the second of its three hinges is at a right angle, its inertia is raised to 1e-4 kg m^2,"
    " friction below the hand's has no effect, and Euler angles of the same orientation differ by up to 2 pi."
)


@task("myoChallengeDieReorientDemo-v1", FREE, free=True)
@task("myoChallengeDieReorientDemo-v0")
def demo() -> DieReorientTask:
    """Turn a die on the hand by up to 45 degrees about each axis."""
    return DieReorientTask(offset=0.0, angle=0.785, near=math.inf)


@task("myoChallengeDieReorientP1-v1", FREE, free=True)
@task("myoChallengeDieReorientP1-v0")
def first_phase() -> DieReorientTask:
    """Turn a die on the hand by up to 90 degrees about each axis, and move it by up to 1 cm."""
    return DieReorientTask(offset=0.01, angle=1.57)


@task("myoChallengeDieReorientP2-v1", FREE, free=True)
@task("myoChallengeDieReorientP2-v0")
def second_phase() -> DieReorientTask:
    """Turn a die of random size, mass and friction to any orientation, and move it by up to 2 cm."""
    return DieReorientTask(
        offset=0.02, angle=3.14, growth=0.007, mass=(0.05, 0.25), friction=(0.2, 0.001, 0.00002)
    )

"""The die ids: a trial and two phases, as MyoSuite has them (v0) and with a die that turns freely (v1)."""

import math
from dataclasses import replace

from myowarp.definitions.task import task
from myowarp.tasks.die_reorient import DieReorientTask

FREE = (
    "The die has a free joint, its true inertia, and the friction that was drawn, and its orientation is"
    " judged by the angle from the wanted one; in v0, as in MyoSuite 3.0.0, it loses a direction of rotation"
    " where the second of its three hinges is at a right angle, its inertia is raised to 1e-4 kg m^2,"
    " friction below the hand's has no effect, and Euler angles of the same orientation differ by up to 2 pi."
)


def demo() -> DieReorientTask:
    """Return the trial task: turns up to 45 degrees, and no place asked for."""
    return DieReorientTask(offset=0.0, angle=0.785, near=math.inf)


def first_phase() -> DieReorientTask:
    """Return phase 1: turns up to 90 degrees, places up to 1 cm away."""
    return DieReorientTask(offset=0.01, angle=1.57)


def second_phase() -> DieReorientTask:
    """Return phase 2: any turn, places up to 2 cm away, dice that differ."""
    return DieReorientTask(
        offset=0.02, angle=3.14, growth=0.007, mass=(0.05, 0.25), friction=(0.2, 0.001, 0.00002)
    )


@task("myoChallengeDieReorientDemo-v0")
def demo_v0() -> DieReorientTask:
    """Turn a die on the hand by up to 45 degrees about each axis."""
    return demo()


@task("myoChallengeDieReorientP1-v0")
def p1_v0() -> DieReorientTask:
    """Turn a die on the hand by up to 90 degrees about each axis, and move it by up to 1 cm."""
    return first_phase()


@task("myoChallengeDieReorientP2-v0")
def p2_v0() -> DieReorientTask:
    """Turn a die of random size, mass and friction to any orientation, and move it by up to 2 cm."""
    return second_phase()


@task("myoChallengeDieReorientDemo-v1", FREE)
def demo_v1() -> DieReorientTask:
    """Turn a die on the hand by up to 45 degrees about each axis."""
    return replace(demo(), free=True)


@task("myoChallengeDieReorientP1-v1", FREE)
def p1() -> DieReorientTask:
    """Turn a die on the hand by up to 90 degrees about each axis, and move it by up to 1 cm."""
    return replace(first_phase(), free=True)


@task("myoChallengeDieReorientP2-v1", FREE)
def p2() -> DieReorientTask:
    """Turn a die of random size, mass and friction to any orientation, and move it by up to 2 cm."""
    return replace(second_phase(), free=True)

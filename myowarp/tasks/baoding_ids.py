"""The baoding ids: MyoSuite's challenge, the paper's tasks, and both corrected."""

import numpy as np

from myowarp.definitions.task import task
from myowarp.tasks.baoding import BaodingTask
from myowarp.tasks.baoding_balls import BallRanges
from myowarp.tasks.baoding_orbits import OrbitRanges

FRICTION_RANGE = ((0.8, 0.004, 0.00008), (1.2, 0.006, 0.00012))  # nominal -+ (0.2, 0.001, 0.00002)
CORRECTED = (
    "A fall costs 500, and balls near their targets pay; in MyoSuite 3.0.0 every step costs and a fall ends"
    " the episode for free. The balls have the inertia of solid spheres, which MyoSuite raises to 1e-4 kg m^2"
    " and so up to 26 times; the friction of a contact is the ball's, not the larger of ball's and hand's."
)
ANY_ORBIT = OrbitRanges(
    directions=(0.0, -1.0, 1.0),
    angle=(0.0, 2.0 * np.pi),
    radius_x=(0.02, 0.03),
    radius_y=(0.022, 0.032),
    period=(4.0, 6.0),
)
ANY_BALLS = BallRanges(mass=(0.03, 0.3), radius=(0.018, 0.024), friction=FRICTION_RANGE)


@task("myoHandBaodingFixed-v1", CORRECTED, corrected=True)
@task("myoHandBaodingFixed-v0")
@task("myoChallengeBaodingP1-v2", CORRECTED, corrected=True)
@task("myoChallengeBaodingP1-v1")
def circle() -> BaodingTask:
    """Circle two balls on the palm, counter-clockwise, a revolution in 5 s."""
    return BaodingTask()


@task("myoHandBaodingRandom-v1", CORRECTED, corrected=True)
@task("myoHandBaodingRandom-v0")
@task("myoChallengeBaodingP2-v2", CORRECTED, corrected=True)
@task("myoChallengeBaodingP2-v1")
def either_way() -> BaodingTask:
    """Circle two balls of unknown mass, size and friction either way, or hold them."""
    return BaodingTask(orbits=ANY_ORBIT, balls=ANY_BALLS)


@task("myoHandBaodingSwap-v0", CORRECTED)
def swap() -> BaodingTask:
    """Hold two balls on the palm for 2.5 s, then swap them and hold them again.

    It counts as solved only after the targets have jumped.
    """
    # One jump, in the middle of the episode: with a period below 5 s a second one takes the targets back to
    # where they began, to a hand that never swapped; with a longer one less time is left for the swap than
    # half a revolution of the other tasks takes.
    return BaodingTask(orbits=OrbitRanges(period=(5.0, 5.0), jumps=2), corrected=True)

"""A variant of a task."""

from dataclasses import replace

import myowarp


@myowarp.task("outsideElbowNear-v0")
def near():
    """Bring the elbow near a random angle."""
    return replace(myowarp.TASKS["myoElbowPose1D6MRandom-v0"], near=0.5)

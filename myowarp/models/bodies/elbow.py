"""Elbow, one flexion joint with six muscles.

Source: myo-sim 0.2.3, legacy elbow model, unchanged.
"""

import mujoco
from myo_sim import MODELS_DIR

from myowarp.definitions.body import BODIES, Body, CoarseStep


def elbow() -> mujoco.MjSpec:
    """Return the elbow; joint r_elbow_flex, 0 to 2.27 rad, three extensors and three flexors."""
    path = MODELS_DIR / "legacy/elbow/myoelbow_1dof6muscles.xml"
    return mujoco.MjSpec.from_file(str(path))


BODIES.add("elbow", Body(elbow, tips=("wrist",), coarse_step=CoarseStep(0.010, 1.0)))

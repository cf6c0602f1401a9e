"""Elbow, one flexion joint with six muscles.

Source: myo-sim 0.2.3, legacy elbow model, unchanged.
"""

import mujoco
from myo_sim import MODELS_DIR

from myowarp.definitions.body import BODIES, Body, Brace, CoarseStep, Place
from myowarp.models.bodies.arm_muscles import FATIGUE_RATES, GROUPS

FOREARM = "r_ulna_radius_hand"
LOAD = Place(FOREARM, (0.05, -0.35, 0.07))  # where MyoSuite 3.0.0 has the weight of its exoskeleton tasks


def elbow() -> mujoco.MjSpec:
    """Return the elbow; joint r_elbow_flex, 0 to 2.27 rad, three extensors and three flexors."""
    path = MODELS_DIR / "legacy/elbow/myoelbow_1dof6muscles.xml"
    return mujoco.MjSpec.from_file(str(path))


ELBOW = BODIES.add(
    "elbow",
    Body(
        elbow,
        tips=("wrist",),
        coarse_step=CoarseStep(0.010, 1.0),
        groups=GROUPS,
        fatigue_rates=FATIGUE_RATES,
        load=LOAD,
        antagonists=(("BIClong", "TRIlong"), ("BICshort", "TRIlat"), ("BRA", "TRImed")),
        exoskeleton=Brace("r_elbow_flex", FOREARM),
    ),
)

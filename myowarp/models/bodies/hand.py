"""Right hand with forearm rotation and wrist, 23 joints and 39 muscles.

Source: myo-sim 0.2.3, the hand cut from the composed right arm, placed as MyoSuite 3.0.0 places it for
its hand pose and hand reach tasks. Everything proximal to the radius is welded to the world.
"""

from functools import cache

import mujoco
from myo_sim.build.compose import build_right_hand_from_arm_spec

from myowarp.definitions.body import BODIES, Body, CoarseStep, Place, Transfer
from myowarp.models.bodies.arm_muscles import FATIGUE_RATES, GROUPS

ROOT_POS = (-0.02525155, 0.07146933, 1.39249298)  # m
ROOT_QUAT = (0.52167746, 0.46981366, -0.47875126, -0.52718591)  # w, x, y, z


@cache
def _cut() -> mujoco.MjSpec:
    """Return the hand as myo-sim cuts it from the arm, which takes a second."""
    return build_right_hand_from_arm_spec()


def hand() -> mujoco.MjSpec:
    """Return the hand; all joint angles 0 is the open hand."""
    spec = _cut().copy()
    root = spec.body("myoarm_r_root")
    root.pos = ROOT_POS
    root.quat = ROOT_QUAT
    return spec


PALM = "lunate_r"  # carries the wrist's joints; the metacarpals of the four fingers are fixed to it
TIPS = ("THtip_r", "IFtip_r", "MFtip_r", "RFtip_r", "LFtip_r")
TRANSFER = Transfer(
    donor="EIP",
    lost="EPL",
    path=(
        ("EIP-P1_r",),
        ("EIP-P2_r",),
        ("EIP-P3_r",),
        ("EPL-P8_r",),
        ("EPL-P9_r",),
        ("MPthumb_wrap", ""),
        ("EPL-P10_r",),
        ("EPL-P11_r",),
        ("IPthumb_wrap", "IPthumb_site_EPL_side_r"),
        ("EPL-P12_r",),
    ),
)
"""The index finger's second extensor goes to the thumb, along EIP-P1..P3, EPL-P8..P12 (the dorsal thumb).

Sources: Caggiano et al. (2022), arXiv:2205.13600; the path is that of the unused hand with a transfer that
MyoSuite 2.12.2 bundles.
"""

APPROACH = ("FDP2", "FDP3", "FDP4", "FDP5", "RI2", "RI3", "RI4", "RI5", "EPL", "APL")
"""Fingers closed, thumb out. From there a muscle controller brings the hand to half of the random postures of
`myoHandPoseRandom-v1`, from where episodes start to 13 %."""

HAND = BODIES.add(
    "hand",
    Body(
        hand,
        TIPS,
        palm=PALM,
        coarse_step=CoarseStep(0.020 / 3, 0.5),
        groups=GROUPS,
        fatigue_rates=FATIGUE_RATES,
        load=Place("trapezium_r", (-0.011, -0.06, -0.03)),  # myo-sim's site S_grasp_r
        transfer=TRANSFER,
        torn=("FPL",),
        antagonists=(*((f"FDP{digit}", f"EDC{digit}") for digit in range(2, 6)), ("FPL", "EPL")),
        approach=APPROACH,
    ),
)

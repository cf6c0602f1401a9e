"""Right hand with forearm rotation and wrist, 23 joints and 39 muscles.

Source: myo-sim 0.2.3, the hand cut from the composed right arm, placed as MyoSuite 3.0.0 places it for
its hand pose and hand reach tasks. Everything proximal to the radius is welded to the world.
"""

import mujoco
from myo_sim.build.compose import build_right_hand_from_arm_spec

from myowarp.definitions.body import BODIES, Body, CoarseStep

ROOT_POS = (-0.02525155, 0.07146933, 1.39249298)  # m
ROOT_QUAT = (0.52167746, 0.46981366, -0.47875126, -0.52718591)  # w, x, y, z


def hand() -> mujoco.MjSpec:
    """Return the hand; all joint angles 0 is the open hand."""
    spec = build_right_hand_from_arm_spec()
    root = spec.body("myoarm_r_root")
    root.pos = ROOT_POS
    root.quat = ROOT_QUAT
    return spec


TIPS = ("THtip_r", "IFtip_r", "MFtip_r", "RFtip_r", "LFtip_r")
BODIES.add("hand", Body(hand, TIPS, coarse_step=CoarseStep(0.020 / 3, 0.5)))

"""Right arm on a fixed trunk, 18 joints and 50 muscles; fingers and thumb are stiff.

Source: myo-sim 0.2.3, the composed right arm, edited as MyoSuite 3.0.0 edits it for its arm reach tasks:
joints from the metacarpals on are removed, and with them the muscles that span no joint any more. Eleven soft
equalities let clavicle, scapula and humerus follow the shoulder. Upper arm and forearm touch the chest.
"""

import mujoco

from myowarp.definitions.body import BODIES, Body, CoarseStep
from myowarp.models.bodies.arm_muscles import FATIGUE_RATES, GROUPS
from myowarp.models.bodies.composed import composed

ROOT = "Full Body"
ROOT_POS = (0.00685025, -0.00150371, 0.91886071)  # m
ROOT_QUAT = (0.9999998414685886, -0.0003981600005847333, 1.6000000023497422e-07, 0.0003981600005847333)

STIFF = ("firstmc_r", "secondmc_r", "thirdmc_r", "fourthmc_r", "fifthmc_r")
INTRINSIC = ("RI", "LU_RB", "UI_UB", "OP")  # the muscles from metacarpals to fingers begin with these
TIP = "IFtip"


def arm() -> mujoco.MjSpec:
    """Return the right arm from the clavicle to the wrist; all joint angles 0 is the hanging arm."""
    spec = composed("myoarm_r")
    root = spec.body(ROOT)
    root.pos, root.quat = ROOT_POS, ROOT_QUAT
    for bone in STIFF:
        for joint in spec.body(bone).find_all("joint"):
            spec.delete(joint)
    for muscle in [m for m in spec.actuators if m.name.startswith(INTRINSIC)]:
        tendon = spec.tendon(muscle.target)
        spec.delete(muscle)
        spec.delete(tendon)
    fingertip = spec.site(f"{TIP}_r")
    fingertip.parent.add_site(name=TIP, pos=fingertip.pos, size=fingertip.size, type=fingertip.type)
    return spec


BODIES.add(
    "arm",
    Body(
        arm,
        tips=(TIP,),
        coarse_step=CoarseStep(0.010, 0.5),
        groups=GROUPS,
        fatigue_rates=FATIGUE_RATES,
        large=True,
    ),
)

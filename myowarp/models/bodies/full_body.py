"""Whole human body that nothing holds: trunk, arms with hands, legs; 128 degrees of freedom, 416 muscles.

Source: myo-sim 0.2.3, its composed full body, unchanged but for the height at which it stands. The parts are
those of the bodies `torso` (without the muscles of the abdomen), `arm` (with moving fingers, the left one
mirrored) and `legs`. Fifty-one soft equalities let vertebrae, shoulders and knees follow others. Feet touch
the floor, arms the trunk and the thighs, and the legs each other, as explicit pairs. MyoSuite 3.0.0 has no
task on it that is registered here: it is there to be looked at, stepped, and given tasks of one's own.
"""

import mujoco

from myowarp.definitions.body import BODIES, Body
from myowarp.models.bodies import arm_muscles, leg_muscles, torso_muscles
from myowarp.models.bodies.by_muscle import grouped_by_side, on_both_sides
from myowarp.models.bodies.composed import composed

ROOT = "Full Body"
HEIGHT = 0.945  # m, of the root above the floor: soles touch it


def full_body() -> mujoco.MjSpec:
    """Return the whole body; joint angles 0 is standing upright with hanging arms."""
    spec = composed("myofullbody")
    root = spec.body(ROOT)
    root.pos = (root.pos[0], root.pos[1], HEIGHT)
    return spec


BODIES.add(
    "full_body",
    Body(
        full_body,
        tips=("IFtip_r", "IFtip_l"),
        groups=torso_muscles.GROUPS | grouped_by_side(arm_muscles.GROUPS) | leg_muscles.GROUPS,
        fatigue_rates=on_both_sides(arm_muscles.FATIGUE_RATES) | leg_muscles.FATIGUE_RATES,
        large=True,
    ),
)

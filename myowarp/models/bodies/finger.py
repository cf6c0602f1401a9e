"""Index finger, four joints: with five muscles, or with five tendon motors.

Source: myo-sim 0.2.3, legacy finger models. The motors carry MyoSuite 3.0.0's gears, four times those of
the file, with which upstream made the motor twins of the finger tasks solvable. `strong_motor_finger` has
those of myo-sim 0.2.4, whose authors found these still too weak.
"""

import mujoco
from myo_sim import MODELS_DIR

from myowarp.definitions.body import BODIES, Body, CoarseStep
from myowarp.models.bodies.arm_muscles import HAND
from myowarp.models.bodies.by_muscle import by_muscle

GROUPS = by_muscle(
    {"finger extensors": "extn", "finger flexors": "mflx dflx", "finger abductors": "adabR adabL"}
)
"""The muscles are named after what they do."""

MOTOR_GEARS = {"extn": 80.0, "adabR": 20.0, "adabL": 20.0, "mflx": 40.0, "dflx": 40.0}  # N per unit

STRONG_GEARS = {"extn": 160.0, "adabR": 80.0, "adabL": 80.0, "mflx": 160.0, "dflx": 160.0}
"""N per unit, of myo-sim 0.2.4: the extensor has 8 times what the file of 0.2.3 says, the others 16 times."""


def finger() -> mujoco.MjSpec:
    """Return the finger with five muscles; joints IFadb, IFmcp, IFpip, IFdip."""
    return mujoco.MjSpec.from_file(str(MODELS_DIR / "legacy/finger/myofinger_v0.xml"))


def with_gears(gears: dict[str, float]) -> mujoco.MjSpec:
    """Return the finger whose tendon motors have certain gears."""
    spec = mujoco.MjSpec.from_file(str(MODELS_DIR / "legacy/finger/motorfinger_v0.xml"))
    for name, gear in gears.items():
        spec.actuator(name).gear[0] = gear
    return spec


def motor_finger() -> mujoco.MjSpec:
    """Return the finger with five tendon motors, control range -1 (full pull) to 0."""
    return with_gears(MOTOR_GEARS)


def strong_motor_finger() -> mujoco.MjSpec:
    """Return the finger with five tendon motors, two to four times as strong."""
    return with_gears(STRONG_GEARS)


BODIES.add(
    "finger",
    Body(
        finger,
        tips=("IFtip",),
        coarse_step=CoarseStep(0.020 / 6, 0.6),
        groups=GROUPS,
        fatigue_rates=dict.fromkeys(GROUPS, HAND),
        antagonists=(("dflx", "extn"),),
    ),
)
BODIES.add("motor_finger", Body(motor_finger, tips=("IFtip",), title="finger with motors"))
BODIES.add(
    "strong_motor_finger", Body(strong_motor_finger, tips=("IFtip",), title="finger with strong motors")
)

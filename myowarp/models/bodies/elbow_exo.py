"""Elbow in MyoSuite's exoskeleton: the six muscles and a torque motor, a weight in the hand.

Source: myo-sim 0.2.3, legacy `myoelbow_exo`. As there the parts of the exoskeleton weigh nothing, because the
limbs have explicit inertias, and the weight, 0.1 kg, is fixed to the forearm. The motor is actuator 0; its
control, unlimited there, has the bounds of the action, which it equals. An exoskeleton whose mass counts and
that can follow the muscles is the condition `exoskeleton` on the plain elbow.
"""

from dataclasses import replace

import mujoco
from myo_sim import MODELS_DIR

from myowarp.definitions.body import BODIES
from myowarp.models.bodies.elbow import ELBOW

WEIGHT = "carry_weight"  # name of the weight's body


def elbow_exo() -> mujoco.MjSpec:
    """Return the elbow with the motor `Exo`, 8.5 N m per unit, and the body `carry_weight`."""
    spec = mujoco.MjSpec.from_file(str(MODELS_DIR / "legacy/elbow/myoelbow_1dof6muscles_1dofexo.xml"))
    motor = spec.actuator("Exo")
    motor.ctrllimited, motor.ctrlrange = True, (-1.0, 1.0)
    spec.body(WEIGHT).fuse = 0  # a task may draw its mass
    return spec


BODIES.add("elbow_exo", replace(ELBOW, build=elbow_exo, exoskeleton=None, title="elbow with exoskeleton"))

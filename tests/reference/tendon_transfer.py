"""The operated hand as MuJoCo C has it: EIP's actuator pulls another tendon, EPL's pulls with no force.

Path: that of the unused hand with a transfer in MyoSuite 2.12.2: EIP as far as the wrist, then the last sites
and wraps of EPL.
"""

import mujoco
import numpy as np

PATH = "EIP-P1 EIP-P2 EIP-P3 EPL-P8 EPL-P9 MPthumb_wrap EPL-P10 EPL-P11 "
PATH += "IPthumb_wrap:IPthumb_site_EPL_side EPL-P12"

MOMENTS = {
    "deviation_r": -0.0042,
    "flexion_r": 0.0050,
    "axis A": -0.0062,
    "axis B": 0.0074,
    "mp_flexion_r": -0.0090,
    "ip_flexion_r": -0.0052,
}
"""Derivative of the new path's length by the joints [m], open hand; axis A and B are the joints 3 and 4, to
which the two hands give each other's name."""

LENGTH = 0.2142  # m, open hand
SAMPLED_RANGE = (0.193, 0.236)  # m, thousands of random postures of the contact hand


def operated(spec: mujoco.MjSpec, length_range: tuple[float, float]) -> mujoco.MjModel:
    """Return the operated model of a healthy hand's spec; EIP's fibers fit `length_range` [m]."""
    spec = spec.copy()
    tendon = spec.add_tendon(name="operated")
    for element in PATH.split():
        geom, _, side = element.partition(":")
        if geom.endswith("wrap"):
            tendon.wrap_geom(geom, f"{side}_r" if side else "")
        else:
            tendon.wrap_site(f"{geom}_r")
    muscle = spec.actuator("EIP_r")
    muscle.target = "operated"
    muscle.lengthrange = np.array(length_range)
    model = spec.compile()
    lost = model.actuator("EPL_r").id
    model.actuator_gainprm[lost, 2] = model.actuator_biasprm[lost, 2] = 0.0
    return model

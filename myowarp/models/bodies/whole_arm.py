"""Right arm and hand from the clavicle to the fingertips, 38 joints and 63 muscles, which touch objects.

Source: the files of myo-sim 0.2.3, put together as MyoSuite 3.0.0 does for its relocate tasks: no trunk, but
a still stub of the thorax with the places from which chest and back muscles come (positions are recorded
values of MyoSuite 3.0.0, Apache-2.0). Eleven soft equalities let clavicle, scapula and humerus follow the
shoulder. What collides are capsules along humerus, forearm, palm and fingers; they do not touch each other.
Room and floor, out of reach, are left out.
"""

import mujoco
from myo_sim import MODELS_DIR

from myowarp.definitions.body import BODIES, Body
from myowarp.models.bodies.arm_muscles import FATIGUE_RATES, GROUPS
from myowarp.models.bodies.hand import PALM, TIPS
from myowarp.models.bodies.torso import including

FILES = (
    *(f"arm/assets/myoarm_r_{part}.xml" for part in ("assets", "tendon", "muscle")),
    "scene/myosuite_scene.xml",
)
ARM_POS = "-0.02525155 0.07146933 1.39249298"  # m
ARM_QUAT = "0.52167746 0.46981366 -0.47875126 -0.52718591"

RIBS = 'type="sphere" size="0.08" pos="-0.0709 0.1226 1.3539" rgba="0.19 0.83 0.78 0" group="3"'
SITES = {
    "PECM2_PECM2-P3_r": "-0.097050 0.053090 1.441980",
    "PECM2_PECM2-P4_r": "-0.022710 0.056310 1.436220",
    "Thorax_ellipsoid_PECM2_3_sidesite_r": "-0.870900 -0.677400 2.153900",
    "PECM3_PECM3-P3_r": "-0.089350 0.031500 1.397030",
    "PECM3_PECM3-P4_r": "-0.037870 0.026760 1.364660",
    "Thorax_ellipsoid_PECM3_3_sidesite_r": "-0.870900 -0.677400 2.153900",
    "LAT1_LAT1-P4_r": "-0.068157 0.202595 1.401272",
    "LAT1_LAT1-P5_r": "-0.033160 0.202280 1.380020",
    "LAT1_LAT1-P6_r": "-0.008820 0.179780 1.363960",
    "LAT2_LAT2-P4_r": "-0.077034 0.207719 1.357030",
    "LAT2_LAT2-P5_r": "-0.028780 0.193920 1.312120",
    "LAT2_LAT2-P6_r": "-0.008150 0.155860 1.293020",
    "LAT3_LAT3-P4_r": "-0.092743 0.204427 1.321655",
    "LAT3_LAT3-P5_r": "-0.055320 0.195570 1.287330",
    "LAT3_LAT3-P6_r": "-0.009070 0.155170 1.232620",
}
"""Places on the thorax where muscles begin, and the side of the ribs on which they pass [m], world."""

WORLD = f"""
<body name="thorax_stub">
  <geom type="mesh" mesh="thorax_r" pos="0 0.084 1.4812" euler="1.57079633 -1.57079633 0"/>
  <geom name="Thorax_ellipsoid_PECM2" {RIBS}/>
  <geom name="Thorax_ellipsoid_PECM3" {RIBS}/>
  {"".join(f'<site name="{name}" pos="{pos}"/>' for name, pos in SITES.items())}
</body>
<body name="arm_r" pos="{ARM_POS}" quat="{ARM_QUAT}">
  <include file="{MODELS_DIR}/arm/assets/myoarm_r_chain.xml"/>
</body>
"""


def whole_arm() -> mujoco.MjSpec:
    """Return the arm with the hand; all joint angles 0 is the hanging arm."""
    spec = including(FILES, WORLD)
    for geom in spec.worldbody.geoms:  # a room
        spec.delete(geom)
    return spec


BODIES.add(
    "whole_arm",
    Body(*(whole_arm, TIPS, PALM), groups=GROUPS, fatigue_rates=FATIGUE_RATES, title="arm", large=True),
)

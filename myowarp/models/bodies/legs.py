"""Both legs under a rigid torso with a free root, on flat ground; 80 muscles.

Source: the files of myo-sim 0.2.3, put together as MyoSuite 3.0.0 does for its leg tasks. Its height field is
added by the tasks in which something touches it (`tasks/field.py`). The legs are those of Rajagopal et al.
(2016), doi:10.1109/TBME.2016.2586891. Fourteen soft equalities let the knees slide and the kneecaps follow
the angles of the knees. The trunk, its arms included, is one rigid body with the mass of all that the legs
carry.
"""

import mujoco
from myo_sim import MODELS_DIR

from myowarp.definitions.body import BODIES, Body, CoarseStep
from myowarp.models.bodies.leg_muscles import FATIGUE_RATES, GROUPS
from myowarp.models.bodies.torso import including

FILES = (
    "legacy/torso/assets/myotorso_rigid_assets.xml",
    *(f"leg/assets/myolegs_{part}.xml" for part in ("tendon", "muscle", "assets")),
    "scene/myosuite_scene_noPedestal.xml",
)
DEVICES = "ankle_angle", "knee_angle", "hip_flexion"
# The trunk is z-up. The files of the legs turn the pelvis themselves, which the frame undoes.
WORLD = f"""
<body name="root" pos="0 0 1" euler="0 0 -1.57">
  <include file="{MODELS_DIR}/legacy/torso/assets/myotorso_rigid_chain.xml"/>
  <frame euler="0 0 1.57"><include file="{MODELS_DIR}/leg/assets/myolegs_chain.xml"/></frame>
  <freejoint name="root"/>
</body>
"""


def legs() -> mujoco.MjSpec:
    """Return the legs; joint angles 0 is standing upright, with the root 1 m above ground."""
    spec = including(FILES, WORLD)
    spec.mesh("torso").file = "meshes/torso_lowpoly-v1.stl"
    spec.body("torso").alt.euler = (0.0, 0.0, 0.0)  # it looks where the root does
    return spec


BODIES.add(
    "legs",
    Body(
        legs,
        tips=("pelvis",),
        coarse_step=CoarseStep(0.005, 0.35),
        groups=GROUPS,
        fatigue_rates=FATIGUE_RATES,
        large=True,
        root="root",
        devices=tuple(f"{joint}_{side}" for joint in DEVICES for side in "rl"),
    ),
)

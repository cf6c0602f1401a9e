"""Lumbar spine and abdomen under a rigid thorax, 18 joints and 216 muscles.

Source: the files of myo-sim 0.2.3, unchanged, put together as MyoSuite 3.0.0 does for its torso tasks.
Fifteen soft equalities share the three motions of the trunk among vertebrae and abdomen. The model
descends from the Constrained Lumbar Spine model 210 of SimTK; muscles of the left side mirror the right.
"""

import mujoco
from myo_sim import MODELS_DIR

from myowarp.definitions.body import BODIES, Body, CoarseStep
from myowarp.models.bodies.torso_muscles import GROUPS

TIP = "arm_attach_r"  # the shoulder
FILES = (
    *(f"torso/assets/myotorso_{part}.xml" for part in ("assets", "muscle", "tendon")),
    *(f"torso/assets/myotorso_abdomen_{part}.xml" for part in ("muscle", "tendon")),
    "head/assets/myohead_simple_assets.xml",
    "scene/myosuite_scene.xml",
)


def including(files: tuple[str, ...], world: str, more: str = "") -> mujoco.MjSpec:
    """Return what files of myo-sim say, with MJCF of our own in its world and beside it."""
    includes = "".join(f'<include file="{MODELS_DIR / file}"/>' for file in files)
    compiler = f'<compiler meshdir="{MODELS_DIR}" texturedir="{MODELS_DIR}"/>'
    return mujoco.MjSpec.from_string(
        f"<mujoco>{includes}{compiler}<worldbody>{world}</worldbody>{more}</mujoco>"
    )


def torso_in(name: str, pos: str) -> str:
    """Return the MJCF of the torso's bones in a body of the world, which is at `pos` [m]."""
    chain = MODELS_DIR / "torso/assets/myotorso_chain.xml"
    return f'<body name="{name}" pos="{pos}"><include file="{chain}"/></body>'


def torso() -> mujoco.MjSpec:
    """Return the torso on a pelvis that is fixed; all joint angles 0 is upright."""
    return including(FILES, torso_in("Torso", "-0.025 0.1 0.9"))


TORSO = BODIES.add(
    "torso", Body(torso, tips=(TIP,), coarse_step=CoarseStep(0.010, 0.5), groups=GROUPS, large=True)
)

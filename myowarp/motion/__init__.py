"""Recorded motions, from files of markers and loads to joint angles, joint moments and muscle forces.

    from pathlib import Path

    from myowarp import motion
    arm = motion.Bones.read(Path("arm.osim"))
    trial = motion.TrialSetup(motion=Path("bend.mot"), cutoff=6.0, reserve=1.0)
    motion.forces(arm, trial).write(Path("out/arm"))

Each step is a function of a model and a set-up; what it returns writes itself. What stands here is public,
and imported when it is first used.
"""

import importlib
from typing import Any

_STEPS = "kinematics", "dynamics", "analyze", "forces", "track"
_LATER = {
    "Bones": "osim.body.skeleton",
    "TrialSetup": "motion.setup",
    "read_tool_setup": "motion.tool_setup",
    **dict.fromkeys(_STEPS, "motion.steps"),
    **dict.fromkeys(("marker_places", "read_motion", "write_angles"), "motion.movement"),
    **dict.fromkeys(("Markers", "read_trc", "write_trc"), "motion.markers"),
}
__all__ = list(_LATER)


def __getattr__(name: str) -> Any:
    """Import what is asked for."""
    if name not in _LATER:
        raise AttributeError(f"module 'myowarp.motion' has no attribute {name!r}")
    return getattr(importlib.import_module(f"myowarp.{_LATER[name]}"), name)

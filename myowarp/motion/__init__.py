"""Recorded motions, from files of markers and loads to joint angles, joint moments and muscle forces.

    from myowarp import motion
    arm = motion.Bones.read(Path("arm.osim"))

What stands here is public, and imported when it is first used.
"""

import importlib
from typing import Any

_LATER = {
    "Bones": "osim.body.skeleton",
    **dict.fromkeys(
        (
            "analyze",
            "dynamics",
            "follow",
            "forces",
            "kinematics",
            "marker_places",
            "read_motion",
            "write_angles",
        ),
        "motion.trial",
    ),
    **dict.fromkeys(("Markers", "read_trc", "write_trc"), "motion.markers"),
}
__all__ = list(_LATER)


def __getattr__(name: str) -> Any:
    """Import what is asked for."""
    if name not in _LATER:
        raise AttributeError(f"module 'myowarp.motion' has no attribute {name!r}")
    return getattr(importlib.import_module(f"myowarp.{_LATER[name]}"), name)

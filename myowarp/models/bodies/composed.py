"""Models that myo-sim puts together itself, from parts of its own."""

from functools import cache

import mujoco
from myo_sim.build.compose import build_spec


def composed(name: str) -> mujoco.MjSpec:
    """Return a fresh spec of one of myo-sim's composed models."""
    return _put_together(name).copy()


@cache
def _put_together(name: str) -> mujoco.MjSpec:
    """Return the spec that is copied, which takes a second.

    myo-sim joins its parts without a prefix for names, of which MuJoCo warns, at every compilation of that
    spec and not of a copy.
    """
    handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        return build_spec(name).copy()
    finally:
        mujoco.set_mju_user_warning(handler)

"""Muscle models; a new one is one file here and one import below."""

from myowarp.models.muscles import hill, mujoco, mujoco_native  # noqa: F401

"""Texts that a model brings along, by name: read, replaced, and held against what the model has."""

from collections.abc import Iterable

import mujoco
import numpy as np


def text_of(model: mujoco.MjModel, name: str) -> str | None:
    """Return a model's text, None for a model without one of that name."""
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, name)
    if number < 0:
        return None
    first, size = model.text_adr[number], model.text_size[number]
    return model.text_data[first : first + size].rstrip(b"\0").decode()


def set_text(spec: mujoco.MjSpec, name: str, text: str) -> None:
    """Give a spec a text; one of that name that it has already is replaced."""
    for old in [old for old in spec.texts if old.name == name]:
        spec.delete(old)
    spec.add_text(name=name, data=text)


def scalar_joints(model: mujoco.MjModel) -> set[str]:
    """Return the names of a model's hinges and slides."""
    kinds = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    return {model.joint(j).name for j in np.flatnonzero(np.isin(model.jnt_type, kinds))}


def check_named(text: str, kind: str, named: Iterable[str], known: Iterable[str]) -> None:
    """Raise ValueError if a text names what the model has not."""
    if lost := set(named) - set(known):
        raise ValueError(
            f"the {text} name {min(lost)!r}, and the model has no {kind} of that name; "
            "they belong to another model"
        )

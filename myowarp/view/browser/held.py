"""A body whose root is held in place, as if it hung in a harness.

A model of OpenSim has no controller that keeps it on its feet, and often no contact with its floor: it falls.
"""

from __future__ import annotations

import dataclasses

import mujoco

from myowarp.definitions.body import BODIES
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TaskSpec
from myowarp.view.drawing.style import carried_root

INERTIA = 1e7
"""kg and kg m^2 that joints of a held root have of their own: a man of 75 kg falls 0.3 mm in 2 s."""


def root_of(spec: TaskSpec) -> str:
    """Return the name of the body that free coordinates carry away, all others with it; "" for none."""
    model = BODIES[spec.body].build().compile()
    root = carried_root(model)
    return model.body(root).name if root else ""


def held(spec: TaskSpec, root: str) -> TaskSpec:
    """Return the same task on a body whose root is held.

    Args:
        spec: The task; it stays as it is.
        root: Name of the body to hold.
    """

    def build() -> mujoco.MjSpec:
        body = BODIES[spec.body].build()
        for joint in body.body(root).joints:
            joint.armature = INERTIA
        return body

    name = f"{spec.body}_held"
    BODIES.add(name, dataclasses.replace(BODIES[spec.body], build=build), replace=True)
    return dataclasses.replace(spec, body=name)


def held_setup(setup: Setup) -> Setup:
    """Return a complete setup with the root of its body held.

    Raises:
        ValueError: No free root carries the body.
    """
    if not (root := root_of(setup.spec)):
        raise ValueError(f"--held is for a body that can move away; that of task {setup.spec.key!r} cannot")
    return dataclasses.replace(setup, task=held(setup.spec, root))

"""The model for plain MuJoCo, `model.mjb`: the document's inertias, light bodies, equalities that hold these.

A row of an equality gives way by 1e-4 of what a unit of force does to its joints in the default pose
(`dof_invweight0`; MuJoCo documentation, Computation, "Constraint model"). A unit of force moves a light body
far, so a row that holds one gives way to the load of a whole shank. MJCF has no field for these weights and
therefore heavier bodies; a binary model keeps both, in the version of MuJoCo that wrote it. Moments of
inertia that no solid has are refused by MuJoCo's compiler only, so a binary model keeps these, too.

Where joints follow others its integrator is Euler. `implicitfast` takes the damping of muscles in after the
constraints are solved, and light joints that a muscle crosses with them leave their equalities: at rest
gait10dof18musc is 0.12 rad or m off them after 2 s of steps of 2 ms, and fails at 2.4 s. Under Euler it stays
within 9e-6.
"""

import copy

import mujoco
import numpy as np

from myowarp.osim.bundle.couplings import Couplings, couplings
from myowarp.osim.convert.compose.geometry import positive

LIGHTER = 1e-3
"""Masses of bodies that weigh nothing in the document, as a share of those in MJCF."""
STIFFER = 1e-6
"""Weights of joints that follow, or are followed, as a share of MuJoCo's."""


def stiff(model: mujoco.MjModel, said: Couplings) -> mujoco.MjModel:
    """Return a converted model with the document's inertias, joints following as stiffly as float64 allows.

    A document that weighs nothing keeps the masses that it was given.
    """
    model = copy.copy(model)
    bodies = {model.body(name).id: stated for name, stated in said.bodies.items()}
    light = [body for body, (mass, _) in bodies.items() if mass == 0]
    if not np.delete(model.body_mass, light).any():
        return model
    for body, (mass, inertia) in bodies.items():
        if mass > 0:
            model.body_inertia[body] = positive(np.array(inertia), mass)
        else:
            model.body_mass[body] *= LIGHTER
            model.body_inertia[body] *= LIGHTER
    ties = couplings(model)
    if ties:
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    followers = np.array([tie.joint for tie in ties], int)
    model.dof_armature[followers] = 0.0
    mujoco.mj_setConst(model, mujoco.MjData(model))
    model.dof_invweight0[sorted({*followers.tolist(), *(tie.driver for tie in ties)} - {-1})] *= STIFFER
    return model


def binary(model: mujoco.MjModel) -> bytes:
    """Return a model as MuJoCo writes it."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()

"""A weight in the hand whose mass is drawn anew in every episode.

Source: MyoSuite 3.0.0, `myoElbowPose1D6MExoRandom-v0`: a ball of radius 1 cm + 2.5 cm per kg with the inertia
of a solid one, but at least MyoSuite's floor. It recompiles what MuJoCo derives from the mass; here the same
fields are written per world. The random load of any other task is the condition `load`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.parameter import Parameter, Uniform
from myowarp.kernels.body_mass import MASS_FIELDS, WeighedBody, set_body_mass, weighed_body
from myowarp.kernels.launch import launch
from myowarp.models.bodies.elbow_exo import WEIGHT

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene

BATCHED = (*MASS_FIELDS, "body_inertia", "dof_invweight0")
"""Names of the model's fields that `weigh_ball` writes per world."""

RADIUS, RADIUS_PER_MASS = wp.constant(0.01), wp.constant(0.025)  # m, m/kg
INERTIA_FLOOR = wp.constant(0.001)  # kg m^2


@wp.kernel(enable_backward=False)
def weigh_ball(
    # Params:
    body: WeighedBody,
    square_lever: float,
    limb_inertia: float,
    # In:
    mass: wp.array2d[float],
    mask: wp.array[bool],
    # Out:
    body_mass: wp.array2d[float],
    body_subtreemass: wp.array2d[float],
    body_inertia: wp.array2d[wp.vec3],
    dof_invweight0: wp.array2d[float],
):
    """I = max(floor, 2/5 m r^2); inverse weight of the joint 1 / (limb + m lever^2 + I)."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    m = mass[worldid, 0]
    radius = RADIUS + RADIUS_PER_MASS * m
    inertia = wp.max(INERTIA_FLOOR, 0.4 * m * radius * radius)
    set_body_mass(body, worldid, m, body_mass, body_subtreemass)
    body_inertia[worldid, body.bodyid] = wp.vec3(inertia, inertia, inertia)
    dof_invweight0[worldid, 0] = 1.0 / (limb_inertia + m * square_lever + inertia)


class CarriedWeight:
    """The weight of a scene whose only joint is the elbow.

    Attributes:
        mass: Mass in every world [kg], shape (num_worlds, 1).
    """

    def __init__(self, scene: Scene, low: float, high: float) -> None:
        """Allocate; masses are drawn between `low` and `high` [kg]."""
        model = scene.oracle
        self.scene = scene
        self.draw = Parameter("carried weight", Uniform(low, high), scene, (), neutral=low)
        self.mass = self.draw.curve.start
        self.body = weighed_body(model, WEIGHT)
        weight = model.body(WEIGHT)
        data, jacobian = mujoco.MjData(model), np.zeros((3, model.nv))
        mujoco.mj_forward(model, data)
        mujoco.mj_jacBodyCom(model, data, jacobian, None, weight.id)
        self.square_lever = float(np.square(jacobian).sum())
        nominal = weight.mass[0] * self.square_lever + weight.inertia[0]
        self.limb_inertia = float(1.0 / model.dof_invweight0[0] - nominal)

    def sample(self, mask: wp.array) -> None:
        """Draw masses in the worlds of `mask` (num_worlds,) bool and hang them there."""
        self.draw.sample(self.scene.keys, mask)
        self.hang(mask)

    def hang(self, mask: wp.array) -> None:
        """Give the model's fields the present masses in the worlds of `mask`."""
        launch(weigh_ball, self.scene.num_worlds, self, self.scene.model, mask=mask)

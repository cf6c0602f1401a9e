"""Metabolic rates of every muscle and of the whole body in every world, under whatever muscle model runs.

The laws are those of `laws/metabolics.py`. Half of the fibers are slow, and the specific tension is that
of OpenSim's probes; heat of recovery is in Umberger's rates (aerobic factor 1.5), as in OpenSim. A condition
that weakens a muscle takes away force, not mass: the fibers that are left to pull less cost as much heat.
Under MuJoCo's muscle fibers are in line with a tendon that keeps its length, and as long as the body's range
of normalized lengths says.
"""

from __future__ import annotations

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.muscle import FiberStates, new_fiber_states
from myowarp.definitions.scene import Scene
from myowarp.kernels.batching import batched
from myowarp.kernels.launch import launch
from myowarp.laws.metabolics import BASAL_RATE, bhargava2004, muscle_mass, umberger2010

LAWS = ("bhargava2004", "umberger2010")
SLOW_TWITCH_RATIO = wp.constant(0.5)
AEROBIC_FACTOR = wp.constant(1.5)

WHOLE_BODY_UNITS = {name: "W" for name in LAWS} | {f"{name}_per_kg": "W/kg" for name in LAWS}
"""Rates of the whole body, basal rate included, by name."""


@wp.struct
class MuscleRates:
    """Heat and work of every muscle [W], arrays (num_worlds, num_muscles)."""

    bhargava2004: wp.array2d[float]
    umberger2010: wp.array2d[float]


@wp.kernel(enable_backward=False)
def metabolic_rates(
    # Params:
    actuator_id: wp.array[int],
    mass: wp.array2d[float],
    max_contraction_velocity: wp.array2d[float],
    # Data in:
    ctrl_in: wp.array2d[float],
    # In:
    activation: wp.array2d[float],
    fibers: FiberStates,
    # Out:
    rates: MuscleRates,
):
    """Heat + work after both laws, of the excitation that was held and the fibers' present state."""
    worldid, m = wp.tid()
    own = mass[batched(worldid, mass.shape[0]), m]
    excitation = wp.clamp(ctrl_in[worldid, actuator_id[m]], 0.0, 1.0)
    active, speed = fibers.active_force[worldid, m], fibers.velocity[worldid, m]
    heat, work = bhargava2004(
        own,
        SLOW_TWITCH_RATIO,
        excitation,
        fibers.norm_length[worldid, m],
        speed,
        active,
        active + fibers.passive_force[worldid, m],
    )
    rates.bhargava2004[worldid, m] = heat + work
    heat, work = umberger2010(
        own,
        SLOW_TWITCH_RATIO,
        excitation,
        activation[worldid, m],
        fibers.norm_length[worldid, m],
        fibers.active_force_length[worldid, m],
        fibers.norm_velocity[worldid, m],
        max_contraction_velocity[batched(worldid, max_contraction_velocity.shape[0]), m],
        -active * speed,
        AEROBIC_FACTOR,
    )
    rates.umberger2010[worldid, m] = heat + work


@wp.kernel(enable_backward=False)
def whole_body_rates(
    # Params:
    basal: float,
    per_kg: float,
    # In:
    rates: MuscleRates,
    # Out:
    sums: wp.array2d[float],
):
    """Sum of the muscles + 1.2 W/kg of the body, in W by law, then in W/kg."""
    worldid = wp.tid()
    first, second = float(0.0), float(0.0)
    for m in range(rates.bhargava2004.shape[1]):
        first += rates.bhargava2004[worldid, m]
        second += rates.umberger2010[worldid, m]
    sums[0, worldid] = basal + first
    sums[1, worldid] = basal + second
    sums[2, worldid] = (basal + first) * per_kg
    sums[3, worldid] = (basal + second) * per_kg


class Metabolics:
    """Rates of a scene's muscles in its present state.

    Attributes:
        rates: Of every muscle [W], arrays (num_worlds, num_muscles); NaN where the muscle model does not tell
            what its fibers do.
        whole_body: Of the whole body, by name in `WHOLE_BODY_UNITS`, shape (num_worlds,).
        body_mass: Mass of the limbs and trunk that muscles move [kg], without what they hold or carry.
    """

    def __init__(self, scene: Scene) -> None:
        """Allocate on the current Warp device."""
        muscles = scene.muscles
        self._scene, self.body_mass = scene, moved_mass(scene.oracle)
        own = muscles.geometry()
        self.actuator_id = wp.array(muscles.actuator_id, dtype=int)
        self.mass = wp.array(muscle_mass(own.max_isometric_force, own.optimal_fiber_length), dtype=float)
        self.max_contraction_velocity = wp.array(own.max_contraction_velocity, dtype=float)
        shape = muscles.activation.shape
        self.rates, self.fibers = MuscleRates(), new_fiber_states(muscles.activation)
        for name in LAWS:
            setattr(self.rates, name, wp.full(shape, float("nan"), dtype=float))
        self.sums = wp.full((len(WHOLE_BODY_UNITS), shape[0]), float("nan"), dtype=float)
        self.whole_body = {name: self.sums[i] for i, name in enumerate(WHOLE_BODY_UNITS)}

    def launch(self) -> None:
        """Compute the rates; lengths, velocities and tensions of the muscles are those of the state."""
        scene = self._scene
        if not scene.muscles.tells_fibers:
            return
        scene.muscles.read_fibers(self.fibers)
        launch(metabolic_rates, self.rates.bhargava2004.shape, self, scene.data, scene.muscles)
        wp.launch(
            whole_body_rates,
            dim=scene.num_worlds,
            inputs=[BASAL_RATE * self.body_mass, 1.0 / max(self.body_mass, 1e-9), self.rates],
            outputs=[self.sums],
        )


def known_metabolics(scene: Scene, law: str) -> Metabolics:
    """Return the rates of a scene whose muscles tell what they depend on.

    Raises:
        ValueError: The muscle model does not tell what its fibers do.
    """
    if not scene.muscles.tells_fibers:
        raise ValueError(
            f"{law} needs a muscle model that tells what its fibers do (`read_fibers`), got "
            f"{type(scene.muscles).__name__}"
        )
    return Metabolics(scene)


def moved_mass(model: mujoco.MjModel) -> float:
    """Return the mass of the trees of bodies that muscles' paths touch, or else of all [kg]."""
    sites = model.wrap_objid[model.wrap_type == mujoco.mjtWrap.mjWRAP_SITE]
    roots = np.setdiff1d(model.body_rootid[model.site_bodyid[sites]], [0])
    own = np.isin(model.body_rootid, roots) if roots.size else np.ones(model.nbody, bool)
    return float(model.body_mass[own].sum())

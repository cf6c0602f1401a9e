"""Metabolic power of a motion: heat and work of its fibers after Bhargava 2004, frame by frame.

Fibers have the lengths and forces that `muscle_forces` found, and the velocity that the path leaves them with
a tendon that keeps its length. Activations stand for excitations, which nothing in a frame says. The law is
that of `laws.metabolics`, and so of OpenSim's probe of this name, with its default half of slow fibers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from myowarp.kernels.launch import launch
from myowarp.laws.metabolics import bhargava2004, muscle_mass
from myowarp.motion.muscle_forces import ALONG_TENDON, MuscleForces
from myowarp.osim.body.hill_muscle import HillMuscle, known
from myowarp.osim.body.muscle_paths import MusclePaths
from myowarp.osim.document.model import Model

SLOW_TWITCH_RATIO = 0.5
"""Share of slow fibers."""

wp.set_module_options({"enable_backward": False})


@wp.kernel(enable_backward=False)
def burn_energy(
    # Params:
    mass: wp.array[wp.float64],
    slow_twitch_ratio: wp.float64,
    # In:
    activation: wp.array2d[wp.float64],
    norm_fiber_length: wp.array2d[wp.float64],
    fiber_velocity: wp.array2d[wp.float64],
    active_fiber_force: wp.array2d[wp.float64],
    fiber_force: wp.array2d[wp.float64],
    # Out:
    power: wp.array2d[wp.float64],
):
    """P = heat + work of each muscle [W]."""
    worldid, i = wp.tid()
    heat, work = bhargava2004(
        mass[i],
        slow_twitch_ratio,
        activation[worldid, i],
        norm_fiber_length[worldid, i],
        fiber_velocity[worldid, i],
        active_fiber_force[worldid, i],
        fiber_force[worldid, i],
    )
    power[worldid, i] = heat + work


def metabolic_power(model: Model, found: MuscleForces, paths: MusclePaths, device: Any = "cpu") -> np.ndarray:
    """Return the metabolic power of each muscle [W], shape (frames, muscles), without that of a body at rest.

    Args:
        model: The model.
        found: Activations, forces and fibers of the motion.
        paths: Of its muscles.
        device: Where it is computed.
    """
    muscles = [known(HillMuscle.of(model.muscles[name]))[0] for name in found.muscles]
    optimal, strength = (np.array([m.values[name] for m in muscles])
                         for name in ("optimal_fiber_length", "max_isometric_force"))  # fmt: skip
    width = np.array([m.fiber_width for m in muscles])
    cosine = np.sqrt(np.maximum(1.0 - (width / found.fiber_length) ** 2, 0.0))
    velocity = paths.velocity * cosine
    norm = found.fiber_length / optimal
    passive = np.zeros_like(norm)
    for k, muscle in enumerate(muscles):
        damped = muscle.damping * velocity[:, k] / muscle.velocity_scale
        passive[:, k] = strength[k] * (muscle.curves.passive_force(norm[:, k])[0] + damped)
    # In mode `opensim` the force is that of some classes' fibers, which have no passive one.
    along = np.array([found.steady or muscle.kind in ALONG_TENDON for muscle in muscles])
    force = np.where(along, found.force / np.maximum(cosine, 1e-9), found.force)
    active = np.where(found.steady, np.maximum(force - passive, 0.0), force)
    with wp.ScopedDevice(device):
        power = wp.zeros(norm.shape, dtype=wp.float64)
        named = {
            "activation": found.activation,
            "norm_fiber_length": norm,
            "fiber_velocity": velocity,
            "active_fiber_force": active,
            "fiber_force": force,
        }
        launch(
            burn_energy,
            norm.shape,
            mass=wp.array(muscle_mass(strength, optimal), dtype=wp.float64),
            slow_twitch_ratio=SLOW_TWITCH_RATIO,
            power=power,
            **{name: wp.array(array, dtype=wp.float64) for name, array in named.items()},
        )
        return np.array(power.numpy())

"""Accelerations of a model: at rest in its default pose, and by its motors.

Bodies of next to no inertia start so fast that no time step follows them, OpenSim's own neither; a motor may
throw a light body, too. Both are known from the document's equations of motion before anything is simulated.
"""

import math
from collections.abc import Mapping

import numpy as np

from myowarp.osim.body.hill_muscle import HillMuscle, known
from myowarp.osim.body.path_solution import lengths_and_moment_arms
from myowarp.osim.bundle.couplings import REGULAR, regularity
from myowarp.osim.document.dynamics import equations
from myowarp.osim.document.model import Model
from myowarp.process import listed

LIGHT = 1e5
"""rad/s^2 or m/s^2 by 1 N m or N: coordinates of published models that move have at most 1e4."""
STILL = 1e5
"""rad/s^2 or m/s^2 at rest from which a model cannot be stepped: 200 rad/s in one step of 2 ms."""
THROWN = 5e3
"""rad/s^2 or m/s^2 from which a motor throws a body: 100 rad/s in a control step of 20 ms."""
LISTED = 4
"""Motors that are named."""


def too_fast(model: Model) -> list[str]:
    """Return what is too fast in a model, one sentence each; none where masses say no acceleration."""
    free = model.independent
    values = {name: np.array([model.coordinates[name].default]) for name in free}
    speeds = np.zeros((1, len(free)))
    if not free:
        return []
    mass, bias = (array[0] for array in equations(model, values, speeds))
    if not regularity(mass) >= REGULAR:
        return []
    by_force = np.linalg.inv(mass)
    said = []
    if np.diag(by_force).max() > LIGHT:
        rest = by_force @ (_pull(model, values, speeds) - bias)
        name = free[int(np.abs(rest).argmax())]
        if np.abs(rest).max() > STILL:
            size = _size(model, name, rest)
            said.append(
                f"at rest in its default pose {name} accelerates by {size}: bodies have next to no inertia, "
                "no time step follows them, and the model cannot move"
            )
    thrown = {}
    for motor in model.coordinate_actuators:
        if motor.coordinate in free:
            most = max(abs(x) if math.isfinite(x) else 1.0 for x in motor.control_range)
            given = most * motor.optimal_force * by_force[free.index(motor.coordinate)]
            if np.abs(given).max() > THROWN:
                thrown[motor.name] = given
    if thrown:
        names = sorted(thrown, key=lambda name: -np.abs(thrown[name]).max())
        given = thrown[names[0]]
        size = _size(model, free[int(np.abs(given).argmax())], given)
        said.append(
            f"at full control motors throw light bodies, by up to {size}, which may end in faults: "
            f"{listed(names, LISTED)}; give them less optimal force, or bound their controls"
        )
    return said


def _size(model: Model, coordinate: str, accelerations: np.ndarray) -> str:
    """Return the greatest of some accelerations, which is a coordinate's."""
    unit = "rad" if model.coordinates[coordinate].rotational else "m"
    return f"{np.abs(accelerations).max():.2g} {unit}/s^2"


def _pull(model: Model, values: Mapping[str, np.ndarray], speeds: np.ndarray) -> np.ndarray:
    """Return what muscles do along independent coordinates at their least activation [N m] or [N]."""
    muscles = {name: muscle for name, muscle in model.muscles.items() if muscle.applies_force}
    if not muscles:
        return np.zeros(speeds.shape[1])
    paths = {name: muscle.path for name, muscle in muscles.items()}
    found = lengths_and_moment_arms(model, paths, values, speeds)
    force = []
    for muscle, length in zip(muscles.values(), found.length[0], strict=True):
        hill = known(HillMuscle.of(muscle))[0]
        least = max(hill.values["min_control"], hill.values.get("minimum_activation", 0.0), 0.0)
        force.append(hill.values["max_isometric_force"] * float(hill.tendon_force(least, length)))
    return np.array(force) @ found.moment_arm[0]

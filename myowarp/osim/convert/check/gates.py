"""Gates: figures of a conversion, what they may be at most, and where they are worst."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from myowarp.osim.convert.check.dynamics import Dynamics
from myowarp.osim.convert.check.frames import KinematicsError
from myowarp.osim.convert.check.muscles import MomentArmError, MuscleError, Spread

Item = TypeVar("Item", MomentArmError, MuscleError)

EXACT_FRAMES, FITTED_FRAMES = 1e-6, 0.35
"""[mm]: of models without functions that are fitted, and with."""
EXACT_TURNS, FITTED_TURNS = 1e-6, 0.5
"""[deg]: the same of rotations."""
MEAN_ARM = 0.7
"""[mm]: root mean square, mean over pairs of muscle and coordinate."""
ARM, LENGTH, FORCE = (2.0, 5.0, 20.0), (3.0, 6.0, 15.0), (10.0, 20.0, 40.0)
"""Of the worst pair or muscle: root mean square, 95th percentile and greatest error [mm], [mm] and
[% of max_isometric_force], this at the converted path's own length."""
EXCLUDED = 5.0
"""[%] of the samples of a pair that may be left out."""
FORCE_MAP, FULL_FORCE, POSE_FORCE = 2.5, 3.0, 5.0
"""[% of max_isometric_force]: root mean square over lengths, mean over muscles; five activations, full, and
at the converted path's own length."""
ENGINES = {
    "step": "MyoWarp's step",
    "mjb": "model.mjb in MuJoCo",
    "xml": "model.xml in MuJoCo",
}
"""Engines that step a converted model."""
ACCELERATIONS = {"step": (0.01, 1.0), "mjb": (0.5, 5.0)}
"""[%]: median and worst of the states."""
COORDINATES = {
    "step": {"inertia": 0.1, "response": 1.0, "gravity": 0.1, "torque": 1.0},
    "mjb": {"inertia": 2.0, "response": 2.0, "gravity": 2.0, "torque": 5.0},
}
"""[%]: worst of a coordinate, by quantity of `check.dynamics`; model.xml alone has figures and no gates."""
SAID = {
    "inertia": "mass matrix, greatest error",
    "response": "unit force at rest, greatest error",
    "gravity": "gravity at rest, greatest error",
    "acceleration": "accelerations, greatest error",
    "torque": "inverse dynamics, greatest error",
}
"""Quantities for people."""


@dataclass(frozen=True)
class Gate:
    """A figure and what it may be at most."""

    name: str
    value: float
    bound: float
    unit: str
    where: str = ""
    """The owner of the figure; "": all."""

    @property
    def passed(self) -> bool:
        """Whether the figure is within its bound; one that is no number is not."""
        return self.value <= self.bound


def worst(items: Iterable[Item], of: Callable[[Item], float]) -> Item:
    """Return the item with the greatest figure; one that is no number is the worst."""
    return max(items, key=lambda item: math.inf if math.isnan(of(item)) else of(item))


def most(name: str, items: Iterable[Item], of: Callable[[Item], float], bound: float, unit: str) -> Gate:
    """Return the gate of the worst of pairs or muscles, which it names."""
    item = worst(items, of)
    where = f"{item.muscle}, {item.coordinate}" if isinstance(item, MomentArmError) else item.muscle
    return Gate(name, of(item), bound, unit, where if of(item) != 0 else "")


def spread_gates(
    what: str,
    items: Sequence[Item],
    of: Callable[[Item], Spread],
    bounds: tuple[float, float, float],
    unit: str,
) -> list[Gate]:
    """Return the gates of root mean square, 95th percentile and greatest error, each of the worst in it."""
    factor = 1e3 if unit == "mm" else 100
    return [
        most(f"{what}, worst RMS", items, lambda item: of(item).rms * factor, bounds[0], unit),
        most(f"{what}, worst 95th percentile", items, lambda item: of(item).p95 * factor, bounds[1], unit),
        most(f"{what}, greatest error", items, lambda item: of(item).worst * factor, bounds[2], unit),
    ]


def frame_gates(kinematics: KinematicsError, fitted: bool) -> list[Gate]:
    """Return the gates of positions and orientations; `fitted`: whether functions of joints are fitted."""
    place, turn = (FITTED_FRAMES, FITTED_TURNS) if fitted else (EXACT_FRAMES, EXACT_TURNS)
    return [
        Gate("frames, greatest error", kinematics.position * 1e3, place, "mm", kinematics.worst),
        Gate("orientations, greatest error", math.degrees(kinematics.rotation), turn, "°"),
        Gate("markers, greatest error", kinematics.marker * 1e3, place, "mm"),
    ]


def arm_gates(arms: Sequence[MomentArmError]) -> list[Gate]:
    """Return the gates of moment arms; none without moment arms."""
    if not arms:
        return []
    mean = float(np.mean([pair.error.rms for pair in arms]))
    return [
        Gate("moment arms, mean RMS", mean * 1e3, MEAN_ARM, "mm"),
        *spread_gates("moment arms", arms, lambda pair: pair.error, ARM, "mm"),
        most("moment arms, wrong signs", arms, lambda pair: pair.wrong_signs * 100, 0.0, "%"),
        most("moment arms, excluded samples", arms, lambda pair: pair.excluded * 100, EXCLUDED, "%"),
    ]


def muscle_gates(muscles: Sequence[MuscleError]) -> list[Gate]:
    """Return the gates of lengths and forces; none without muscles."""
    if not muscles:
        return []

    def mean(name: str, of: Callable[[MuscleError], Spread], bound: float) -> Gate:
        return Gate(name, float(np.mean([of(muscle).rms for muscle in muscles])) * 100, bound, "%")

    return [
        *spread_gates("lengths", muscles, lambda muscle: muscle.length, LENGTH, "mm"),
        mean("force maps, mean RMS", lambda muscle: muscle.force, FORCE_MAP),
        mean("full activation, mean RMS", lambda muscle: muscle.force_full, FULL_FORCE),
        mean("forces at own length, mean RMS", lambda muscle: muscle.force_in_pose, POSE_FORCE),
        *spread_gates("forces at own length", muscles, lambda muscle: muscle.force_in_pose, FORCE, "%"),
        most("lengths and forces, excluded samples", muscles, lambda one: one.excluded * 100, EXCLUDED, "%"),
    ]


def dynamics_gates(dynamics: Dynamics) -> list[Gate]:
    """Return the gates of our step and of model.mjb; none where the document determines no accelerations."""
    if dynamics.samples is None:
        return []
    gates = [
        Gate("dynamics, states left out", dynamics.samples.undetermined * 100, EXCLUDED, "%"),
    ]
    names = list(dynamics.coordinates)
    for key, (median, greatest) in ACCELERATIONS.items():
        engine = dynamics.engines[key]
        said = f"{ENGINES[key]}, accelerations"
        where = f"condition {engine.condition:.1g}"
        gates += [
            Gate(f"{said}, median", float(np.median(engine.states)) * 100, median, "%"),
            Gate(f"{said}, worst state", float(engine.states.max()) * 100, greatest, "%", where),
        ]
        for quantity, bound in COORDINATES[key].items():
            most = engine.errors[quantity].max(axis=0)
            place = int(np.argmax(most))
            value = float(most[place]) * 100
            gates.append(Gate(f"{ENGINES[key]}, {SAID[quantity]}", value, bound, "%", names[place]))
    return gates

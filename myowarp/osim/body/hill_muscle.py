"""Hill muscles as OpenSim defines them: tendon force at given activation, length and velocity.

With the fiber length l, its part z = l cos(phi) along the tendon, and a constant width l sin(phi):

    (a f_L(l) f_V(v) + f_P(l) + beta v) cos(phi) = f_T((L - z) / slack length)

is solved for z by Newton steps kept in a bracket. It has one, since the residual falls below 0 where the
fiber is shortest and is not negative where the tendon is slack; what is left at an end of the bracket
stays there: a slack tendon, or a fiber at its shortest. A rigid tendon needs no solving.

The velocity is that of the whole muscle with a tendon of constant length (v = V cos(phi)): exact for a
rigid tendon, for an elastic one the force that a steady velocity leads to.

Sources: see muscle_curves.py; fiber bounds: OpenSim's MuscleFixedWidthPennationModel.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from myowarp.laws.millard_curves import MIN_DAMPING, millard_curves
from myowarp.laws.muscles import degroote_fregly2016, thelen2003
from myowarp.laws.muscles.hill_parameters import MAX_PENNATION
from myowarp.osim.body.hill_curves import SPLINES, DeGrooteCurves, MuscleCurves, SplineCurves, ThelenCurves
from myowarp.osim.document.functions import Function
from myowarp.osim.document.model import Muscle, Note
from myowarp.osim.document.read.muscle_defaults import DEFAULTS

Array = np.ndarray

CLASSES = (
    "Thelen2003Muscle",
    "Millard2012EquilibriumMuscle",
    "Millard2012AccelerationMuscle",
    "DeGrooteFregly2016Muscle",
    "Schutte1993Muscle_Deprecated",
    "Delp1990Muscle_Deprecated",
    "RigidTendonMuscle",
)
"""OpenSim's muscle classes with equations here."""

FORCE_TOLERANCE = 1e-11
"""Residual at which the equilibrium counts as found [max_isometric_force]; OpenSim stops at 1e-8."""

ACTIVATIONS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Of a force map: activations at which a muscle is compared with its fit."""

MAX_STEPS = 100
"""Of which the first 50 alone bring a bracket to 1e-15 of its width by bisection."""


@dataclass(frozen=True)
class HillMuscle:
    """The parameters of one muscle, without its path.

    Attributes:
        name: Of the muscle.
        kind: OpenSim's class.
        values: Every number of the class under OpenSim's names, in SI units; switches are 0 or 1; the
            numbers of a nested curve as `ForceVelocityCurve.isometric_slope`.
        functions: Curves that the file holds as functions, under OpenSim's names.
    """

    name: str
    kind: str
    values: Mapping[str, float]
    functions: Mapping[str, Function] = field(default_factory=dict)

    @classmethod
    def of(cls, muscle: Muscle) -> "HillMuscle":
        """Return the parameters of a muscle that was read from a file."""
        low, high = muscle.control_range
        values = {
            **{name: float(getattr(muscle, name)) for name in COMMON},
            "min_control": low,
            "max_control": high,
            **muscle.parameters,
        }
        functions = {**SPLINES.get(muscle.type, {}), **muscle.curves}
        return cls(muscle.name, muscle.type, values, functions)

    @cached_property
    def curves(self) -> MuscleCurves:
        """Force multipliers.

        Raises:
            NotImplementedError: For a class without equations here.
        """
        v = self.values
        match self.kind:
            case "Thelen2003Muscle":
                return ThelenCurves(*(v[name] for name in thelen2003.PARAMETERS))
            case "Millard2012EquilibriumMuscle" | "Millard2012AccelerationMuscle":
                return millard_curves(v)
            case "DeGrooteFregly2016Muscle":
                active, passive, tendon = (v[name] for name in degroote_fregly2016.PARAMETERS)
                return DeGrooteCurves(active, passive, tendon, not v["ignore_passive_fiber_force"])
        if self.kind in CLASSES:
            f = self.functions
            return SplineCurves(
                f["active_force_length_curve"],
                f.get("passive_force_length_curve"),
                None if self.rigid_tendon else f["tendon_force_length_curve"],
                f.get("force_velocity_curve"),
            )
        raise NotImplementedError(
            f"muscle '{self.name}' is a {self.kind}, which has no equations here; "
            f"available: {', '.join(CLASSES)}"
        )

    @property
    def rigid_tendon(self) -> bool:
        """Whether the tendon keeps its slack length."""
        v = self.values
        rigid = self.kind == "RigidTendonMuscle" or bool(v["ignore_tendon_compliance"])
        return rigid or v["tendon_slack_length"] <= 0.0

    @property
    def fiber_width(self) -> float:
        """Distance between the planes that the fibers run between [m]."""
        return self.values["optimal_fiber_length"] * math.sin(self.values["pennation_angle_at_optimal"])

    @property
    def shortest_fiber(self) -> float:
        """Length along the tendon that the fiber cannot go below [m]."""
        if self.kind not in CLASSES[:3]:
            return 0.0
        angle = self.values.get("maximum_pennation_angle", MAX_PENNATION)
        length = abs(self.fiber_width) / math.sin(angle)
        if start := self.values.get("ActiveForceLengthCurve.min_norm_active_fiber_length"):
            length = max(length, start * self.values["optimal_fiber_length"])
        return math.sqrt(length**2 - self.fiber_width**2)

    @property
    def damping(self) -> float:
        """Fiber force per velocity [max_isometric_force / max_contraction_velocity]."""
        beta = self.values.get("fiber_damping", self.values.get("damping", 0.0))
        return beta if beta >= MIN_DAMPING else 0.0

    @property
    def velocity_scale(self) -> float:
        """Fiber velocity at which f_V reaches 0 [m/s]."""
        v = self.values
        per_second = 1.0 / v["time_scale"] if "time_scale" in v else v["max_contraction_velocity"]
        return v["optimal_fiber_length"] * per_second

    def fiber_force(self, z: Array, activation: Array, velocity: Array) -> tuple[Array, Array]:
        """Return the force of the fiber along the tendon [max_isometric_force] and its slope [1/m].

        Args:
            z: Fiber length along the tendon [m].
            activation: Activation [1].
            velocity: Velocity of z [m/s].
        """
        optimal, scale, beta = self.values["optimal_fiber_length"], self.velocity_scale, self.damping
        length = np.sqrt(z**2 + self.fiber_width**2)
        cosine = z / np.maximum(length, TINY)
        turn = (1.0 - cosine**2) / np.maximum(length, TINY)
        active, active_slope = self.curves.active_force_length(length / optimal)
        passive, passive_slope = self.curves.passive_force(length / optimal)
        speed = velocity * cosine / scale
        factor, factor_slope = self.curves.force_velocity(speed, activation)
        force = activation * active * factor + passive + beta * speed
        stretch = cosine / optimal
        slope = (activation * active_slope * factor + passive_slope) * stretch
        slope = slope + (activation * active * factor_slope + beta) * velocity * turn / scale
        return force * cosine, slope * cosine + force * turn

    def tendon_force(self, activation: ArrayLike, length: ArrayLike, velocity: ArrayLike = 0.0) -> Array:
        """Return the force in the tendon [max_isometric_force], at least 0.

        Args:
            activation: Activation [1].
            length: Length of muscle and tendon [m].
            velocity: Its velocity [m/s], positive when lengthening.

        Returns:
            Array of the broadcast shape of the arguments.
        """
        numbers = (np.asarray(x, float) for x in (activation, length, velocity))
        arrays = np.broadcast_arrays(*numbers)
        activation, length, velocity = (array.ravel() for array in arrays)
        slack = np.full(length.shape, self.values["tendon_slack_length"])
        return self.steady(activation, length, velocity, slack)[1].reshape(arrays[0].shape)

    def steady(self, activation: Array, length: Array, velocity: Array, slack: Array) -> tuple[Array, Array]:
        """Return fiber length along the tendon [m] and force in the tendon [max_isometric_force].

        Args:
            activation: Activation [1], shape (n,).
            length: Length of muscle and tendon [m].
            velocity: Its velocity [m/s], positive when lengthening.
            slack: Tendon slack length [m].
        """
        shortest = self.shortest_fiber
        longest = length - slack
        z = np.maximum(longest, shortest)
        if self.rigid_tendon:
            force, _ = self.fiber_force(z, activation, velocity)
        else:
            z = self._solve(activation, length, velocity, slack, np.full(length.shape, shortest), z)
            force, _ = self.curves.tendon_force((length - z) / slack)
        return z, np.where(longest > shortest, np.maximum(force, 0.0), 0.0)

    def _solve(
        self, a: Array, length: Array, velocity: Array, slack: Array, low: Array, high: Array
    ) -> Array:
        """Return the fiber length along the tendon between `low` and `high` at equilibrium [m]."""

        def residual(z: Array, where: Array) -> tuple[Array, Array]:
            pull, pull_slope = self.fiber_force(z, a[where], velocity[where])
            tension, stiffness = self.curves.tendon_force((length[where] - z) / slack[where])
            return pull - tension, pull_slope + stiffness / slack[where]

        every = np.arange(len(length))
        long, short = residual(high, every)[0] <= 0.0, residual(low, every)[0] >= 0.0
        result = np.where(short, low, high)
        index = np.flatnonzero(~(long | short))
        low, high = low[index], high[index]
        # Most muscles stretch their tendon little: begin next to the slack end.
        z = np.maximum(0.5 * (low + high), high - 0.02 * slack[index])
        for _ in range(MAX_STEPS):
            if not index.size:
                break
            value, slope = residual(z, index)
            low, high = np.where(value < 0.0, z, low), np.where(value < 0.0, high, z)
            step = z - value / np.where(slope > 0.0, slope, 1.0)
            inside = (slope > 0.0) & (step > low) & (step < high)
            result[index] = z
            rest = (np.abs(value) > FORCE_TOLERANCE) & (high - low > TINY)
            z = np.where(inside, step, 0.5 * (low + high))[rest]
            index, low, high = index[rest], low[rest], high[rest]
        return result


def known(muscle: HillMuscle) -> tuple[HillMuscle, tuple[Note, ...]]:
    """Return a muscle that has equations here, and what was put in the place of its own."""
    if muscle.kind == "Millard2012AccelerationMuscle":
        rule = "the mass of its fiber and its compressive elements are left out"
        return muscle, (
            Note(muscle.name, rule, "3e-5 of the maximum isometric force at rest, with defaults"),
        )
    if muscle.kind in CLASSES:
        return muscle, ()
    kind = "Thelen2003Muscle"
    rule = f"its class {muscle.kind} has no equations here; it is taken as a {kind} of its own parameters"
    values = {**DEFAULTS[kind], **muscle.values}
    return HillMuscle(muscle.name, kind, values), (Note(muscle.name, rule),)


COMMON = (
    "max_isometric_force",
    "optimal_fiber_length",
    "tendon_slack_length",
    "pennation_angle_at_optimal",
    "max_contraction_velocity",
    "ignore_tendon_compliance",
    "ignore_activation_dynamics",
)
"""Numbers that every class has."""

TINY = 1e-15
"""[m]; keeps a fiber of no length from dividing by 0."""

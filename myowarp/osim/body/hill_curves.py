"""The curves of OpenSim's muscles: force multipliers of fiber and tendon, each with its slope.

Every function maps float64 arrays of one shape to `(value, slope)` of that shape. Lengths are in
optimal fiber lengths or tendon slack lengths, velocities in `max_contraction_velocity`, forces in
`max_isometric_force`; landmarks: f_L(1) = 1, f_V(0) = 1, f_T(1) = 0, f_P(1) = 0 (De Groote: small).

Sources: Thelen 2003 (doi:10.1115/1.1531112) in the form of OpenSim's Thelen2003Muscle; Millard et al.
2013 (doi:10.1115/1.4023390), curves of quintic Bezier corners; De Groote, Kinney, Rao, Fregly 2016
(doi:10.1007/s10439-016-1591-9) with OpenSim's shift of the tendon curve to f_T(1) = 0; Schutte,
Rodgers, Zajac, Glaser 1993 (doi:10.1109/86.242425) for `SplineCurves`.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from myowarp.osim.document.functions import Function, SimmSpline
from myowarp.osim.document.read.muscle_defaults import FORCE_LENGTH

Array = np.ndarray
Curve = tuple[Array, Array]


class MuscleCurves(Protocol):
    """The four curves of a muscle class."""

    def active_force_length(self, length: Array) -> Curve:
        """Return f_L and its slope."""

    def passive_force(self, length: Array) -> Curve:
        """Return f_P and its slope."""

    def tendon_force(self, length: Array) -> Curve:
        """Return f_T and its slope."""

    def force_velocity(self, velocity: Array, activation: Array) -> Curve:
        """Return f_V and its slope along the velocity."""


@dataclass(frozen=True)
class ThelenCurves:
    """Gaussian f_L, exponential f_P, exponential toe and line for f_T, hyperbolic f_V.

    Attributes:
        active_width: Variance of f_L (KshapeActive).
        passive_shape: Exponent of f_P (KshapePassive).
        passive_strain: Fiber strain at f_P = 1 (FmaxMuscleStrain).
        tendon_strain: Tendon strain at f_T = 1 (FmaxTendonStrain).
        velocity_shape: Curvature of the hyperbola (Af).
        eccentric_multiplier: Limit of f_V (Flen).
        extrapolation_threshold: Share of the limit where f_V goes on as a line.
    """

    active_width: float
    passive_shape: float
    passive_strain: float
    tendon_strain: float
    velocity_shape: float
    eccentric_multiplier: float
    extrapolation_threshold: float

    def active_force_length(self, length: Array) -> Curve:
        """f_L = exp(-(l - 1)^2 / width)."""
        value = np.exp(-((length - 1.0) ** 2) / self.active_width)
        return value, -2.0 * (length - 1.0) / self.active_width * value

    def passive_force(self, length: Array) -> Curve:
        """f_P = (exp(k (l - 1) / strain) - 1) / (exp(k) - 1) above 1, else 0."""
        rate = self.passive_shape / self.passive_strain
        growth = np.exp(rate * np.maximum(length - 1.0, 0.0))
        scale = math.expm1(self.passive_shape)
        return (growth - 1.0) / scale, np.where(length > 1.0, rate * growth / scale, 0.0)

    def tendon_force(self, length: Array) -> Curve:
        """Exponential toe up to a third of the force, a line of matching slope beyond, 0 when slack."""
        toe_shape, toe_force = 3.0, 0.33
        e = math.exp(toe_shape)
        toe_strain = 99.0 * self.tendon_strain * e / (166.0 * e - 67.0)
        stiffness = 0.67 / (self.tendon_strain - toe_strain)
        strain = length - 1.0
        rate = toe_shape / toe_strain
        growth = np.exp(rate * np.clip(strain, 0.0, toe_strain))
        toe = toe_force * (growth - 1.0) / (e - 1.0)
        line = strain > toe_strain
        value = np.where(line, toe_force + stiffness * (strain - toe_strain), toe)
        slope = np.where(line, stiffness, np.where(strain > 0, toe_force * rate * growth / (e - 1.0), 0.0))
        return value, slope

    def force_velocity(self, velocity: Array, activation: Array) -> Curve:
        """Thelen's eq. 6, 7 solved for the force: hyperbolas with speeds in 0.25 + 0.75 a, lines outside."""
        k = 0.25 + 0.75 * activation
        v = np.maximum(velocity, -k)
        concentric_pole = k - np.minimum(v, 0.0) / self.velocity_shape
        concentric = (k + v) / concentric_pole
        concentric_slope = (1.0 + 1.0 / self.velocity_shape) * k / concentric_pole**2
        concentric = concentric + concentric_slope * (np.minimum(velocity, -k) + k)

        limit = self.eccentric_multiplier
        q = (2.0 + 2.0 / self.velocity_shape) / (limit - 1.0)
        end = self.extrapolation_threshold * limit
        end_velocity = k * (end - 1.0) / (q * (limit - end))
        w = np.clip(velocity, 0.0, end_velocity)
        eccentric_slope = q * k * (limit - 1.0) / (k + q * w) ** 2
        eccentric = (w * q * limit + k) / (k + q * w) + eccentric_slope * (velocity - w)
        shortens = velocity <= 0.0
        return np.where(shortens, concentric, eccentric), np.where(
            shortens, concentric_slope, eccentric_slope
        )


@dataclass(frozen=True)
class DeGrooteCurves:
    """Smooth closed forms without cases; the tendon can push and the passive fiber is never slack.

    Attributes:
        active_width: Scale of the width of f_L (active_force_width_scale).
        passive_strain: Fiber strain at f_P = 1.
        tendon_strain: Tendon strain at f_T = 1.
        passive: False switches f_P off.
    """

    active_width: float
    passive_strain: float
    tendon_strain: float
    passive: bool

    def active_force_length(self, length: Array) -> Curve:
        """Sum of three bells (eq. S3)."""
        x = (length - 1.0) / self.active_width + 1.0
        value, slope = np.zeros_like(x), np.zeros_like(x)
        for height, centre, width, skew in DE_GROOTE_ACTIVE:
            spread = width + skew * x
            z = (x - centre) / spread
            bell = height * np.exp(-0.5 * z**2)
            value = value + bell
            slope = slope - bell * z * (spread - skew * (x - centre)) / spread**2
        return value, slope / self.active_width

    def passive_force(self, length: Array) -> Curve:
        """f_P = (exp(4 (l - 1) / strain) - o) / (exp(4) - o), 0 at l = 0.2."""
        if not self.passive:
            return np.zeros_like(length), np.zeros_like(length)
        rate = 4.0 / self.passive_strain
        offset = math.exp(rate * (0.2 - 1.0))
        growth = np.exp(rate * (length - 1.0)) / (math.exp(4.0) - offset)
        return growth - offset / (math.exp(4.0) - offset), rate * growth

    def tendon_force(self, length: Array) -> Curve:
        """f_T = 0.2 (exp(k (l - 1)) - 1)."""
        rate = math.log(1.2 / 0.2) / self.tendon_strain
        growth = 0.2 * np.exp(rate * (length - 1.0))
        return growth - 0.2, rate * growth

    def force_velocity(self, velocity: Array, activation: Array) -> Curve:
        """f_V = d1 asinh(d2 v + d3) + d4 (eq. S4)."""
        d1, d2, d3, d4 = DE_GROOTE_VELOCITY
        x = d2 * velocity + d3
        return d1 * np.arcsinh(x) + d4, d1 * d2 / np.sqrt(1.0 + x**2)


DE_GROOTE_ACTIVE = (
    (0.8150671134243542, 1.055033428970575, 0.162384573599574, 0.063303448465465),
    (0.433004984392647, 0.716775413397760, -0.029947116970696, 0.200356847296188),
    (0.1, 1.0, 0.353553390593274, 0.0),
)
"""Height, centre, width, width per length of the bells of f_L (OpenSim's digits)."""

DE_GROOTE_VELOCITY = (-0.3211346127989808, -8.149, -0.374, 0.8825327733249912)
"""d1 to d4; d1 and d4 give f_V(-1) = 0 and f_V(0) = 1 exactly."""


@dataclass(frozen=True)
class SplineCurves:
    """Curves that the file holds as functions, over fiber length and tendon strain.

    Attributes:
        active: f_L over fiber length, negative values cut off.
        passive: f_P over fiber length; None: exp(8 (l - 1) - 4), which Schutte's class takes unless told.
        tendon: f_T over tendon strain, 0 below; None where the tendon is rigid.
        velocity: f_V; None: Schutte's two hyperbolas.
    """

    active: Function
    passive: Function | None
    tendon: Function | None
    velocity: Function | None

    def active_force_length(self, length: Array) -> Curve:
        """Return the spline, at least 0."""
        value, slope = self.active.value(length), self.active.derivative(length)
        return np.maximum(value, 0.0), np.where(value > 0.0, slope, 0.0)

    def passive_force(self, length: Array) -> Curve:
        """Return the spline, at least 0."""
        if self.passive is None:
            value = np.exp(8.0 * (length - 1.0) - 4.0)
            return value, 8.0 * value
        value, slope = self.passive.value(length), self.passive.derivative(length)
        return np.maximum(value, 0.0), np.where(value > 0.0, slope, 0.0)

    def tendon_force(self, length: Array) -> Curve:
        """Return the spline over the strain, 0 when slack."""
        if self.tendon is None:
            return np.zeros_like(length), np.zeros_like(length)
        strain = length - 1.0
        value, slope = self.tendon.value(strain), self.tendon.derivative(strain)
        return np.where(strain > 0.0, value, 0.0), np.where(strain > 0.0, slope, 0.0)

    def force_velocity(self, velocity: Array, activation: Array) -> Curve:
        """kv (1 + v) / (kv - v) shortening, (q + 1.4 v) / (q + v) lengthening, 0 below -1."""
        if self.velocity is not None:
            return self.velocity.value(velocity), self.velocity.derivative(velocity)
        kv, limit = 0.15, 1.4
        q = 0.13 * kv / (kv + 1.0)
        shortening, lengthening = np.clip(velocity, -1.0, 0.0), np.maximum(velocity, 0.0)
        value = np.where(
            velocity <= 0.0,
            kv * (1.0 + shortening) / (kv - shortening),
            (q + limit * lengthening) / (q + lengthening),
        )
        slope = np.where(
            velocity <= 0.0,
            np.where(velocity > -1.0, kv * (1.0 + kv) / (kv - shortening) ** 2, 0.0),
            q * (limit - 1.0) / (q + lengthening) ** 2,
        )
        return value, slope


def _spline(x: str, y: str) -> SimmSpline:
    """Return the spline through points that are written as two rows."""
    return SimmSpline(tuple(map(float, x.split())), tuple(map(float, y.split())))


# Curves of spline muscles where the file does not state them, asked of OpenSim 4.6; classes share them.
TENDON = _spline(
    "-10 -0.002 -0.001 0 0.00131 0.00281 0.00431 0.00581 0.00731 0.00881 0.0103 0.0118 0.0123 9.2 "
    "9.201 9.202 20",
    "0 0 0 0 0.0108 0.0257 0.0435 0.0652 0.0915 0.123 0.161 0.208 0.227 345 345 345 345",
)
"""Over tendon strain [1]; forces in maximum isometric forces."""

ACTIVE = _spline(
    "-5.307692 -4.307692 -1.923077 -0.884615 -0.269231 0.230769 0.461538 0.52725 0.62875 0.71875 "
    "0.86125 1.045 1.2175 1.43875 1.5 1.615385 2 2.961538 3.692308 5.461538 9.901902",
    "0.012188 0.021899 0.036466 0.052493 0.075312 0.114158 0.157859 0.226667 0.636667 0.856667 0.95 "
    "0.993333 0.77 0.246667 0.193821 0.133252 0.072683 0.044417 0.036341 0.021899 0.007332",
)
"""Over fiber length [optimal fiber lengths]."""

PASSIVE = FORCE_LENGTH
"""Over fiber length; Schutte's class has an exponential instead."""

VELOCITY = _spline(
    "-1.001 -1 -0.95 -0.9 -0.85 -0.8 -0.75 -0.7 -0.65 -0.6 -0.55 -0.5 -0.45 -0.4 -0.35 -0.3 -0.25 "
    "-0.2 -0.15 -0.1 -0.05 0 0.05 0.1 0.15 0.2 0.25 0.3 0.35 0.4 0.45 0.5 0.55 0.6 0.65 0.7 0.75 0.8 "
    "0.85 0.9 0.95 1",
    "0 0 0.010417 0.021739 0.034091 0.047619 0.0625 0.078947 0.097222 0.117647 0.140625 0.166667 "
    "0.196429 0.230769 0.270833 0.318182 0.375 0.444444 0.53125 0.642857 0.791667 1 1.482014 1.601571 "
    "1.655791 1.686739 1.706751 1.720753 1.731099 1.739055 1.745365 1.75049 1.754736 1.758312 "
    "1.761364 1.763999 1.766298 1.768321 1.770115 1.771717 1.773155 1.774455",
)
"""Over velocity [maximum contraction velocities]."""

SPLINES: dict[str, dict[str, Function]] = {
    "Schutte1993Muscle_Deprecated": {
        "tendon_force_length_curve": TENDON,
        "active_force_length_curve": ACTIVE,
    },
    "Delp1990Muscle_Deprecated": {
        "tendon_force_length_curve": TENDON,
        "active_force_length_curve": ACTIVE,
        "passive_force_length_curve": PASSIVE,
        "force_velocity_curve": VELOCITY,
    },
    "RigidTendonMuscle": {
        "active_force_length_curve": ACTIVE,
        "passive_force_length_curve": PASSIVE,
        "force_velocity_curve": VELOCITY,
    },
}
"""Class: property: default."""

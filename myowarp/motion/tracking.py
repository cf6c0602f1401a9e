"""Tracking: excitations that make a forward simulation follow a motion, by computed muscle control.

Every `WINDOW` the accelerations that bring the model back to the motion are

    q''* = q'' + KV (q' - q'_now) + KP (q - q_now)

and those forces of least stress, sum (F / F_max)^2, are found that give them at the window's end, among
those that excitations can reach by then, with tendons that stretch meanwhile; then the excitation that
reaches each. It is constant in the window and drives activations, fibers and bones through it in `SUBSTEPS`
steps: activations by the midpoint rule, fibers by backward Euler, speeds with inertias and loads of the
step's middle and the mean force of its ends, coordinates with the mean speed. Loads from outside are those
that were recorded. Reserves and motors of the model are optimised with the muscles, and what they do along
coordinates changes linearly in the window. What reserves give at the root is the residual.

Worlds are simulations of one motion with other strengths. A replay drives them by given excitations and
reserves, without a way back to the motion.

Where we differ from OpenSim's CMC: the moments of the window's end are those of the state that the wanted
accelerations lead to, steps are fixed, muscles begin in equilibrium at the least sum of squared activations,
and ranges of coordinates do not push back.

Source: Thelen, Anderson, Delp (2003), J Biomech 36:321, doi:10.1016/S0021-9290(02)00432-3; Thelen, Anderson
(2006), J Biomech 39:1107, doi:10.1016/j.jbiomech.2005.02.010.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from myowarp.motion.actuators import Actuators, actuators_of
from myowarp.motion.inverse_dynamics import Load, inverse_dynamics
from myowarp.motion.muscle_forces import muscle_forces
from myowarp.motion.smooth import spline
from myowarp.motion.static_optimization import optimal_activations
from myowarp.osim.body.activation import activation_dynamics
from myowarp.osim.body.hill_muscle import HillMuscle
from myowarp.osim.body.muscle_paths import MusclePaths, PathsOfMuscles
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.body.steady_muscles import SteadyMuscles

WINDOW = 0.01
"""Time over which an excitation is constant [s]."""

SUBSTEPS = 10
"""Of a window."""

KP, KP_LIGHT, LIGHT = 100.0, 1600.0, 0.01
"""Way back to the motion [1/s^2], and that of hinges with less inertia than the last number [kg m^2], which
small errors of muscle forces carry far: OpenSim's example has both, the second for the foot on its talus.
KV = 2 sqrt(KP) [1/s] damps critically."""

ROUNDS, MET = 20, 1e-3
"""Of the excitation that reaches a force, until it does so within the last number [N]."""

FAR = 1e3
"""Speed [rad/s, m/s] from which a simulation counts as lost."""


@dataclass(frozen=True, eq=False)
class Tracked:
    """A simulation that follows a motion; all of shape (times, worlds, ...).

    Attributes:
        time: Beginnings of windows, and the end [s], shape (times,).
        coordinates: Names of independent coordinates.
        muscles: Names.
        values: [rad] or [m].
        wanted: Those of the motion, shape (times, coordinates).
        excitation: Of the window that follows [1]; at the end that of the last one.
        activation: [1].
        fiber_length: [m].
        force: In the tendon [N].
        reserve: What reserves and motors give [N m] or [N]; linear in between.
    """

    time: np.ndarray
    coordinates: tuple[str, ...]
    muscles: tuple[str, ...]
    values: np.ndarray
    wanted: np.ndarray
    excitation: np.ndarray
    activation: np.ndarray
    fiber_length: np.ndarray
    force: np.ndarray
    reserve: np.ndarray

    def off(self) -> np.ndarray:
        """Return the root mean square of what is off [rad] or [m], shape (worlds, coordinates)."""
        return np.sqrt(np.mean((self.values - self.wanted[:, None]) ** 2, axis=0))


class Activation:
    """da/dt = (u - a) / tau, tau = up (0.5 + 1.5 a) while a rises, else down / (0.5 + 1.5 a)."""

    def __init__(self, muscles: Sequence[HillMuscle]) -> None:
        """Read the time constants; where a muscle has none, its activation is its excitation."""
        known = [activation_dynamics(muscle)[0] or (1e-9, 1e-9, 0.0) for muscle in muscles]
        self.up, self.down = np.array([(up, down) for up, down, _ in known]).T

    def step(self, activation: np.ndarray, excitation: np.ndarray, dt: float) -> np.ndarray:
        """Return activations after a step, with the rate in its middle."""
        after = activation
        for share in (0.5, 1.0):
            slow = 0.5 + 1.5 * after
            tau = np.where(excitation > activation, self.up * slow, self.down / slow)
            after = activation + (excitation - activation) * -np.expm1(-share * dt / tau)
        return after


def gains_of(bones: Bones, inertia: np.ndarray, gains: Mapping[str, float]) -> np.ndarray:
    """Return `KP` of each coordinate [1/s^2], of inertias [kg m^2, kg] and of what is stated.

    Raises:
        ValueError: A coordinate is unknown, or its gain is not above 0 and finite.
    """
    for name, gain in gains.items():
        if name not in bones.coordinates:
            raise ValueError(f"gain of {name!r}: unknown; available: {', '.join(bones.coordinates)}")
        if not 0.0 < gain < np.inf:
            raise ValueError(f"the gain of {name!r} must be above 0 and finite, got {gain:g}")
    turns = [bones.model.coordinates[name].rotational for name in bones.coordinates]
    usual = np.where(turns & (inertia < LIGHT), KP_LIGHT, KP)
    return np.array([gains.get(name, gain) for name, gain in zip(bones.coordinates, usual, strict=True)])


def controlled(bones: Bones, controls: Mapping[str, tuple[float, float]]) -> Bones:
    """Return a model whose muscles have other least and greatest excitations.

    Raises:
        ValueError: A muscle is unknown, or its excitations are not within 0 and 1.
    """
    muscles = dict(bones.model.muscles)
    for name, (low, high) in controls.items():
        if name not in muscles:
            raise ValueError(f"controls of {name!r}: unknown; available: {', '.join(muscles)}")
        if not 0.0 <= low <= high <= 1.0:
            raise ValueError(f"controls of {name!r} must be within 0 and 1, got {low:g} to {high:g}")
        muscles[name] = replace(muscles[name], control_range=(low, high))
    return Bones(replace(bones.model, muscles=muscles), bones.device)


def equations(
    bones: Bones, values: np.ndarray, speeds: np.ndarray, loads: Sequence[Load]
) -> tuple[np.ndarray, np.ndarray]:
    """Return M and c - sum J^T load - passive of M q'' + c = moments + sum J^T load + passive.

    Their shapes are (n, k, k) and (n, k); passive is what springs and ligaments of the model do.
    """
    count, free = values.shape
    still = np.zeros_like(values)
    bias = inverse_dynamics(bones, values, speeds, still, loads).joint_moment
    rows = np.repeat(values, free + 1, axis=0)
    unit = np.tile(np.eye(free + 1, free), (count, 1))
    moment = inverse_dynamics(bones, rows, np.zeros_like(rows), unit, passive=False).joint_moment
    moment = moment.reshape(count, free + 1, free)
    return moment[:, :free] - moment[:, free:], bias


class _Muscles:
    """Muscles of all worlds, as the optimisation and the simulation see them."""

    def __init__(self, bones: Bones, names: Sequence[str], strength: np.ndarray) -> None:
        self.steady = SteadyMuscles(
            [HillMuscle.of(bones.model.muscles[name]) for name in names], bones.device
        )
        self.strength = strength
        muscles = self.steady.muscles
        self.whole = strength * [m.values["max_isometric_force"] for m in muscles]
        self.activation = Activation(muscles)
        self.lower = np.array([max(m.values["min_control"], m.values.get("minimum_activation", 0.0), 0.0)
                               for m in muscles])  # fmt: skip
        self.upper = np.array([min(m.values["max_control"], 1.0) for m in muscles])
        self.width = np.array([m.fiber_width for m in muscles])

    def step(
        self, activation: np.ndarray, fiber: np.ndarray, length: np.ndarray, velocity: np.ndarray, dt: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return forces [N], fiber lengths [m] and slopes of forces [N s/m] after a step to path lengths."""
        force, along, slope = self.steady.at(activation, length, velocity, before=fiber, dt=dt)
        return self.strength * force, np.hypot(along, self.width), self.strength * slope


class _Simulations:
    """State of all worlds, and what moves it.

    Attributes:
        values: [rad] or [m], shape (worlds, coordinates).
        speeds: Their derivatives by time.
        activation: [1], shape (worlds, muscles).
        fiber: Lengths [m].
        force: In the tendon [N].
        mass: Of the beginning, shape (worlds, coordinates, coordinates).
        reserve: What reserves and motors give [N m] or [N]; at first what holds the beginning.
    """

    def __init__(
        self, bones: Bones, muscles: _Muscles, loads: Sequence[Load], values: np.ndarray, speeds: np.ndarray,
        acceleration: np.ndarray, cost: np.ndarray, begin: float,
    ) -> None:  # fmt: skip
        """Begin on the motion, muscles in equilibrium at its moments; loads are those of all half steps."""
        worlds = len(muscles.strength)
        self.bones, self.muscles, self._loads, self._cost, self._begin = bones, muscles, loads, cost, begin
        self.values, self.speeds = (np.tile(array, (worlds, 1)) for array in (values, speeds))
        self._followed = PathsOfMuscles(bones, worlds)
        self._paths = paths = self._followed.along(self.values, self.speeds)
        self.mass, bias = equations(bones, self.values, self.speeds, self._acting(0))
        needed = np.einsum("njk,k->nj", self.mass, acceleration) + bias
        first = muscle_forces(
            bones.model, bones.coordinates, paths, needed,
            reserves=dict(zip(bones.coordinates, cost, strict=True)),
            actuators=actuators_of(bones, self.values), strength=muscles.strength, device=bones.device,
        )  # fmt: skip
        self.activation = np.clip(first.activation, muscles.lower, muscles.upper)
        force, along, _ = muscles.steady.at(self.activation, paths.length, paths.velocity)
        self.force, self.fiber = muscles.strength * force, np.hypot(along, muscles.width)
        self.reserve = first.reserve

    def _acting(self, step: int) -> list[Load]:
        """Return the loads after a number of half steps, for all worlds."""
        rows = [step] * len(self.muscles.strength)
        return [Load(x.body, x.force[rows], x.point[rows], x.torque[rows], x.force_frame, x.point_frame)
                for x in self._loads]  # fmt: skip

    def controls(self, window: int, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return excitations and what else gives, for these accelerations at the end of a window."""
        q, u = self.values, self.speeds
        q_end, u_end = q + WINDOW * (u + 0.5 * WINDOW * wanted), u + WINDOW * wanted
        mass, bias = equations(self.bones, q_end, u_end, self._acting(2 * (window + 1) * SUBSTEPS))
        needed = np.einsum("njk,nk->nj", mass, wanted) + bias
        times = WINDOW / SUBSTEPS * np.arange(1, SUBSTEPS + 1)
        ahead = [self._followed.along(q + t * (u + 0.5 * t * wanted), u + t * wanted) for t in times]
        state = self.activation, self.fiber
        return _controls(self.muscles, ahead, needed, *state, self._cost, actuators_of(self.bones, q_end))

    def advance(self, window: int, excitation: np.ndarray, reserve: np.ndarray) -> None:
        """Simulate a window, at whose end reserves and motors give as much.

        Raises:
            ValueError: A simulation is lost.
        """
        dt, before = WINDOW / SUBSTEPS, self.reserve
        for step in range(SUBSTEPS):
            q, u = self.values, self.speeds
            given = before + (step + 0.5) / SUBSTEPS * (reserve - before)
            self.activation = self.muscles.activation.step(self.activation, excitation, dt)
            pull = np.einsum("nmk,nm->nk", self._paths.moment_arm, self.force)
            paths = self._followed.along(q + dt * u, u)
            self.force, self.fiber, slope = self.muscles.step(
                self.activation, self.fiber, paths.length, paths.velocity, dt
            )
            middle = q + 0.5 * dt * u
            mass, bias = equations(self.bones, middle, u, self._acting(2 * (window * SUBSTEPS + step) + 1))
            pull = 0.5 * (pull + np.einsum("nmk,nm->nk", paths.moment_arm, self.force))
            moment = pull + given - bias
            stiff = mass + 0.5 * dt * np.einsum("nmj,nm,nmk->njk", paths.moment_arm, slope, paths.moment_arm)
            self.speeds = u + dt * np.linalg.solve(stiff, moment[:, :, None])[:, :, 0]
            if not (np.abs(self.speeds) < FAR).all():
                lost = int(np.argmax(~(np.abs(self.speeds) < FAR).all(axis=1)))
                raise ValueError(
                    f"simulation {lost} is lost at {self._begin + WINDOW * window:.3f} s; give reserves more "
                    "force, or smooth the motion"
                )
            self.values = q + 0.5 * dt * (u + self.speeds)
            self._paths = self._followed.along(self.values, self.speeds)
        self.reserve = reserve


def track(
    bones: Bones,
    time: np.ndarray,
    values: np.ndarray,
    loads: Callable[[np.ndarray], Sequence[Load]] = lambda times: (),
    *,
    reserves: Mapping[str, float],
    strength: np.ndarray | None = None,
    gains: Mapping[str, float] | None = None,
    controls: Mapping[str, tuple[float, float]] | None = None,
    span: tuple[float, float] | None = None,
    replay: Tracked | None = None,
    advance: Callable[[int], None] = lambda count: None,
) -> Tracked:
    """Simulate a motion.

    Args:
        bones: The model.
        time: Of the motion [s], shape (frames,).
        values: Of its independent coordinates [rad] or [m], smoothed, shape (frames, coordinates).
        loads: Returns loads from outside at some times.
        reserves: By coordinate, the force of a reserve at cost 1 [N m] or [N]; all coordinates need one.
        strength: Factors on maximum isometric forces, shape (worlds, muscles); None: one world as it is.
        gains: `KP` of coordinates that have another one [1/s^2].
        controls: Least and greatest excitation, by muscle, where they are not the model's [1].
        span: First and last time; by default all.
        replay: A simulation whose excitations and reserves drive this one.
        advance: Is told how many windows are done.

    Raises:
        ValueError: A coordinate has no reserve, a gain is on none or not above 0, controls are on no muscle
            or not within 0 and 1, the span is not in the motion, or a simulation is lost.
    """
    if controls:
        bones = controlled(bones, controls)
    coordinates = bones.coordinates
    if missing := [name for name in coordinates if not reserves.get(name, 0.0) > 0.0]:
        raise ValueError(
            f"tracking needs a reserve on every coordinate, such as --reserve 1; {missing[0]!r} has none"
        )
    names = tuple(name for name, muscle in bones.model.muscles.items() if muscle.applies_force)
    factors = np.ones((1, len(names))) if strength is None else np.atleast_2d(strength)
    muscles = _Muscles(bones, names, factors)
    begin, end = span or (float(time[0]), float(time[-1]))
    if not time[0] - 1e-9 <= begin < end <= time[-1] + 1e-9:
        raise ValueError(
            f"the span must lie within {time[0]:g} to {time[-1]:g} s, got {begin:g} to {end:g} s"
        )
    windows = max(1, round((end - begin) / WINDOW))
    times = begin + WINDOW * np.arange(windows + 1)
    curve = spline(time, values)
    q_there, u_there, a_there = (curve(np.minimum(times, time[-1]), order) for order in range(3))
    half = 0.5 * WINDOW / SUBSTEPS
    external = loads(np.minimum(begin + half * np.arange(2 * windows * SUBSTEPS + 1), time[-1]))
    cost = np.array([reserves[name] for name in coordinates])
    worlds = _Simulations(bones, muscles, external, q_there[0], u_there[0], a_there[0], cost, begin)
    back = gains_of(bones, worlds.mass[0].diagonal(), gains or {})
    seen: dict[str, list[np.ndarray]] = {name: [] for name in ("values", "excitation", "activation",
                                         "fiber_length", "force", "reserve")}  # fmt: skip
    excitation = worlds.activation
    if replay is not None:
        worlds.reserve = np.broadcast_to(replay.reserve[0], worlds.reserve.shape)

    def note() -> None:
        """Keep what the worlds are, and are driven by."""
        now = worlds.values, excitation, worlds.activation, worlds.fiber, worlds.force, worlds.reserve
        for rows, array in zip(seen.values(), now, strict=True):
            rows.append(array)

    for window in range(windows):
        if replay is None:
            off, slower = q_there[window] - worlds.values, u_there[window] - worlds.speeds
            wanted = a_there[window + 1] + 2.0 * np.sqrt(back) * slower + back * off
            excitation, reserve = worlds.controls(window, wanted)
        else:
            excitation = np.broadcast_to(replay.excitation[window], excitation.shape)
            reserve = np.broadcast_to(replay.reserve[window + 1], worlds.reserve.shape)
        note()
        worlds.advance(window, excitation, reserve)
        advance(1)
    note()
    arrays = {name: np.stack(rows) for name, rows in seen.items()}
    return Tracked(times, coordinates, names, wanted=q_there, **arrays)


def _controls(
    body: _Muscles,
    paths: Sequence[MusclePaths],
    needed: np.ndarray,
    activation: np.ndarray,
    fiber: np.ndarray,
    cost: np.ndarray,
    motors: Actuators | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return excitations and what reserves and motors give, so that moments are met at the end of a window.

    `paths` are those of its steps, with the wanted accelerations.
    """

    def ahead(excitation: np.ndarray) -> np.ndarray:
        """Return forces at the end of the window."""
        a, length, force, dt = activation, fiber, fiber, WINDOW / SUBSTEPS
        for path in paths:
            a = body.activation.step(a, excitation, dt)
            force, length, _ = body.step(a, length, path.length, path.velocity, dt)
        return force

    (worlds, count), free = activation.shape, needed.shape[1]
    low, high = (np.broadcast_to(bound, activation.shape) for bound in (body.lower, body.upper))
    weak, strong = ahead(low), ahead(high)
    whole = np.where(body.whole > 0.0, body.whole, 1.0)
    each, crossed = paths[-1].moment_arm * whole[:, :, None], paths[-1].crossed
    least, most = np.empty((2, worlds, 0))
    if motors is not None:
        each, crossed = np.concatenate([each, motors.effect], axis=1), (*crossed, *motors.crossed)
        least, most = (np.broadcast_to(x, (worlds, len(x))) for x in (motors.lower, motors.upper))
    driven = len(crossed)
    rows = np.full((driven + free, max([1, *map(len, crossed)])), -1)
    effects = np.zeros((worlds, *rows.shape))
    for k, own in enumerate(crossed):
        rows[k, : len(own)] = own
        effects[:, k, : len(own)] = each[:, k, list(own)]
    rows[driven:, 0] = np.arange(free)
    effects[:, driven:, 0] = cost
    endless = np.full((worlds, free), np.inf)
    lower = np.concatenate([np.minimum(weak, strong) / whole, least, -endless], axis=1)
    upper = np.concatenate([np.maximum(weak, strong) / whole, most, endless], axis=1)
    found = optimal_activations(rows, effects, needed, lower, upper)
    target = found.activation[:, :count] * whole
    excitation = illinois_root(lambda e: ahead(e) - target, low, high, weak - target, strong - target)
    # Light bodies feel what the solver's softness leaves; a reserve has no bound.
    given = found.activation[:, driven:] * cost + found.missing
    if motors is not None:
        given += np.einsum("nm,nmk->nk", found.activation[:, count:driven], motors.effect)
    return excitation, given


def illinois_root(
    off: Callable[[np.ndarray], np.ndarray], low: np.ndarray, high: np.ndarray, below: np.ndarray,
    above: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return where a rising function of each muscle is 0, by the Illinois method; an end if it is nowhere.

    Args:
        off: Of excitations.
        low: Least excitations.
        high: Greatest ones.
        below: The function at the least ones [N].
        above: The function at the greatest ones [N].
    """
    a, fa, b, fb = low, below, high, above
    best, least = np.where(fa >= 0.0, a, b), np.where((fa >= 0.0) | (fb <= 0.0), 0.0, np.inf)
    side = np.zeros(a.shape, int)
    for _ in range(ROUNDS):
        if (least <= MET).all():
            break
        middle = np.where(fb > fa, (a * fb - b * fa) / np.where(fb > fa, fb - fa, 1.0), best)
        f = np.where(least > 0.0, off(np.where(least > 0.0, middle, best)), 0.0)
        nearer = np.abs(f) < least
        best, least = np.where(nearer, middle, best), np.where(nearer, np.abs(f), least)
        under = f < 0.0
        fb = np.where(under, np.where(side < 0, 0.5 * fb, fb), f)
        fa = np.where(under, f, np.where(side > 0, 0.5 * fa, fa))
        a, b, side = np.where(under, middle, a), np.where(under, b, middle), np.where(under, -1, 1)
    return best

"""Muscle forces of a motion: what each muscle can give in a frame, and what it gives at the least cost.

In mode `opensim` a muscle has a rigid tendon and no passive force, as OpenSim's StaticOptimization takes it:
F = a Fmax f_L f_V, for some classes times the cosine of the pennation angle (`ALONG_TENDON`). In mode
`equilibrium` fiber and tendon are in equilibrium at the velocity of the path, with passive force. F(a) is no
straight line then: a muscle that shortens fast has no force up to an activation well above 0. So a few rounds
follow, each with the chord of F from the least activation to that which gives the force of the round before.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from myowarp.motion.actuators import Actuators
from myowarp.motion.static_optimization import Activations, optimal_activations
from myowarp.osim.body.hill_muscle import HillMuscle, known
from myowarp.osim.body.muscle_paths import MusclePaths
from myowarp.osim.body.parts import GRAIN, in_parts
from myowarp.osim.body.steady_muscles import SteadyMuscles
from myowarp.osim.document.model import Model

Mode = Literal["equilibrium", "opensim"]

ALONG_TENDON = ("Thelen2003Muscle", "Millard2012AccelerationMuscle")
"""Classes whose `calcInextensibleTendonActiveFiberForce` is that along the tendon; OpenSim 4.6 leaves the
cosine out of Millard2012EquilibriumMuscle's and DeGrooteFregly2016Muscle's."""

ROUNDS = 6
"""Of chords in mode `equilibrium`."""

NARROW = 1e-9
"""Distance of two activations that is not divided by."""

FEASIBLE = 1e-5
"""Share of the greatest moment of a coordinate up to which it counts as met."""

SOLVED = 1e-3
"""Distance from the least cost, in units of the rows, from which a frame counts as unsolved; less is said as
what is missing."""

MOST_RESERVE = 1e6
"""N m or N at cost 1; the solver's tolerance is a share of it, beyond which moments would be lost."""

FRAMES = 4096
"""Frames that are solved together."""

SATURATED = 0.999
"""Share of the way to its upper bound from which a muscle counts as saturated."""


@dataclass(frozen=True, eq=False)
class MuscleForces:
    """Muscle forces of a motion.

    Attributes:
        muscles: Names.
        coordinates: Names of independent coordinates.
        activation: Shape (frames, muscles).
        force: In the tendon [N].
        passive: Share of it that is there without activation [N].
        fiber_length: Of fibers [m].
        steady: Whether fiber and tendon are in equilibrium, as in mode `equilibrium`.
        power: That muscles give to the skeleton [W], shortening > 0.
        motors: Names of motors.
        control: Of motors [1], shape (frames, motors).
        reserve: What reserves and motors give [N m] or [N], shape (frames, coordinates); 0 without.
        missing: What nobody gives, likewise.
        feasible: Frames in which nothing is missing at coordinates without a reserve.
        saturated: Frames in which each muscle is at its upper bound, by name, those of no frame left out.
    """

    muscles: tuple[str, ...]
    coordinates: tuple[str, ...]
    activation: np.ndarray
    force: np.ndarray
    passive: np.ndarray
    fiber_length: np.ndarray
    steady: bool
    power: np.ndarray
    motors: tuple[str, ...]
    control: np.ndarray
    reserve: np.ndarray
    missing: np.ndarray
    feasible: np.ndarray
    saturated: Mapping[str, int]


def rigid_capacity(
    muscle: HillMuscle, length: np.ndarray, velocity: np.ndarray, slack: np.ndarray | float = 1.0
) -> np.ndarray:
    """Return the active force with a rigid tendon at activation 1 [N], as OpenSim's static optimisation.

    Args:
        muscle: The muscle.
        length: Of muscle and tendon [m].
        velocity: Its velocity [m/s], lengthening > 0.
        slack: Factor on the tendon slack length.
    """
    v = muscle.values
    z = length - slack * v["tendon_slack_length"]
    held = np.maximum(z, muscle.shortest_fiber)
    fiber = np.sqrt(held**2 + muscle.fiber_width**2)
    cosine = held / np.maximum(fiber, 1e-15)
    active, _ = muscle.curves.active_force_length(fiber / v["optimal_fiber_length"])
    factor, _ = muscle.curves.force_velocity(
        velocity * cosine / muscle.velocity_scale, np.ones_like(velocity)
    )
    force = v["max_isometric_force"] * active * factor * (cosine if muscle.kind in ALONG_TENDON else 1.0)
    return np.where(z > muscle.shortest_fiber, np.maximum(force, 0.0), 0.0)


def muscle_forces(
    model: Model,
    coordinates: tuple[str, ...],
    paths: MusclePaths,
    joint_moment: np.ndarray,
    *,
    mode: Mode = "equilibrium",
    exponent: float = 2.0,
    reserves: Mapping[str, float] | None = None,
    actuators: Actuators | None = None,
    strength: np.ndarray | float = 1.0,
    slack: np.ndarray | float = 1.0,
    device: Any = "cpu",
    sequence: int = 0,
) -> MuscleForces:
    """Return the muscle forces of least cost that give the moments of a motion.

    Coordinates that no muscle, motor or reserve acts on are left out; what they need is missing, as the
    residuals of the root are.

    Args:
        model: The model.
        coordinates: Names of its independent coordinates.
        paths: Of its muscles in all frames.
        joint_moment: Wanted [N m] or [N], shape (frames, coordinates).
        mode: What a muscle can give, see the module.
        exponent: p of the cost sum |a|^p, which counts reserves with their force over `reserves`.
        reserves: By coordinate, the force of a reserve at cost 1 [N m] or [N].
        actuators: Motors of the model, whose controls cost as activations do; None: they rest.
        strength: Factors on maximum isometric forces, which broadcast to (frames, muscles).
        slack: Factors on tendon slack lengths, likewise.
        device: Where it is solved.
        sequence: Frames of a recording, where several follow each other, see `optimal_activations`.

    Raises:
        ValueError: A coordinate is unknown, an option is out of bounds, or a frame is not solved.
    """
    if mode not in ("equilibrium", "opensim"):
        raise ValueError(f"mode must be equilibrium or opensim, got {mode!r}")
    reserves = dict(reserves or {})
    if unknown := set(reserves) - set(coordinates):
        raise ValueError(f"reserve on {sorted(unknown)[0]!r}: unknown; available: {', '.join(coordinates)}")
    for name, force in reserves.items():
        if not 0.0 < force <= MOST_RESERVE:
            raise ValueError(
                f"the force of a reserve must be above 0 and at most {MOST_RESERVE:g} N m or N, got "
                f"{force:g} on {name!r}"
            )
    muscles = [known(HillMuscle.of(model.muscles[name]))[0] for name in paths.muscles]
    share = _Share.of(muscles, coordinates, paths, reserves, actuators, exponent, device, sequence)
    steady = SteadyMuscles(muscles, device) if mode == "equilibrium" else None
    wanted = np.maximum(np.abs(joint_moment).max(axis=0, initial=0.0), 1.0)
    factors = strength, slack

    def solve(part: slice) -> MuscleForces:
        strong, long = (x[part] if len(x) > 1 else x for x in map(np.atleast_2d, factors))
        given = paths.part(part), joint_moment[part], strong, long
        own = share if actuators is None else replace(share, motor=actuators.effect[part])
        found = own.rigid(*given) if steady is None else own.settled(steady, *given)
        if far := int((found[0].residual > SOLVED).sum()):
            raise ValueError(
                f"no least cost was found in {far} of {len(found[0].residual)} frames with an exponent of "
                f"{exponent:g}; take one nearer to 2, or change the reserves"
            )
        return _made_of(own, given[0], given[1], wanted, mode, found)

    grain = sequence or GRAIN
    return _together(in_parts(len(joint_moment), FRAMES, solve, grain))


def _together(parts: list[MuscleForces]) -> MuscleForces:
    """Return the forces of parts of a motion as those of all of it."""
    if len(parts) == 1:
        return parts[0]
    arrays: dict[str, Any] = {
        one.name: np.concatenate([getattr(part, one.name) for part in parts])
        for one in fields(MuscleForces)
        if isinstance(getattr(parts[0], one.name), np.ndarray)
    }
    counts: Counter[str] = sum((Counter(part.saturated) for part in parts), Counter())
    order = {name: counts[name] for name in parts[0].muscles if name in counts}
    return replace(parts[0], saturated=order, **arrays)


Solved = tuple[Activations, np.ndarray, np.ndarray, np.ndarray]
"""Activations, force [N], its passive share [N], and length of fibers along the tendon [m]."""


@dataclass(frozen=True, eq=False)
class _Share:
    """Shares of muscles, and of motors and reserves behind them, in the moments of a motion.

    Attributes:
        muscles: Their parameters.
        coordinates: Names.
        motors: Names of motors.
        motor: What each does at control 1 [N m] or [N], shape (frames, motors, coordinates).
        held: Coordinates that any of them acts on.
        helped: Coordinates with a reserve.
        reserve: Its force [N m] or [N].
        rows: For each of them the numbers of these in `held`, -1 behind them.
        entries: Where their moment arms are in those of a frame; -1: a reserve has none.
        lower: Least activations.
        upper: Greatest.
        exponent: p.
        device: Where it is solved.
        sequence: Frames of a recording.
    """

    muscles: list[HillMuscle]
    coordinates: tuple[str, ...]
    motors: tuple[str, ...]
    motor: np.ndarray
    held: list[int]
    helped: list[int]
    reserve: np.ndarray
    rows: np.ndarray
    entries: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    exponent: float
    device: Any
    sequence: int

    @classmethod
    def of(
        cls, muscles: list[HillMuscle], coordinates: tuple[str, ...], paths: MusclePaths,
        reserves: Mapping[str, float], actuators: Actuators | None, exponent: float, device: Any,
        sequence: int,
    ) -> _Share:  # fmt: skip
        """Return who shares which moments."""
        motors = () if actuators is None else actuators.names
        motor = np.zeros((1, 0, len(coordinates))) if actuators is None else actuators.effect
        crossed = (*paths.crossed, *(() if actuators is None else actuators.crossed))
        count, helped = len(crossed), [coordinates.index(name) for name in reserves]
        held = sorted({row for rows in crossed for row in rows} | set(helped))
        rows = np.full((count + len(helped), max([len(own) for own in crossed] + [1])), -1)
        entries = rows.copy()
        for number, own in enumerate(crossed):
            rows[number, : len(own)] = [held.index(row) for row in own]
            entries[number, : len(own)] = number * len(coordinates) + np.array(own, int)
        rows[count:, 0] = [held.index(row) for row in helped]
        bounds = [(max(m.values["min_control"], 0.0), min(m.values["max_control"], 1.0)) for m in muscles]
        bounds += [] if actuators is None else zip(actuators.lower, actuators.upper, strict=True)
        lower, upper = np.array([*bounds, *[(-np.inf, np.inf)] * len(helped)], float).reshape(-1, 2).T
        force = np.array(list(reserves.values()))
        return cls(
            muscles, coordinates, motors, motor, held, helped, force, rows, entries, lower, upper, exponent,
            device, sequence,
        )  # fmt: skip

    def solve(
        self, paths: MusclePaths, moment: np.ndarray, capacity: np.ndarray, near: np.ndarray | None = None
    ) -> Activations:
        """Return the activations that give moments, with muscles that have these forces at activation 1."""
        behind = np.concatenate([np.ones(len(self.motors)), self.reserve])
        scale = np.concatenate([capacity, np.broadcast_to(behind, (len(capacity), len(behind)))], axis=1)
        effects = paths.moment_arm
        if self.motors:
            effects = np.concatenate([effects, self.motor], axis=1)
        return optimal_activations(
            self.rows, effects, moment[:, self.held], self.lower, self.upper, self.exponent,
            self.device, near, self.sequence, scale, self.entries,
        )  # fmt: skip

    def rigid(
        self, paths: MusclePaths, moment: np.ndarray, strength: np.ndarray, slack: np.ndarray
    ) -> Solved:
        """Solve with rigid tendons and without passive force."""
        muscles = self.muscles
        longer = np.broadcast_to(slack, paths.length.shape)
        slacks = np.array([muscle.values["tendon_slack_length"] for muscle in muscles])
        shortest = np.array([muscle.shortest_fiber for muscle in muscles])
        along = np.maximum(paths.length - longer * slacks, shortest)
        capacity = np.empty_like(paths.length)
        for i, muscle in enumerate(muscles):
            capacity[:, i] = rigid_capacity(muscle, paths.length[:, i], paths.velocity[:, i], longer[:, i])
        capacity *= strength
        found = self.solve(paths, moment, capacity)
        force = capacity * found.activation[:, : len(muscles)]
        return found, force, np.zeros_like(capacity), along

    def settled(
        self,
        steady: SteadyMuscles,
        paths: MusclePaths,
        moment: np.ndarray,
        strength: np.ndarray,
        slack: np.ndarray,
    ) -> Solved:
        """Solve with fibers and tendons in equilibrium, by chords."""

        def at(activation: ArrayLike, near: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
            force, along, _ = steady.at(activation, paths.length, paths.velocity, slack, near)
            return strength * force, along

        count = len(self.muscles)
        low, high = (np.broadcast_to(a[:count], paths.length.shape) for a in (self.lower, self.upper))
        passive, _ = at(0.0)
        least, _ = at(low) if low.any() else (passive, passive)
        most, along = at(high)
        tried, forces = [low, high], [least, most]  # activations, and what they give

        def on_chords(
            slope: np.ndarray, near: np.ndarray | None = None
        ) -> tuple[Activations, np.ndarray, np.ndarray]:
            """Return the solution, its activations of muscles and their forces."""
            rest = moment - np.einsum("nmk,nm->nk", paths.moment_arm, least - slope * low)
            found = self.solve(paths, rest, slope, near)
            activation = found.activation[:, :count]
            return found, activation, least + slope * (activation - low)

        slope = (most - least) / np.maximum(high - low, NARROW)
        found, activation, wanted = on_chords(slope)
        for _ in range(ROUNDS - 1):
            force, along = at(activation, along)
            tried, forces = [*tried, activation], [*forces, force]
            needed = between(np.array(forces), np.array(tried), wanted)
            chord = (wanted - least) / np.maximum(needed - low, NARROW)
            slope = np.where(activation > low, chord, slope)
            found, activation, wanted = on_chords(slope, found.dual)
        return found, wanted, passive, along


def between(x: np.ndarray, y: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return y where x is wanted, on the line between the nearest points, of which a first axis has several.

    y grows with x; where x has a value several times, the last of them counts. Beyond the greatest x y ends.
    """
    below, above = x <= wanted, x > wanted
    x0, y0 = (np.where(below, values, -np.inf).max(axis=0) for values in (x, y))
    x1, y1 = (np.where(above, values, np.inf).min(axis=0) for values in (x, y))
    last = ~above.any(axis=0)
    share = (wanted - x0) / np.where(last, 1.0, x1 - x0)
    return np.where(last, y0, y0 + share * (np.where(last, y0, y1) - y0))


def _made_of(
    share: _Share,
    paths: MusclePaths,
    joint_moment: np.ndarray,
    wanted: np.ndarray,
    mode: Mode,
    solved: Solved,
) -> MuscleForces:
    """Return the forces of a solution; `wanted` are the greatest moments of all of the motion."""
    (found, force, passive, along), count = solved, len(share.muscles)
    activation = found.activation[:, :count]
    widths = np.array([muscle.fiber_width for muscle in share.muscles])
    missing = joint_moment.copy()
    missing[:, share.held] = found.missing
    control = found.activation[:, count : count + len(share.motors)]
    reserve = np.zeros_like(joint_moment)
    reserve[:, share.helped] = found.activation[:, count + len(share.motors) :] * share.reserve
    if share.motors:
        reserve += np.einsum("nm,nmk->nk", control, share.motor)
    lower, upper = share.lower[:count], share.upper[:count]
    full = activation >= lower + SATURATED * (upper - lower)
    counts = {name: int(n) for name, n in zip(paths.muscles, full.sum(axis=0), strict=True) if n}
    # A reserve has no bound: what is missing beside one is the softness of the solver, not a lack of force.
    alone = np.array([row not in share.helped for row in share.held], bool)
    feasible = (np.abs(found.missing) <= FEASIBLE * wanted[share.held])[:, alone].all(axis=1)
    return MuscleForces(
        paths.muscles, share.coordinates, activation, force, passive, np.sqrt(along**2 + widths**2),
        mode == "equilibrium", -force * paths.velocity, share.motors, control, reserve, missing, feasible,
        counts,
    )  # fmt: skip

"""Verdict on a converted model: joint torques of all muscles and lengths of paths, three ways.

These are OpenSim's own paths in MyoWarp with the file's muscles (`own`), the fitted tendons with the file's
muscles (`tendon`), and the fitted tendons with MuJoCo's muscles (`plain`). The judge of torques is
`computeMomentArm`, which OpenSim's forces follow. Poses in which a path of OpenSim itself jumps are counted
and left out: there the guard refuses a wrap, or OpenSim has no length.
"""

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from myowarp.laws.paths.tables import TURNS
from myowarp.osim.body.hill_muscle import ACTIVATIONS, HillMuscle, known
from myowarp.osim.body.path_solution import PathsFound, lengths_and_moment_arms
from myowarp.osim.convert.check.gates import Gate
from myowarp.osim.convert.check.muscles import Motion, engine_force
from myowarp.osim.convert.compose.convert import Converted
from myowarp.osim.convert.tendon.fits import Samples
from myowarp.osim.convert.tendon.fitted import Fits, MuscleFit

Array = np.ndarray

FAR = 2e-3
"""[m] of length beyond which a pose counts."""
STRONG = 0.05
"""[max_isometric_force] of static force, at any activation, beyond which a pose counts."""
OFTEN = 0.1
"""Share of poses beyond `FAR` or `STRONG` from which on a muscle is not to be trusted."""
MEAN_TORQUE, TORQUE = 0.1, 0.5
"""[%]: of joint torques with OpenSim's paths, mean over coordinates and worst coordinate."""
DETOUR = (0.02, 0.1)
"""[m] and share of OpenSim's length by which a tendon is longer that takes the far side of a surface."""
BENT, UNBENT = 5e-3, 1e-3
"""[m] by which a path is longer than the straight line through its points where it goes round a surface, and
by which it differs from that line where it does not."""
FAR_SIDE, NEVER = 1.0, 10.0
"""[%] of poses, worst muscle: on the far side of a surface, and straight where OpenSim's path is not."""
GOOD = 5.0
"""[%]: torque of the worst coordinate up to which fitted tendons are said to be good for motion."""


@dataclass(frozen=True)
class PathOff:
    """Errors of a path over the poses in which OpenSim does not jump.

    Attributes:
        median: Of the length [m].
        worst: Of the length [m].
        far: Share of poses with a length beyond `FAR`.
        strong: Share of poses with a static force of the file's muscle beyond `STRONG`.
    """

    median: float
    worst: float
    far: float
    strong: float

    @classmethod
    def of(cls, length: Array, force: Array) -> "PathOff":
        """Return the errors of lengths (n,) and forces (n, activations)."""
        if not length.size:
            return cls(np.nan, np.nan, np.nan, np.nan)
        size = np.nan_to_num(np.abs(length), nan=np.inf)
        strong = ~(np.abs(force) <= STRONG).all(axis=1)
        return cls(
            float(np.median(size)), float(size.max()), float((size > FAR).mean()), float(strong.mean())
        )


@dataclass(frozen=True)
class MuscleJudged:
    """A muscle.

    Attributes:
        muscle: Name.
        own: OpenSim's path as MyoWarp runs it.
        tendon: The fitted tendon.
        far_side: Share of poses in which the fitted tendon goes round the far side of a surface (`DETOUR`).
        unbent: Share of poses in which it runs straight, and OpenSim's path goes round a surface.
        jumps: Poses in which OpenSim's path jumps, or has no length.
    """

    muscle: str
    own: PathOff
    tendon: PathOff
    far_side: float
    unbent: float
    jumps: int


@dataclass(frozen=True)
class TorqueOff:
    """Error of a joint torque: root mean square and greatest, as shares of the reference's."""

    rms: float
    worst: float


@dataclass(frozen=True)
class TorqueJudged:
    """Static torque of all muscles about a coordinate, at five activations.

    Attributes:
        coordinate: Name.
        own: OpenSim's paths and the file's muscles.
        tendon: Fitted tendons and the file's muscles.
        plain: Fitted tendons and MuJoCo's muscles.
        greatest: Of the reference [N m] or [N].
        poses: In which no path about it jumps.
    """

    coordinate: str
    own: TorqueOff
    tendon: TorqueOff
    plain: TorqueOff
    greatest: float
    poses: int


@dataclass(frozen=True)
class Judgement:
    """The result of the judge."""

    muscles: list[MuscleJudged]
    torques: list[TorqueJudged]

    def gates(self) -> list[Gate]:
        """Return the gates of torques with OpenSim's paths, and of what no fit of tendons mends."""
        if not self.torques:
            return []
        far, straight = (max(self.muscles, key=key) for key in (_far_side, _unbent))
        worst = max(self.torques, key=lambda torque: torque.own.rms)
        mean = float(np.mean([torque.own.rms for torque in self.torques]))
        name = "joint torque, OpenSim's paths"
        return [
            Gate(f"{name}, mean of coordinates", 100 * mean, MEAN_TORQUE, "%"),
            Gate(f"{name}, worst coordinate", 100 * worst.own.rms, TORQUE, "%", worst.coordinate),
            Gate("poses on the far side of a surface", 100 * far.far_side, FAR_SIDE, "%", far.muscle),
            Gate("poses straight, not round a surface", 100 * straight.unbent, NEVER, "%", straight.muscle),
        ]

    def verdict(self) -> list[str]:
        """Return what the model is good for, and what not to trust, in sentences."""
        said = []
        if self.torques:
            for way, title in (
                ("own", "MyoWarp, with OpenSim's paths and the file's muscles"),
                ("plain", "Plain MuJoCo, with fitted tendons and MuJoCo's muscles"),
            ):
                rms = {torque.coordinate: getattr(torque, way).rms for torque in self.torques}
                worst = max(rms, key=lambda name: rms[name])
                mean, most = 100 * float(np.mean(list(rms.values()))), 100 * rms[worst]
                use = "Good for forward simulation and inverse problems" if most <= TORQUE else ""
                use = use or ("Good for motion" if most <= GOOD else "Do not trust joint torques")
                where = f" ({worst})" if most > TORQUE else ""
                said.append(
                    f"{title}: joint torques are {mean:.2g} % off, at worst {most:.2g} %{where}. {use}."
                )
        poor = [one for one in self.muscles if max(one.tendon.far, one.tendon.strong) > OFTEN]
        poor.sort(key=lambda one: -max(one.tendon.far, one.tendon.strong))
        if poor:
            names = ", ".join(
                f"{one.muscle} ({100 * max(one.tendon.far, one.tendon.strong):.0f} %)" for one in poor
            )
            said.append(
                f"In plain MuJoCo do not trust {names}: in that share of poses they are {1e3 * FAR:g} mm or "
                f"{100 * STRONG:g} % of the maximum isometric force off."
            )
        for share, most, what in (
            (_far_side, FAR_SIDE, "go round the far side of a surface"),
            (_unbent, NEVER, "run straight where OpenSim's paths go round a surface"),
        ):
            if lost := [one for one in self.muscles if 100 * share(one) > most]:
                names = ", ".join(f"{one.muscle} ({100 * share(one):.0f} %)" for one in lost)
                said.append(f"Fitted tendons {what}, in that share of poses: {names}.")
        if jumping := [one for one in self.muscles if one.jumps]:
            names = ", ".join(f"{one.muscle} ({one.jumps})" for one in jumping)
            said.append(f"OpenSim's own path jumps in some poses, left out here: {names}.")
        return said


def off_surfaces(own: Array, chain: Array, tendon: Array) -> tuple[float, float]:
    """Return the shares of poses on the far side of a surface, and straight where OpenSim's path is not.

    Args:
        own: Lengths of OpenSim's path [m], shape (n,).
        chain: Of the straight line through its points.
        tendon: Of the fitted tendon.
    """
    if not own.size:
        return 0.0, 0.0
    detour = tendon - own > np.maximum(DETOUR[0], DETOUR[1] * own)
    unbent = (own - chain > BENT) & (np.abs(tendon - chain) < UNBENT)
    return float(detour.mean()), float(unbent.mean())


def _far_side(one: MuscleJudged) -> float:
    return one.far_side


def _unbent(one: MuscleJudged) -> float:
    return one.unbent


def judge(
    converted: Converted, model: mujoco.MjModel, fits: Fits, samples: Samples, found: Motion
) -> Judgement:
    """Judge a conversion in the random poses of the check; `found` are its tendons in these."""
    if not fits.muscles:
        return Judgement([], [])
    source = converted.model
    free = source.independent
    values = {name: samples.check.coordinates[name] for name in free}
    paths = {fit.name: source.muscles[fit.name].path for fit in fits.muscles}
    still = np.zeros((len(found.length), len(free)))
    own = lengths_and_moment_arms(source, paths, values, still, TURNS)
    straight = {name: replace(path, wraps=()) for name, path in paths.items()}
    chain = lengths_and_moment_arms(source, straight, values, still).length
    muscles: list[MuscleJudged] = []
    laws: dict[str, HillMuscle] = {}
    calm = np.ones((len(fits.muscles), len(found.length)), bool)
    for number, fit in enumerate(fits.muscles):
        law = laws[fit.name] = known(HillMuscle.of(source.muscles[fit.name]))[0]
        reference, tendon = fit.expected.random, found.length[:, model.tendon(fit.name).id]
        calm[number] = np.isfinite(reference.length) & ~own.jumps[:, number]
        calm[number] &= np.isfinite(fit.expected.forces).all(axis=1)
        kept = calm[number]
        ours, fitted = (
            PathOff.of(
                (length - reference.length)[kept],
                (law.tendon_force(ACTIVATIONS, length[:, None]) - fit.expected.forces)[kept],
            )
            for length in (own.length[:, number], tendon)
        )
        shares = off_surfaces(own.length[kept, number], chain[kept, number], tendon[kept])
        muscles.append(MuscleJudged(fit.name, ours, fitted, *shares, int((~kept).sum())))
    torques = [
        torque
        for coordinate in converted.coordinates.free()
        if (torque := _torque(coordinate, converted, model, fits, found, own, free, laws, calm)) is not None
    ]
    return Judgement(muscles, torques)


def _torque(
    coordinate: str,
    converted: Converted,
    model: mujoco.MjModel,
    fits: Fits,
    found: Motion,
    own: PathsFound,
    free: list[str],
    laws: dict[str, HillMuscle],
    calm: Array,
) -> TorqueJudged | None:
    """Return the torques about a coordinate; None where no muscle has any."""
    place, column = converted.coordinates.free().index(coordinate), free.index(coordinate)
    crossing: list[tuple[int, MuscleFit]] = [
        (number, fit)
        for number, fit in enumerate(fits.muscles)
        if coordinate in fit.expected.random.moment_arm
    ]
    kept = np.ones(len(found.length), bool)
    sums = np.zeros((4, len(found.length), len(ACTIVATIONS)))  # reference, own, tendon, plain
    for number, fit in crossing:
        kept &= calm[number]
        law, tendon = laws[fit.name], model.tendon(fit.name).id
        lengths = own.length[:, number], found.length[:, tendon]
        arm = found.moment_arm[:, tendon, place][:, None]
        parts = (
            fit.expected.random.moment_arm[coordinate][:, None] * fit.expected.forces,
            own.moment_arm[:, number, column][:, None] * law.tendon_force(ACTIVATIONS, lengths[0][:, None]),
            arm * law.tendon_force(ACTIVATIONS, lengths[1][:, None]),
            arm * engine_force(fit, lengths[1]),
        )
        sums += fit.max_isometric_force * np.array(parts)
    kept &= np.isfinite(sums[0]).all(axis=1)
    greatest = float(np.abs(sums[0, kept]).max(initial=0.0))
    if greatest == 0.0:
        return None
    square = float(np.sqrt(np.mean(sums[0, kept] ** 2)))

    def off(part: Array) -> TorqueOff:
        error = np.nan_to_num(np.abs(part - sums[0])[kept], nan=np.inf)
        return TorqueOff(float(np.sqrt(np.mean(error**2))) / square, float(error.max()) / greatest)

    _, own_paths, tendons, plain = sums
    return TorqueJudged(coordinate, off(own_paths), off(tendons), off(plain), greatest, int(kept.sum()))

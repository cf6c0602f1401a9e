"""Approximations by fitted paths and forces, as notes with the errors found in the poses of the check."""

from collections.abc import Sequence

import mujoco
import numpy as np

from myowarp.laws.muscles.hill_law import OPENSIM_LAWS
from myowarp.osim.convert.check.gates import ARM, LENGTH
from myowarp.osim.convert.check.muscles import MomentArmError, Motion, MuscleError
from myowarp.osim.convert.tendon.fitted import Fits
from myowarp.osim.convert.tendon.path import TendonPath, Via
from myowarp.osim.document.elements import ConditionalPathPoint, Path
from myowarp.osim.document.model import Model, Note

BEYOND = f"beyond {ARM[0]:g} mm of moment arm or {LENGTH[0]:g} mm of length, root mean square"
"""Bounds of the gates of the worst muscle, in words."""


def approximations(
    model: Model,
    compiled: mujoco.MjModel,
    fits: Fits,
    found: Motion,
    arms: Sequence[MomentArmError],
    muscles: Sequence[MuscleError],
) -> list[Note]:
    """Return notes: paths that are no row of fixed points, muscles beyond the gates and why, all forces.

    Args:
        model: What was converted.
        compiled: The result.
        fits: Its paths and forces.
        found: Its lengths in the poses of the check.
        arms: Errors of moment arms there.
        muscles: Errors of forces there.
    """
    notes, references, paths = [], fits.references(), model.pulling
    for name, fit in fits.paths().items():
        rule = _rule(fit.tendon, paths[name])
        if not rule:
            continue
        off = np.abs(found.length[:, compiled.tendon(name).id] - references[name].length)
        worst = max((pair.computed.rms for pair in arms if pair.muscle == name), default=0.0)
        bound = f"length {1e3 * off.max():.2g} mm at most, moment arms {1e3 * worst:.2g} mm root mean square"
        notes.append(Note(f"/forceset/{name}", rule, bound))
    for muscle in muscles:
        own = [pair for pair in arms if pair.muscle == muscle.muscle]
        arm = max((pair.error.rms for pair in own), default=0.0)
        if not (1e3 * arm <= ARM[0] and 1e3 * muscle.length.rms <= LENGTH[0]):
            rule = f"{BEYOND}: {_reason(paths[muscle.muscle], fits.paths()[muscle.muscle].tendon, own)}"
            bound = (
                f"moment arms {1e3 * arm:.2g} mm, length {1e3 * muscle.length.rms:.2g} mm root mean square"
            )
            notes.append(Note(f"/forceset/{muscle.muscle}", rule, bound))
        bound = f"{100 * muscle.force.worst:.2g} % of max_isometric_force at most, at rest"
        kind = model.muscles[muscle.muscle].type
        runs = "its own law" if kind in OPENSIM_LAWS else "that, too"
        rule = f"{kind} is MuJoCo's muscle with a rigid tendon in model.xml; MyoWarp runs {runs}"
        notes.append(Note(f"/forceset/{muscle.muscle}", rule, bound))
    return notes


def _reason(path: Path, tendon: TendonPath, pairs: Sequence[MomentArmError]) -> str:
    """Return what of a path MuJoCo has no equal for."""
    said = []
    if switched := [point for point in path.points if isinstance(point, ConditionalPathPoint)]:
        coordinates = ", ".join(dict.fromkeys(point.coordinate for point in switched))
        said.append(
            f"OpenSim switches {len(switched)} of its points on and off by {coordinates}; no surface does"
        )
    bare = {wrap.object.replace("/", "-") for wrap in path.wraps} - {over.name for over in tendon.surfaces}
    if bare:
        named = ", ".join(sorted(bare))
        said.append(f"no surface stands for {named}: MuJoCo takes one between two points")
    if share := max((pair.inconsistent for pair in pairs), default=0.0):
        said.append(
            f"in up to {100 * share:.0f} % of the poses OpenSim's moment arm is not the slope of its length"
        )
    return "; ".join(said) or "the best surfaces come no nearer, MuJoCo has spheres and cylinders only"


def _rule(tendon: TendonPath, path: Path) -> str:
    """Return what stands for wraps and conditional points, "" for a path that has none."""
    surfaces = tendon.surfaces
    shown = {over.name for over in surfaces}
    said = [f"{over.name} is a {over.surface.kind}" for over in surfaces]
    passed = {element.point for element in tendon.elements if isinstance(element, Via)}
    for number, point in enumerate(path.points):
        name = f"P{number + 1}"
        if isinstance(point, ConditionalPathPoint) and name not in shown:
            said.append(f"{name} is {'always' if number in passed else 'never'} passed")
    wraps = dict.fromkeys(wrap.object.replace("/", "-") for wrap in path.wraps)
    said += [f"{name} is left out" for name in wraps if name not in shown]
    return "a path of sites and surfaces: " + ", ".join(said) if said else ""

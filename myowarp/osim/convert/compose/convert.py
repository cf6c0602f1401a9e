"""An OpenSim model -> a MuJoCo model with its sidecars: the order of the stages.

Geometry (Cvt1) is done here from `geometry`, `points`, `passive` and `meshes`. Paths (Cvt2) and
forces of muscles (Cvt3) come in from outside: `convert` takes tendon paths and force fits and has plain
ones for those that are missing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from myowarp.osim.body.hill_muscle import HillMuscle
from myowarp.osim.bundle.bundle import Bundle
from myowarp.osim.bundle.coordinate_map import CoordinateMap
from myowarp.osim.bundle.couplings import Couplings
from myowarp.osim.convert.compose.beside import (
    document_contacts,
    document_paths,
    muscle_table,
    passive_forces,
)
from myowarp.osim.convert.compose.geometry import Build, begin, exact_couplings, starts_of, tie
from myowarp.osim.convert.compose.meshes import add_shapes
from myowarp.osim.convert.compose.passive import add_forces, path_tendon
from myowarp.osim.convert.compose.points import add_markers, add_moving_points, stilled
from myowarp.osim.convert.compose.visible_body import add_visible_body
from myowarp.osim.convert.tendon.path import TendonPath
from myowarp.osim.document.contacts import resting
from myowarp.osim.document.model import Model, Muscle

if TYPE_CHECKING:
    from myowarp.osim.convert.tendon.force import ForceFit

PLAIN_RANGE = (0.5, 1.5)
"""Fiber lengths [optimal fiber lengths] at the ends of MuJoCo's length range, for a muscle without fit."""

KEYFRAME = "default"


@dataclass(frozen=True)
class Options:
    """Options of a conversion.

    Attributes:
        mesh_folders: Where to look for meshes, before the folders of the model.
        tendons: Whether MuJoCo's tendons and springs stand for paths, limits and ligaments; else tendons
            only show where the paths of our own begin and end, and moving points have no bodies.
    """

    mesh_folders: tuple[Path, ...] = ()
    tendons: bool = True


@dataclass(frozen=True, kw_only=True)
class Converted(Bundle):
    """A bundle with what its checks need.

    Attributes:
        model: What was converted.
        coordinates: How coordinates and joints belong together.
        couplings: How joints follow each other in the document, and what its bodies weigh.
        bodies: Name in MuJoCo of every body, ground included.
        moving: For each path, body at each of its moving points.
    """

    model: Model
    coordinates: CoordinateMap
    couplings: Couplings
    bodies: Mapping[str, str]
    moving: Mapping[str, Mapping[int, str]]


@dataclass(frozen=True)
class Stages:
    """Results of the later stages, by muscle.

    Attributes:
        tendons: Paths, also of ligaments and path actuators; what has none goes straight through its
            fixed points, with a note.
        forces: MuJoCo's parameters; a muscle without them gets plain ones, with a note.
    """

    tendons: Mapping[str, TendonPath] = field(default_factory=dict)
    forces: Mapping[str, ForceFit] = field(default_factory=dict)


def convert(model: Model, options: Options = Options(), stages: Stages = Stages()) -> Converted:
    """Return the MuJoCo model of an OpenSim model.

    Raises:
        ValueError: MuJoCo refuses the result.
    """
    source, model = model, model if options.tendons else stilled(model)
    _, _, coordinates = _skeleton(model, {})
    # Where quartics put joints by default is known when they are there.
    build, moving, coordinates = _skeleton(model, starts_of(coordinates))
    add_markers(build)
    for muscle in model.muscles.values():
        _add_muscle(build, muscle, moving[muscle.name], stages)
    paths, contacts = document_paths(build, source), document_contacts(build, source)
    forces = passive_forces(build, has_paths=paths is not None)
    add_forces(build, moving, stages.tendons, forces, instead=options.tendons)
    if forces is not None:
        forces = replace(forces, springs=tuple(build.springs), dampers=build.dampers, bare=build.bare)
    # What stands for functions in plain MuJoCo alone is no loss where it does not run.
    tangents = {f"/forceset/{name}" for name, path in model.pulling.items() if path.function is not None}
    meshes = add_shapes(build, options.mesh_folders)
    for name, text in (("credits", model.credits), ("publications", model.publications)):
        if text:
            build.spec.add_text(name=name, data=text)
    try:
        compiled = build.spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{model.source}: MuJoCo does not accept the converted model: {reason}") from error
    if not meshes:
        add_visible_body(build, compiled)
    build.spec.add_key(name=KEYFRAME, qpos=coordinates.qpos(compiled, {})[0])
    return Converted(
        spec=build.spec,
        couplings=exact_couplings(build, coordinates),
        paths=paths,
        forces=forces,
        contacts=contacts,
        coordinates=coordinates,
        muscles=muscle_table(map(HillMuscle.of, source.muscles.values())),
        meshes=meshes,
        notes=(
            *resting(model).notes,
            *(note for note in build.notes if options.tendons or note.path not in tangents),
        ),
        model=model,
        bodies={name: body.name for name, body in build.bodies.items()},
        moving=moving,
    )


def _skeleton(
    model: Model, starts: dict[str, float]
) -> tuple[Build, dict[str, dict[int, str]], CoordinateMap]:
    """Return bodies, joints and moving points, tied to the coordinates; see `begin` and `Converted`."""
    build = begin(model, starts)
    moving = add_moving_points(build)
    return build, moving, tie(build)


def _add_muscle(build: Build, muscle: Muscle, moving: Mapping[int, str], stages: Stages) -> None:
    """Add the tendon and the actuator of a muscle."""
    tendon = path_tendon(build, muscle.name, muscle.path, moving, stages.tendons)
    tendon.rgba = (0.8, 0.1, 0.1, 1.0)
    if not muscle.applies_force:
        build.note(f"/forceset/{muscle.name}", "switched off in the file; a tendon without actuator")
        return
    fit = stages.forces.get(muscle.name)
    actuator = build.spec.add_actuator(
        name=build.free_name("actuator", muscle.name), trntype=mujoco.mjtTrn.mjTRN_TENDON, target=muscle.name
    )
    low, high = np.clip(muscle.control_range, 0.0, 1.0)
    actuator.ctrllimited, actuator.ctrlrange = mujoco.mjtLimited.mjLIMITED_TRUE, (min(low, 0.99 * high), high)
    actuator.gaintype = mujoco.mjtGain.mjGAIN_MUSCLE
    actuator.biastype = mujoco.mjtBias.mjBIAS_MUSCLE
    if fit is None:
        build.note(f"/forceset/{muscle.name}", "plain parameters of MuJoCo's muscle, not fitted")
        actuator.lengthrange, actuator.gainprm = _plain(muscle)
        actuator.biasprm = actuator.gainprm
        dynamics = None if muscle.ignore_activation_dynamics else _time_constants(muscle)
    else:
        build.notes += fit.notes
        actuator.lengthrange = fit.length_range
        actuator.gainprm[: len(fit.gainprm)], actuator.biasprm[: len(fit.biasprm)] = fit.gainprm, fit.biasprm
        dynamics = fit.dynprm
    if dynamics is not None:
        actuator.dyntype = mujoco.mjtDyn.mjDYN_MUSCLE
        actuator.dynprm[:3] = dynamics


def _plain(muscle: Muscle) -> tuple[tuple[float, float], np.ndarray]:
    """Return length range [m] and parameters of a muscle on a rigid tendon, its pennation constant."""
    low, high = PLAIN_RANGE
    flat = math.cos(muscle.pennation_angle_at_optimal)
    length = muscle.optimal_fiber_length * flat
    parameters = np.zeros(10)
    force = muscle.max_isometric_force * flat
    speed = HillMuscle.of(muscle).velocity_scale / muscle.optimal_fiber_length
    # range, force, scale (unused), lmin, lmax, vmax, fpmax, fvmax: MuJoCo's defaults but for force and speed.
    parameters[:9] = low, high, force, 200.0, 0.5, 1.6, speed, 1.3, 1.4
    slack = muscle.tendon_slack_length
    return (slack + low * length, slack + high * length), parameters


def _time_constants(muscle: Muscle) -> tuple[float, float, float]:
    """Return the time constants of rise and fall [s], and no smoothing."""
    values = {name.rsplit(".", 1)[-1]: value for name, value in muscle.parameters.items()}
    return values.get("activation_time_constant", 0.01), values.get("deactivation_time_constant", 0.04), 0.0

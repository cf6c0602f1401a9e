"""An .osim file -> a folder with a MuJoCo model, its sidecars and a report."""

import dataclasses
import importlib.util
import json
import os
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco

from myowarp.disk import check_folder, files_digest, in_place, make_folder
from myowarp.extras import to_install
from myowarp.opensim.model.model import Loss, Model, pulling
from myowarp.progress import patient_bar

if TYPE_CHECKING:
    from myowarp.opensim.tendon.fits import Samples
    from myowarp.opensim.tendon.fitted import Fits

NO_FITS = f"paths and muscles' forces are not fitted: it needs SciPy; run {to_install('convert')}"
LACKS = (
    "Joints that follow others do so by quartics and springs, on bodies too heavy: accelerations are "
    "off by a third in places; model.mjb in MuJoCo, and couplings.json in MyoWarp, are near OpenSim's. "
)
PATIENCE = 1.0
"""[s] after which a progress bar is drawn."""
COMPLETE = ("report.json", "report.html", "model.xml")
"""Files that show that a folder holds a whole result: the first to go and the last to come."""
SIDECARS = ("couplings.json", "paths.json", "forces.json")
"""Files that not every model has, and that act where they lie beside one."""


def run(
    source: Path,
    output: Path,
    mesh_folders: tuple[Path, ...] = (),
    method: str = "least_squares",
    workers: int = 0,
    reference: str = "own",
    accepted: Sequence[str] = (),
) -> dict[str, Any]:
    """Convert a file and write the result; the report is written last, the model before it.

    Raises:
        ValueError: The file is no usable model, or the folder cannot be written.
        NotImplementedError: The model contains something that is not supported.
        OSError: A file cannot be read or written.
    """
    from myowarp.opensim.check.dynamics import dynamics
    from myowarp.opensim.check.engines import Engine, OurStep, PlainMuJoCo
    from myowarp.opensim.check.left_out import sized
    from myowarp.opensim.compose.binary import binary, stiff
    from myowarp.opensim.compose.convert import Options, Stages, convert
    from myowarp.opensim.compose.mjcf import mjcf
    from myowarp.opensim.muscle.hill import HillMuscle
    from myowarp.opensim.muscle.table import muscle_table
    from myowarp.opensim.read.model import read_model
    from myowarp.opensim.report.data import along_coordinates, check, report_of
    from myowarp.opensim.report.page import page

    if not source.is_file():
        raise ValueError(f"model {str(source)!r} is no file; give the path of an .osim file")
    if workers < 0:
        raise ValueError(f"workers must be at least 0, got {workers}")
    check_folder(output)
    begin = time.perf_counter()
    digest = files_digest([source])
    model = read_model(source)
    fits, samples = _fits(model, digest, method, workers)
    if samples is not None and reference == "opensim":
        from myowarp.opensim.check.oracle import against_opensim

        fits = against_opensim(source, model, samples, fits)
    tendons = {name: path.tendon for name, path in fits.paths().items()}
    stages = Stages(tendons, {fit.name: fit.force for fit in fits.muscles})
    converted = convert(model, Options(mesh_folders), stages)
    converted = dataclasses.replace(converted, notes=sized(source, model, converted.notes))
    if pulling(model) and samples is None:
        note = Loss("/forceset", NO_FITS, code="fits")
        converted = dataclasses.replace(converted, notes=(*converted.notes, note))
    converted.spec.meshdir = "meshes" if converted.meshes else ""
    text = mjcf(
        converted.spec, comment=f"{model.name}. {LACKS if converted.exact.curves else ''}{model.credits}"
    )
    compiled = mujoco.MjModel.from_xml_string(text, {**converted.meshes})
    asks = converted.exact.curves or converted.exact.turns_otherwise
    said = converted.exact.as_json() if asks else ""
    stiffer = stiff(compiled, converted.exact)
    coordinates = converted.coordinates
    engines: dict[str, Engine] = {}
    if coordinates.free():
        try:
            engines["step"] = OurStep(coordinates, mujoco.MjSpec.from_string(text), said)
        except ValueError as error:
            reason = " ".join(str(error).split())
            raise ValueError(f"{source}: MyoWarp cannot step the converted model: {reason}") from error
        engines["mjb"] = PlainMuJoCo(coordinates, stiffer)
        engines["xml"] = PlainMuJoCo(coordinates, compiled)
    with patient_bar("Comparing accelerations", "steps", 1 + len(engines), patience=PATIENCE) as advance:
        moved = dynamics(source, model, engines, advance)
    checked = check(converted, compiled, fits, samples, moved)
    report = report_of(converted, compiled, checked, digest, reference, accepted)
    report["moment_arms"]["along"] = {} if samples is None else along_coordinates(fits, samples)
    report["seconds"] = round(time.perf_counter() - begin, 3)
    files = {
        **{f"meshes/{name}": content for name, content in converted.meshes.items()},
        "coordinates.json": json.dumps(converted.coordinates.as_json(), indent=1).encode(),
        **({"couplings.json": said.encode()} if said else {}),
        **({"paths.json": converted.paths.as_json().encode()} if converted.paths else {}),
        **({"forces.json": converted.forces.as_json().encode()} if converted.forces else {}),
        "muscles.csv": muscle_table(map(HillMuscle.of, model.muscles.values())).encode(),
        "model.xml": text.encode(),
        "model.mjb": binary(stiffer),
        "report.html": page(report, converted, compiled, fits, samples, moved).encode(),
        "report.json": json.dumps(report, indent=1).encode(),
    }
    write(output, files, instead_of=(*COMPLETE, *SIDECARS))
    return report


def _fits(model: Model, digest: str, method: str, workers: int) -> tuple["Fits", "Samples | None"]:
    """Return the fits of all paths in the model's order, and the poses; nothing without SciPy."""
    from myowarp.opensim.tendon.fitted import Fits, MuscleFit

    if importlib.util.find_spec("scipy") is None or not pulling(model):
        return Fits(), None
    from myowarp.opensim.tendon.fits import PAPER, Methods, fit_muscles, sampled

    methods = PAPER if method == "paper" else Methods()
    samples, order = sampled(model), list(pulling(model))
    found = []
    with patient_bar("Fitting", "paths", len(order), patience=PATIENCE) as advance:
        for fit in fit_muscles(model, samples, digest, methods, workers or os.cpu_count() or 1):
            found.append(fit)
            advance(1)
    found.sort(key=lambda fit: order.index(fit.name))
    muscles = [fit for fit in found if isinstance(fit, MuscleFit)]
    return Fits(muscles, [fit for fit in found if not isinstance(fit, MuscleFit)]), samples


def write(output: Path, files: dict[str, bytes], instead_of: Sequence[str] = ()) -> None:
    """Write files into a folder; when all are on the disk, they take their places in their order.

    Args:
        output: The folder.
        files: Contents by name.
        instead_of: Files of an earlier result, which go before.

    Raises:
        OSError: A file cannot be written; those before are there as they were.
    """
    for folder in dict.fromkeys((output / name).parent for name in files):
        make_folder(folder)
    with ExitStack() as places:
        for name in reversed(files):  # the last one that is entered is the first that is moved
            places.enter_context(in_place(output / name)).write_bytes(files[name])
        for name in instead_of:
            (output / name).unlink(missing_ok=True)

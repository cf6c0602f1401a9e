"""An .osim file -> a folder with a MuJoCo model, its sidecars and a report."""

import dataclasses
import importlib.util
import json
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco

from myowarp.disk import check_folder, files_digest
from myowarp.extras import to_install
from myowarp.osim.bundle.bundle import MODEL, SIDECARS, write
from myowarp.osim.document.model import Loss, Model
from myowarp.progress import patient_bar

if TYPE_CHECKING:
    from myowarp.osim.convert.check.engines import NewStep
    from myowarp.osim.convert.tendon.fits import Samples
    from myowarp.osim.convert.tendon.fitted import Fits

NO_FITS = f"paths and muscles' forces are not fitted: it needs SciPy; run {to_install('convert')}"
LACKS = (
    "Joints that follow others do so by quartics and springs, on bodies too heavy: accelerations are "
    "off by a third in places; model.mjb in MuJoCo, and couplings.json in MyoWarp, are near OpenSim's. "
)
PATIENCE = 1.0
"""[s] after which a progress bar is drawn."""
COMPLETE = ("report.json", "report.html", "model.xml")
"""Files that show that a folder holds a whole result: the first to go and the last to come."""


def run(
    source: Path,
    output: Path,
    step: "NewStep",
    mesh_folders: tuple[Path, ...] = (),
    method: str = "least_squares",
    workers: int = 0,
    reference: str = "own",
    accepted: Sequence[str] = (),
    function_paths: Path | None = None,
) -> dict[str, Any]:
    """Convert a file and write the result; the report is written last, the model before it.

    Args:
        source: .osim.
        output: Folder for the result.
        step: Makes the physics step that is checked beside plain MuJoCo's.
        mesh_folders: As for `Options`.
        method: "least_squares" or "paper".
        workers: Processes that fit; 0: one per core.
        reference: "own" or "opensim", what paths are checked against.
        accepted: Codes of what may be left out.
        function_paths: A set of `FunctionBasedPath`, in place of the paths of the muscles that it names.

    Raises:
        ValueError: The file is no usable model, or the folder cannot be written.
        NotImplementedError: The model contains something that is not supported.
        OSError: A file cannot be read or written.
    """
    from myowarp.osim.convert.check.dynamics import dynamics
    from myowarp.osim.convert.check.engines import Engine, PlainMuJoCo
    from myowarp.osim.convert.check.left_out import sized
    from myowarp.osim.convert.compose.binary import binary, stiff
    from myowarp.osim.convert.compose.convert import Options, Stages, convert
    from myowarp.osim.convert.report.data import along_coordinates, check, report_of
    from myowarp.osim.convert.report.page import page
    from myowarp.osim.document.read.model import read_model

    if not source.is_file():
        raise ValueError(f"model {str(source)!r} is no file; give the path of an .osim file")
    if workers < 0:
        raise ValueError(f"workers must be at least 0, got {workers}")
    check_folder(output)
    begin = time.perf_counter()
    digest = files_digest([source, *([] if function_paths is None else [function_paths])])
    model = read_model(source, function_paths=function_paths)
    fits, samples = _fits(model, digest, method, workers)
    if samples is not None and reference == "opensim":
        from myowarp.osim.convert.check.oracle import against_opensim

        fits = against_opensim(source, model, samples, fits)
    tendons = {name: path.tendon for name, path in fits.paths().items()}
    stages = Stages(tendons, {fit.name: fit.force for fit in fits.muscles})
    converted = convert(model, Options(mesh_folders), stages)
    converted = dataclasses.replace(converted, notes=sized(source, model, converted.notes))
    if model.pulling and samples is None:
        note = Loss("/forceset", NO_FITS, code="fits")
        converted = dataclasses.replace(converted, notes=(*converted.notes, note))
    couplings = converted.couplings
    files = converted.files(f"{model.name}. {LACKS if couplings.curves else ''}{model.credits}")
    if not couplings.acts:
        del files[couplings.FILE]
    text = files[MODEL].decode()
    compiled = mujoco.MjModel.from_xml_string(text, {**converted.meshes})
    stiffer = stiff(compiled, couplings)
    coordinates = converted.coordinates
    engines: dict[str, Engine] = {}
    if coordinates.free():
        try:
            spec = mujoco.MjSpec.from_string(text)
            engines["step"] = step(coordinates, couplings.put_into(spec) if couplings.acts else spec)
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
    files |= {
        "model.mjb": binary(stiffer),
        "report.html": page(report, converted, compiled, fits, samples, moved).encode(),
        "report.json": json.dumps(report, indent=1).encode(),
    }
    write(output, files, instead_of=(*COMPLETE, *SIDECARS))
    return report


def _fits(model: Model, digest: str, method: str, workers: int) -> tuple["Fits", "Samples | None"]:
    """Return the fits of all paths in the model's order, and the poses; nothing without SciPy."""
    from myowarp.osim.convert.tendon.fitted import Fits, MuscleFit

    if importlib.util.find_spec("scipy") is None or not model.pulling:
        return Fits(), None
    from myowarp.osim.convert.tendon.fits import PAPER, Methods, fit_muscles, sampled

    methods = PAPER if method == "paper" else Methods()
    samples, order = sampled(model), list(model.pulling)
    found = []
    with patient_bar("Fitting", "paths", len(order), patience=PATIENCE) as advance:
        for fit in fit_muscles(model, samples, digest, methods, workers or os.cpu_count() or 1):
            found.append(fit)
            advance(1)
    found.sort(key=lambda fit: order.index(fit.name))
    muscles = [fit for fit in found if isinstance(fit, MuscleFit)]
    return Fits(muscles, [fit for fit in found if not isinstance(fit, MuscleFit)]), samples

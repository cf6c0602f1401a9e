"""The command `myowarp convert`: an .osim file -> a folder with a MuJoCo model, its sidecars and a report."""

import dataclasses
import importlib.util
import json
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import mujoco
import tyro
from rich.console import Console

from myowarp.disk import check_folder, check_overwrite, files_digest, in_place
from myowarp.opensim.model.model import Loss, Model, pulling
from myowarp.progress import patient_bar

if TYPE_CHECKING:
    from myowarp.opensim.tendon.fits import Samples
    from myowarp.opensim.tendon.fitted import Fits

NO_FITS = "paths and muscles' forces are not fitted: it needs SciPy; pip install 'myowarp[convert]'"
LACKS = (
    "Joints that follow others do so by quartics and springs, on bodies too heavy: accelerations are "
    "off by a third in places; model.mjb in MuJoCo, and couplings.json in MyoWarp, are near OpenSim's. "
)
PATIENCE = 1.0
"""[s] after which a progress bar is drawn."""
COMPLETE = ("report.json", "report.html", "model.xml")
"""Files that show that a folder holds a whole result: the first to go and the last to come."""


@dataclass
class Convert:
    """Convert an OpenSim model to MuJoCo: bodies, joints, muscles, with a report of what is not exact.

    Writes model.xml; model.mjb, the same for plain MuJoCo of this version, stiffer; coordinates.json (how
    OpenSim coordinates map to MuJoCo joints); couplings.json (how joints follow others, as the file says, for
    MyoWarp); muscles.csv (the Hill parameters of the file); report.json and report.html; and meshes where
    they are found. Works without OpenSim. Run again, an interrupted conversion continues.

    Example: myowarp convert arm26.osim -o out/arm26
    """

    model: Annotated[Path, tyro.conf.Positional]
    """The model, .osim of OpenSim 2.1 to 4.6 (document versions 20101 to 40600)."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out/model")
    """Folder for the result."""
    meshes: tuple[Path, ...] = ()
    """More folders with .vtp, .stl or .obj files; the model's own and Geometry beside it are searched."""
    method: Literal["least_squares", "paper"] = "least_squares"
    """Fitting method; paper: simulated annealing and differential evolution, slow, for comparison."""
    reference: Literal["own", "opensim"] = "own"
    """What lengths and moment arms are checked against: our own path code, or an installed OpenSim."""
    workers: int = 0
    """Processes that fit muscles; 0: one per core."""
    strict: bool = False
    """Fail if a stated gate is missed or something is left out; the result is written all the same."""
    accept_losses: Annotated[tuple[str, ...], tyro.conf.arg(metavar="[CODE ...]", help_behavior_hint="")] = ()
    """Codes of what may be left out with --strict, such as BushingForce; the report says which there are."""
    json: bool = False
    """Print the report as JSON instead of a summary."""
    overwrite: bool = False
    """Replace output files that exist."""

    def __call__(self) -> None:
        """Convert, check, write."""
        check_overwrite((self.output / name for name in COMPLETE), self.overwrite)
        report = run(
            self.model,
            self.output,
            self.meshes,
            self.method,
            self.workers,
            self.reference,
            self.accept_losses,
        )
        if self.json:
            print(json.dumps(report, indent=1))
        else:
            _summarize(report, self.output, self.accept_losses)
        if self.strict and (failed := _failed(report)):
            raise ValueError(f"{self.model}: {failed}")


def _failed(report: dict[str, Any]) -> str:
    """Return what --strict fails on, "" for nothing."""
    missed = [gate for gate in report["gates"] if not gate["passed"]]
    said = "; ".join(
        f"{gate['name']} {_figure(gate)} (at most {gate['bound']:g}"
        + (f"; {gate['where']})" if gate["where"] else ")")
        for gate in missed
    )
    parts = [f"{len(missed)} gates of --strict missed: {said}"] if missed else []
    lost = [loss for loss in report["left_out"] if not loss["accepted"]]
    if lost:
        codes = " ".join(sorted({loss["code"] for loss in lost}))
        parts.append(f"{len(lost)} things left out that act in OpenSim; --accept-losses {codes} accepts them")
    return ". ".join(parts)


def _figure(gate: dict[str, Any]) -> str:
    """Return the value of a gate with its unit."""
    return "has no number" if gate["value"] is None else f"{gate['value']:.3g} {gate['unit']}"


def _summarize(report: dict[str, Any], output: Path, accepted: tuple[str, ...]) -> None:
    from myowarp.opensim.report.data import alike, left_out

    console = Console(highlight=False, soft_wrap=True)
    counts = report["counts"]
    console.print(f"{output}/model.xml: {counts['joints']} joints, {counts['muscles']} muscles")
    for code, said, rules, _ in left_out(report["left_out"]):
        console.print(f"left out: {code}, {said}: {rules}", markup=False)
    for code in sorted(set(accepted) - {loss["code"] for loss in report["left_out"]}):
        console.print(f"accepted but not left out here: {code}", markup=False)
    for engine in report["dynamics"]["engines"].values():
        median, worst = (f"{100 * engine['accelerations'][key]:.2g} %" for key in ("median", "worst"))
        console.print(f"{engine['name']}: accelerations {median} off (median of states), {worst} (worst)")
    missed = [gate for gate in report["gates"] if not gate["passed"]]
    for gate in missed:
        where = f" ({gate['where']})" if gate["where"] else ""
        console.print(f"{gate['name']}: {_figure(gate)}, beyond {gate['bound']:g}{where}", markup=False)
    console.print(
        f"{len(report['gates']) - len(missed)} of {len(report['gates'])} figures within their gates"
    )
    for done, notes in alike(report["notes"]).items():
        console.print(f"{len(notes)} x {done}", markup=False)
    console.print(f"each of these, and how far off it is: {output}/report.html")


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
    from myowarp.opensim.report.data import check, report_of
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
        from myowarp.opensim.tendon.fits import against_opensim

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
    report["seconds"] = round(time.perf_counter() - begin, 3)
    files = {
        **{f"meshes/{name}": content for name, content in converted.meshes.items()},
        "coordinates.json": json.dumps(converted.coordinates.as_json(), indent=1).encode(),
        **({"couplings.json": said.encode()} if said else {}),
        "muscles.csv": muscle_table(map(HillMuscle.of, model.muscles.values())).encode(),
        "model.xml": text.encode(),
        "model.mjb": binary(stiffer),
        "report.html": page(report, converted, compiled, fits, samples, moved).encode(),
        "report.json": json.dumps(report, indent=1).encode(),
    }
    write(output, files)
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


def write(output: Path, files: dict[str, bytes]) -> None:
    """Write files into a folder, each whole; what marks an earlier result as complete goes first."""
    for name in COMPLETE:
        (output / name).unlink(missing_ok=True)
    for name, content in files.items():
        path = output / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with in_place(path) as scratch:
            scratch.write_bytes(content)

"""The command `myowarp convert`."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console

from myowarp.apps.cli.motion.steps import say
from myowarp.disk import check_overwrite
from myowarp.osim.convert.run import COMPLETE, run


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
    """The model, .osim of OpenSim 1.9 to 4.6 (document versions 10901 to 40600)."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out/model")
    """Folder for the result."""
    meshes: tuple[Path, ...] = ()
    """More folders with .vtp, .stl or .obj files; the model's own and Geometry beside it are searched."""
    method: Literal["least_squares", "paper"] = "least_squares"
    """Fitting method; paper: simulated annealing and differential evolution, slow, for comparison."""
    reference: Literal["own", "opensim"] = "own"
    """Reference of lengths and moment arms: our own path code, or an installed OpenSim."""
    workers: int = 0
    """Processes that fit muscles; 0: one per core."""
    function_paths: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """A set of FunctionBasedPath, such as Moco's, in place of the paths of the muscles that it names."""
    fit_paths: bool = False
    """Write function_paths.xml, too, lengths as polynomials of coordinates, which OpenSim reads and
    --function-paths takes; and function_paths.csv with their errors."""
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
        from myowarp.osim.convert.function_paths import FILES, write_fitted
        from myowarp.sim.converted_step import OurStep  # compiles nothing that help needs

        fitted = FILES if self.fit_paths else ()
        check_overwrite((self.output / name for name in (*COMPLETE, *fitted)), self.overwrite)
        report = run(
            self.model,
            self.output,
            OurStep,
            self.meshes,
            self.method,
            self.workers,
            self.reference,
            self.accept_losses,
            self.function_paths,
        )
        if self.fit_paths:
            say([write_fitted(self.model, self.output)])
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
    from myowarp.osim.convert.report.data import alike, left_out

    console = Console(highlight=False, soft_wrap=True)
    counts = report["counts"]
    console.print(f"{output}/model.xml: {counts['joints']} joints, {counts['muscles']} muscles")
    for sentence in report["judge"].get("verdict", ()):
        console.print(sentence, markup=False)
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

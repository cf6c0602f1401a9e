"""Computed muscle control of a gait beside OpenSim 4.6's CMC, both live, of one motion under one load.

    python -m benchmarks.tracking --output benchmarks/results/opensim_tracking.json

The motion is what OpenSim's CMC ended with in its Gait2354 example, on the model that its residual reduction
adjusted, in equal steps; actuators, gains and least controls are those of the example. CMC settles its
muscles in the first 30 ms, and both are compared after them, up to CMC's last window: there its residual is
not what its own states need (forwards 3.6 N instead of 4.0 N), while before both differ by less than 0.1 N.
Residuals are the force at the point of the
pelvis at which the example's actuators pull, and the moment there.
"""

import json
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table
from scipy.interpolate import interp1d

from benchmarks.machine import processor
from benchmarks.rivals import ROOT
from myowarp.motion.inverse_dynamics import Load, inverse_dynamics
from myowarp.motion.loads import loads_at
from myowarp.motion.smooth import spline
from myowarp.motion.storage import Storage, read_storage, write_storage
from myowarp.motion.tool_setup import read_tool_setup
from myowarp.motion.tracking import track
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.read.element import Element, parse

SETTLED, LAST = 0.03, 0.01
"""Time that CMC needs to settle, and its last window [s]."""
STEP = 1.0 / 600.0
"""Of the motion [s]."""
PARTS = ("FX", "FY", "FZ", "MX", "MY", "MZ")
"""Names of the example's residual actuators."""


@dataclass
class Options:
    """Measure beside OpenSim; the trial is no part of this repository, see shared/osim/motion."""

    trial: Path = ROOT / "../shared/osim/motion/gait2354"
    """Folder of OpenSim's Gait2354 example."""
    opensim: Path = ROOT / ".venv-opensim/bin/python"
    """Interpreter with OpenSim."""
    work: Path | None = None
    """Folder of CMC's files and results; where it has results, they are taken."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out/tracking.json")
    """JSON file."""


def motion(trial: Path) -> Storage:
    """Return the motion in equal steps, angles in degrees."""
    recorded = read_storage(trial / "reference_subject01_walk1_Kinematics_q.sto")
    first, last = recorded.time[[0, -1]]
    time = np.linspace(first, last, 1 + round((last - first) / STEP))
    return Storage(recorded.labels, time, spline(recorded.time, recorded.values)(time), recorded.in_degrees)


def theirs(options: Options, wanted: Storage, folder: Path) -> Path:
    """Run CMC on a motion; return the folder with its results."""
    results = folder / "ResultsCMC"
    if results.exists():
        return results
    (folder / "ResultsRRA").mkdir(parents=True, exist_ok=True)
    write_storage(folder / "ResultsRRA/subject01_walk1_RRA_Kinematics_q.sto", "Coordinates", wanted)
    name = "subject01_simbody_adjusted.osim"
    shutil.copy(options.trial / f"reference_{name}", folder / name)
    for name in ("CMC_Actuators", "CMC_Tasks", "CMC_ControlConstraints"):
        shutil.copy(options.trial / f"gait2354_{name}.xml", folder)
    for name in ("subject01_walk1_grf.xml", "subject01_walk1_grf.mot"):
        shutil.copy(options.trial / name, folder)
    text = (options.trial / "subject01_Setup_CMC.xml").read_text()
    for tag, value in (("initial_time", wanted.time[0]), ("final_time", wanted.time[-1])):
        start, end = text.index(f"<{tag}>") + len(tag) + 2, text.index(f"</{tag}>")
        text = f"{text[:start]}{value:.9g}{text[end:]}"
    text = text.replace("<step_interval> 10 </step_interval>", "<step_interval> 1 </step_interval>")
    (folder / "setup.xml").write_text(text)
    command = [str(options.opensim), str(ROOT / "benchmarks/tracking_opensim.py"), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    line = next(line for line in done.stdout.splitlines() if line.startswith("RESULT "))
    (results / "run.json").write_text(line.removeprefix("RESULT "))
    return results


def actuators(trial: Path) -> list[Element]:
    """Return the example's actuators."""
    root, _ = parse(trial / "gait2354_CMC_Actuators.xml")
    return [one for one in root.walk() if one.tag.endswith("Actuator") and one.name != "default"]


def reserves(trial: Path, bones: Bones) -> dict[str, float]:
    """Return the force of the reserve on each coordinate."""
    at_root = dict(zip(PARTS, ("pelvis_tx", "pelvis_ty", "pelvis_tz", "pelvis_list", "pelvis_rotation",
                               "pelvis_tilt"), strict=True))  # fmt: skip
    found = {at_root.get(one.name, one.string("coordinate")): one.number("optimal_force")
             for one in actuators(trial)}  # fmt: skip
    return {name: found[name] for name in bones.coordinates}


def at_the_point(bones: Bones, trial: Path, values: np.ndarray, moment: np.ndarray) -> np.ndarray:
    """Return forces and moments at the pelvis that act as generalised forces do, shape (frames, 6)."""
    point = next(one.numbers("point", count=3) for one in actuators(trial) if one.name == "FX")
    still = np.zeros_like(values)
    rest = inverse_dynamics(bones, values, still, still).joint_moment
    own = [k for k, name in enumerate(bones.coordinates) if name.startswith("pelvis")]
    effect = np.empty((len(values), 6, 6))
    for part in range(6):
        unit = np.zeros((2, len(values), 3))
        unit[part // 3, :, part % 3] = 1.0
        load = Load("pelvis", unit[0], np.tile(point, (len(values), 1)), unit[1], "ground", "pelvis")
        acted = rest - inverse_dynamics(bones, values, still, still, [load]).joint_moment
        effect[:, :, part] = acted[:, own]
    return np.linalg.solve(effect, moment[:, own, None])[:, :, 0]


def main() -> None:
    """Measure, print, write."""
    options = tyro.cli(Options)
    bones = Bones.read(options.trial / "reference_subject01_simbody_adjusted.osim")
    example = read_tool_setup(options.trial / "subject01_Setup_CMC.xml")
    wanted = motion(options.trial)
    with tempfile.TemporaryDirectory() as scratch:
        results = theirs(options, wanted, options.work or Path(scratch))
        there = read_storage(next(results.glob("*_Actuation_force.sto")))
        angles = read_storage(next(results.glob("*_Kinematics_q.sto")))
        run: dict[str, Any] = json.loads((results / "run.json").read_text())
    turns = np.array([bones.model.coordinates[name].rotational for name in bones.coordinates])
    columns = [wanted.labels.index(name) for name in bones.coordinates]
    values = np.where(turns, np.radians(wanted.values[:, columns]), wanted.values[:, columns])
    grf = options.trial / "subject01_walk1_grf.xml"
    found = track(
        bones, wanted.time, values, lambda times: loads_at(grf, times),
        reserves=reserves(options.trial, bones), gains=example.gains, controls=example.controls,
        span=(wanted.time[0] + SETTLED, float(there.time[-1]) - LAST),
    )  # fmt: skip
    begin, end = found.time[0] - 1e-9, found.time[-1] + 1e-9
    late = (there.time >= begin) & (there.time <= end)
    both = np.stack([found.values[:, 0], found.reserve[:, 0]], axis=1)
    both = interp1d(found.time, both, axis=0, fill_value="extrapolate")(there.time[late])
    residual = at_the_point(bones, options.trial, both[:, 0], both[:, 1])
    other = there.values[late][:, [there.labels.index(part) for part in PARTS]]
    off = np.degrees(found.off()[0][turns])
    curve = spline(wanted.time, wanted.values)
    late = (angles.time >= begin) & (angles.time <= end)
    columns = [angles.labels.index(name) for name in bones.coordinates]
    slipped = (angles.values - curve(angles.time)[:, [wanted.labels.index(x) for x in angles.labels]])[late]
    slipped = np.sqrt(np.mean(slipped[:, columns] ** 2, axis=0))[turns]
    table = Table("residual", "CMC rms", "ours", "ratio", "CMC peak", "ours", "ratio")
    rows = {}
    for part, one, two in zip(PARTS, other.T, residual.T, strict=True):
        sizes = [np.sqrt(np.mean(one**2)), np.sqrt(np.mean(two**2)), abs(one).max(), abs(two).max()]
        cmc_rms, rms, cmc_peak, peak = map(float, sizes)
        rows[part] = {"cmc_rms": cmc_rms, "rms": rms, "cmc_peak": cmc_peak, "peak": peak}
        shown = cmc_rms, rms, rms / cmc_rms, cmc_peak, peak, peak / cmc_peak
        table.add_row(part, *(f"{number:.2f}" for number in shown))
    console = Console()
    console.print(table)
    names = np.array(bones.coordinates)[turns]
    console.print(f"off the motion, rms: ours {off.max():.2f}° at {names[off.argmax()]}, "
                  f"CMC {slipped.max():.2f}° at {names[slipped.argmax()]}")  # fmt: skip
    options.output.parent.mkdir(parents=True, exist_ok=True)
    result = {"processor": processor(), "opensim": run, "residuals": rows,
              "off, deg": dict(zip(names, off.tolist(), strict=True)),
              "off of CMC, deg": dict(zip(names, slipped.tolist(), strict=True))}  # fmt: skip
    options.output.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()

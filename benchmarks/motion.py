"""Inverse kinematics, inverse dynamics and static optimisation of a gait, beside OpenSim 4.6 in one run.

    python -m benchmarks.motion --output out/motion.json

The trial is tiled, its markers with noise. OpenSim's time for a frame is the difference of its CPU time for
one and for ten copies of the trial, on one core, so that loading counts on neither side; ours is the wall
time of all frames on all cores, after one run that compiles, with its CPU time beside it for cores that
others use, too. Paths of muscles are part of static optimisation in OpenSim; they are shown apart, too.
"""

import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from benchmarks.machine import disturbances, least_disturbed, processor, timed_here
from benchmarks.rivals import ROOT
from myowarp.motion.inverse_dynamics import inverse_dynamics
from myowarp.motion.inverse_kinematics import inverse_kinematics
from myowarp.motion.loads import loads_at
from myowarp.motion.markers import Markers, read_trc, write_trc
from myowarp.motion.movement import write_angles
from myowarp.motion.muscle_forces import muscle_forces
from myowarp.motion.smooth import derivatives
from myowarp.motion.storage import Storage, read_storage, write_storage
from myowarp.motion.tasks import tasks_of
from myowarp.osim.body.muscle_paths import muscle_paths
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.read.element import parse
from myowarp.osim.document.read.model import read_model

COPIES = (1, 10)
"""Of the trial that OpenSim gets."""
SPAN = (0.4, 1.6)
NOISE = 1e-3  # m


@dataclass
class Options:
    """Measure beside OpenSim; the trial is no part of this repository, see shared/osim/motion."""

    trial: Path = ROOT / "../shared/osim/motion/gait2354"
    """Folder of OpenSim's Gait2354 example."""
    opensim: Path = ROOT / ".venv-opensim/bin/python"
    """Interpreter with OpenSim."""
    frames: int = 10_000
    """Frames that we solve."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out/motion.json")
    """JSON file."""


def timed(run: Callable[[], object], others: list[float]) -> np.ndarray:
    """Return wall and CPU time of a run after one that compiles [s]; notes what others kept busy."""

    def both() -> np.ndarray:
        begin, used = time.perf_counter(), time.process_time()
        run()
        return np.array((time.perf_counter() - begin, time.process_time() - used))

    both()
    seconds, busy = least_disturbed(timed_here(both))
    others.append(busy)
    return seconds


def tiled(markers: Markers, copies: int) -> Markers:
    """Return copies of a trial after each other, with noise."""
    step = float(np.diff(markers.time).mean())
    positions = np.tile(markers.positions, (copies, 1, 1))
    positions = positions + NOISE * np.random.default_rng(0).normal(size=positions.shape)
    return Markers(markers.names, SPAN[0] + step * np.arange(len(positions)), positions)


def theirs(
    options: Options, bones: Bones, markers: Markers, angles: np.ndarray, copies: int
) -> dict[str, float]:
    """Return OpenSim's CPU seconds by tool."""
    many = tiled(markers, copies)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(options.trial / "reference_subject01_simbody.osim", folder / "model.osim")
        shutil.copy(options.trial / "subject01_Setup_IK.xml", folder / "ik.xml")
        shutil.copy(options.trial / "subject01_walk1_grf.xml", folder / "grf.xml")
        write_trc(folder / "walk.trc", many)
        write_angles(
            folder / "ik.mot", bones.model, bones.coordinates, many.time, np.tile(angles, (copies, 1))
        )
        forces = read_storage(options.trial / "subject01_walk1_grf.mot")
        last = SPAN[0] + copies * (SPAN[1] - SPAN[0]) + 1.0
        time_ = np.arange(0.0, last, float(np.diff(forces.time).mean()))
        rows = np.resize(np.arange(len(forces.time)), len(time_))
        write_storage(
            folder / "subject01_walk1_grf.mot", "grf", Storage(forces.labels, time_, forces.values[rows])
        )
        command = [
            options.opensim,
            ROOT / "benchmarks/motion_opensim.py",
            folder,
            many.time[0],
            many.time[-1],
        ]
        done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=True)
    line = next(line for line in done.stdout.splitlines() if line.startswith("RESULT "))
    return dict(json.loads(line.removeprefix("RESULT ")))


def main() -> None:
    """Measure, print, write."""
    options = tyro.cli(Options)
    others: list[float] = []
    bones = Bones(read_model(options.trial / "reference_subject01_simbody.osim"))
    tasks = tasks_of(parse(options.trial / "subject01_Setup_IK.xml")[0])
    markers = read_trc(options.trial / "subject01_walk1.trc").between(*SPAN)
    weights = {name: weight for name, weight in tasks.markers.items() if name in markers.names}
    one = inverse_kinematics(bones, markers, weights, tasks.coordinates)
    times = [theirs(options, bones, markers, one.values, copies) for copies in COPIES]
    more = (COPIES[1] - COPIES[0]) * len(markers.time)
    opensim = {name: (times[1][name] - times[0][name]) / more for name in times[0]}

    many = tiled(markers, -(-options.frames // len(markers.time)))
    many = Markers(many.names, many.time[: options.frames], many.positions[: options.frames])
    ours = {
        "inverse kinematics": timed(
            lambda: inverse_kinematics(bones, many, weights, tasks.coordinates), others
        )
    }
    grf = options.trial / "subject01_walk1_grf.xml"
    q, u, a = (
        np.resize(x, (options.frames, x.shape[1]))
        for x in derivatives(markers.time, one.values, markers.time, 6.0)
    )
    loads = loads_at(grf, np.resize(markers.time, options.frames)[: len(markers.time)])
    for load in loads:
        for part in ("force", "point", "torque"):
            object.__setattr__(load, part, np.resize(getattr(load, part), (options.frames, 3)))
    needed = inverse_dynamics(bones, q, u, a, loads)
    ours["inverse dynamics"] = timed(lambda: inverse_dynamics(bones, q, u, a, loads), others)
    reserves = {name: 1000.0 if name.startswith("pelvis") else 10.0 for name in bones.coordinates}
    paths = muscle_paths(bones, q, u)

    def optimise() -> object:
        return muscle_forces(
            bones.model, bones.coordinates, paths, needed.joint_moment, mode="opensim", reserves=reserves
        )

    ours["static optimisation"] = timed(optimise, others)
    ours["paths of muscles"] = timed(lambda: muscle_paths(bones, q, u), others)
    ours["paths and static optimisation"] = ours["paths of muscles"] + ours["static optimisation"]
    opensim["paths and static optimisation"] = opensim["static optimisation"]
    frame = {name: dict(zip(("wall", "cpu"), seconds / options.frames, strict=True))
             for name, seconds in ours.items()}  # fmt: skip
    table = Table("ms a frame", "OpenSim", "MyoWarp", "its CPU time", "frames/s", "ratio", "of CPU times")
    for name, own in frame.items():
        there = opensim.get(name)
        ratios = ("", "") if there is None else tuple(f"{there / own[kind]:.0f}" for kind in ("wall", "cpu"))
        left = "" if there is None else f"{1e3 * there:.2f}"
        shown = f"{1e3 * own['wall']:.4f}", f"{1e3 * own['cpu']:.4f}", f"{1 / own['wall']:.0f}"
        table.add_row(name, left, *shown, *ratios)
    Console().print(table)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    result = {
        "processor": processor(),
        "cores_busy_with_others": disturbances(others),
        "frames": options.frames,
        "opensim": opensim,
    }
    options.output.write_text(json.dumps(result | {"myowarp": frame}, indent=2, default=str) + "\n")


if __name__ == "__main__":
    main()

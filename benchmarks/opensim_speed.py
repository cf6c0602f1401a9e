"""Forward simulation in OpenSim 4.6, MuJoCo C and MyoWarp with 1 to 64 times the muscles, in one run.

    make opensim OPENSIM="arm26.osim gait2354_simbody.osim"

Every model is converted once; then each muscle is replicated, every copy with its share of the force, so that
the motion stays the same (`replicas.py`). All start in the default pose with a constant excitation. Every
contestant is a process of its own that is up all the time; only one simulates at a time, in rounds. Rates are
simulated seconds per second of wall time, in a batch those of all worlds together.
"""

import json
import os
import platform
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import tyro
import warp as wp
from rich.console import Console
from rich.progress import Progress

from benchmarks.machine import disturbances, processor
from benchmarks.opensim_report import draw, print_tables
from benchmarks.replicas import EXCITATION
from benchmarks.rivals import ROOT, Worker, start, take_turns

OPENSIM = "OpenSim"
DIFFERENCES = {
    "muscles": "OpenSim's muscles have elastic tendons and a state for each fiber; the converted ones have "
    "rigid tendons, which is why larger steps are stable. Their forces are fitted (myowarp convert).",
    "steps": "OpenSim's Manager with its Runge-Kutta-Merson integrator chooses its steps for the stated "
    "accuracy; MuJoCo C and MyoWarp take the converted file's steps of 2 ms, implicitfast.",
    "precision": "OpenSim and MuJoCo C compute in float64, MyoWarp in float32.",
    "worlds": "OpenSim and MuJoCo C simulate one world in one thread, MyoWarp a batch; its rate is the sum.",
    "timed": "Whole episodes from the default pose, resets and OpenSim's Manager.initialize included; not "
    "building models and compiling kernels.",
}


@dataclass
class Options:
    """Measure MyoWarp beside OpenSim.

    The models are no part of this repository: by default they are looked for in shared/osim beside it. They
    are arm26.osim and gait2354_simbody.osim of OpenSim's collection, github.com/opensim-org/opensim-models.
    """

    models: tyro.conf.Positional[tuple[Path, ...]] = (
        ROOT / "../shared/osim/arm26.osim",
        ROOT / "../shared/osim/gait2354_simbody.osim",
    )
    """Models, .osim."""
    durations: tuple[float, ...] = (0.5, 0.06)
    """Simulated time of an episode for each model [s], a multiple of 0.02 s."""
    copies: tuple[int, ...] = (1, 2, 4, 8, 16, 32, 64)
    """Numbers of copies of each muscle."""
    worlds: int = 64
    """Worlds of MyoWarp on the CPU."""
    gpu_worlds: int = 1024
    """Worlds of MyoWarp on a GPU, where there is one."""
    opensim_python: Path = ROOT / ".venv-opensim/bin/python"
    """Python of an environment with opensim==4.6."""
    output: Path = Path("out/opensim_speed.json")
    """JSON file to write; the plot goes beside it."""
    rounds: int = 3
    """Rounds; the median counts."""
    seconds: float = 0.4
    """Least duration of one measurement."""
    quick: bool = False
    """1 and 8 copies, the first model, 8 worlds, two rounds: does everything run?"""

    def __post_init__(self) -> None:
        """Check the files, and cut down to what is quick."""
        if missing := [path for path in (self.opensim_python, *self.models) if not path.exists()]:
            raise ValueError(f"{str(missing[0])!r} does not exist; give models, and make .venv-opensim first")
        if len(self.durations) != len(self.models):
            raise ValueError(
                f"--durations needs one for each of the {len(self.models)} models, got {len(self.durations)}"
            )
        if self.quick:
            self.models, self.durations, self.copies = self.models[:1], (0.1,), (1, 8)
            self.worlds, self.rounds, self.seconds = 8, 2, 0.2


def line_up(source: Path, converted: Path, options: Options, log: Any, **settings: Any) -> list[Worker]:
    """Start all contestants for one number of copies, at once, and wait until they are ready."""
    cores, ours = len(os.sched_getaffinity(0)), Path(sys.executable)
    wanted: list[tuple[str, Path, dict[str, Any]]] = []
    for name, accuracy in ((OPENSIM, 1e-5), (f"{OPENSIM}, accuracy 1e-3", 1e-3)):
        arguments = {"kind": "opensim", "model": str(source), "accuracy": accuracy}
        wanted.append((name, options.opensim_python, arguments))
    wanted.append(("MuJoCo C, 1 thread", ours, {"kind": "mujoco_c", "model": str(converted)}))
    batch = {"kind": "myowarp", "model": str(converted), "worlds": options.worlds, "device": "cpu"}
    wanted.append(("MyoWarp, 1 core", ours, batch | {"shards": 1}))
    if cores > 1:
        wanted.append((f"MyoWarp, {cores} cores", ours, batch | {"shards": cores}))
    if wp.is_cuda_available():
        gpu = {"device": "cuda:0", "worlds": options.gpu_worlds, "shards": 1}
        wanted.append(("MyoWarp, GPU", ours, batch | gpu))
    workers = [
        start(name, python, log, script="replicas.py", **arguments, **settings)
        for name, python, arguments in wanted
    ]
    for worker in workers:
        worker.await_first_step(timed=False)
    return workers


def measure(workers: list[Worker], options: Options, tell: Any) -> dict[str, Any]:
    """Return figures of all contestants."""
    take_turns(workers, options.rounds, options.seconds, tell)
    rival = [sample["rate"] for sample in workers[0].samples]
    rows = {}
    for worker in workers:
        rates = [sample["rate"] for sample in worker.samples]
        ratios = [ours / theirs for ours, theirs in zip(rates, rival, strict=True)]
        rows[worker.name] = worker.facts | {
            "rate": spread(rates),
            "over_opensim": spread(ratios),
            "cpu_over_wall": spread([sample["cpu"] / sample["wall"] for sample in worker.samples]),
            "peak_memory_mb": round(max(sample["memory"] for sample in worker.samples)),
            "cores_busy_with_others": [round(sample["others"], 3) for sample in worker.samples],
            "pose": worker.samples[-1]["pose"],
        }
    return rows


def spread(values: list[float]) -> dict[str, float]:
    """Return median, least and greatest."""
    figures = {"median": statistics.median(values), "min": min(values), "max": max(values)}
    return {key: float(f"{value:.4g}") for key, value in figures.items()}


def poses(rows: dict[str, dict[str, Any]], first: dict[str, Any], coordinates: list[Any]) -> None:
    """Replace end poses by how far they are from OpenSim's, in place.

    Args:
        rows: What `measure` returned.
        first: End poses with one copy, by contestant.
        coordinates: Of coordinates.json: what joint shows a coordinate, at which scale.
    """
    angles = [row for row in coordinates if row["kind"] == "free" and row["rotational"]]
    reference = rows[OPENSIM]["pose"]
    for name, row in rows.items():
        pose, own = row.pop("pose"), name.startswith(OPENSIM)
        found = [pose[c["name"]] if own else pose[c["joint"]] / c["scale"] for c in angles]
        error = np.array(found) - [reference[c["name"]] for c in angles]
        row["angles_off_opensim_rad"] = {
            "rms": float(f"{np.sqrt(np.mean(error**2)):.3g}"),
            "max": float(f"{np.abs(error).max():.3g}"),
        }
        moved = max(abs(pose[key] - first[name][key]) for key in pose)
        row["moved_by_replication"] = float(f"{moved:.2g}")


def measure_model(source: Path, duration: float, options: Options, log: Any, bar: Any) -> dict[str, Any]:
    """Return the figures of one model for all numbers of copies."""
    folder = options.output.parent / source.stem
    bar(f"{source.stem}: converting", 0)
    command = [sys.executable, "-m", "myowarp.apps.cli.main", "convert", str(source), "-o", str(folder)]
    subprocess.run(command, check=True, stdout=log, stderr=log)
    coordinates = json.loads((folder / "coordinates.json").read_text())["coordinates"]
    rows: dict[str, Any] = {}
    first: dict[str, Any] = {}
    for copies in options.copies:

        def tell(what: str, copies: int = copies) -> None:
            bar(f"{source.stem}, {copies} x: {what}", 0)

        tell("starting")
        files = source, folder / "model.xml"
        workers = line_up(*files, options, log, copies=copies, duration=duration)
        rows[str(copies)] = found = measure(workers, options, tell)
        first = first or {name: row["pose"] for name, row in found.items()}
        poses(found, first, coordinates)
        rates = (f"{name} {row['rate']['median']:g}" for name, row in found.items())
        bar(f"{source.stem}, {copies} x: {' | '.join(rates)}", 1)
    return {"duration": duration, "copies": rows}


def main() -> None:
    """Measure, print tables, write JSON and plot."""
    options = tyro.cli(Options, prog="python -m benchmarks.opensim_speed")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    begin, load, models = time.perf_counter(), os.getloadavg()[0], {}
    log_path = options.output.with_suffix(".log")
    with log_path.open("w") as log, Progress(console=Console(stderr=True, soft_wrap=True)) as progress:
        task = progress.add_task("", total=len(options.models) * len(options.copies))

        def bar(what: str, done: int) -> None:
            progress.update(task, description=what, advance=done)
            if done:
                progress.console.print(what, highlight=False)

        for source, duration in zip(options.models, options.durations, strict=True):
            models[source.stem] = measure_model(source, duration, options, log, bar)
    rows = [row for model in models.values() for found in model["copies"].values() for row in found.values()]
    others = [cores for row in rows for cores in row["cores_busy_with_others"]]
    report: dict[str, Any] = {
        "processor": processor(),
        "cores": len(os.sched_getaffinity(0)),
        "gpu": wp.get_device("cuda:0").name if wp.is_cuda_available() else None,
        "python": platform.python_version(),
        "versions": {name: version(name) for name in ("mujoco", "mujoco-warp", "warp-lang")}
        | {"opensim": installed(options.opensim_python)},
        "rounds": options.rounds,
        "excitation": EXCITATION,
        "minutes": round((time.perf_counter() - begin) / 60, 2),
        "load_before": round(load, 2),
        "cores_busy_with_others": disturbances(others),
        "differences": DIFFERENCES,
        "models": models,
    }
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    draw(report, options.output.with_suffix(".png"))
    print_tables(report, Console(width=None if sys.stdout.isatty() else 160))


def installed(python: Path) -> str:
    """Return the version of OpenSim in an environment."""
    code = "import importlib.metadata as m; print(m.version('opensim'))"
    return subprocess.run([python, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


if __name__ == "__main__":
    main()

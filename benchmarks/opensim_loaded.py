"""Forward simulation of OpenSim models as they are, beside OpenSim 4.6 in one run.

    python -m benchmarks.opensim_loaded ../shared/osim/more/MoBL_ARMS.osim ... --python PYTHON

PYTHON has opensim==4.6 (`make .venv-opensim/.installed`). All start in the default pose with a constant
excitation. MyoWarp steps the file as `myowarp.from_osim` loads it (OpenSim's paths, the file's muscles, 2 ms,
implicitfast, float32) in a batch on one core, with the rays of an ellipsoid's fan sampled, and all of them
(`exact`); OpenSim one world (Runge-Kutta-Merson, accuracy 1e-5). Every contestant is a process of its own
that is up all the time; only one simulates at a time, in rounds. Rates are simulated seconds per second of
processor time, in a batch those of all worlds together. Writes benchmarks/results/opensim_loaded.json after
each model.
"""

import argparse
import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

from benchmarks.machine import processor
from benchmarks.opensim_speed import spread
from benchmarks.rivals import ROOT, start, take_turns
from myowarp.osim.convert.load import load

RESULT = Path(__file__).parent / "results" / "opensim_loaded.json"
OPENSIM = "OpenSim"


def exact(source: Path, work: Path) -> Path:
    """Return model.xml of a model whose fans have all rays."""
    folder = work / source.stem
    shutil.copytree(load(source).parent, folder, dirs_exist_ok=True)
    paths = folder / "paths.json"
    paths.write_text(json.dumps(json.loads(paths.read_text()) | {"exact": True}))
    return folder / "model.xml"


def measured(source: Path, options: argparse.Namespace, log: Any) -> dict[str, Any]:
    """Return the rates of all contestants for one model."""
    batch = {"kind": "myowarp", "worlds": options.worlds, "device": "cpu", "shards": 1, "copies": 0}
    ours = Path(sys.executable)
    wanted: list[tuple[str, Path, dict[str, Any]]] = [
        (OPENSIM, options.python, {"kind": "opensim", "model": str(source), "accuracy": 1e-5, "copies": 1}),
        ("MyoWarp", ours, batch | {"model": str(source)}),
        ("MyoWarp, exact", ours, batch | {"model": str(exact(source, options.work))}),
    ]
    workers = []
    for name, python, arguments in wanted:
        worker = start(name, python, log, script="replicas.py", duration=options.duration, **arguments)
        worker.await_first_step(timed=False)
        workers.append(worker)
    take_turns(workers, options.rounds, options.seconds, lambda what: print(source.stem, what, flush=True))
    rows: dict[str, Any] = {"duration": options.duration}
    rates = {
        worker.name: [sample["rate"] * sample["wall"] / sample["cpu"] for sample in worker.samples]
        for worker in workers
    }
    for worker in workers:
        ratios = [mine / theirs for mine, theirs in zip(rates[worker.name], rates[OPENSIM], strict=True)]
        rows[worker.name] = worker.facts | {
            "rate": spread(rates[worker.name]),
            "over_opensim": spread(ratios),
            "cores_busy_with_others": [round(sample["others"], 3) for sample in worker.samples],
        }
    return rows


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("--python", type=Path, default=ROOT / ".venv-opensim/bin/python")
    parser.add_argument("--duration", type=float, default=0.06, help="of an episode [s], multiple of 0.02")
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=2.0, help="least duration of a measurement")
    parser.add_argument("--work", type=Path, default=Path("out/opensim_loaded"))
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    result = json.loads(RESULT.read_text()) if RESULT.is_file() else {"models": {}}
    with (options.work / "contestants.log").open("w") as log:
        for source in options.models:
            result |= {"processor": processor(), "cores": len(os.sched_getaffinity(0))}
            result["models"][source.stem] = found = measured(source, options, log)
            print(source.stem, json.dumps(found, indent=1), flush=True)
            RESULT.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()

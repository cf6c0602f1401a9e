"""Time of function paths beside the wraps that they were fitted to.

    python -m benchmarks.function_paths ../shared/osim/more/gait2392_millard2012muscle.osim

All models are the file as `myowarp.from_osim` loads it: as it is, with the set of `myowarp convert
--fit-paths`, and with one of order 5 at most, as Moco's examples have. Worlds are in states that random
actions reach. `paths` is what places and follows all paths, and writes their moment arms; `step` is the whole
physics step. Microseconds are CPU time of this thread for one world, the least of all rounds. Writes
benchmarks/results/function_paths.json.
"""

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

import warp as wp

from benchmarks.machine import processor
from benchmarks.substep import Options, Physics
from myowarp.engine.compile import quiet
from myowarp.engine.graph import Graph
from myowarp.osim.convert.function_paths import FILES, MOST_ORDER, write_fitted
from myowarp.tasks.from_file import from_osim

RESULT = Path(__file__).parent / "results" / "function_paths.json"
ROUNDS, WORLDS, WARMUP, REPEATS = 12, 64, 10, 10
ORDERS = {"functions": MOST_ORDER, "functions of order 5": 5}


def times(source: Path, functions: Path | None) -> dict[str, list[float]]:
    """Return microseconds of a world: of its paths, and of its physics step, in each round."""
    spec = from_osim(source, function_paths=functions, stops=False)
    physics = Physics(spec, WORLDS, Options(warmup=WARMUP))
    scene, step = physics.scene, physics.all_stages()
    if scene.paths is None:
        raise ValueError(f"{source} must have paths of its own")
    with quiet(), wp.ScopedDevice(scene.device):
        graph = Graph(lambda: scene.paths.launch(scene.model, scene.data), scene.device)
    found: dict[str, list[float]] = {"paths": [], "step": []}
    for _ in range(ROUNDS):
        found["step"].append(step())
        begin = time.thread_time()
        for _ in range(REPEATS):
            graph.launch()
        found["paths"].append(1e6 * (time.thread_time() - begin) / (REPEATS * WORLDS))
    return found


def measure(source: Path, work: Path) -> dict[str, Any]:
    """Return the figures of one model."""
    load, rows = os.getloadavg()[0], {"wraps": times(source, None)}
    for name, order in ORDERS.items():
        folder = work / source.stem / str(order)
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / FILES[0]).is_file():
            print(write_fitted(source, folder, order))
        rows[name] = times(source, folder / FILES[0])
    least = {name: {part: round(min(taken), 2) for part, taken in row.items()} for name, row in rows.items()}
    wraps = least["wraps"]
    return {
        "microseconds": least,
        "wraps_over": {
            name: {part: round(wraps[part] / least[name][part], 2) for part in wraps} for name in ORDERS
        },
        "load_before_and_after": [round(load, 2), round(os.getloadavg()[0], 2)],
    }


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("--work", type=Path, default=Path("out/function_paths"))
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    options = parser.parse_args()
    result: dict[str, Any] = {"processor": processor(), "num_worlds": WORLDS, "rounds": ROUNDS, "models": {}}
    for source in options.models:
        result["models"][source.stem] = found = measure(source, options.work)
        print(source.stem, json.dumps(found, indent=1), flush=True)
    options.output.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()

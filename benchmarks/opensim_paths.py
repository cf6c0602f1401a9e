"""Muscle paths beside OpenSim's in random poses: lengths, moment arms, speeds, and which points they take.

    .venv-opensim/bin/python benchmarks/opensim_paths_record.py MODEL.osim ... -o out/paths
    python -m benchmarks.opensim_paths MODEL.osim ... --recorded out/paths

or `make opensim-check`. The first needs OpenSim 4.6 and records, each pose from a copy of the initial state.
The second needs none, and writes benchmarks/results/opensim_paths.json. Two things are compared: `paths`, the
kernel with float64 frames, the guard against OpenSim's jumps off; and `step`, the model as
`myowarp.from_osim` loads it, with float32 frames, the guard on. Where the guard acts is counted, and left out
of `step`.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import processor
from myowarp.coordinates.step import step_of
from myowarp.laws.paths.tables import TURNS
from myowarp.osim.body.path_solution import lengths_and_moment_arms
from myowarp.osim.bundle.coordinate_map import CoordinateMap
from myowarp.osim.convert.load import load
from myowarp.osim.document.model import Model
from myowarp.osim.document.read.model import read_model
from myowarp.sim.build import compile_scene, stepped_of
from myowarp.tasks.from_file import from_osim

RESULT = Path(__file__).parent / "results" / "opensim_paths.json"
WORLDS = 100
SAME = 1e-5  # m: within that a path runs as OpenSim's
LEAST = 1e-3  # m/s: least speed that errors are a share of


def compare(source: Path, recorded: Path) -> dict[str, Any]:
    """Return the errors of one model."""
    record, model = np.load(recorded / f"paths_{source.stem}.npz"), read_model(source)
    free, muscles = record["free"].tolist(), record["muscles"].tolist()
    if free != model.independent:
        raise ValueError(f"{source}: coordinates of the recording are not those of the model; record it anew")
    values = dict(zip(record["coordinates"].tolist(), record["values"].T, strict=True))
    paths = {name: model.muscles[name].path for name in muscles}
    begin, own = time.perf_counter(), {name: values[name] for name in free}
    found = lengths_and_moment_arms(model, paths, own, record["speeds"])
    seconds = time.perf_counter() - begin
    jumps = lengths_and_moment_arms(model, paths, own, record["speeds"], TURNS).jumps
    length, arm, velocity = stepped(source, model, own, record["speeds"], muscles)
    known = np.isfinite(record["length"])
    calm = known & ~jumps
    same = np.abs(found.length - record["length"]) <= SAME
    return {
        "model": source.stem,
        "muscles": len(muscles),
        "poses": len(record["length"]),
        "poses_with_moment_arms": len(record["moment_arm"]),
        "opensim": str(record["version"]),
        "paths": errors(record, muscles, free, found.length, found.moment_arm, found.velocity, known)
        | {
            "other_points": int((found.size != record["size"])[known].sum()),
            "other_lengths": int((~same)[known].sum()),
            "seconds": round(seconds, 3),
        },
        "step": errors(record, muscles, free, length, arm, velocity, calm)
        | {"other_lengths": int((np.abs(length - record["length"]) > SAME)[calm].sum())},
        "jumps": {name: int(count) for name, count in zip(muscles, jumps.sum(axis=0), strict=True) if count},
        "no_length_in_opensim": int((~known).sum()),
        "opensim_seconds": round(float(record["seconds"]), 3),
    }


def errors(
    record: Any,
    muscles: list[str],
    free: list[str],
    length: np.ndarray,
    arm: np.ndarray,
    velocity: np.ndarray,
    kept: np.ndarray,
) -> dict[str, Any]:
    """Return median and worst errors, and where they are worst: [mm], and shares of speeds."""
    count = len(record["moment_arm"])
    off = np.where(kept, np.abs(length - record["length"]), 0.0) * 1e3
    arms = np.where(kept[:count, :, None], np.abs(arm[:count] - record["moment_arm"]), 0.0) * 1e3
    speeds = np.where(kept, np.abs(velocity - record["velocity"]), 0.0)
    shares = speeds / np.maximum(np.abs(record["velocity"]), LEAST)
    place = np.unravel_index(arms.argmax(), arms.shape)
    return {
        "length_mm": {
            "median": float(np.median(off)),
            "p9999": float(np.quantile(off, 0.9999)),
            **worst(off, muscles),
        },
        "moment_arm_mm": {
            "median": float(np.median(arms)),
            "p9999": float(np.quantile(arms, 0.9999)),
            "worst": float(arms.max()),
            "where": f"{muscles[place[1]]}, {free[place[2]]}",
        },
        "velocity_share": {"p9999": float(np.quantile(shares, 0.9999)), **worst(shares, muscles)},
    }


def worst(values: np.ndarray, muscles: list[str]) -> dict[str, Any]:
    """Return the greatest value and whose it is."""
    return {"worst": float(values.max()), "where": muscles[values.max(axis=0).argmax()]}


def stepped(
    source: Path, model: Model, values: dict[str, np.ndarray], speeds: np.ndarray, muscles: list[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return lengths, moment arms and speeds of the physics step, in the model's order of coordinates."""
    coordinates = CoordinateMap.read(load(source).with_name("coordinates.json"))
    scene = compile_scene(from_osim(source), WORLDS, device="cpu", physics="parity")
    launch, data, host = step_of(stepped_of(scene)).launches(), scene.data, scene.oracle
    tendons = [host.tendon(name).id for name in muscles]
    rows = np.repeat(np.arange(host.ntendon), scene.model.ten_J_rownnz.numpy())
    columns = scene.model.ten_J_colind.numpy()[: len(rows)]
    order = [model.independent.index(name) for name in coordinates.free()]
    count = len(speeds)
    length, velocity = np.zeros((count, len(muscles))), np.zeros((count, len(muscles)))
    arm = np.zeros((count, len(muscles), len(order)))
    for first in range(0, count, WORLDS):
        chosen = np.minimum(np.arange(first, first + WORLDS), count - 1)
        qpos, slope = coordinates.rates(host, {name: value[chosen] for name, value in values.items()})
        data.qpos.assign(qpos)
        data.qvel.assign(np.einsum("nij,nj->ni", slope, speeds[chosen][:, order]))
        launch()
        jacobian = np.zeros((WORLDS, host.ntendon, host.nv))
        jacobian[:, rows, columns] = data.ten_J.numpy()[:, : len(rows)]
        length[chosen] = data.ten_length.numpy()[:, tendons]
        velocity[chosen] = data.ten_velocity.numpy()[:, tendons]
        arm[np.ix_(chosen, range(len(muscles)), order)] = -np.einsum(
            "ntj,njk->ntk", jacobian[:, tendons], slope
        )
    return length, arm, velocity


def main() -> None:
    """Compare the models that are named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("--recorded", type=Path, default=Path("out/paths"))
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    asked = parser.parse_args()
    rows = []
    for source in asked.models:
        rows.append(compare(source, asked.recorded))
        print(json.dumps(rows[-1], indent=1), flush=True)
    asked.output.parent.mkdir(parents=True, exist_ok=True)
    asked.output.write_text(json.dumps({"processor": processor(), "models": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()

"""Record what OpenSim says about muscle paths in random poses, for `benchmarks.opensim_paths`.

    .venv-opensim/bin/python benchmarks/opensim_paths_record.py MODEL.osim ... --poses 2000 -o out/paths

Needs opensim==4.6 and numpy, and nothing of ours. Every model gives `paths_<file>.npz` in the folder: numbers
alone, no part of a model. Every free coordinate is uniform over its full range, others follow couplers;
speeds are normal, 1 rad/s or m/s. Each pose begins with a copy of the initial state. Arrays, for n poses, in
m and rad:

    coordinates (c,), values (n, c)      names and values of all coordinates
    free (f,), speeds (n, f)             names and speeds of the independent coordinates
    muscles (m,), length (n, m)          getLength
    size (n, m)                          points of the current path, wrap points included
    velocity (n, m)                      getLengtheningSpeed
    moment_arm (k, m, f)                 computeMomentArm in the first k poses
    seconds ()                           that lengths and speeds took, in one thread
    version ()                           of OpenSim
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import opensim

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "data"))
from record_opensim_paths import Posed

SEED = 7


def record(file: Path, count: int, with_arms: int) -> dict[str, Any]:
    """Return the arrays of one model."""
    posed = Posed(file)
    initial = opensim.State(posed.state)
    random = np.random.default_rng(SEED)
    poses = random.uniform(*posed.ranges(), (count, len(posed.free)))
    speeds = random.normal(size=(count, len(posed.free)))
    paths = [opensim.GeometryPath.safeDownCast(muscle.getPath()) for muscle in posed.muscles]
    shape = count, len(posed.muscles)
    values: list[Any] = []
    length, velocity, size = np.zeros(shape), np.zeros(shape), np.zeros(shape, np.int8)
    arms = np.zeros((min(with_arms, count), len(posed.muscles), len(posed.free)))
    seconds = 0.0
    for row, pose in enumerate(poses):
        posed.state = opensim.State(initial)
        values.append(posed.set(pose))
        for item, rate in zip(posed.coordinates, posed.rates(speeds[row], values[-1]), strict=True):
            item.setSpeedValue(posed.state, float(rate))
        begin = time.perf_counter()
        posed.model.realizeVelocity(posed.state)
        length[row] = posed.lengths()
        velocity[row] = [muscle.getLengtheningSpeed(posed.state) for muscle in posed.muscles]
        seconds += time.perf_counter() - begin
        size[row] = [path.getCurrentPath(posed.state).getSize() for path in paths]
        if row < len(arms):
            for column, muscle in enumerate(posed.muscles):
                arms[row, column] = [muscle.computeMomentArm(posed.state, item) for item in posed.free]
        if row % 100 == 99:
            print(f"{file.stem}: {row + 1} of {count} poses", file=sys.stderr, flush=True)
    return {
        "coordinates": posed.names,
        "values": values,
        "free": [item.getName() for item in posed.free],
        "speeds": speeds,
        "muscles": [muscle.getName() for muscle in posed.muscles],
        "length": length,
        "size": size,
        "velocity": velocity,
        "moment_arm": arms,
        "seconds": seconds,
        "version": opensim.GetVersion(),
    }


def main() -> None:
    """Record the models that are named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("--poses", type=int, default=2000)
    parser.add_argument(
        "--arms", type=int, default=200, help="poses with moment arms, which take OpenSim long"
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("out/paths"))
    asked = parser.parse_args()
    opensim.Logger.setLevelString("Off")
    asked.output.mkdir(parents=True, exist_ok=True)
    for file in asked.models:
        np.savez(asked.output / f"paths_{file.stem}.npz", **record(file, asked.poses, asked.arms))


if __name__ == "__main__":
    main()

"""Record what OpenSim says about the muscles of an arm, for `myowarp reproduce validation`.

    .venv-opensim/bin/python benchmarks/opensim_arms.py arm26.osim MoBL_ARMS.osim

Needs opensim==4.6 and nothing else. It writes numbers alone, no part of a model: lengths, moment arms and
static tendon forces over the range of one coordinate after the other, all others at their default; and the
passive fiber's force along the tendon at OpenSim's least activation; and where the markers are.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import opensim

OUTPUT = Path(__file__).parents[1] / "myowarp/apps/studies/reproduce/opensim_arms.json"
POINTS = 21
ACTIVATIONS = (0.5, 1.0)
STEP = 1e-5  # rad
PRESENT = 1e-4  # m; a muscle with smaller arms throughout does not cross the joint
RANGES = {  # rad; of a body's joint: where both OpenSim's coordinate and the joint go
    "arm26": {"r_elbow_flex": (0.0, 2.2689), "r_shoulder_elev": (-1.5707, 3.1415)},
    "MoBL_ARMS": {
        **{"pro_sup": (-1.5707, 1.5707), "deviation": (-0.1745, 0.4363), "flexion": (-0.7854, 0.7854)},
        **{"elv_angle": (-1.5707, 2.2689), "shoulder_elv": (0.0, 3.1415), "shoulder_rot": (-1.5707, 0.349)},
        "elbow_flexion": (0.0, 2.2689),
    },
}
UNIT = {"length": 7, "moment_arm": 7, "slope": 7, "force": 3, "passive": 3}  # decimals


def record(path: Path) -> dict[str, Any]:
    """Return the curves of all muscles that cross a coordinate."""
    model = opensim.Model(str(path))
    muscles, coordinates = model.getMuscles(), model.getCoordinateSet()
    for i in range(coordinates.getSize()):
        coordinates.get(i).setDefaultLocked(False)
    state = model.initSystem()
    rows: list[dict[str, Any]] = []
    paths: dict[str, dict[str, Any]] = {}
    for name, ends in RANGES[path.stem].items():
        coordinate = coordinates.get(name)
        rest = coordinate.getDefaultValue()
        grid = np.linspace(*ends, POINTS)
        print(f"{path.stem}: {name}", file=sys.stderr)
        paths[name] = markers(model, state, coordinate, grid)
        for i in range(muscles.getSize()):
            muscle = muscles.get(i)
            row = curves(model, state, muscle, coordinate, grid)
            if np.abs(row["slope"]).max() > PRESENT:
                peak = muscle.getMaxIsometricForce()
                rows.append(
                    {"muscle": muscle.getName(), "coordinate": name, "max_isometric_force": peak, **row}
                )
        coordinate.setValue(state, rest, True)
    defaults = {
        coordinates.get(i).getName(): coordinates.get(i).getDefaultValue()
        for i in range(coordinates.getSize())
    }
    return {
        "model": model.getName(),
        "credits": " ".join(model.get_credits().split()),
        "ranges": RANGES[path.stem],
        "defaults": {name: round(value, 6) for name, value in defaults.items()},
        "curves": rows,
        "markers": paths,
    }


def markers(model: Any, state: Any, coordinate: Any, grid: np.ndarray) -> dict[str, Any]:
    """Return where each marker is in the ground frame over a coordinate [m], (K, 3)."""
    listed = model.getMarkerSet()
    found: dict[str, list[list[float]]] = {listed.get(i).getName(): [] for i in range(listed.getSize())}
    for value in grid:
        coordinate.setValue(state, value, True)
        model.realizePosition(state)
        for i in range(listed.getSize()):
            place = listed.get(i).getLocationInGround(state)
            found[listed.get(i).getName()].append([round(place.get(k), 7) for k in range(3)])
    return found


def curves(model: Any, state: Any, muscle: Any, coordinate: Any, grid: np.ndarray) -> dict[str, Any]:
    """Return length, moment arm in both of OpenSim's senses, and force of a muscle over a coordinate."""
    found: dict[str, list[Any]] = {name: [] for name in UNIT}

    def length(value: float) -> float:
        coordinate.setValue(state, value, True)
        model.realizePosition(state)
        return muscle.getLength(state)

    for value in grid:
        found["slope"].append(-(length(value + STEP) - length(value - STEP)) / (2.0 * STEP))
        found["length"].append(length(value))
        found["moment_arm"].append(muscle.getGeometryPath().computeMomentArm(state, coordinate))
        forces = []
        for activation in ACTIVATIONS:
            muscle.setActivation(state, activation)
            try:
                muscle.computeEquilibrium(state)
                model.realizeDynamics(state)
                forces.append(round(muscle.getTendonForce(state), UNIT["force"]))
            except RuntimeError:
                forces.append(None)  # no equilibrium
        found["force"].append(forces)
        muscle.setActivation(state, 0.0)
        try:
            muscle.computeEquilibrium(state)
            model.realizeDynamics(state)
            found["passive"].append(round(muscle.getPassiveFiberForceAlongTendon(state), UNIT["passive"]))
        except RuntimeError:
            found["passive"].append(None)
    rounded = ("length", "moment_arm", "slope")
    return {name: np.round(v, UNIT[name]).tolist() if name in rounded else v for name, v in found.items()}


def main() -> None:
    """Record the models that are named."""
    opensim.Logger.setLevelString("Off")
    table = {
        "opensim": opensim.GetVersion(),
        "points": POINTS,
        "activations": ACTIVATIONS,
        "models": {Path(path).stem: record(Path(path)) for path in sys.argv[1:]},
    }
    OUTPUT.write_text(json.dumps(table, separators=(",", ":")).replace('{"muscle"', '\n{"muscle"') + "\n")


if __name__ == "__main__":
    main()

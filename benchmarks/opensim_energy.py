"""Energy of bones under two accelerations: OpenSim's, and those of the document's equations of motion.

    python -m benchmarks.opensim_energy MODEL.osim ... [--python .venv-opensim/bin/python]

Nothing but gravity acts, so that dE/dt must be 0. E is OpenSim's own, kinetic and potential, and dE/dt its
central difference of fourth order along the accelerations, with coordinates that follow others. States are
random: speeds up to 3 rad/s and 1 m/s. PYTHON has opensim==4.6; it runs this file by itself. Writes
benchmarks/results/opensim_energy.json.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
RESULT = ROOT / "benchmarks/results/opensim_energy.json"
STATES, SPEED = 100, {True: 3.0, False: 1.0}  # rad/s, m/s
STEP = 1e-4  # s, of the difference


def record(source: Path, file: Path) -> None:
    """Write random states and OpenSim's accelerations; with opensim."""
    sys.path.insert(0, str(ROOT / "tests/data"))
    import record_opensim_accelerations as recording

    recording.SPEED, recording.FORCE = SPEED, {True: 0.0, False: 0.0}
    np.savez(file, **recording.record(source, STATES, 0.9, 0.0))


def judge(source: Path, file: Path) -> None:
    """Write dE/dt [W] along OpenSim's accelerations and along ours; with opensim."""
    sys.path.insert(0, str(ROOT / "tests/data"))
    from record_opensim_paths import Posed

    posed, known = Posed(source), dict(np.load(file))
    assert [item.getName() for item in posed.free] == known["coordinates"].tolist()

    def energy(values: np.ndarray, speeds: np.ndarray) -> float:
        every = posed.set(values)
        rates = posed.rates(speeds, every)
        for item, rate in zip(posed.coordinates, rates, strict=True):
            item.setSpeedValue(posed.state, float(rate))
        posed.model.realizeVelocity(posed.state)
        center = posed.model.calcMassCenterPosition(posed.state).to_numpy()
        weight = posed.model.getTotalMass(posed.state) * posed.model.getGravity().to_numpy()
        return float(posed.model.calcKineticEnergy(posed.state) - weight @ center)

    def change(q: np.ndarray, u: np.ndarray, a: np.ndarray) -> float:
        ends = [energy(q + h * u + 0.5 * h * h * a, u + h * a) for h in STEP * np.array((1, -1, 2, -2))]
        return (8.0 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12.0 * STEP)

    rows = [known[name] for name in ("values", "speeds", "accelerations", "ours")]
    found = [[change(q, u, a) for a in both] for q, u, *both in zip(*rows, strict=True)]
    np.savez(file, **known, power=np.array(found))


def ours(source: Path, file: Path) -> None:
    """Add the accelerations of the document's equations of motion in float64."""
    from myowarp.osim.document.dynamics import equations
    from myowarp.osim.document.read.model import read_model

    known = dict(np.load(file))
    names = known["coordinates"].tolist()
    values = dict(zip(names, known["values"].T, strict=True))
    mass, bias = equations(read_model(source), values, known["speeds"])
    np.savez(file, **known, ours=-np.linalg.solve(mass, bias[..., None])[..., 0])


def compare(source: Path, python: Path) -> dict[str, Any]:
    """Return |dE/dt| [W] and how far accelerations differ, median and worst of the states."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "states.npz"
        subprocess.run([str(python), __file__, "--record", str(source), str(file)], check=True)
        ours(source, file)
        subprocess.run([str(python), __file__, "--judge", str(source), str(file)], check=True)
        known = dict(np.load(file))
    theirs, mine = np.abs(known["power"]).T
    apart = np.abs(known["accelerations"] - known["ours"])
    size = np.linalg.norm(known["ours"], axis=1)
    worst = int((apart / size[:, None]).max(axis=1).argmax())
    return {
        "states": len(mine),
        "opensim_watts": _spread(theirs),
        "ours_watts": _spread(mine),
        "apart_of_acceleration": _spread(np.linalg.norm(apart, axis=1) / size),
        "where_most_apart": str(known["coordinates"][apart[worst].argmax()]),
        "most_apart": float(f"{apart[worst].max():.3g}"),
        "opensim": str(known["version"]),
    }


def _spread(values: np.ndarray) -> dict[str, float]:
    return {"median": float(f"{np.median(values):.2g}"), "worst": float(f"{values.max():.2g}")}


def main() -> None:
    """Compare, print and write; or do the part of the run that has opensim."""
    if sys.argv[1] in ("--record", "--judge"):
        part, source, file = sys.argv[1:]
        import opensim

        opensim.Logger.setLevelString("Off")
        {"--record": record, "--judge": judge}[part](Path(source), Path(file))
        return
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("--python", type=Path, default=ROOT / ".venv-opensim/bin/python")
    options = parser.parse_args()
    result = json.loads(RESULT.read_text()) if RESULT.is_file() else {"models": {}}
    for source in options.models:
        result["models"][source.stem] = compare(source, options.python)
        print(source.stem, json.dumps(result["models"][source.stem]))
        RESULT.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()

"""Write a trajectory of Moco as OpenSim writes it: states and controls of arm26 over a part of a trial.

    python tests/data/record_opensim_trajectory.py -o tests/data/opensim/trajectory.sto

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. Angles are those of
`angles`, the control of muscle k is 0.3 + 0.2 sin(9 t + k), activations are nine tenths of that.
"""

import argparse
from pathlib import Path

import numpy as np
import opensim

ARM = Path(__file__).parent / "osim/arm26.osim"
TIME = np.linspace(0.5, 0.8, 7)


def matrix(values):
    """Return a SimTK matrix."""
    found = opensim.Matrix(*values.shape)
    for (row, column), value in np.ndenumerate(values):
        found.set(row, column, float(value))
    return found


def strings(values):
    """Return a list that OpenSim takes."""
    found = opensim.StdVectorString()
    for value in values:
        found.append(value)
    return found


def main():
    """Write the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    output = parser.parse_args().output
    model = opensim.Model(str(ARM))
    model.initSystem()
    muscles = [model.getMuscles().get(k).getAbsolutePathString() for k in range(model.getMuscles().getSize())]
    coordinates = ["/jointset/r_shoulder/r_shoulder_elev", "/jointset/r_elbow/r_elbow_flex"]
    angles = np.stack([0.3 + 0.3 * np.sin(4.0 * TIME), 1.2 + 0.6 * np.cos(4.0 * TIME)], axis=1)
    speeds = np.stack([1.2 * np.cos(4.0 * TIME), -2.4 * np.sin(4.0 * TIME)], axis=1)
    controls = np.stack([0.3 + 0.2 * np.sin(9.0 * TIME + k) for k in range(len(muscles))], axis=1)
    time = opensim.Vector(len(TIME), 0.0)
    for row, value in enumerate(TIME):
        time.set(row, float(value))
    states = [f"{name}/{of}" for of in ("value", "speed") for name in coordinates]
    trajectory = opensim.MocoTrajectory(
        time,
        strings([*states, *(f"{name}/activation" for name in muscles)]),
        strings(muscles),
        strings([]),
        strings([]),
        matrix(np.concatenate([angles, speeds, 0.9 * controls], axis=1)),
        matrix(controls),
        opensim.Matrix(len(TIME), 0),
        opensim.RowVector(),
    )
    trajectory.write(str(output))


if __name__ == "__main__":
    main()

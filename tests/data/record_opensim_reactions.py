"""Record OpenSim's joint reactions of the motion in `motion_gait10dof18musc.npz`, at its static optimisation.

    python tests/data/record_opensim_reactions.py -o tests/data/opensim

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. Arrays, for n frames
and j joints, float64, SI, in ground, on the child:

    joints (j,), reactions (n, j, 9)     force, moment about the point, point
"""

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np
import opensim
from record_opensim_motion import analyze, columns, push, table, with_reserves

HERE = Path(__file__).parent.resolve()


def main():
    """Record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    output = parser.parse_args().output.resolve()
    opensim.Logger.setLevelString("Error")
    there = np.load(HERE / "opensim/motion_gait10dof18musc.npz")
    time, free = there["time"], list(there["coordinates"])
    home = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        model = with_reserves(HERE / "osim/gait10dof18musc.osim", free)
        table(Path("motion.mot"), "Coordinates", free, time, there["values"])
        push(there["body"], time, there["force"], there["point"])
        table(Path("forces.sto"), "forces", list(there["actuators"]), time, there["forces"])
        analysis = opensim.JointReaction()
        analysis.setForcesFileName("forces.sto")
        analyze("jr", analysis, time)
        found = next(Path().glob("jr*ReactionLoads*"))
        joints = [model.getJointSet().get(i) for i in range(model.getJointSet().getSize())]
        names = [
            f"{joint.getName()}_on_{joint.getChildFrame().findBaseFrame().getName()}_in_ground_{part}{axis}"
            for joint in joints
            for part in "fmp"
            for axis in "xyz"
        ]
        rows, values, _ = columns(found, names)
        os.chdir(home)
    assert len(rows) == len(time), (len(rows), len(time))
    reactions = values.reshape(len(time), len(joints), 9)
    arrays = {"joints": np.array([joint.getName() for joint in joints]), "reactions": reactions}
    np.savez_compressed(output / "reactions_gait10dof18musc.npz", version=opensim.GetVersion(), **arrays)


if __name__ == "__main__":
    main()

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
from record_opensim_motion import RESERVE, columns, table

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
        model = opensim.Model(str(HERE / "osim/gait10dof18musc.osim"))
        for name in free:
            reserve = opensim.CoordinateActuator(str(name))
            reserve.setName(f"reserve_{name}")
            reserve.setOptimalForce(RESERVE if not name.startswith("pelvis") else 100 * RESERVE)
            reserve.setMinControl(-np.inf)
            reserve.setMaxControl(np.inf)
            model.addForce(reserve)
        model.finalizeConnections()
        model.printToXML("reserves.osim")
        table(Path("motion.mot"), "Coordinates", free, time, there["values"])
        labels = [f"f_v{axis}" for axis in "xyz"] + [f"p_{axis}" for axis in "xyz"]
        table(Path("push.mot"), "push", labels, time, np.hstack([there["force"], there["point"]]))
        table(Path("forces.sto"), "forces", list(there["actuators"]), time, there["forces"])
        Path("push.xml").write_text(
            '<?xml version="1.0"?><OpenSimDocument Version="40000"><ExternalLoads name="push"><objects>'
            f'<ExternalForce name="push"><applied_to_body>{there["body"]}</applied_to_body>'
            "<force_expressed_in_body>ground</force_expressed_in_body>"
            "<point_expressed_in_body>ground</point_expressed_in_body><force_identifier>f_v</force_identifier>"
            "<point_identifier>p_</point_identifier><data_source_name>push.mot</data_source_name>"
            "</ExternalForce></objects><datafile>push.mot</datafile></ExternalLoads></OpenSimDocument>"
        )
        tool = opensim.AnalyzeTool()
        tool.setName("jr")
        tool.setModelFilename("reserves.osim")
        tool.setCoordinatesFileName("motion.mot")
        tool.setLowpassCutoffFrequency(6.0)
        tool.setExternalLoadsFileName("push.xml")
        tool.setStartTime(time[0])
        tool.setFinalTime(time[-1])
        tool.setResultsDir(".")
        analysis = opensim.JointReaction()
        analysis.setStartTime(time[0])
        analysis.setEndTime(time[-1])
        analysis.setForcesFileName("forces.sto")
        tool.updAnalysisSet().cloneAndAppend(analysis)
        tool.printToXML("jr.xml")
        opensim.AnalyzeTool("jr.xml").run()
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

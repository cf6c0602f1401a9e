"""OpenSim's side of `benchmarks.motion`: CPU seconds of its tools on the files of a folder, as JSON.

Needs an interpreter with `opensim` (4.6) only; nothing of ours is imported.
"""

import json
import os
import sys
import time

import opensim


def seconds(run):
    """Return how much CPU time a call takes."""
    before = time.process_time()
    run()
    return time.process_time() - before


def main():
    """Run the tools in a folder: model.osim, ik.xml, walk.trc, ik.mot, grf.xml."""
    os.chdir(sys.argv[1])
    opensim.Logger.setLevelString("Error")
    first, last = float(sys.argv[2]), float(sys.argv[3])
    ik = opensim.InverseKinematicsTool("ik.xml")
    ik.set_model_file("model.osim")
    ik.set_marker_file("walk.trc")
    ik.setStartTime(first)
    ik.setEndTime(last)
    ik.set_output_motion_file("found.mot")
    dynamics = opensim.InverseDynamicsTool()
    dynamics.setModelFileName("model.osim")
    dynamics.setCoordinatesFileName("ik.mot")
    dynamics.setExternalLoadsFileName("grf.xml")
    dynamics.setLowpassCutoffFrequency(6.0)
    dynamics.setStartTime(first)
    dynamics.setEndTime(last)
    muscles = opensim.ArrayStr()
    muscles.append("Muscles")
    dynamics.setExcludedForces(muscles)
    dynamics.setResultsDir(".")
    model = opensim.Model("model.osim")
    for index in range(model.getCoordinateSet().getSize()):
        name = model.getCoordinateSet().get(index).getName()
        reserve = opensim.CoordinateActuator(name)
        reserve.setName(f"reserve_{name}")
        reserve.setOptimalForce(1000.0 if name.startswith("pelvis") else 10.0)
        model.addForce(reserve)
    model.finalizeConnections()
    model.printToXML("reserves.osim")
    tool = opensim.AnalyzeTool()
    tool.setName("so")
    tool.setModelFilename("reserves.osim")
    tool.setCoordinatesFileName("ik.mot")
    tool.setLowpassCutoffFrequency(6.0)
    tool.setExternalLoadsFileName("grf.xml")
    tool.setStartTime(first)
    tool.setFinalTime(last)
    tool.setResultsDir(".")
    analysis = opensim.StaticOptimization()
    analysis.setStartTime(first)
    analysis.setEndTime(last)
    tool.updAnalysisSet().cloneAndAppend(analysis)
    tool.printToXML("so.xml")
    optimised = opensim.AnalyzeTool("so.xml")
    runs = {
        "inverse kinematics": ik.run,
        "inverse dynamics": dynamics.run,
        "static optimisation": optimised.run,
    }
    print("RESULT " + json.dumps({name: seconds(run) for name, run in runs.items()}))


if __name__ == "__main__":
    main()

"""OpenSim's side of `benchmarks.opensim_motion`: its tools on a public trial and on motions made here.

    .venv-opensim/bin/python benchmarks/opensim_motion_record.py MODEL.osim ... --trial FOLDER -o out/motion

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. Models give
`motion_<model>.npz`, as `tests/data/record_opensim_motion.py` describes, with joints and reactions
(n, j, 9) as in `record_opensim_reactions.py`. The trial, OpenSim's Gait2354 example, gives
`trial.npz` with the same, and of its scaling bodies, factors, and markers with their places once scaled.
"""

import argparse
import os
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import opensim

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests/data"))
from record_opensim_motion import analyze, columns, optimised, record, table

SPAN = (0.4, 1.6)
ACCURACY = 1e-10
"""Of inverse kinematics. With clamped coordinates OpenSim's interior-point solver keeps a distance from the
ends of ranges: the forearms of Rajagopal2016 by 0.9 deg at 1e-7, 0.09 at 1e-9, 0.02 at 1e-10."""


def vector(v):
    """Return an OpenSim vector as an array."""
    return np.array([v.get(i) for i in range(v.size())])


def reactions(found, time):
    """Return joint reactions at the muscle forces that were found; the model is reserves.osim."""
    actuators = list(map(str, found["actuators"]))
    rows = np.column_stack([time, found["forces"]])
    with Path("forces.sto").open("w") as file:
        file.write(f"f\nversion=1\nnRows={len(rows)}\nnColumns={len(rows[0])}\ninDegrees=no\nendheader\n")
        file.write("\t".join(["time", *actuators]) + "\n")
        np.savetxt(file, rows, fmt="%.17g", delimiter="\t")
    analysis = opensim.JointReaction()
    analysis.setForcesFileName("forces.sto")
    analyze("jr", analysis, time)
    model = opensim.Model("reserves.osim")
    model.initSystem()
    joints = [model.getJointSet().get(i) for i in range(model.getJointSet().getSize())]
    names = [
        f"{joint.getName()}_on_{joint.getChildFrame().findBaseFrame().getName()}_in_ground_{part}{axis}"
        for joint in joints
        for part in "fmp"
        for axis in "xyz"
    ]
    values = columns(next(Path().glob("jr*ReactionLoads*")), names)[1]
    return {
        "joints": [joint.getName() for joint in joints],
        "reactions": values.reshape(len(time), len(joints), 9),
    }


def scaling(trial, generic):
    """Return factors and scaled places of markers, in full precision."""
    for name in ("subject01_Setup_Scale.xml", "gait2354_Scale_MarkerSet.xml", "subject01_static.trc"):
        shutil.copy(trial / name, ".")
    shutil.copy(generic, "gait2354_simbody.osim")
    tool = opensim.ScaleTool("subject01_Setup_Scale.xml")
    model = tool.createModel()
    model.initSystem()
    before = {m.getName(): vector(m.get_location()) for m in markers_of(model)}
    tool.getModelScaler().processModel(model, "", tool.getSubjectMass())
    after = {m.getName(): vector(m.get_location()) for m in markers_of(model)}
    names = list(before)
    return {
        "scaled/markers": names,
        "scaled/before": np.array([before[name] for name in names]),
        "scaled/after": np.array([after[name] for name in names]),
        "scaled/mass": model.getTotalMass(model.initSystem()),
    }


def markers_of(model):
    """Return the markers."""
    return [model.getMarkerSet().get(i) for i in range(model.getMarkerSet().getSize())]


def of_trial(trial, generic):
    """Return what the tools make of the trial; the working folder is where files may be written."""
    out = scaling(trial, generic)
    source = trial / "reference_subject01_simbody.osim"
    shutil.copy(source, "subject01_simbody.osim")
    for name in ("subject01_Setup_IK.xml", "subject01_walk1.trc", "subject01_walk1_grf.mot"):
        shutil.copy(trial / name, ".")
    shutil.copy(trial / "subject01_walk1_grf.xml", "push.xml")
    tool = opensim.InverseKinematicsTool("subject01_Setup_IK.xml")
    tool.set_model_file("subject01_simbody.osim")
    tool.set_marker_file("subject01_walk1.trc")
    tool.setStartTime(SPAN[0])
    tool.setEndTime(SPAN[1])
    tool.set_accuracy(1e-9)
    tool.set_output_motion_file("motion.mot")
    tool.run()
    model = opensim.Model(str(source))
    state = model.initSystem()
    coordinates = [model.getCoordinateSet().get(i) for i in range(model.getCoordinateSet().getSize())]
    free = [c.getName() for c in coordinates if not c.isConstrained(state)]
    turns = np.array([model.getCoordinateSet().get(n).getMotionType() == 1 for n in free])
    time, values, degrees = columns(Path("motion.mot"), free)
    fitted = np.where(turns & degrees, np.radians(values), values)
    time = np.linspace(time[0], time[-1], len(time))  # files round it, and then rates are uneven
    out |= {"coordinates": free, "time": time, "fitted": fitted}
    every = [c.getName() for c in coordinates]
    full = np.zeros((len(time), len(every)))
    full[:, [every.index(name) for name in free]] = fitted
    table(Path("motion.mot"), "Coordinates", every, time, full)
    dynamics = opensim.InverseDynamicsTool()
    dynamics.setModelFileName("subject01_simbody.osim")
    dynamics.setCoordinatesFileName("motion.mot")
    dynamics.setExternalLoadsFileName("push.xml")
    dynamics.setLowpassCutoffFrequency(6.0)
    dynamics.setStartTime(SPAN[0])
    dynamics.setEndTime(SPAN[1])
    muscles = opensim.ArrayStr()
    muscles.append("Muscles")
    dynamics.setExcludedForces(muscles)
    dynamics.setResultsDir(".")
    dynamics.setOutputGenForceFileName("moments.sto")
    dynamics.run()
    names = [f"{n}_{'moment' if turn else 'force'}" for n, turn in zip(free, turns, strict=True)]
    out["moments"] = columns(Path("moments.sto"), names)[1]
    out |= optimised(Path("subject01_simbody.osim"), free, time)
    return out | reactions(out, time)


def main():
    """Record all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("models", nargs="*", type=Path)
    parser.add_argument("--trial", type=Path, help="folder of OpenSim's Gait2354 example")
    parser.add_argument("--generic", type=Path, help="gait2354_simbody.osim; default: beside the models")
    parser.add_argument("-o", "--output", type=Path, required=True)
    arguments = parser.parse_args()
    output, home = arguments.output.resolve(), Path.cwd()
    output.mkdir(parents=True, exist_ok=True)
    opensim.Logger.setLevelString("Error")

    def inside(run, name):
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            arrays = {key: np.array(value) for key, value in run().items()}
            os.chdir(home)
        np.savez_compressed(output / f"{name}.npz", version=opensim.GetVersion(), **arrays)

    def made(source):
        found = record(source, "calcn_r", True, ACCURACY)
        return found | reactions(found, found["time"])

    for source in (path.resolve() for path in arguments.models):
        inside(lambda source=source: made(source), f"motion_{source.stem}")
    if arguments.trial is not None:
        trial = arguments.trial.resolve()
        generic = (arguments.generic or trial.parents[1] / "gait2354_simbody.osim").resolve()
        inside(lambda: of_trial(trial, generic), "trial")


if __name__ == "__main__":
    main()

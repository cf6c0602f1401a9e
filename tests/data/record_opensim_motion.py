"""Record what OpenSim's tools make of a motion: inverse kinematics, inverse dynamics, static optimisation.

    python tests/data/record_opensim_motion.py tests/data/osim/gait10dof18musc.osim -o tests/data/opensim
(and leg6dof9musc.osim with `--no-forces`: 4.6 does not come back from its static optimisation)

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. Every model gives
`motion_<model>.npz`. The motion is a sine of each free coordinate about its default, with the same seed
always; markers of the model follow it with noise. A foot is pushed from below, and reserves help. Arrays, for
n frames, c free coordinates, k markers and a actuators, float64, SI and rad:

    coordinates (c,), time (n,), values (n, c)             the motion
    markers (k,), seen (n, k, 3), fitted (n, c)            what was seen, and inverse kinematics of it
    body, force, point (n, 3), moments (n, c)              the load, and inverse dynamics (filter: 6 Hz)
    actuators (a,), controls, forces (n, a)                static optimisation
    reserve                                                force of a reserve at control 1 [N m, N]
"""

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np
import opensim

RATE, FRAMES = 60.0, 61
NOISE = 2e-3  # m
PUSH = np.array([20.0, 250.0, -5.0])  # N
RESERVE = 10.0
ACCURACY = 1e-9  # of inverse kinematics


def table(path, name, labels, time, values):
    """Write a .mot file in radians."""
    with path.open("w") as file:
        file.write(
            f"{name}\nversion=1\nnRows={len(time)}\nnColumns={len(labels) + 1}\ninDegrees=no\nendheader\n"
        )
        file.write("\t".join(["time", *labels]) + "\n")
        np.savetxt(file, np.column_stack([time, values]), fmt="%.17g", delimiter="\t")


def trc(path, names, time, seen):
    """Write markers."""
    rows = [f"{i + 1}\t{t:.17g}\t" + "\t".join(f"{x:.17g}" for x in row.ravel()) for i, (t, row) in
            enumerate(zip(time, seen, strict=True))]  # fmt: skip
    axes = "\t".join(f"{axis}{k + 1}" for k in range(len(names)) for axis in "XYZ")
    path.write_text(
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\t"
        f"OrigDataStartFrame\tOrigNumFrames\n{RATE}\t{RATE}\t{len(time)}\t{len(names)}\tm\t{RATE}\t1\t{len(time)}\n"
        "Frame#\tTime\t" + "\t\t\t".join(names) + f"\n\t\t{axes}\n\n" + "\n".join(rows) + "\n"
    )


def push(body, time, force, point):
    """Write push.mot and push.xml: a force in ground on a body, at a point of ground."""
    labels = [f"f_v{axis}" for axis in "xyz"] + [f"p_{axis}" for axis in "xyz"]
    table(Path("push.mot"), "push", labels, time, np.hstack([force, point]))
    Path("push.xml").write_text(
        '<?xml version="1.0"?><OpenSimDocument Version="40000"><ExternalLoads name="push"><objects>'
        f'<ExternalForce name="push"><applied_to_body>{body}</applied_to_body>'
        "<force_expressed_in_body>ground</force_expressed_in_body>"
        "<point_expressed_in_body>ground</point_expressed_in_body><force_identifier>f_v</force_identifier>"
        "<point_identifier>p_</point_identifier><data_source_name>push.mot</data_source_name></ExternalForce>"
        "</objects><datafile>push.mot</datafile></ExternalLoads></OpenSimDocument>"
    )


def columns(path, labels):
    """Return time and columns of a .sto or .mot file, in radians."""
    lines = path.read_text().splitlines()
    end = lines.index("endheader")
    degrees = any(line.replace(" ", "") == "inDegrees=yes" for line in lines[:end])
    names = lines[end + 1].split("\t")
    rows = np.array([line.split() for line in lines[end + 2 :] if line.strip()], float)
    return rows[:, 0], rows[:, [names.index(label) for label in labels]], degrees


def record(source, body, forces, accuracy=ACCURACY):
    """Return the arrays of one model; the working folder is where files may be written."""
    random = np.random.default_rng(5)
    model = opensim.Model(str(source))
    state = model.initSystem()
    coordinates = [model.getCoordinateSet().get(i) for i in range(model.getCoordinateSet().getSize())]
    every = [c.getName() for c in coordinates]
    free = [c.getName() for c in coordinates if not c.isConstrained(state)]
    turns = np.array([model.getCoordinateSet().get(n).getMotionType() == 1 for n in free])
    time = np.arange(FRAMES) / RATE
    middle = np.array([model.getCoordinateSet().get(n).getDefaultValue() for n in free])
    size = np.where(turns, 0.25, 0.05) * random.uniform(0.5, 1.0, len(free))
    # A knee that extends beyond straight is weak: all angles go to one side of the default and back.
    rate, phase = random.uniform(0.5, 1.2, len(free)), random.uniform(0, 2 * np.pi, len(free))
    values = middle + size * (np.sin(2 * np.pi * rate * time[:, None] + phase) - np.where(turns, 1.0, 0.0))
    markers = [model.getMarkerSet().get(i) for i in range(model.getMarkerSet().getSize())]
    seen, point = np.zeros((FRAMES, len(markers), 3)), np.zeros((FRAMES, 3))
    full = np.zeros((FRAMES, len(every)))
    for frame, row in enumerate(values):
        for name, value in zip(free, row, strict=True):
            model.getCoordinateSet().get(name).setValue(state, float(value), False)
        model.assemble(state)
        model.realizePosition(state)
        full[frame] = [c.getValue(state) for c in coordinates]
        seen[frame] = [m.getLocationInGround(state).to_numpy() for m in markers] if markers else seen[frame]
        point[frame] = model.getBodySet().get(body).getPositionInGround(state).to_numpy()
    values = full[:, [every.index(name) for name in free]]  # ranges and couplers may have changed some
    seen += NOISE * random.normal(size=seen.shape)
    force = PUSH * (1.0 + 0.3 * np.sin(2 * np.pi * 1.5 * time)[:, None])
    out = {"coordinates": free, "time": time, "values": values, "body": body, "force": force, "point": point}
    out |= {"markers": [m.getName() for m in markers], "seen": seen, "reserve": RESERVE}
    table(Path("motion.mot"), "Coordinates", every, time, full)
    push(body, time, force, point)
    if markers:
        out["fitted"] = fitted(source, out, seen, accuracy)
    tool = opensim.InverseDynamicsTool()
    tool.setModelFileName(str(source))
    tool.setCoordinatesFileName("motion.mot")
    tool.setExternalLoadsFileName("push.xml")
    tool.setLowpassCutoffFrequency(6.0)
    tool.setStartTime(time[0])
    tool.setEndTime(time[-1])
    muscles = opensim.ArrayStr()
    muscles.append("Muscles")
    tool.setExcludedForces(muscles)
    tool.setResultsDir(".")
    tool.setOutputGenForceFileName("moments.sto")
    tool.run()
    names = [f"{n}_{'moment' if turn else 'force'}" for n, turn in zip(free, turns, strict=True)]
    out["moments"] = columns(Path("moments.sto"), names)[1]
    if forces:
        out |= optimised(source, free, time)
    return {name: np.array(value) for name, value in out.items()}


def fitted(source, out, seen, accuracy):
    """Return inverse kinematics."""
    names, time = out["markers"], out["time"]
    trc(Path("seen.trc"), names, time, seen)
    tool = opensim.InverseKinematicsTool()
    tool.set_model_file(str(source))
    tool.set_marker_file("seen.trc")
    for name in names:
        task = opensim.IKMarkerTask()
        task.setName(name)
        task.setApply(True)
        task.setWeight(1.0)
        tool.upd_IKTaskSet().cloneAndAppend(task)
    tool.setStartTime(time[0])
    tool.setEndTime(time[-1])
    tool.set_accuracy(accuracy)
    tool.set_output_motion_file("fitted.mot")
    tool.run()
    _, values, degrees = columns(Path("fitted.mot"), out["coordinates"])
    model = opensim.Model(str(source))
    turns = np.array([model.getCoordinateSet().get(n).getMotionType() == 1 for n in out["coordinates"]])
    return np.where(turns & degrees, np.radians(values), values)


def with_reserves(source, free):
    """Write reserves.osim, a model with a reserve for every free coordinate; returns it."""
    model = opensim.Model(str(source))
    for name in map(str, free):
        reserve = opensim.CoordinateActuator(name)
        reserve.setName(f"reserve_{name}")
        reserve.setOptimalForce(RESERVE if not name.startswith("pelvis") else 100 * RESERVE)
        reserve.setMinControl(-np.inf)
        reserve.setMaxControl(np.inf)
        model.addForce(reserve)
    model.finalizeConnections()
    model.printToXML("reserves.osim")
    return model


def analyze(name, analysis, time):
    """Run an analysis of motion.mot on reserves.osim under the push (filter: 6 Hz)."""
    tool = opensim.AnalyzeTool()
    tool.setName(name)
    tool.setModelFilename("reserves.osim")
    tool.setCoordinatesFileName("motion.mot")
    tool.setLowpassCutoffFrequency(6.0)
    tool.setExternalLoadsFileName("push.xml")
    tool.setStartTime(time[0])
    tool.setFinalTime(time[-1])
    tool.setResultsDir(".")
    analysis.setStartTime(time[0])
    analysis.setEndTime(time[-1])
    tool.updAnalysisSet().cloneAndAppend(analysis)
    tool.printToXML(f"{name}.xml")
    opensim.AnalyzeTool(f"{name}.xml").run()


def optimised(source, free, time):
    """Return static optimisation with a reserve for every free coordinate."""
    model = with_reserves(source, free)
    analysis = opensim.StaticOptimization()
    analysis.setUseModelForceSet(True)
    analysis.setActivationExponent(2.0)
    analysis.setUseMusclePhysiology(True)
    analysis.setConvergenceCriterion(1e-10)
    analysis.setMaxIterations(1000)
    analyze("so", analysis, time)
    names = [model.getActuators().get(i).getName() for i in range(model.getActuators().getSize())]
    controls = columns(Path("so_StaticOptimization_activation.sto"), names)[1]
    forces = columns(Path("so_StaticOptimization_force.sto"), names)[1]
    return {"actuators": names, "controls": controls, "forces": forces}


def main():
    """Record every model."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("models", nargs="+", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--body", default="calcn_r", help="which is pushed")
    parser.add_argument(
        "--no-forces", action="store_true", help="no static optimisation (4.6 hangs in leg6dof9musc)"
    )
    arguments = parser.parse_args()
    opensim.Logger.setLevelString("Error")
    home, output = Path.cwd(), arguments.output.resolve()
    for source in (path.resolve() for path in arguments.models):
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            arrays = record(source, arguments.body, not arguments.no_forces)
            os.chdir(home)
        np.savez_compressed(output / f"motion_{source.stem}.npz", version=opensim.GetVersion(), **arrays)


if __name__ == "__main__":
    main()

"""Record OpenSense's placement and kinematics of inertial sensors on a small model.

    python tests/data/record_opensim_sensors.py -o tests/data/opensim

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. Writes recordings of
sensors with noise, in a world whose z axis is up, `sensors_still.sto` and `sensors_walk.sto`, and gives
`sensors.json`:

    placed      by sensor and heading (with, without): axes in its body, by `IMUPlacer`
    tool        rows of `IMUInverseKinematicsTool` for the model placed without heading: time, coordinates
                [rad]
    solver      the same rows by `InverseKinematicsSolver` at an accuracy of 1e-9
    coordinates names of the columns
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
import opensim

SENSORS = ("pelvis_imu", "thigh_imu", "shank_imu")
ANGLES = (-np.pi / 2, 0.0, 0.0)
WEIGHTS = {"pelvis_imu": 1.0, "thigh_imu": 2.0, "shank_imu": 0.5}
NOISE = 0.08  # rad
FRAMES = 40


def turn(axis, angle):
    """Return a rotation matrix."""
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def quaternion(matrix):
    """Return w, x, y, z as the cell of a file."""
    rows = opensim.Mat33(*[float(x) for x in matrix.ravel()])
    q = opensim.Rotation(rows).convertRotationToQuaternion()
    return ",".join(repr(q.get(k)) for k in range(4))


def write(path, times, rows):
    """Write a file of quaternions."""
    head = "DataRate=100.000000\nDataType=Quaternion\nversion=3\nOpenSimVersion=4.6\nendheader\n"
    lines = ["\t".join((f"{time:.6g}", *cells)) for time, cells in zip(times, rows, strict=True)]
    labels = "\t".join(("time", *SENSORS))
    path.write_text(f"{head}{labels}\n" + "\n".join(lines) + "\n")


def axes(frame, state):
    """Return a frame's axes in ground."""
    rotation = frame.getTransformInGround(state).R()
    return np.array([[rotation.get(i, j) for j in range(3)] for i in range(3)])


def make(model_path, folder):
    """Write what sensors record, still and in motion."""
    rng = np.random.default_rng(0)
    model = opensim.Model(str(model_path))
    state = model.initSystem()
    world = turn([1, 0, 0], ANGLES[0]).T  # from OpenSim's world into the sensors'
    on_body = [turn(rng.normal(size=3), rng.uniform(0, 3)) for _ in SENSORS]
    bodies = [model.getBodySet().get(name.removesuffix("_imu")) for name in SENSORS]

    def seen(noise):
        model.realizePosition(state)
        cells = []
        for body, place in zip(bodies, on_body, strict=True):
            error = turn(rng.normal(size=3), noise * rng.normal())
            cells.append(quaternion(world @ axes(body, state) @ place @ error))
        return cells

    write(folder / "sensors_still.sto", [0.0], [seen(0.0)])
    times, rows = np.arange(FRAMES) / 20.0, []
    for time in times:
        values = {
            "tilt": 0.1 + 0.1 * np.sin(6 * time),
            "list": 0.1 * np.cos(6 * time),
            "turn": 0.2 + 1.2 * time,
            "tx": 1.2 * time,
            "hip_x": 0.2 * np.sin(6 * time),
            "hip_y": 0.1 * np.cos(5 * time),
            "hip_z": 0.3 + 0.6 * np.sin(6 * time + 1),
            "knee_angle": -0.6 + 0.58 * np.cos(6 * time),
        }
        for name, value in values.items():
            model.getCoordinateSet().get(name).setValue(state, float(value), False)
        rows.append(seen(NOISE))
    write(folder / "sensors_walk.sto", times, rows)


def placed(model_path, folder, heading, output):
    """Return the axes of each sensor in its body, by `IMUPlacer`."""
    placer = opensim.IMUPlacer()
    placer.set_model_file(str(model_path))
    placer.set_orientation_file_for_calibration(str(folder / "sensors_still.sto"))
    placer.set_sensor_to_opensim_rotations(opensim.Vec3(*ANGLES))
    if heading:
        placer.set_base_imu_label(SENSORS[0])
        placer.set_base_heading_axis(heading)
    placer.set_output_model_file(str(output))
    placer.run(False)
    model, found = placer.getCalibratedModel(), {}
    for name in SENSORS:
        body = name.removesuffix("_imu")
        frame = opensim.PhysicalOffsetFrame.safeDownCast(model.getComponent(f"/bodyset/{body}/{name}"))
        rotation = frame.getOffsetTransform().R()
        found[name] = [[rotation.get(i, j) for j in range(3)] for i in range(3)]
    return found


def solved(model_path, folder):
    """Return coordinates of each frame by the solver, at a high accuracy."""
    model = opensim.Model(str(model_path))
    for coordinate in ("tx", "ty", "tz"):
        model.updCoordinateSet().get(coordinate).setDefaultLocked(True)
    state = model.initSystem()
    table = opensim.TimeSeriesTableQuaternion(str(folder / "sensors_walk.sto"))
    opensim.OpenSenseUtilities.rotateOrientationTable(
        table,
        opensim.Rotation(
            0, ANGLES[0], opensim.CoordinateAxis(0), ANGLES[1], opensim.CoordinateAxis(1), ANGLES[2],
            opensim.CoordinateAxis(2)),
    )  # fmt: skip
    weights = opensim.OrientationWeightSet()
    for name, weight in WEIGHTS.items():
        weights.cloneAndAppend(opensim.OrientationWeight(name, weight))
    rotations = opensim.OpenSenseUtilities.convertQuaternionsToRotations(table)
    reference = opensim.OrientationsReference(rotations, weights)
    solver = opensim.InverseKinematicsSolver(
        model, opensim.MarkersReference(), reference, opensim.SimTKArrayCoordinateReference()
    )
    solver.setAccuracy(1e-9)
    rows = []
    for number, time in enumerate(rotations.getIndependentColumn()):
        state.setTime(time)
        solver.assemble(state) if number == 0 else solver.track(state)
        coordinates = model.getCoordinateSet()
        rows.append([time, *(coordinates.get(k).getValue(state) for k in range(coordinates.getSize()))])
    return rows


def tool(model_path, folder, output):
    """Return coordinates of each frame by the tool."""
    tool = opensim.IMUInverseKinematicsTool()
    tool.set_model_file(str(model_path))
    tool.set_orientations_file(str(folder / "sensors_walk.sto"))
    tool.set_sensor_to_opensim_rotations(opensim.Vec3(*ANGLES))
    weights = opensim.OrientationWeightSet()
    for name, weight in WEIGHTS.items():
        weights.cloneAndAppend(opensim.OrientationWeight(name, weight))
    tool.set_orientation_weights(weights)
    tool.set_results_directory(str(output))
    tool.set_output_motion_file("ik.mot")
    tool.run(False)
    table = opensim.TimeSeriesTable(str(output / "ik.mot"))
    labels, rows = list(table.getColumnLabels()), []
    for k, time in enumerate(table.getIndependentColumn()):
        row = table.getRowAtIndex(k)
        turned = [x if name in ("tx", "ty", "tz") else np.radians(x)
                  for name, x in zip(labels, (row[i] for i in range(row.size())), strict=True)]  # fmt: skip
        rows.append([time, *turned])
    return labels, rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    folder = parser.parse_args().output
    opensim.Logger.setLevelString("Off")
    source = Path(__file__).parent / "osim" / "sensors.osim"
    make(source, folder)
    with tempfile.TemporaryDirectory() as scratch:
        without = Path(scratch) / "placed.osim"
        found = {
            "opensim": opensim.GetVersion(),
            "placed": {
                "": placed(source, folder, "", without),
                "-z": placed(source, folder, "-z", Path(scratch) / "headed.osim"),
            },
        }
        found["coordinates"], found["tool"] = tool(without, folder, Path(scratch))
        found["solver"] = solved(without, folder)
    (folder / "sensors.json").write_text(json.dumps(found) + "\n")

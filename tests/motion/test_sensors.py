"""Inertial sensors beside OpenSim 4.6: where they are placed, and the joint angles that they give."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import reader_cases as cases
from recordings import ANGLES, STILL, WALK, WEIGHTS, write_sensors

from myowarp.apps.cli.motion.kinematics import Kinematics
from myowarp.apps.cli.motion.place import Place
from myowarp.motion.orientation_kinematics import orientation_kinematics
from myowarp.motion.orientations import Placing, axes_of_sensors, euler_of, place, read_orientations
from myowarp.motion.setup import TrialSetup
from myowarp.motion.steps import kinematics_of_sensors
from myowarp.motion.storage import read_storage
from myowarp.motion.tool_setup import read_tool_setup
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.read.element import parse, write
from myowarp.osim.document.read.frames import euler_xyz
from myowarp.osim.document.read.model import Document, read_model

DATA = Path(__file__).parents[1] / "data"
MODEL = DATA / "osim" / "sensors.osim"
RECORDED = json.loads((DATA / "opensim" / "sensors.json").read_text())

TIGHT = 2e-6
"""[rad]: OpenSim's solver at an accuracy of 1e-9."""
TOOL = 1e-2
"""[rad]: its tool, which ends at an accuracy of 1e-4 and is up to 0.0085 rad from that solver."""


def placed(heading=""):
    """Return the model with its sensors."""
    base = "pelvis_imu" if heading else ""
    document = Document(MODEL, parse(MODEL)[0])
    return place(document, read_orientations(STILL), Placing(STILL, ANGLES, base, heading))


@pytest.mark.parametrize("heading", ["", "-z"])
def test_sensors_are_placed_as_by_opensim(heading, tmp_path):
    found = placed(heading)
    assert (abs(found.heading) > 0.1) == bool(heading)
    write(tmp_path / "placed.osim", found.document.root)
    model = read_model(tmp_path / "placed.osim")
    for name, axes in RECORDED["placed"][heading].items():
        body, pose = model.frames[name]
        assert f"{body}_imu" == name
        np.testing.assert_allclose(pose.rotation, axes, atol=1e-9)
        np.testing.assert_allclose(pose.position, model.bodies[body].mass_center)


@pytest.fixture(scope="module")
def fitted():
    bones = Bones(placed().document.model)
    return orientation_kinematics(bones, read_orientations(WALK).turned(axes_of_sensors(ANGLES)), WEIGHTS)


@pytest.mark.parametrize(("rows", "close"), [("solver", TIGHT), ("tool", TOOL)])
def test_joint_angles_are_those_of_opensim(fitted, rows, close):
    """Sensors have noise of 0.08 rad, so that angles depend on what is minimised, and on weights."""
    wanted = np.array(RECORDED[rows])
    assert list(fitted.coordinates) == RECORDED["coordinates"]
    np.testing.assert_allclose(fitted.time, wanted[:, 0], atol=1e-9)
    assert np.abs(fitted.values - wanted[:, 1:]).max() < close
    assert fitted.values[:, -1].max() > -1e-6  # the knee is at its limit in some frames
    assert 0.05 < fitted.error.max() < 0.5


def test_weights_count(fitted):
    bones = Bones(placed().document.model)
    same = orientation_kinematics(bones, read_orientations(WALK).turned(axes_of_sensors(ANGLES)))
    assert np.abs(same.values - fitted.values).max() > 3 * TOOL


def test_a_frame_without_a_sensor_and_a_half_turn(fitted):
    """What was not recorded does not count; a start that is half a turn off is no trap."""
    bones = Bones(placed().document.model)
    recorded = read_orientations(WALK).turned(axes_of_sensors(ANGLES))
    recorded.rotations[3, 1] = np.nan
    gone = orientation_kinematics(bones, recorded, WEIGHTS)
    assert np.isnan(gone.error[3, 1])
    assert np.isfinite(gone.values).all()
    np.testing.assert_allclose(np.delete(gone.values, 3, 0), np.delete(fitted.values, 3, 0), atol=1e-6)
    half = recorded.turned(np.diag([-1.0, 1.0, -1.0]))
    turned = orientation_kinematics(bones, half, WEIGHTS)
    np.testing.assert_allclose(turned.error[4:], gone.error[4:], atol=1e-6)


def test_from_set_up_files_to_files(tmp_path):
    write_sensors(tmp_path)
    out = tmp_path / "out"
    Place(MODEL, setup=tmp_path / "placer.xml", output=out)()
    Kinematics(out / "placed.osim", setup=tmp_path / "imu_ik.xml", output=out)()
    table = read_storage(out / "ik.mot")
    wanted = np.array(RECORDED["solver"])[10:21]
    np.testing.assert_allclose(table.time, wanted[:, 0], atol=1e-9)
    knee = np.radians(table.values[:, table.labels.index("knee_angle")])
    np.testing.assert_allclose(knee, wanted[:, -1], atol=TIGHT)
    assert set(read_storage(out / "orientation_errors.sto").labels) == set(WEIGHTS)
    assert read_tool_setup(tmp_path / "imu_ik.xml").sensor_weights == WEIGHTS


@pytest.mark.parametrize("angles", [(0.3, -0.4, 2.0), (1.0, np.pi / 2, 0.0), (3.0, 1.5, -3.0)])
def test_angles_of_a_rotation(angles):
    rotation = euler_xyz(np.array(angles))
    np.testing.assert_allclose(euler_xyz(euler_of(rotation)), rotation, atol=1e-12)


HEAD = "DataType=Quaternion\nversion=3\nendheader\ntime\tpelvis_imu\tthigh_imu\n"
BAD = {
    "numbers": ("0\t1\t0\n", "row 1 of {} has a cell that is no quaternion w,x,y,z: '1'; orientations have"),
    "three": ("0\t1,0,0\t1,0,0,0\n", "row 1 of {} has a cell that is no quaternion w,x,y,z: '1,0,0'"),
    "words": ("0\t1,0,0,a\t1,0,0,0\n", "row 1 of {} has a cell that is no number: 'a'"),
    "zero": ("0\t1,0,0,0\t0,0,0,0\n", "{} has the quaternion 0 of 'thigh_imu' at 0 s; where a sensor"),
    "columns": ("0\t1,0,0,0\n", "row 1 of {} must have 9 cells, got 5"),
    "nothing": ("", "{} must have at least one row of numbers"),
}


@pytest.mark.parametrize("case", BAD)
def test_files_that_hold_no_quaternions(case, tmp_path):
    rows, message = BAD[case]
    path = tmp_path / "bad.sto"
    path.write_text(HEAD + rows)
    with pytest.raises(ValueError, match=re.escape(message.format(repr(str(path)))[:70])) as caught:
        read_orientations(path)
    assert "\n" not in str(caught.value)


def test_what_cannot_be_placed_or_followed():
    document, recorded = Document(MODEL, parse(MODEL)[0]), read_orientations(STILL)
    with pytest.raises(
        ValueError, match=r"the recording has no base sensor 'torso_imu'; available: pelvis_imu"
    ):
        place(document, recorded, Placing(STILL, ANGLES, "torso_imu", "z"))
    with pytest.raises(ValueError, match=r"the heading axis must be x, y or z, with a sign, got 'up'"):
        place(document, recorded, Placing(STILL, ANGLES, "pelvis_imu", "up"))
    with pytest.raises(
        ValueError, match=r"the model has no frame of a sensor; the recording has pelvis_imu, .*"
    ):
        orientation_kinematics(Bones(document.model), recorded)
    with pytest.raises(ValueError, match=r"the recording has no sensor 'foot_imu'"):
        orientation_kinematics(Bones(document.model), recorded, {"foot_imu": 1.0})
    with pytest.raises(ValueError, match=r"give --orientations FILE"):
        kinematics_of_sensors(Bones(document.model), TrialSetup())


@pytest.mark.parametrize("option", ["fill", "marker_set"])
def test_options_of_markers_are_refused(tmp_path, option):
    message = f"--{option.replace('_', '-')} is of markers; leave it out where sensors are followed"
    with pytest.raises(ValueError, match=message):
        Kinematics(MODEL, orientations=WALK, output=tmp_path, **{option: 0.1})()


def test_wrong_files_of_quaternions(tmp_path):
    """Read with orthonormal axes, or refused in one sentence that names the file."""
    text, read = "".join(WALK.read_text().splitlines(keepends=True)[:12]), 0
    for number in range(200):
        path = tmp_path / f"{number}.sto"
        path.write_text(cases.mutated(text, number), encoding="utf-8", newline="")
        found, fault = None, path.name
        try:
            found = read_orientations(path)
        except ValueError as error:
            fault = str(error)
        assert path.name in fault
        assert "\n" not in fault
        if found is None:
            continue
        rotations = found.rotations[np.isfinite(found.rotations).all(axis=(2, 3))]
        product = rotations @ rotations.swapaxes(1, 2)
        assert (np.abs(product - np.eye(3)) < 1e-12).all()
        read += 1
    assert 40 < read < 190

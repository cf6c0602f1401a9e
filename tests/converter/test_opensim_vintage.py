"""Documents of all versions beside OpenSim 4.6, which recorded what it makes of them."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from myowarp.osim.body.moment_arm import own_reference, poses_of
from myowarp.osim.document.kinematics import complete, forward
from myowarp.osim.document.read.model import read_model

DATA = Path(__file__).parents[1] / "data"
RECORDED = json.loads((DATA / "opensim" / "vintage.json").read_text())
MODELS = sorted(set(RECORDED) - {"opensim"})

CLOSE = 1e-12
"""[m]: rounding of float64."""


def posed(model, values):
    """Return frames and lengths in one pose."""
    names = [row[0] for row in RECORDED[model.name]["coordinates"]]
    whole = complete(model, {name: np.array([x]) for name, x in zip(names, values, strict=True)}, 1)
    poses = poses_of(model, whole, [])
    lengths = [own_reference(model, one.path, poses, []).length[0] for one in model.muscles.values()]
    return forward(model, whole), lengths


@pytest.mark.parametrize("name", MODELS)
def test_documents_of_all_versions(name):
    wanted, model = RECORDED[name], read_model(DATA / "osim" / f"{name}.osim")
    found = [[c.name, c.default, *c.range, c.clamped] for c in model.coordinates.values()]
    assert found == wanted["coordinates"]
    assert {body.name: body.mass for body in model.bodies.values()} == wanted["masses"]
    assert list(model.muscles) == wanted["muscles"]
    assert model.notes == ()
    for pose in wanted["poses"]:
        frames, lengths = posed(model, pose["values"])
        assert lengths == pytest.approx(pose["lengths"], abs=CLOSE)
        for body, origin, rotation in zip(wanted["masses"], pose["origins"], pose["rotations"], strict=True):
            np.testing.assert_allclose(frames[body][1][0], origin, atol=CLOSE)
            np.testing.assert_allclose(frames[body][0][0], rotation, atol=CLOSE)


def test_actuators_of_version_1_push_the_other_way():
    model = read_model(DATA / "osim" / "vintage_1.osim")
    torque, push = model.body_actuators
    one, other, axis = RECORDED["vintage_1"]["actuators"]["twist"]
    assert (torque.body, torque.reaction, torque.in_ground) == (one, other, True)
    np.testing.assert_allclose(torque.axis, axis)
    body, point, direction = RECORDED["vintage_1"]["actuators"]["push"]
    assert (push.body, push.in_ground) == (body, True)
    np.testing.assert_allclose(push.location, point)
    np.testing.assert_allclose(push.axis, direction)


def test_meshes_of_version_1():
    shapes = read_model(DATA / "osim" / "vintage_1.osim").shapes
    assert [(shape.file, shape.body) for shape in shapes] == [("humerus.vtp", "upper"), ("ribs.vtp", "upper")]
    np.testing.assert_array_equal([shape.size for shape in shapes], [[1.1, 1.0, 0.9]] * 2)


def test_joints_of_one_name_are_numbered():
    """As OpenSim does; osim-rl's models of a walker have two joints called back."""
    joints = read_model(DATA / "osim" / "vintage_1.osim").joints
    assert [(joint.name, joint.child) for joint in joints.values()] == [
        ("shoulder_joint", "upper"),
        ("elbow_joint", "lower"),
        ("elbow_joint_0", "hand"),
    ]


def test_coordinates_of_one_name_are_told_apart_by_their_joints(tmp_path):
    """In OpenSim they are /jointset/shoulder_joint/elbow and /jointset/elbow_joint/elbow."""
    text = (DATA / "osim" / "stations.osim").read_text().replace('name="shoulder"', 'name="elbow"')
    spring = '<SpringGeneralizedForce name="spring"><socket_coordinate>/jointset/{}/elbow</socket_coordinate>'
    for joint, coordinate in (("shoulder_joint", "elbow"), ("elbow_joint", "elbow_joint_elbow")):
        path = tmp_path / f"{joint}.osim"
        held = f"{spring.format(joint)}</SpringGeneralizedForce>"
        muscle = '<Thelen2003Muscle name="flexor">'
        path.write_text(text.replace(muscle, held + muscle))
        model = read_model(path)
        assert list(model.coordinates) == ["elbow", "elbow_joint_elbow"]
        assert model.coordinate_springs[0].coordinate == coordinate


BAD = {
    "other body": ("/markerset/side", "/markerset/wrist", "must have points of one body, got lower, upper"),
    "no station": ("<socket_point_a>../a<", "<socket_point_a>../q<", "has the point_a '../q', but the model"),
    "a line": ("<location>0.02 -0.3 0.06", "<location>0.05 -0.28 0.02", "must have points a, b and c that"),
    "one axis": ("<ab_axis>-y", "<ab_axis>-x", "has 'x' as both of its axes; they must differ"),
    "no axis": ("<ab_axis>-y", "<ab_axis>up", "must have ab_axis of x, y or z with a sign, got 'up'"),
    "itself": ("frame>../tilted<", "frame>../end<", "is defined by points in itself"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_frames_that_stations_do_not_define(case, tmp_path):
    old, new, message = BAD[case]
    text = (DATA / "osim" / "stations.osim").read_text()
    assert old in text
    path = tmp_path / "bad.osim"
    path.write_text(text.replace(old, new))
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        read_model(path)
    assert re.match(
        rf"{re.escape(str(path))}:\d+: <StationDefinedFrame name='(end|second)'>", str(caught.value)
    )

"""Reading .osim files: what is read, both forms of documents, and what is refused in one sentence."""

import os
import re
import time
from pathlib import Path

import numpy as np
import pytest

from myowarp.osim.document.elements import ConditionalPathPoint, MovingPathPoint, PathPoint
from myowarp.osim.document.functions import Constant, Linear, SimmSpline
from myowarp.osim.document.read.element import MAX_DEPTH, parse
from myowarp.osim.document.read.model import read_model

MODELS = Path(__file__).parents[1] / "data" / "osim"
ARM, OLD, JOINTS = (MODELS / f"{name}.osim" for name in ("arm26", "old", "joints"))

FOLDER = Path(os.environ.get("MYOWARP_OSIM_DIR", Path(__file__).parents[2] / ".." / "shared" / "osim"))
TWINS = [FOLDER / "more" / f"gait2392_millard2012muscle{end}.osim" for end in ("_20303", "")]

PATIENCE = 20.0
"""s of processor time for a hostile file; a sound one of 1 MB takes 0.2 s."""


def changed(tmp_path, source, old, new, count=1):
    """Return a copy of a model with a piece of its text exchanged."""
    text = source.read_text()
    assert old in text
    path = tmp_path / "changed.osim"
    path.write_text(text.replace(old, new, count))
    return path


def test_arm():
    model = read_model(ARM)
    assert (model.name, model.version) == ("arm26", 40000)
    assert "CCBY 3.0" in model.credits
    assert model.publications.startswith("Holzbaur")
    np.testing.assert_array_equal(model.gravity, [0, -9.8066, 0])
    assert list(model.bodies) == ["base", "r_humerus", "r_ulna_radius_hand"]
    humerus = model.bodies["r_humerus"]
    assert humerus.mass == 1.864572
    np.testing.assert_array_equal(humerus.mass_center, [0, -0.180496, 0])
    np.testing.assert_array_equal(humerus.inertia, [0.01481, 0.004551, 0.013193, 0, 0, 0])
    assert list(model.joints) == ["offset", "r_shoulder", "r_elbow"]
    assert [move.coordinate for move in model.joints["r_elbow"].moves] == ["r_elbow_flex"]
    elbow = model.coordinates["r_elbow_flex"]
    assert (elbow.range, elbow.clamped, elbow.locked) == ((0.0, 2.26892803), False, False)
    assert set(model.markers) == {"r_acromion", "r_humerus_epicondyle", "r_radius_styloid"}
    ellipsoid = model.wraps["BIClonghh"]
    assert (ellipsoid.kind, ellipsoid.body, ellipsoid.size) == ("ellipsoid", "r_humerus", (0.025, 0.02, 0.02))
    assert model.wraps["TRI"].quadrant == "all"
    triceps = model.muscles["TRIlong"]
    assert (triceps.type, triceps.max_isometric_force) == ("Thelen2003Muscle", 798.52)
    assert [wrap.object for wrap in triceps.path.wraps] == ["TRI", "TRIlonghh", "TRIlongglen"]
    assert triceps.parameters["FmaxTendonStrain"] == 0.033
    assert "FmaxTendonStrain" in triceps.given
    # Not in the file: the class's default.
    assert triceps.parameters["fv_linear_extrap_threshold"] == 0.95
    assert "fv_linear_extrap_threshold" not in triceps.given
    assert model.notes == ()


def test_points_that_move_and_come_and_go():
    path = read_model(MODELS / "leg6dof9musc.osim").muscles["rect_fem_r"].path
    assert [type(point) for point in path.points] == [PathPoint, ConditionalPathPoint, MovingPathPoint]
    assert path.points[1].coordinate == "knee_angle_r"
    assert path.points[2].coordinates == ("knee_angle_r", "knee_angle_r", None)
    assert isinstance(path.points[2].functions[2], Constant)


def test_document_of_version_3():
    model = read_model(OLD)
    assert model.version == 30000
    assert model.credits.endswith("& free.")
    assert [(joint.parent, joint.child) for joint in model.joints.values()] == [
        ("ground", "upper"),
        ("upper", "lower"),
    ]
    np.testing.assert_array_equal(model.bodies["upper"].inertia, [0.02, 0.01, 0.02, 0.001, 0, 0])
    slide, hinge = model.joints["shoulder"].moves
    assert (slide.kind, type(slide.function)) == ("slide", SimmSpline)
    assert (hinge.kind, hinge.function) == ("hinge", Linear(1.0))
    triceps = model.muscles["triceps"]
    assert [point.body for point in triceps.path.points] == ["upper", "upper", "lower"]
    assert triceps.path.points[1].range == (0.4, 2.0)
    assert triceps.path.wraps[0].object == "elbow_cylinder"
    assert model.wraps["elbow_cylinder"].quadrant == "-x"
    # The file's degrees, as OpenSim 4.6 applies them: 5 N m at 0 rad, 4.1 N m at 113 degrees within the step.
    (stop,) = model.limit_forces
    assert stop.limits == pytest.approx(np.radians([5, 110]))
    assert stop.stiffness[0] * stop.limits[0] == pytest.approx(5.0)
    assert [note.path for note in model.notes] == ["/controllerset/control"]


def test_document_of_version_2(tmp_path):
    """Classes have older names, and paths lie in the muscle itself; OpenSim 4.6 saves the same of both."""
    text = OLD.read_text().replace('Version="30000"', 'Version="20101"').replace("ForceSet", "ActuatorSet")
    for new, old in (
        ("ConditionalPathPoint", "MuscleViaPoint"),
        ("MovingPathPoint", "MovingMusclePoint"),
        ("PathPoint", "MusclePoint"),
        ("PathWrap", "MuscleWrap"),
        ("pennation_angle_at_optimal", "pennation_angle"),
    ):
        text = re.sub(rf"\b{new}(Set)?\b", rf"{old}\1", text)
    text = re.sub("</?GeometryPath>", "", text)
    gone = "<Vmax>7</Vmax><Vmax0>3</Vmax0><damping>0.1</damping>"
    text = text.replace("<FmaxTendonStrain>", f"{gone}<FmaxTendonStrain>")
    motor = '<GeneralizedForce name="motor"><coordinate>elbow_flexion</coordinate></GeneralizedForce>'
    path = tmp_path / "older.osim"
    path.write_text(text.replace("<CoordinateLimitForce ", f"{motor}<CoordinateLimitForce "))
    older, old = read_model(path), read_model(OLD)
    assert (older.version, [motor.name for motor in older.coordinate_actuators]) == (20101, ["motor"])
    found, wanted = older.muscles["triceps"], old.muscles["triceps"]
    for key in ("name", "type", "max_isometric_force", "pennation_angle_at_optimal", "control_range"):
        assert getattr(found, key) == getattr(wanted, key), key
    assert {key: found.parameters[key] for key in wanted.parameters} == wanted.parameters
    assert "damping" not in found.parameters
    assert found.path.wraps == wanted.path.wraps
    assert [type(point) for point in found.path.points] == [type(point) for point in wanted.path.points]


@pytest.mark.parametrize(("version", "least"), [(20303, 0.01), (30000, 0.01), (30513, 0.0), (40000, 0.0)])
def test_a_least_control_of_zero_counts_since_30513(version, least, tmp_path):
    """As in OpenSim 4.6; it is 0.01 in a Thelen2003Muscle that states none."""
    path = changed(tmp_path, OLD, '"30000"', f'"{version}"')
    path.write_text(path.read_text().replace("<isDisabled>false</isDisabled>", ""))
    assert read_model(path).muscles["triceps"].control_range == (least, 1.0)


@pytest.mark.skipif(not TWINS[0].is_file(), reason="needs the public models")
def test_twins_of_versions_2_and_4_are_the_same():
    older, new = map(read_model, TWINS)
    assert (older.version, new.version) == (20303, 40000)
    assert list(older.joints) == list(new.joints)
    assert older.coordinates.keys() == new.coordinates.keys()
    for name, body in new.bodies.items():
        assert older.bodies[name].mass == body.mass
        np.testing.assert_allclose(older.bodies[name].inertia, body.inertia, rtol=1e-12)
    for name, muscle in new.muscles.items():
        twin = older.muscles[name]
        assert twin.control_range == muscle.control_range
        assert twin.optimal_fiber_length == pytest.approx(muscle.optimal_fiber_length, rel=1e-12)
        assert {key: twin.parameters[key] for key in muscle.parameters} == pytest.approx(muscle.parameters)
        for point, other in zip(twin.path.points, muscle.path.points, strict=True):
            assert (type(point), point.body) == (type(other), other.body)


def test_frames_chain_and_joints_turn_round():
    model = read_model(JOINTS)
    welded = model.joints["wel"]
    assert (welded.parent, welded.child) == ("free", "welded")
    # far + far's axes * (farther + farther's axes * p), checked against OpenSim in test_opensim_kinematics
    assert not np.allclose(welded.parent_frame.position, [0.1, -0.2, 0.3])
    turned = model.joints["rev"]
    assert (turned.parent, turned.child) == ("ball", "turned")
    assert turned.moves[0].function.value(0.3) == -0.3
    assert model.coordinates["stuck"].locked


def test_defaults_of_the_document(tmp_path):
    """What an element leaves out comes from its class's entry in <defaults>, then from the class."""
    block = "<defaults><Thelen2003Muscle><Af>0.4</Af><Flen>1.7</Flen></Thelen2003Muscle></defaults>"
    path = changed(tmp_path, OLD, "<Model ", f"{block}<Model ")
    path.write_text(path.read_text().replace("<FmaxTendonStrain>", "<Flen>1.5</Flen><FmaxTendonStrain>"))
    parameters = read_model(path).muscles["triceps"].parameters
    assert (parameters["Af"], parameters["Flen"], parameters["KshapeActive"]) == (0.4, 1.5, 0.45)


def test_what_is_left_out_is_noted(tmp_path):
    extra = """<ForceSet><objects><ElasticFoundationForce name="floor">
    </ElasticFoundationForce><BushingForce name="off"><appliesForce>false</appliesForce></BushingForce>"""
    path = changed(tmp_path, OLD, "<ForceSet>\n      <objects>", extra)
    notes = {note.path: note.rule for note in read_model(path).notes}
    assert notes["/forceset/floor"] == "ElasticFoundationForce has no counterpart; left out"
    assert notes["/forceset/off"] == "switched off in the file; left out"


def test_speeds_at_the_start_are_noted(tmp_path):
    """OpenSim's simulations begin with them; those of a scene begin at rest."""
    assert not any("at rest" in note.rule for note in read_model(ARM).notes)
    path = changed(tmp_path, ARM, "<default_speed_value>0<", "<default_speed_value>-2.5<")
    rules = [note.rule for note in read_model(path).notes]
    assert "begins with -2.5 rad/s in OpenSim; here it begins at rest" in rules


def test_bytes_that_are_no_utf_8(tmp_path):
    path = tmp_path / "latin.osim"
    path.write_bytes(OLD.read_text().replace("free.", "Jörg").encode("latin-1"))
    model = read_model(path)
    assert model.credits.endswith("Jörg")
    assert model.notes[0].rule == "the file is not UTF-8 as it says; read as Latin-1"


MASS = "<mass>2</mass>"
BAD = {
    "not a number": (MASS, "<mass>two</mass>", r":\d+: <mass> must be numbers, got 'two'"),
    "not finite": (MASS, "<mass>nan</mass>", r":\d+: <mass> must be finite, below 1e\+15 in size, got 'nan'"),
    "negative mass": (
        MASS,
        "<mass>-2</mass>",
        r":\d+: <Body name='upper'> must have a mass of at least 0, got -2",
    ),
    "missing mass": (MASS, "", r":\d+: <Body name='upper'> has no <mass>"),
    "no such body": (
        "<body>lower</body>",
        "<body>low</body>",
        r"is attached to 'low', but the model has no such",
    ),
    "no such coordinate": (
        "<coordinate>elbow_flexion",
        "<coordinate>e",
        r"'e', which the model does not have",
    ),
    "no such wrap": (
        "<wrap_object>elbow_c",
        "<wrap_object>c",
        r"refers to wrap object 'cylinder', which the",
    ),
    "duplicate": (
        '<Body name="lower">',
        '<Body name="upper">',
        r"has the name of another body, in line \d+",
    ),
    "duplicate coordinate": (
        '<Coordinate name="shoulder_flexion">',
        '<Coordinate name="shoulder_flexion"/><Coordinate name="shoulder_flexion">',
        r"<Coordinate name='shoulder_flexion'> has the coordinate 'shoulder_flexion' twice",
    ),
    "unsupported joint": (
        "PinJoint",
        "ConstantCurvatureJoint",
        r"is no supported joint; these are: WeldJoint, PinJoint",
    ),
    "unsupported function": (
        "NaturalCubicSpline",
        "Wave",
        r"<Wave> is no supported function; these are: Constant",
    ),
    "unsupported point": ("ConditionalPathPoint", "Orbit", r"<Orbit name='t-P2'> is no supported path point"),
    "falling knots": ("-1 0 1 2", "-1 0 -0.1 2", r"must have knots with ascending x"),
    "uneven knots": ("-1 0 1 2", "-1 0 1", r"must have at least 2 knots, as many x as y, got 3 and 4"),
    "old version": ('"30000"', '"10900"', r"has version '10900'; documents 10901 to 40699 are read"),
    "other root": ("OpenSimDocument", "Sdf", r"is no OpenSim model; its root must be <OpenSimDocument>"),
    "zero fiber": (">0.12<", ">0<", r"must have optimal_fiber_length from 1e-06 to inf, got 0"),
    "falling range": (
        "<range>-1 2</range>",
        "<range>2 -1</range>",
        r"must have an ascending range, got 2 -1",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused(case, tmp_path):
    old, new, message = BAD[case]
    count = 2 if old in ("PinJoint", "NaturalCubicSpline", "ConditionalPathPoint", "OpenSimDocument") else 1
    path = changed(tmp_path, OLD, old, new, count)
    with pytest.raises((ValueError, NotImplementedError), match=message) as caught:
        read_model(path)
    assert re.match(rf"{re.escape(str(path))}:\d+: <\w+", str(caught.value))
    assert "\n" not in str(caught.value)


FUNCTION = '<LinearFunction name="function"><coefficients>0.5 0</coefficients></LinearFunction>'
TWIST = "<coordinates>twist</coordinates><axis>0 1 0.2</axis>"
COUPLER = "<coupled_coordinates_function>"
MISREAD = {
    "unknown function": (
        "joints",
        FUNCTION,
        FUNCTION.replace("LinearFunction", "Wave"),
        r"Wave.* is no supp",
    ),
    "function of another name": ("joints", FUNCTION, FUNCTION.replace('="f', '="another_f'), "no <function>"),
    "no function": ("joints", FUNCTION, "", r"'rotation3'> has no <function> of its coordinate 'twist'"),
    "function of nothing": (
        "joints",
        TWIST,
        TWIST.replace("twist", ""),
        r"no constant, and names no coordinate",
    ),
    "axis twice": ("joints", '="rotation2"', '="rotation1"', r"'cus'> has two axes of one name"),
    "coordinate missing": (
        "joints",
        '<Coordinate name="gim_b">',
        '<Lost name="gim_b">',
        r"have 3 coord.* got 2",
    ),
    "decimal comma": ("joints", "0.01 0.02 0.07", "0,01 0,02 0,07", r"numbers with points, not commas"),
    "frame of another joint": ("joints", "frame>p</", "frame>far</", r"of that name is, but not there"),
    "coupler without function": ("forces", COUPLER, "<lost>", r"has no <coupled_coordinates_function>"),
    "negative stiffness": ("forces", "stiffness>900<", "stiffness>-900<", r"must be at least 0, got -900"),
    "negative spring": ("forces", "<stiffness>700<", "<stiffness>-700<", r"must be at least 0, got -700"),
    "exponent": ("arm26", "<KshapePassive>4", "<KshapePassive>4000", r"KshapePassive at most 50, got 4000"),
}
"""Text of a model, and what else than it said was read from another one before: what OpenSim 4.6 refuses, or
reads as no motion."""


@pytest.mark.parametrize("case", MISREAD)
def test_what_could_only_be_guessed_is_refused(case, tmp_path):
    name, old, new, message = MISREAD[case]
    path = changed(tmp_path, MODELS / f"{name}.osim", old, new)
    if old == COUPLER:
        path.write_text(path.read_text().replace("</coupled_coordinates_function>", "</lost>", 1))
    if "Lost" in new:
        text = path.read_text()
        begin = text.index("<Lost")
        path.write_text(text[:begin] + text[text.index("</Coordinate>", begin) + 13 :])
    with pytest.raises((ValueError, NotImplementedError), match=message) as caught:
        read_model(path)
    assert re.match(rf"{re.escape(str(path))}:\d+: <\w+", str(caught.value))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<orientation>0.2 -0.3 0.4<", "<orientation>0 0 -90<", "has the orientation 0 0 -90 in radians"),
        ("<default_value>0.3</default_value>", "<default_value>30</default_value>", "has the default 30 in"),
        ("<range>-1.2 1.1</range>", "<range>-120 10</range>", "has the range -120 10 in radians, as OpenSim"),
        ("<range>-1.2 1.1</range>", "<range>-10 10</range>", ""),
        ("<range>-1.2 1.1</range>", "<range>-99999.9 99999.9</range>", ""),
    ],
)
def test_angles_that_look_like_degrees_are_said(old, new, said, tmp_path, caplog):
    text = JOINTS.read_text()
    begin = text.index('name="loc"') if "orient" in old else text.index('name="gim_b"')
    (tmp_path / "turned.osim").write_text(text[:begin] + text[begin:].replace(old, new, 1))
    read_model(tmp_path / "turned.osim")
    assert len(caplog.records) == bool(said)
    assert said in caplog.text


def test_a_function_needs_no_name(tmp_path):
    named, unnamed = (
        read_model(changed(tmp_path, JOINTS, FUNCTION, text)).joints["cus"].moves
        for text in (FUNCTION, FUNCTION.replace(' name="function"', ""))
    )
    assert [move.function for move in unnamed] == [move.function for move in named]


@pytest.mark.parametrize("form", ['<{0} name="{1}">{2}</{0}>', "<{1}><{0}>{2}</{0}></{1}>"])
@pytest.mark.parametrize("function", ["SimmSpline", "Wave"])
def test_curves_of_muscles_are_read_or_refused(function, form, tmp_path):
    curve = form.format(function, "active_force_length_curve", "<x>0 1 2</x><y>0 1 0</y>")
    text = ARM.read_text().replace("Thelen2003Muscle", "Schutte1993Muscle_Deprecated")
    path = tmp_path / "spline.osim"
    path.write_text(text.replace("<max_isometric_force>", f"{curve}<max_isometric_force>", 1))
    if function == "Wave":
        with pytest.raises(NotImplementedError, match="is no supported function"):
            read_model(path)
        return
    assert read_model(path).muscles["TRIlong"].curves == {
        "active_force_length_curve": SimmSpline((0.0, 1.0, 2.0), (0.0, 1.0, 0.0))
    }


def test_of_two_properties_of_a_name_the_first_counts(tmp_path):
    once = "<tendon_slack_length>0.14299999999999999"
    both = "".join(
        f"<ignore_tendon_compliance>{word}</ignore_tendon_compliance>" for word in ("true", "false")
    )
    muscle = read_model(changed(tmp_path, ARM, once, both + once)).muscles["TRIlong"]
    assert muscle.ignore_tendon_compliance


CYCLIC = (
    "<socket_parent>..</socket_parent>\n              <translation>0.02",
    "<socket_parent>farther</socket_parent>\n              <translation>0.02",
)


def test_cyclic_frames(tmp_path):
    with pytest.raises(ValueError, match="is attached to 'p', which is its own parent or on over 100 frames"):
        read_model(changed(tmp_path, JOINTS, *CYCLIC))


def test_couplers_in_a_circle(tmp_path):
    old = "<independent_coordinate_names>bend<"
    path = changed(tmp_path, JOINTS, old, "<independent_coordinate_names>patella_2<")
    with pytest.raises(ValueError, match=r"<CoordinateCouplerConstraint name='patella_.*depend on itself"):
        read_model(path)


def test_loops_of_joints(tmp_path):
    """A joint too many moves a copy of its body, which is welded to the body and has half of its mass."""
    weld = '<WeldJoint name="shut"><socket_parent_frame>/ground</socket_parent_frame>'
    weld += "<socket_child_frame>/bodyset/loose</socket_child_frame></WeldJoint>"
    path = changed(tmp_path, JOINTS, '<PinJoint name="loc">', f'{weld}<PinJoint name="loc">')
    model = read_model(path)
    (copy,) = set(model.bodies) - set(read_model(JOINTS).bodies)
    (closing,) = (joint for joint in model.joints.values() if joint.child == copy)
    body = copy.removesuffix(f"-closed-by-{closing.name}")
    assert body in model.bodies
    whole = read_model(JOINTS).bodies[body]
    assert whole.mass > 0
    for half in (model.bodies[body], model.bodies[copy]):
        assert half.mass == whole.mass / 2
        np.testing.assert_array_equal(half.inertia, whole.inertia / 2)
    constraint = model.constraints[-1]
    assert (constraint.kind, constraint.bodies) == ("weld", (body, copy))


def test_components_without_name(tmp_path):
    """They are called as OpenSim calls them."""
    path = changed(tmp_path, OLD, '<PinJoint name="elbow">', "<PinJoint>")
    assert "pinjoint" in read_model(path).joints


def test_bodies_without_joint_float(tmp_path):
    path = changed(
        tmp_path,
        JOINTS,
        '<Body name="slid">',
        '<Body name="lost"><mass>1</mass><inertia>1 1 1 0 0 0</inertia></Body><Body name="slid">',
    )
    model = read_model(path)
    assert model.joints["free_lost"].type == "FreeJoint"
    assert len([name for name in model.coordinates if name.startswith("free_lost_coord_")]) == 6
    assert [note.path for note in model.notes] == ["/bodyset/lost"]


def test_truncated_anywhere(tmp_path):
    text = OLD.read_text()
    path = tmp_path / "short.osim"
    for end in range(0, len(text) - 20, 997):
        path.write_text(text[:end])
        with pytest.raises(ValueError, match=r"short.osim:\d+: not a complete XML document: .+"):
            read_model(path)


BOMB = '<!DOCTYPE x [<!ENTITY a "aa"><!ENTITY b "&a;&a;&a;">]><OpenSimDocument>&b;</OpenSimDocument>'
FETCH = '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/hostname">]><OpenSimDocument>&a;</OpenSimDocument>'


@pytest.mark.parametrize("text", [BOMB, FETCH], ids=["bomb", "external"])
def test_entities_are_refused(text, tmp_path):
    path = tmp_path / "hostile.osim"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"hostile.osim:1: a document type is not allowed"):
        read_model(path)


HOSTILE = {
    "nested": ("<a>" * 10**6, f"nested more than {MAX_DEPTH} deep"),
    "comments": ("<!--" * 10**6, "not a complete XML document"),
    "one long number": ("<OpenSimDocument Version='4" + "0" * 10**6 + "'/>", "has version '40000"),
    "ampersands": ("&" * 10**6, "not a complete XML document"),
    "binary": ("\0\1\2\3" * 10**5, "not a complete XML document"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_files_end_soon(case, tmp_path):
    text, message = HOSTILE[case]
    path = tmp_path / "hostile.osim"
    path.write_text(text)
    begin = time.process_time()
    with pytest.raises(ValueError, match=message) as caught:
        read_model(path)
    assert time.process_time() - begin < PATIENCE
    assert len(str(caught.value)) < 500


def test_lines_are_those_of_the_file():
    root, latin = parse(OLD)
    lines = OLD.read_text().splitlines()
    assert not latin
    assert all(f"<{element.tag}" in lines[element.line - 1] for element in root.walk())


@pytest.mark.parametrize("text", ["x", "1 2", "0 0 0", "1_0", "\u0663"])
@pytest.mark.parametrize(
    "name", ["pennation_angle_at_optimal", "FmaxTendonStrain", "deactivation_time_constant"]
)
def test_parameters_that_are_no_number_are_refused(tmp_path, name, text):
    """Each parameter that a class has, not the three most important ones alone."""
    source = (MODELS / "arm26.osim").read_text()
    found = re.search(rf"<{name}>[^<]*</{name}>", source)
    path = tmp_path / "arm.osim"
    path.write_text(source.replace(found[0], f"<{name}>{text}</{name}>", 1), encoding="utf-8")
    with pytest.raises(ValueError, match=rf"<{name}> must be (one number|numbers), got '{text}'"):
        read_model(path)


def test_tabs_and_line_breaks_in_names_are_blanks(tmp_path):
    """As in the texts that refer to them; else a table with such a column is no table."""
    path = changed(tmp_path, MODELS / "arm26.osim", 'name="BRA"', 'name="BRA&#9;&#10;  a"')
    assert "BRA a" in read_model(path).muscles

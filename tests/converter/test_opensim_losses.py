"""What acts in OpenSim and not in the result: it has a code and a size, and --strict fails until accepted."""

import mujoco
import numpy as np
import pytest

from myowarp.apps.cli.convert import Convert
from myowarp.osim.convert import run as command
from myowarp.osim.document.model import Loss, Note
from myowarp.osim.document.read.components import READERS
from myowarp.osim.document.read.model import read_model
from myowarp.sim.converted_step import OurStep

TORSION, TENSION = 30.0, 400.0
"""N m/rad and N/m of the bushings."""

PENDULUM = """<OpenSimDocument Version="40000"><Model name="pendulum"><gravity>0 -9.8 0</gravity>
<BodySet><objects>
 <Body name="rod"><mass>2</mass><mass_center>0 -.3 0</mass_center><inertia>.1 .02 .1 0 0 0</inertia></Body>
 <Body name="bob"><mass>1</mass><mass_center>0 -.1 0</mass_center><inertia>.1 .1 .1 0 0 0</inertia></Body>
</objects></BodySet>
<JointSet><objects>
 <PinJoint name="top"><socket_parent_frame>/ground</socket_parent_frame>
  <socket_child_frame>/bodyset/rod</socket_child_frame>
  <coordinates><Coordinate name="swing"><range>-1 1</range></Coordinate></coordinates></PinJoint>
 <CustomJoint name="low"><socket_parent_frame>hinge</socket_parent_frame>
  <socket_child_frame>/bodyset/bob</socket_child_frame>
  <coordinates><Coordinate name="bend"><range>-.8 .8</range></Coordinate>
   <Coordinate name="hidden"><range>-1 1</range></Coordinate></coordinates>
  <frames><PhysicalOffsetFrame name="hinge"><socket_parent>/bodyset/rod</socket_parent>
   <translation>0 -.6 0</translation></PhysicalOffsetFrame></frames>
  <SpatialTransform>
   <TransformAxis name="rotation3"><coordinates>bend</coordinates><axis>0 0 1</axis>
    <LinearFunction name="function"><coefficients>-1 .2</coefficients></LinearFunction>
   </TransformAxis>
   <TransformAxis name="translation1"><coordinates>hidden</coordinates><axis>1 0 0</axis>
    <PolynomialFunction name="function"><coefficients>.01 0 .01</coefficients>
    </PolynomialFunction>
   </TransformAxis>
  </SpatialTransform></CustomJoint>
</objects></JointSet>
<ConstraintSet><objects><CoordinateCouplerConstraint name="couple">
 <coupled_coordinates_function><LinearFunction><coefficients>1 0</coefficients></LinearFunction>
 </coupled_coordinates_function><independent_coordinate_names>bend</independent_coordinate_names>
 <dependent_coordinate_name>hidden</dependent_coordinate_name></CoordinateCouplerConstraint>
 {constraint}</objects></ConstraintSet>
<ForceSet><objects>{force}</objects></ForceSet>{more}</Model></OpenSimDocument>"""

BUSHING = """<BushingForce name="lost">
<socket_frame1>/ground</socket_frame1><socket_frame2>{frame}</socket_frame2>
<rotational_stiffness>0 0 {torsion}</rotational_stiffness><translational_stiffness>{tension}
</translational_stiffness></BushingForce>"""


def written(tmp_path, force="", constraint="", more=""):
    path = tmp_path / "pendulum.osim"
    path.write_text(PENDULUM.format(force=force, constraint=constraint, more=more))
    return path


def converted(path, tmp_path, **options):
    """Convert strictly; returns what was printed by an error, "" for none."""
    convert = Convert(path, tmp_path / "out", workers=1, strict=True, overwrite=True, **options)
    try:
        convert()
    except ValueError as error:
        return str(error)
    return ""


UNREAD = sorted(set(READERS) - {"Marker", "CoordinateCouplerConstraint"})
UNREAD = sorted({*UNREAD, "HuntCrossleyForce", "PointOnLineConstraint", "NoOneKnowsForce"})
"""Kinds of what acts, none of which is read in the test below."""


def test_what_nobody_reads_is_a_loss(tmp_path, monkeypatch, capsys):
    """Each kind: --strict fails and names the codes that accept them, down to the last one."""
    lost = {"constraint": "", "force": ""}
    for kind in UNREAD:
        monkeypatch.delitem(READERS, kind, raising=False)
        lost["constraint" if kind.endswith("Constraint") else "force"] += f'<{kind} name="lost {kind}"/>'
    path = written(tmp_path, **lost)
    assert converted(path, tmp_path).endswith(f"--accept-losses {' '.join(UNREAD)} accepts them")
    said, page = capsys.readouterr().out, (tmp_path / "out" / "report.html").read_text()
    assert [kind for kind in UNREAD if f"left out: {kind}, 1, " not in said] == []
    assert [kind for kind in UNREAD if f">{kind}</td>" not in page] == []
    *others, last = UNREAD
    left = converted(path, tmp_path, accept_losses=tuple(others))
    assert left.endswith(f"; --accept-losses {last} accepts them")
    capsys.readouterr()
    assert converted(path, tmp_path, accept_losses=tuple(UNREAD)) == ""
    lines = [line for line in capsys.readouterr().out.splitlines() if "accepted by you" in line]
    assert sorted(line.split()[2].rstrip(",") for line in lines) == UNREAD


@pytest.mark.parametrize(
    ("kind", "force"),
    [
        ("CoordinateLimitForce", "<coordinate>hidden</coordinate>"),
        ("SpringGeneralizedForce", "<coordinate>hidden</coordinate><stiffness>5</stiffness>"),
        ("CoordinateActuator", "<coordinate>hidden</coordinate>"),
    ],
)
def test_what_acts_where_no_joint_is_is_a_loss(kind, force, tmp_path):
    path = written(tmp_path, f'<{kind} name="lost">{force}</{kind}>')
    assert f"--accept-losses {kind} " in converted(path, tmp_path)
    assert converted(path, tmp_path, accept_losses=(kind,)) == ""


CONTROLLERS = "<ControllerSet><objects>{}</objects></ControllerSet>"
ON = {
    "PrescribedController": CONTROLLERS.format('<PrescribedController name="on"/>'),
    "MyReflex": CONTROLLERS.format('<MyReflex name="on"><enabled>true</enabled></MyReflex>'),
    "ControlSetController": CONTROLLERS.format(
        "<ControlSetController><controls_file>c.xml</controls_file></ControlSetController>"
    ),
    "ToyReflexController": '<ComponentSet><objects><ToyReflexController name="on"/></objects></ComponentSet>',
    "ControllerSet": '<ControllerSet file="controllers.xml"/>',
}


@pytest.mark.parametrize("code", ON)
def test_controllers_that_are_on_are_losses(code, tmp_path):
    """They act in OpenSim; a set of them may be in another file."""
    notes = read_model(written(tmp_path, more=ON[code])).notes
    found = [(note.code, note.effect, note.largest) for note in notes if isinstance(note, Loss)]
    assert found == [(code, "control", None)]


def test_a_controller_is_a_loss_of_unknown_size(tmp_path, capsys):
    code = "MyReflex"
    path = written(tmp_path, more=ON[code])
    assert converted(path, tmp_path).endswith(f"--accept-losses {code} accepts them")
    assert f"left out: {code}, 1, control, size unknown:" in capsys.readouterr().out
    assert converted(path, tmp_path, accept_losses=(code,)) == ""


def test_what_is_off_or_records_is_no_loss(tmp_path):
    """By the switches of OpenSim 4 and 3, of classes that nobody reads, too."""
    off = ("enabled>false</enabled", "isDisabled>true</isDisabled")
    controllers = "".join(
        f'<ReflexController name="{n}"><{text}></ReflexController>' for n, text in enumerate(off)
    )
    force = '<HuntCrossleyForce name="off"><appliesForce>false</appliesForce></HuntCrossleyForce>'
    probes = (
        '<ProbeSet><objects><JointInternalPowerProbe name="p"/></objects></ProbeSet><MarkerSet file="m.xml"/>'
    )
    notes = read_model(written(tmp_path, force, more=CONTROLLERS.format(controllers) + probes)).notes
    assert [type(note) for note in notes] == [Note] * 5
    assert [note.rule for note in notes].count("switched off in the file; left out") == 3
    assert {note.error_bound for note in notes} == {"0", "0: records, and does not act"}


def test_nothing_is_lost_of_a_pendulum(tmp_path, capsys):
    assert converted(written(tmp_path), tmp_path, accept_losses=("BushingForce",)) == ""
    assert "accepted but not left out here: BushingForce" in capsys.readouterr().out


def test_a_bushing_elsewhere_is_measured(tmp_path):
    """From ground to the bob, whose angle is that of both hinges: -swing with -bend + .2."""
    force = BUSHING.format(frame="/bodyset/bob", torsion=TORSION, tension="1 2 3")
    path = written(tmp_path, force)
    assert "--accept-losses BushingForce " in converted(path, tmp_path)
    (loss,) = command.run(path, tmp_path / "again", OurStep)["left_out"]
    assert loss["code"] == "BushingForce"
    assert loss["effect"] == "force"
    assert loss["unit"] == "N m"
    assert 0.8 * TORSION < loss["largest"] < TORSION * (1 + 0.8 + 0.2)


def energies(model, poses):
    """Return potential energies of springs alone, in poses of all joints."""
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    data, found = mujoco.MjData(model), []
    for pose in poses:
        data.qpos = pose
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        found.append(data.energy[0])
    return np.array(found)


def test_a_bushing_at_a_joint_is_springs_on_its_joints(tmp_path):
    """Energy k/2 d^2 of each deflection d: a turn with an offset, and a slide that follows a polynomial."""
    force = BUSHING.replace("/ground", "/jointset/low/hinge").format(
        frame="/bodyset/bob", torsion=TORSION, tension=f"{TENSION} 0 0"
    )
    path = written(tmp_path, force)
    assert converted(path, tmp_path) == ""
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "model.xml"))
    report = command.run(path, tmp_path / "again", OurStep)
    assert not report["left_out"]
    assert [note["error_bound"] for note in report["notes"] if note["path"] == "/forceset/lost"] == ["0"]
    coordinates = command.json.loads((tmp_path / "out" / "coordinates.json").read_text())
    bend = np.linspace(-0.8, 0.8, 9)
    joints = {entry["name"]: entry["joint"] for entry in coordinates["coordinates"]}
    poses = np.zeros((9, model.nq))
    poses[:, model.joint(joints["bend"]).qposadr[0]] = bend
    for tie in coordinates["dependents"]:
        of = poses[:, model.joint(tie["of"]).qposadr[0]]
        poses[:, model.joint(tie["joint"]).qposadr[0]] = np.polyval(tie["polynomial"][::-1], of)
    turned, slid = -bend + 0.2, 0.01 * bend**2 + 0.01
    expected = 0.5 * TORSION * turned**2 + 0.5 * TENSION * slid**2
    np.testing.assert_allclose(energies(model, poses), expected, rtol=1e-9)


def test_a_bushing_as_stiff_in_all_directions_is_a_spring_between_points(tmp_path):
    force = BUSHING.format(frame="/bodyset/bob", torsion=0, tension=f"{TENSION} {TENSION} {TENSION}")
    path = written(tmp_path, force)
    assert converted(path, tmp_path) == ""
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "model.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    away = np.linalg.norm(data.body("bob").xpos)
    assert energies(model, [data.qpos])[0] == pytest.approx(0.5 * TENSION * away**2)
    assert away == pytest.approx(np.hypot(0.6, 0.01), rel=1e-3)


def test_what_is_inside_of_another_component_is_a_loss(tmp_path):
    inside = '<components><PathActuator name="deep"/></components>'
    path = written(tmp_path)
    path.write_text(path.read_text().replace("<mass>2</mass>", f"{inside}<mass>2</mass>"))
    (loss,) = read_model(path).notes
    assert (loss.code, loss.path) == ("PathActuator", "/deep")


def test_actuators_of_locked_coordinates_are_no_loss(tmp_path):
    path = written(
        tmp_path, '<CoordinateActuator name="idle"><coordinate>swing</coordinate></CoordinateActuator>'
    )
    path.write_text(path.read_text().replace("<range>-1 1</range>", "<locked>true</locked>", 1))
    report = command.run(path, tmp_path / "out", OurStep)
    assert report["left_out"] == []
    assert {note["error_bound"] for note in report["notes"] if note["path"] == "/forceset/idle"} == {
        "0: the coordinate is locked"
    }


def test_a_negative_moment_is_as_in_the_document(tmp_path):
    """In MyoWarp's step; MuJoCo C has joints that follow as joints of their own, and needs a repaired one."""
    path = written(tmp_path)
    old = "<mass_center>0 -.1 0</mass_center><inertia>.1 .1 .1 0 0 0<"
    path.write_text(path.read_text().replace(old, old.replace(".1 .1 .1", ".1 .1 -.001")))
    report = command.run(path, tmp_path / "out", OurStep)
    errors = {key: engine["accelerations"] for key, engine in report["dynamics"]["engines"].items()}
    assert errors["step"]["worst"] < 1e-4
    assert errors["mjb"]["median"] > 1e-3
    (note,) = (note for note in report["notes"] if note["path"] == "/bodyset/bob")
    assert note["rule"].endswith("not positive; least moments were raised in model.xml and model.mjb")
    assert note["error_bound"] == "0.001 kg m^2"

"""Cvt1: frames, inertias and springs of the converted model, its text, its sidecar, and the command."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from myowarp.osim.bundle.bundle import write
from myowarp.osim.bundle.couplings import couplings, follow
from myowarp.osim.bundle.mjcf import mjcf
from myowarp.osim.convert.check.frames import kinematics_error
from myowarp.osim.convert.compose.convert import Options, convert
from myowarp.osim.convert.compose.passive import onset, rising
from myowarp.osim.convert.compose.quartics import fit_all
from myowarp.osim.convert.run import run
from myowarp.osim.document.functions import SimmSpline
from myowarp.osim.document.read.model import read_model
from myowarp.sim.converted_step import OurStep

DATA = Path(__file__).parents[1] / "data"
EXACT = 1e-12
"""m and 1: models without splines, in float64."""
QUARTIC = 1.5e-4
"""m: splines as quartics of phantoms; the project's gate for forward kinematics."""
POINT = 2.5e-4
"""m: moving points, three axes of up to 0.1 mm each on a body of the tolerance above."""
BOUNDS = {
    "arm26": EXACT,
    "Tug_of_War": EXACT,
    "ellipsoids": EXACT,
    "joints": QUARTIC,
    "leg6dof9musc": QUARTIC,
    "gait10dof18musc": QUARTIC,
}


@pytest.fixture(scope="module")
def conversions():
    """Return a function that converts a model once."""
    done = {}

    def of(name):
        if name not in done:
            converted = convert(read_model(DATA / "osim" / f"{name}.osim"))
            done[name] = converted, converted.spec.compile()
        return done[name]

    return of


@pytest.mark.parametrize("name", BOUNDS)
def test_frames_equal_opensim(name, conversions):
    """Bodies, markers and moving points, in the poses and with the numbers recorded from OpenSim 4.6."""
    converted, model = conversions(name)
    recorded = np.load(DATA / "opensim" / f"frames_{name}.npz")
    given = dict(zip(recorded["coordinates"], recorded["values"].T, strict=True))
    qpos = converted.coordinates.qpos(model, {key: given[key] for key in converted.coordinates.free()})
    data, bound = mujoco.MjData(model), BOUNDS[name]
    for index in range(len(qpos)):
        data.qpos = qpos[index]
        mujoco.mj_kinematics(model, data)
        turn = data.body("ground").xmat.reshape(3, 3).T
        for number, body in enumerate(recorded["bodies"]):
            origin = turn @ data.body(converted.bodies[body]).xpos
            np.testing.assert_allclose(origin, recorded["origin"][index, number], atol=bound, err_msg=body)
        for number, marker in enumerate(recorded["markers"]):
            place = turn @ data.site(marker).xpos
            np.testing.assert_allclose(place, recorded["marker"][index, number], atol=bound, err_msg=marker)
        for number, key in enumerate(recorded["points"]):
            muscle, point = key.split("/")
            place = turn @ data.body(converted.moving[muscle][int(point)]).xpos
            np.testing.assert_allclose(place, recorded["point"][index, number], atol=POINT, err_msg=key)


def test_validation_sees_a_moved_body(conversions):
    converted, _ = conversions("arm26")
    good = kinematics_error(converted, converted.spec.compile(), 20)
    assert max(good.position, good.rotation, good.marker) < EXACT
    spec = converted.spec.copy()
    spec.body("r_humerus").pos += [0, 0, 1e-3]
    bad = kinematics_error(converted, spec.compile(), 20)
    assert bad.position == pytest.approx(1e-3)
    assert bad.marker == pytest.approx(1e-3)


@pytest.mark.parametrize("name", ["leg6dof9musc", "joints"])
def test_text_reads_back_the_same(name, conversions):
    """Every number of the compiled model, to the last bit."""
    converted, model = conversions(name)
    back = mujoco.MjModel.from_xml_string(mjcf(converted.spec, comment="a -- b-"))
    for field in dir(model):
        value = getattr(model, field)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(back, field), value, err_msg=field)


def test_up_is_z_and_inertias_are_kept(conversions):
    converted, model = conversions("arm26")
    np.testing.assert_allclose(model.opt.gravity, [0, 0, -9.8066])
    for name, body in converted.model.bodies.items():
        if body.mass == 0:
            continue
        there = model.body(name)
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, there.iquat)
        axes = axes.reshape(3, 3)
        xx, yy, zz, xy, xz, yz = body.inertia
        expected = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        np.testing.assert_allclose(axes @ np.diag(there.inertia) @ axes.T, expected, atol=1e-12)
        np.testing.assert_allclose(there.ipos, body.mass_center, atol=1e-15)
        assert there.mass[0] == body.mass


def test_masses_that_mujoco_refuses_are_repaired(tmp_path):
    text = (DATA / "osim" / "joints.osim").read_text()
    blocks = text.split("<Body name=")
    for index, block in enumerate(blocks):
        if block.startswith(('"turned"', '"loose"')):
            blocks[index] = block.replace("<mass>1.0</mass>", "<mass>0</mass>")
        if block.startswith('"ball"'):
            blocks[index] = block.replace("<inertia>0.01 0.02 0.025", "<inertia>0.01 0.01 0.05")
    path = tmp_path / "light.osim"
    path.write_text("<Body name=".join(blocks))
    converted = convert(read_model(path))
    model = converted.spec.compile()
    notes = {note.path: note for note in converted.notes}
    assert notes["/bodyset/turned"].error_bound == "0.001 kg, 1e-06 kg m^2"
    assert "break A + B >= C" in notes["/bodyset/ball"].rule
    a, b, c = sorted(model.body("ball").inertia)
    assert c <= a + b <= (1 + 2e-6) * c
    # A body behind a locked joint moves with one that has mass: nothing to repair.
    assert "/bodyset/loose" not in notes
    assert model.body("loose").mass[0] == 0


def test_coordinates_and_joints(conversions):
    converted, model = conversions("joints")
    entries = {entry.name: entry for entry in converted.coordinates.coordinates}
    assert (entries["bend"].kind, entries["patella"].kind, entries["stuck"].kind) == (
        "free",
        "coupled",
        "locked",
    )
    assert (entries["twist"].joint, entries["twist"].scale) == ("twist", 0.5)
    assert entries["stuck"].joint is None
    np.testing.assert_allclose(model.joint("pin_q").range, [-1, 1])
    assert model.jnt_limited[model.joint("pin_q").id]
    assert not model.jnt_limited[model.joint("slide").id]
    key = model.key("default")
    assert key.qpos[model.joint("pin_q").qposadr[0]] == 0.2
    assert key.qpos[model.joint("twist").qposadr[0]] == 0.1
    # Slopes of joint positions are those of differences.
    values = {"bend": np.array([-0.9, 0.3]), "twist": np.array([0.1, 0.2])}
    _, slope = converted.coordinates.rates(model, values)
    step = 1e-6
    ends = [converted.coordinates.qpos(model, {**values, "bend": values["bend"] + h}) for h in (step, -step)]
    column = converted.coordinates.free().index("bend")
    np.testing.assert_allclose(slope[:, :, column], (ends[0] - ends[1]) / (2 * step), atol=1e-6)
    assert np.abs(slope[:, :, column]).sum(axis=1).min() > 1
    json.dumps(converted.coordinates.as_json())


@pytest.mark.parametrize("name", ["joints", "gait10dof18musc", "leg6dof9musc"])
def test_a_reset_leaves_joints_where_they_follow(conversions, name):
    """`mj_resetData` is the default pose; from zeros, couplers would be off by up to 2.2."""
    converted, model = conversions(name)
    np.testing.assert_allclose(model.qpos0, model.key("default").qpos, atol=1e-12)
    qpos, data = model.qpos0.copy(), mujoco.MjData(model)
    follow(model, qpos)
    np.testing.assert_allclose(qpos, model.qpos0, atol=1e-12)
    mujoco.mj_forward(model, data)
    ties = data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY.value]
    assert not len(ties) or np.abs(ties).max() < 1e-12
    assert name == "joints" or np.abs(model.qpos0).max() > 0.5
    exact = {model.joint(joint).id: curves for joint, (_, curves) in converted.couplings.curves.items()}
    assert exact.keys() <= {tie.joint for tie in couplings(model)}


def test_fit_claims_what_it_does():
    """The errors that a fit states hold on other samples; phantoms do better than one quartic."""
    spline = SimmSpline((-2.1, -1.5, -1.0, -0.5, 0.0, 0.17), (-0.032, -0.018, -0.005, 0.004, 0.0, -0.003))
    fit = fit_all([spline], [1.0], -2.1, 0.17)
    (end,) = fit.functions
    q = np.linspace(-2.1, 0.17, 1009)
    values = []
    for phantom in fit.phantoms:
        values.append(np.polyval(phantom.coefficients[::-1], q if phantom.of is None else values[phantom.of]))
    error = np.abs(
        np.polyval(end.coefficients[::-1], q if end.of is None else values[end.of]) - spline.value(q)
    ).max()
    assert error < 1.05 * end.error
    alone = np.abs(np.polyval(np.polyfit(q, spline.value(q), 4), q) - spline.value(q)).max()
    assert error < alone / 3


def test_springs_at_a_limit(conversions):
    """Torques that OpenSim 4.6 gives for the same file: 5 N m at 0 degrees, -20 N m at 120 degrees."""
    converted, model = conversions("old")
    data = mujoco.MjData(model)
    dof = model.joint("elbow_flexion").dofadr[0]
    for degrees, torque in ((0, 5.0), (60, 0.0), (120, -20.0)):
        data.qpos[:] = converted.coordinates.qpos(model, {"elbow_flexion": np.radians([degrees])})[0]
        mujoco.mj_forward(model, data)
        assert data.qfrc_spring[dof] == pytest.approx(torque, abs=1e-9)
    notes = [note.rule for note in converted.notes if note.path == "/forceset/elbow_stop"]
    assert any("damping beyond the limits is left out" in rule for rule in notes)


LIMIT_FORCE = {
    2.0: 0.38431604938272385,
    5.0: 10.493827160493824,
    10.0: 79.01234567901233,
    14.0: 139.6255604938272,
}
"""OpenSim 4.6: stiffness 10 N m / degree with a transition of 15 degrees, so far beyond its limit."""


def test_springs_set_in_over_a_transition():
    """The quintic onset is OpenSim's; the cubic that stands for it stays near, and never falls."""
    beyond, force = np.array([*LIMIT_FORCE]), np.array([*LIMIT_FORCE.values()])
    np.testing.assert_allclose(10.0 * beyond * onset(beyond / 15.0), force, rtol=1e-12)
    x = np.linspace(0.0, 15.0, 41)[1:]
    spring = rising(x, 10.0 * x * onset(x / 15.0))
    assert (spring >= 0).all()
    np.testing.assert_allclose(beyond[:, None] ** [1, 2, 3] @ spring, force, atol=0.1 * 150)
    np.testing.assert_allclose(rising(x, 3.0 * x), [3.0, 0.0, 0.0], atol=1e-9)


VTP = """<?xml version="1.0"?><VTKFile type="PolyData"><PolyData><Piece NumberOfPoints="4" NumberOfPolys="4">
<Points><DataArray type="Float32" NumberOfComponents="3" format="{format}">
0 0 0 .1 0 0 0 .1 0 0 0 .1</DataArray></Points>
<Polys><DataArray Name="connectivity" format="ascii">0 2 1 0 1 3 0 3 2 1 2 3</DataArray>
<DataArray Name="offsets" format="ascii">3 6 9 12</DataArray></Polys></Piece></PolyData></VTKFile>"""


@pytest.mark.parametrize("form", ["ascii", "binary", None])
def test_meshes(form, tmp_path):
    """An ASCII .vtp becomes a geom without mass; another form or none is left out with a note."""
    if form:
        (tmp_path / "humerus.vtp").write_text(VTP.format(format=form))
    converted = convert(read_model(DATA / "osim" / "old.osim"), Options((tmp_path,)))
    model = converted.spec.compile()
    assert model.nmesh == (form == "ascii")
    assert model.body("upper").mass[0] == 2
    notes = [note.rule for note in converted.notes if note.path in ("upper/humerus.vtp", "/meshes")]
    if form == "ascii":
        assert notes == []
        assert model.mesh_vertnum[0] == 4
        assert list(converted.meshes) == ["humerus.obj"]
    else:
        expected = "1 mesh files are not found" if form is None else "must be in ASCII"
        assert len(notes) == 1
        assert expected in notes[0]


def test_visible_body():
    """Without meshes, capsules go from joint to joint and a floor is below them; nothing else changes."""
    converted = convert(read_model(DATA / "osim" / "arm26.osim"))
    model = mujoco.MjModel.from_xml_string(mjcf(converted.spec))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geom = model.geom("r_humerus_bone")
    along = geom.size[1] * data.geom_xmat[geom.id].reshape(3, 3)[:, 2]
    ends = data.geom_xpos[geom.id] + np.outer([-1, 1], along)
    joints = [data.body(name).xpos for name in ("r_humerus", "r_ulna_radius_hand")]
    np.testing.assert_allclose(ends, joints, atol=1e-9)
    floor = data.geom_xpos[model.geom("floor").id][2]
    assert floor <= data.geom_xpos[:, 2].min()
    drawn = [model.geom(name).id for name in ("floor", "r_humerus_bone", "r_ulna_radius_hand_bone")]
    assert not (model.geom_contype | model.geom_conaffinity)[drawn].any()
    np.testing.assert_allclose(model.body_mass.sum(), sum(b.mass for b in converted.model.bodies.values()))


def test_command_writes_a_model_that_loads(tmp_path):
    report = run(DATA / "osim" / "arm26.osim", tmp_path / "arm", OurStep)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm" / "model.xml"))
    assert (model.njnt, model.nu, model.nkey) == (2, 6, 1)
    assert "CCBY 3.0" in (tmp_path / "arm" / "model.xml").read_text()
    assert json.loads((tmp_path / "arm" / "report.json").read_text()) == report
    assert report["kinematics"]["position"] < EXACT
    assert {
        entry["name"]
        for entry in json.loads((tmp_path / "arm" / "coordinates.json").read_text())["coordinates"]
    } == {
        "r_shoulder_elev",
        "r_elbow_flex",
    }
    mujoco.mj_step(model, mujoco.MjData(model))


def test_failure_leaves_nothing_that_looks_complete(tmp_path):
    bad = tmp_path / "bad.osim"
    bad.write_text((DATA / "osim" / "old.osim").read_text().replace("PinJoint", "ConstantCurvatureJoint"))
    with pytest.raises(NotImplementedError, match=r"bad.osim:\d+: <ConstantCurvatureJoint name='elbow'>"):
        run(bad, tmp_path / "out", OurStep)
    assert not (tmp_path / "out").exists()
    with pytest.raises(ValueError, match=r"none.osim' is no file; give the path of an .osim file"):
        run(tmp_path / "none.osim", tmp_path / "out", OurStep)
    # An older result stays as it was where a new one fails.
    write(tmp_path / "out", {"model.xml": b"old", "report.json": b"old"})
    with pytest.raises(TypeError):
        write(tmp_path / "out", {"coordinates.json": b"new", "model.xml": None})
    left = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    assert left == {"model.xml": b"old", "report.json": b"old"}

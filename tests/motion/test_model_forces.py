"""What acts in a model beside muscles: closed forms, and what OpenSim 4.6's tools recorded.

The tables are from `tests/data/record_opensim_beside.py` and `record_opensim_forces.py`.
"""

import json
import logging
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from myowarp.apps.cli.motion.dynamics import Dynamics
from myowarp.apps.cli.motion.forces import Forces
from myowarp.apps.reports.motion import page
from myowarp.motion.actuators import actuators_of
from myowarp.motion.draws import Recording, Uncertainty, draw_trial
from myowarp.motion.inverse_dynamics import Load, inverse_dynamics
from myowarp.motion.joint_reactions import joint_reactions
from myowarp.motion.loads import prescribed_loads
from myowarp.motion.movement import write_angles
from myowarp.motion.muscle_forces import muscle_forces
from myowarp.motion.residuals import Residuals, astray, too_heavy
from myowarp.motion.setup import TrialSetup
from myowarp.motion.smooth import derivatives
from myowarp.motion.steps import dynamics
from myowarp.motion.storage import Storage, read_storage, write_storage
from myowarp.motion.tracking import equations, track
from myowarp.osim.body.model_forces import left_out, without
from myowarp.osim.body.muscle_paths import muscle_paths
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.contacts import resting
from myowarp.osim.document.kinematics import complete, forward
from myowarp.osim.document.read.model import read_model
from myowarp.process import warn_once

DATA = Path(__file__).parents[1] / "data"
ARM = (DATA / "osim/arm26.osim").read_text()
RECORDED = json.loads((DATA / "opensim/beside.json").read_text())
TIME, VALUES = np.array(RECORDED["time"]), np.array(RECORDED["values"])
RECORDED_FORCES = {name: np.load(DATA / f"opensim/{name}.npz") for name in ("forces", "devices")}
AT = 0.37
"""s: time of the recorded states."""

TOLERANCE = 1e-6
"""N m: what twice differentiated splines differ by."""
CONTROL = 0.003
"""By which controls of static optimisations may differ: OpenSim's optimiser stops before the optimum."""
REACTION = 2e-3
"""Share of the greatest reaction: OpenSim takes the accelerations that its muscle forces give."""

PENDULUM = """<OpenSimDocument Version="40600"><Model name="pendulum"><gravity>0 -9.81 0</gravity>
<BodySet><objects><Body name="rod"><mass>2</mass><mass_center>0.3 0 0</mass_center>
<inertia>0.01 0.02 0.03 0 0 0</inertia></Body></objects></BodySet><JointSet><objects>
<PinJoint name="hinge"><socket_parent_frame>/ground</socket_parent_frame>
<socket_child_frame>/bodyset/rod</socket_child_frame><coordinates><Coordinate name="angle">
<range>-3 3</range></Coordinate></coordinates></PinJoint></objects></JointSet>
<ForceSet><objects>{}</objects></ForceSet></Model></OpenSimDocument>"""
BAND = """<PathSpring name="band"><GeometryPath name="path"><PathPointSet><objects><PathPoint name="a">
<socket_parent_frame>/ground</socket_parent_frame><location>0.2 1 0</location></PathPoint>
<PathPoint name="b"><socket_parent_frame>/bodyset/rod</socket_parent_frame>
<location>0.5 0 0</location></PathPoint></objects></PathPointSet></GeometryPath>
<resting_length>0.4</resting_length><stiffness>300</stiffness><dissipation>0.2</dissipation></PathSpring>"""


def pendulum(folder, *forces):
    """Return a rod on a hinge with some forces."""
    path = folder / "pendulum.osim"
    path.write_text(PENDULUM.format("".join(forces)))
    return Bones.read(path, "cpu")


def arm(folder, names):
    """Return the arm with some of the recorded forces, names joined with +."""
    path = folder / "arm.osim"
    forces = "".join(RECORDED["forces"][name] for name in names.split("+") if name)
    assert RECORDED["place"] in ARM
    path.write_text(ARM.replace(RECORDED["place"], RECORDED["place"] + forces))
    return Bones.read(path, "cpu")


def needed(bones, *loads):
    """Return what the recorded motion takes."""
    assert list(bones.coordinates) == RECORDED["coordinates"]
    return inverse_dynamics(bones, *derivatives(TIME, VALUES, TIME, None), loads)


def test_a_spring_at_an_angle(tmp_path):
    """The moment of a band at rest and while it lengthens, by its triangle."""
    angle, speed = np.array([[-0.4], [0.3], [1.1]]), np.array([[0.0], [-1.5], [0.8]])
    bones = pendulum(tmp_path, BAND)
    found = inverse_dynamics(bones, angle, speed, np.zeros_like(angle))
    end = 0.5 * np.stack([np.cos(angle[:, 0]), np.sin(angle[:, 0])], axis=1)
    to = np.array([0.2, 1.0]) - end
    length = np.hypot(*to.T)
    velocity = -(to * speed * np.stack([-end[:, 1], end[:, 0]], axis=1)).sum(axis=1) / length
    tension = 300.0 * (length - 0.4) * (1.0 + 0.2 * velocity)
    moment = tension * (end[:, 0] * to[:, 1] - end[:, 1] * to[:, 0]) / length
    np.testing.assert_allclose(found.passive[:, 0], moment, rtol=1e-12)
    np.testing.assert_allclose(found.tension["band"], tension, rtol=1e-12)
    bare = inverse_dynamics(bones, angle, speed, np.zeros_like(angle), passive=False)
    np.testing.assert_allclose(bare.joint_moment[:, 0], 2 * 9.81 * 0.3 * np.cos(angle[:, 0]), rtol=1e-12)
    np.testing.assert_allclose(found.joint_moment, bare.joint_moment - found.passive, rtol=1e-12)
    assert np.abs(moment).min() > 10.0


def test_springs_and_limits_are_their_laws(tmp_path):
    spring = RECORDED["forces"]["spring"].replace("r_elbow_flex", "angle")
    limit = RECORDED["forces"]["limit"].replace("r_elbow_flex", "angle").replace(">90<", ">40<")
    angle, speed = np.array([[-0.4], [0.6], [0.75], [2.0]]), np.array([[0.3], [-1.5], [0.8], [2.0]])
    q, u = angle[:, 0], speed[:, 0]
    found = inverse_dynamics(pendulum(tmp_path, spring), angle, speed, np.zeros_like(angle))
    np.testing.assert_allclose(found.passive[:, 0], -5.0 * (q - 0.3) - 0.5 * u, rtol=1e-12)
    found = inverse_dynamics(pendulum(tmp_path, limit), angle, speed, np.zeros_like(angle))
    degree = np.pi / 180.0
    low, high = (np.clip(x / (20.0 * degree), 0.0, 1.0) for x in (30.0 * degree - q, q - 40.0 * degree))
    low_on, high_on = (t**3 * (10.0 - 15.0 * t + 6.0 * t**2) for t in (low, high))
    law = low_on / degree * (30.0 * degree - q) - 2.0 * high_on / degree * (q - 40.0 * degree)
    law -= 0.01 / degree * (low_on + high_on) * u
    np.testing.assert_allclose(found.passive[:, 0], law, rtol=1e-12)
    assert np.abs(law[[0, 3]]).min() > 10.0


TOGETHER = [name for name in RECORDED["moments"] if name == "motor" or name not in RECORDED["forces"]]
"""No force, a motor, and several together; the others are in `test_every_force.py`, class by class."""


@pytest.mark.parametrize("name", TOGETHER)
def test_moments_are_those_of_opensim(name, tmp_path):
    theirs, bare = (np.array(RECORDED["moments"][key]) for key in (name, ""))
    found = needed(arm(tmp_path, name))
    np.testing.assert_allclose(found.joint_moment, theirs, atol=TOLERANCE)
    np.testing.assert_allclose(found.passive, bare - theirs, atol=TOLERANCE)
    if name not in ("", "motor"):
        assert np.abs(theirs - bare).max() > 1e6 * TOLERANCE


@pytest.mark.parametrize("name", RECORDED_FORCES)
def test_coordinates_that_follow_push_those_that_lead(name):
    """Every class on a model with couplers and moving points, as OpenSim's inverse dynamics has it."""
    recorded = RECORDED_FORCES[name]
    bones = Bones.read(DATA / f"osim/{name}.osim", "cpu")
    names, forces = recorded["coordinates"].tolist(), recorded["forces"].tolist()
    columns = [names.index(name) for name in bones.coordinates]
    values, rates = recorded["values"][:, columns], recorded["rates"][:, columns]
    along = [recorded["free"].tolist().index(name) for name in bones.coordinates]
    driven = np.isfinite(recorded["control"])
    still, time = np.zeros_like(values), np.full(len(values), AT)
    for kept in (*(name for name, on in zip(forces, driven, strict=True) if not on), None):
        model, unknown = without(bones.model, [name for name in forces if name != kept] if kept else [])
        assert not unknown
        chosen = [forces.index(kept)] if kept else np.flatnonzero(~driven)
        theirs = recorded["acting"][:, chosen].sum(axis=1)[:, along]
        acting = Bones(model, "cpu")
        loads = prescribed_loads(acting, time)
        found = inverse_dynamics(acting, values, rates, still, loads)
        bare = inverse_dynamics(acting, values, rates, still, passive=False).joint_moment
        scale = np.abs(theirs).max()
        assert scale > 0.01
        np.testing.assert_allclose(bare - found.joint_moment, theirs, atol=1e-8 * scale, err_msg=kept or "")
        if not loads:
            np.testing.assert_allclose(found.passive, theirs, atol=1e-8 * scale, err_msg=kept or "")


@pytest.mark.parametrize("name", RECORDED_FORCES)
def test_motors_do_what_those_of_opensim_do(name):
    recorded = RECORDED_FORCES[name]
    bones = Bones.read(DATA / f"osim/{name}.osim", "cpu")
    names, forces = recorded["coordinates"].tolist(), recorded["forces"].tolist()
    values = recorded["values"][:, [names.index(name) for name in bones.coordinates]]
    along = [recorded["free"].tolist().index(name) for name in bones.coordinates]
    motors = actuators_of(bones, values)
    driven = {name for name, control in zip(forces, recorded["control"], strict=True) if np.isfinite(control)}
    assert set(motors.names) == driven
    for number, motor in enumerate(motors.names):
        theirs = recorded["acting"][:, forces.index(motor)][:, along]
        found = recorded["control"][forces.index(motor)] * motors.effect[:, number]
        np.testing.assert_allclose(found, theirs, atol=1e-8 * np.abs(theirs).max(), err_msg=motor)


@pytest.mark.parametrize("words", RECORDED["excluded"])
def test_forces_are_excluded_as_in_opensim(words, tmp_path):
    """All takes forces of the model alone: OpenSim 4.6 leaves external loads on."""
    names = [name for name in words.split("+") if name != "load"]
    model, unknown = without(arm(tmp_path, RECORDED["excluded of"]).model, names)
    assert unknown == [name for name in names if name == "nobody"]
    load, loads = RECORDED["load"], []
    if words.startswith("load+"):
        force, point = (np.tile(load[part], (len(TIME), 1)) for part in ("force", "point"))
        loads = [Load(load["body"], force, point, np.zeros_like(force))]
    found = needed(Bones(model, "cpu"), *loads).joint_moment
    np.testing.assert_allclose(found, np.array(RECORDED["excluded"][words]), atol=TOLERANCE)


def static(bones, **options):
    """Return the static optimisation of the recorded frames, and what they take."""
    frames = RECORDED["frames"]
    motion = [part[frames] for part in derivatives(TIME, VALUES, TIME, None)]
    inverted = inverse_dynamics(bones, *motion)
    paths = muscle_paths(bones, *motion[:2])
    motors = actuators_of(bones, motion[0])
    moment = inverted.joint_moment
    found = muscle_forces(
        bones.model,
        bones.coordinates,
        paths,
        moment,
        mode="opensim",
        actuators=motors,
        device="cpu",
        **options,
    )
    return found, motors, motion, inverted


def test_motors_share_the_load(tmp_path):
    found, motors, *_ = static(arm(tmp_path, RECORDED["driven"]))
    theirs = RECORDED["static"]["controls"]
    assert set(found.motors) == {"motor", "cable", "twist", "thrust"}
    for names, controls in ((found.muscles, found.activation), (found.motors, found.control)):
        for name, control in zip(names, controls.T, strict=True):
            np.testing.assert_allclose(control, theirs[name], atol=CONTROL, err_msg=name)
    assert found.feasible.all()
    driven = np.einsum("nm,nmk->nk", found.control, motors.effect)
    np.testing.assert_allclose(found.reserve, driven)
    assert np.abs(driven).max() > 1.0
    assert np.isclose(found.control[:, found.motors.index("motor")], 0.02).any(), "bounds hold"


def test_joint_reactions_have_what_acts_on_bodies(tmp_path):
    bones = arm(tmp_path, RECORDED["driven"])
    found, motors, motion, inverted = static(bones)
    forces = {name: np.array(force) for name, force in RECORDED["static"]["forces"].items()}
    control = np.stack([forces[name] for name in motors.names], axis=1) / motors.optimal
    tension = {name: forces[name] for name in (*found.muscles, *motors.paths)}
    driven = inverse_dynamics(bones, *motion, motors.acting(control))
    ours = joint_reactions(bones, motion[0], driven, tension)
    theirs = np.array(RECORDED["reactions"])
    for number, joint in enumerate(("r_shoulder", "r_elbow")):
        row = ours.joints.index(joint)
        for array, first in ((ours.force, 0), (ours.moment, 3)):
            wanted = theirs[:, number, first : first + 3]
            assert np.abs(array[:, row] - wanted).max() < REACTION * np.abs(wanted).max()
    bare = joint_reactions(bones, motion[0], inverted, {name: forces[name] for name in found.muscles})
    assert np.abs(bare.force - ours.force).max() > 1.0


def test_draws_and_tracking_feel_springs(tmp_path):
    """A draw's moments are those of dynamics; a simulation is pushed by as much."""
    bones = arm(tmp_path, RECORDED["excluded of"])
    recording = Recording(bones, TIME, VALUES, TrialSetup(reserve=1.0))
    drawn = draw_trial(recording, Uncertainty(), [0])
    theirs = np.array(RECORDED["moments"][RECORDED["excluded of"]])
    np.testing.assert_allclose(drawn.joint_moment[0], theirs, atol=TOLERANCE)
    q, u, a = derivatives(TIME, VALUES, TIME, None)
    mass, bias = equations(bones, q, u, ())
    np.testing.assert_allclose(np.einsum("njk,nk->nj", mass, a) + bias, theirs, atol=TOLERANCE)


@pytest.mark.slow
def test_tracking_drives_motors(tmp_path):
    """With a spring and motors the arm stays on its motion, and motors take load off its muscles."""
    reserves = dict.fromkeys(RECORDED["coordinates"], 1.0)
    found = {}
    for names in ("spring", RECORDED["driven"].replace("bushing+band+", "")):
        bones = arm(tmp_path, names)
        found[names] = track(bones, TIME, VALUES, reserves=reserves, span=(0.2, 0.5))
        assert found[names].off().max() < 0.02
    alone, driven = found.values()
    assert driven.activation.mean() < 0.8 * alone.activation.mean()


UNREAD = '<NoOneKnowsForce name="unknown"><coordinate>r_elbow_flex</coordinate></NoOneKnowsForce>'
RECORDED["forces"]["unknown"] = UNREAD
CONTACT = """<HuntCrossleyForce name="touch"><HuntCrossleyForce::ContactParametersSet><objects>
<HuntCrossleyForce::ContactParameters><geometry>ball floor</geometry></HuntCrossleyForce::ContactParameters>
</objects></HuntCrossleyForce::ContactParametersSet></HuntCrossleyForce>"""
GEOMETRY = """<ContactGeometrySet><objects><ContactSphere name="ball">
<socket_frame>/bodyset/r_ulna_radius_hand</socket_frame><radius>0.02</radius></ContactSphere>
<ContactHalfSpace name="floor"><socket_frame>/ground</socket_frame></ContactHalfSpace></objects>
</ContactGeometrySet><ForceSet name="forceset">"""


def test_what_is_left_out_is_named_with_its_coordinates(tmp_path, caplog):
    path = tmp_path / "touching.osim"
    text = ARM.replace(RECORDED["place"], RECORDED["place"] + UNREAD + CONTACT)
    path.write_text(text.replace('<ForceSet name="forceset">', GEOMETRY))
    sentence = (
        "left out, though OpenSim has it act: NoOneKnowsForce 'unknown' (r_elbow_flex); "
        "HuntCrossleyForce 'touch' (r_shoulder_elev, r_elbow_flex)"
    )
    assert left_out(resting(read_model(path))) == sentence
    warn_once.cache_clear()
    with caplog.at_level(logging.WARNING, "myowarp"):
        needed(Bones.read(path, "cpu"))
        needed(Bones.read(path, "cpu"))
    assert [record.getMessage() for record in caplog.records] == [f"touching.osim: {sentence}"]
    model, unknown = without(read_model(path), ["unknown", "touch"])
    assert left_out(model) == ""
    assert not unknown
    assert left_out(read_model(DATA / "osim/forces.osim")) == ""


def written(folder, bones):
    """Write the recorded motion of an arm; return the options of `myowarp motion`."""
    write_angles(folder / "motion.mot", bones.model, bones.coordinates, TIME, VALUES)
    return {"motion": folder / "motion.mot", "output": folder / "out", "overwrite": True}


def title(path):
    """Return the first line of a table."""
    return path.read_text().partition("\n")[0]


@pytest.mark.slow
def test_the_commands(tmp_path, capsys):
    """Moments, what springs and motors give, what a set-up file excludes; files of another model go."""
    names = f"{RECORDED['driven']}+unknown"
    options, out = written(tmp_path, arm(tmp_path, names)), tmp_path / "out"
    model = tmp_path / "arm.osim"
    Dynamics(model, **options)()
    passive = read_storage(out / "passive_moments.sto")
    bare = np.array(RECORDED["moments"][""])
    np.testing.assert_allclose(read_storage(out / "moments.sto").values + passive.values, bare, atol=1e-5)
    lost = "left out, though OpenSim has it act: NoOneKnowsForce 'unknown' (r_elbow_flex)"
    assert title(out / "moments.sto") == f"joint moments, N m and N; {lost}"
    assert read_storage(out / "moments.sto").labels == ("r_shoulder_elev_moment", "r_elbow_flex_moment")
    text = page(out, read_model(model)).replace("&#x27;", "'")
    assert lost in text
    assert "Moments of springs and ligaments" in text
    Forces(model, **options)()
    assert "Motors of the model" in page(out, read_model(model))
    assert read_storage(out / "actuators.sto").labels == ("motor", "cable", "twist", "thrust")
    for name in ("activations", "actuators", "joint_reactions", "reserves", "missing"):
        assert title(out / f"{name}.sto").endswith(lost)
    setup = tmp_path / "id.xml"
    setup.write_text(
        '<OpenSimDocument Version="40000"><InverseDynamicsTool name="id"><forces_to_exclude>muscles spring '
        "band bushing nobody</forces_to_exclude></InverseDynamicsTool></OpenSimDocument>"
    )
    Dynamics(model, setup=setup, **options)()
    np.testing.assert_allclose(read_storage(out / "moments.sto").values, bare, atol=1e-5)
    assert not (out / "passive_moments.sto").exists()
    said = capsys.readouterr().err
    assert "forces_to_exclude names 'nobody', which the model has not" in said
    assert "has no Muscles" not in said
    setup.write_text(setup.read_text().replace("muscles", ""))
    Dynamics(model, setup=setup, **options)()
    assert (
        "forces_to_exclude has no Muscles: OpenSim's moments are then what muscles" in capsys.readouterr().err
    )
    arm(tmp_path, "")
    Forces(model, **options)()
    assert not (out / "actuators.sto").exists()


def test_a_motion_without_loads_says_what_carries_the_weight(tmp_path, caplog):
    """The pelvis of a gait model in the air: its root gives the weight and what the masses take."""
    bones = Bones.read(DATA / "osim/gait10dof18musc.osim", "cpu")
    time = np.linspace(0.0, 1.0, 41)
    values = np.tile([bones.model.coordinates[name].default for name in bones.coordinates], (41, 1))
    up = bones.coordinates.index("pelvis_ty")
    values[:, up] += 0.02 * np.cos(4.0 * np.pi * time)
    write_angles(tmp_path / "motion.mot", bones.model, bones.coordinates, time, values)
    with caplog.at_level(logging.WARNING, "myowarp"):
        moments = dynamics(bones, TrialSetup(motion=tmp_path / "motion.mot"))
    moments.write(tmp_path)
    found = moments.needed
    mass = sum(body.mass for body in bones.model.bodies.values())
    most = mass * (np.linalg.norm(bones.model.gravity) + 0.02 * (4.0 * np.pi) ** 2)
    force = np.abs(found.joint_moment[:, up])
    np.testing.assert_allclose(force.max(), most, rtol=0.02)
    share = 100.0 * most / (mass * np.linalg.norm(bones.model.gravity))
    worst = f"{force.max():.0f} N ({share:.0f} % of the weight) at pelvis_ty, at {time[force.argmax()]:.4g} s"
    sentence = f"no external loads: {worst}, carry the weight"
    assert [record.getMessage() for record in caplog.records] == [sentence]
    assert title(tmp_path / "moments.sto") == f"joint moments, N m and N; {sentence}"
    assert Residuals.of(bones, time, 0.03 * found.joint_moment).doubt(loaded=False) == ""
    still = Residuals.of(arm(tmp_path, ""), TIME, np.full(VALUES.shape, 1e3))
    assert (still.doubt(loaded=False), still.lines()) == ("", [])


def test_masses_in_grams_are_doubted():
    model = read_model(DATA / "osim/gait10dof18musc.osim")
    bodies = {name: replace(body, mass=1e3 * body.mass) for name, body in model.bodies.items()}
    (sentence,) = too_heavy(Bones(replace(model, bodies=bodies), "cpu"))
    assert re.fullmatch(r"the model '.*' weighs 7\d,\d{3} kg: are its masses in grams\?", sentence)
    assert not list(too_heavy(Bones(model, "cpu")))


LOADS = """<ExternalLoads name="l"><objects><ExternalForce name="ground"><applied_to_body>calcn_r
</applied_to_body><force_identifier>f</force_identifier><point_identifier>p</point_identifier></ExternalForce>
</objects><datafile>push.mot</datafile></ExternalLoads>"""


@pytest.mark.parametrize(("factor", "doubts"), [(1.0, 0), (1000.0, 1)])
def test_torques_in_newton_millimetres_are_doubted(factor, doubts):
    """Of a foot that turns on its plate; a plate that has its whole moment at its middle is not doubted."""
    bones = Bones.read(DATA / "osim/gait10dof18musc.osim", "cpu")
    still = np.array([[bones.model.coordinates[name].default for name in bones.coordinates]])
    needed = inverse_dynamics(bones, still, 0 * still, 0 * still)
    foot, force = needed.origin[:, bones.number("calcn_r")], np.array([[0.0, 700.0, 0.0]])
    for lever in (0.01, 0.3):
        torque = np.array([[0.0, factor * lever * 700.0, 0.0]])
        load = Load("calcn_r", force, foot, torque, "ground", "ground", "plate")
        said = [*astray(bones, needed, [load])]
        sizes = f"{factor * lever * 700.0:.3g} N m, beside a force of 700 N at most"
        assert said == doubts * [f"the torque of 'plate' goes to {sizes}: is it in N mm?"]


@pytest.mark.parametrize("swapped", [0, 1, 3, 4])
def test_a_force_under_the_other_foot_names_it(swapped):
    """Of four frames the right foot's force lies under the left foot in some; a light one does not count."""
    bones = Bones.read(DATA / "osim/gait10dof18musc.osim", "cpu")
    still = np.array([[bones.model.coordinates[name].default for name in bones.coordinates]] * 5)
    needed = inverse_dynamics(bones, still, 0 * still, 0 * still)
    feet = {name: needed.origin[:, bones.number(name)] for name in ("calcn_r", "calcn_l")}
    force = np.outer([700.0] * 4 + [300.0], [0.0, 1.0, 0.0])
    point = np.concatenate([feet["calcn_l"][:swapped], feet["calcn_r"][swapped:4], feet["calcn_l"][4:]])
    rest = 0 * force, "ground", "ground"
    loads = [
        Load("calcn_r", force, point, *rest, "right"), Load("calcn_l", force, feet["calcn_l"], *rest, "left")
    ]  # fmt: skip
    said = f"'right' acts on calcn_r and lies nearer to calcn_l in {25 * swapped} % of the frames in which it"
    expected = [f"{said} pushes: are left and right swapped?"] if swapped > 2 else []
    assert [*astray(bones, needed, loads)] == expected


@pytest.mark.parametrize(("factor", "share"), [(1.0, 0), (0.97, 3), (1.25, 25), (-1.0, 200), (1e-3, 100)])
@pytest.mark.parametrize("off", [0.2, 0.9])
def test_what_loads_leave_at_the_root_is_said(tmp_path, caplog, capsys, factor, share, off):
    """Of one who stands still on a force of his weight: a heavier one's, of another sign, in kN, and beside
    the foot.
    """
    bones = Bones.read(DATA / "osim/gait10dof18musc.osim", "cpu")
    time = np.linspace(0.0, 1.0, 41)
    pose = {name: np.array([bones.model.coordinates[name].default]) for name in bones.coordinates}
    still = np.tile(np.concatenate(list(pose.values())), (41, 1))
    write_angles(tmp_path / "motion.mot", bones.model, bones.coordinates, time, still)
    weight = sum(body.mass for body in bones.model.bodies.values()) * np.linalg.norm(bones.model.gravity)
    foot = forward(bones.model, complete(bones.model, pose, 1))["calcn_r"][1][0]
    row = [0.0, factor * weight, 0.0, foot[0] + off, *foot[1:]]
    labels = tuple(part + axis for part in "fp" for axis in "xyz")
    write_storage(tmp_path / "push.mot", "push", Storage(labels, time, np.tile(row, (41, 1))))
    (tmp_path / "push.xml").write_text(LOADS)
    options = {"motion": tmp_path / "motion.mot", "loads": tmp_path / "push.xml", "output": tmp_path / "out"}
    with caplog.at_level(logging.WARNING, "myowarp"):
        Dynamics(DATA / "osim/gait10dof18musc.osim", **options)()
    said = [record.getMessage() for record in caplog.records]
    worst = rf"{abs(1.0 - factor) * weight:.0f} N \({share} % of the weight\) at pelvis_t[xy], at \S+ s"
    shown = capsys.readouterr().err
    assert re.search(rf"residuals at the root: {worst}; \S+ N m at pelvis_tilt", shown)
    borne = f"loads carry {100.0 * factor:.0f} % of the weight: is the model this person's?"
    assert (borne in shown) == (factor == 1.25) == ("is the model" in shown)
    doubt = "check sign, unit and bodies of the loads, and the filter: more than 5 % of the weight is left at"
    expected = [f"{doubt} the root"] if share > 5 else []
    if off > 0.5:
        expected.append(f"the centre of pressure of 'ground' is {off} m from calcn_r: wrong foot or unit[?]")
    assert len(said) == len(expected)
    assert all(map(re.fullmatch, expected, said))
    assert title(tmp_path / "out/moments.sto") == "; ".join(["joint moments, N m and N", *said])

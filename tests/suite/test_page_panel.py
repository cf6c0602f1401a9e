"""What the panel of a page is made of, without a browser: the tree of tasks, patients, quantities, charts."""

import io
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from myowarp.apps.cli.options import Said
from myowarp.apps.cli.view import View, note_on, policies_for
from myowarp.definitions.body import BODIES
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.osim.convert.run import run as convert
from myowarp.sim.converted_step import OurStep
from myowarp.sim.presets import PRESETS, fatigued_after, offered
from myowarp.view.browser.body_tab import OpenSimArms, moment_arm
from myowarp.view.browser.chart import Chart, Curve, as_png, as_svg
from myowarp.view.browser.history import History
from myowarp.view.browser.live import ASPECT
from myowarp.view.browser.names import places
from myowarp.view.browser.readings import Readings
from myowarp.view.browser.task_tree import OWN, place_of, task_tree, title_of
from myowarp.view.browser.traces import TRACES_HEIGHT, above_traces
from myowarp.view.drawing import style as look
from myowarp.view.drawing.framing import Framing, view_axes

ELBOW, HAND = "myoElbowPose1D6MRandom-v0", "myoHandPoseFixed-v1"
OSIM = Path(__file__).parents[1] / "data" / "osim"
EXACT = 5e-5  # m: between points of the report that are 2 degrees apart
ROUNDING = 2e-5  # m, N m: positions are float32 in the worlds


@pytest.fixture(scope="module")
def sessions():
    return {key: View(Said(Setup(task=key, device="cpu"))).open(key, "random") for key in (ELBOW, HAND)}


def test_every_task_has_one_place_in_the_tree():
    own = [key for key in TASKS if key.startswith(("myo", "motor"))]  # not what other tests registered
    tree = task_tree(own)
    leaves = [task for levels in tree.values() for versions in levels.values() for task in versions.values()]
    assert sorted(leaves) == sorted(own)
    assert len(tree) < len(own) / 3
    assert list(tree["pose, hand"]["easy"]) == ["v1", "v0"]
    assert tree["pose, hand"]["easy, pose 3"]["v0"] == "myoHandPose3Fixed-v0"
    assert tree["baoding balls, hand"]["P2"]["v2"] == "myoChallengeBaodingP2-v2"
    assert place_of("out/arm26/model.xml") == (OWN, "arm26/model.xml", "-")
    assert tree["walk, legs"]["walk"]["v0"] == "myoLegWalk-v0"


def test_each_page_has_a_title_as_people_say_it():
    assert title_of("myoLegWalk-v0") == "Legs: walk"
    assert title_of("myoHandKeyTurnRandom-v1") == "Hand: key turn"
    assert title_of("out/arm26/model.xml") == "arm26/model.xml"


def test_joints_are_named_as_people_say_them():
    names = ("ankle_angle_r", "ankle_angle_l", "lumbar_extension")
    assert places(names) == {
        "both: ankle": names[:2],
        "right ankle": names[:1],
        "left ankle": names[1:2],
        "lumbar extension": names[2:],
    }


@pytest.mark.parametrize("body", ["elbow", "finger", "hand", "legs"])
def test_traces_leave_the_body_its_height(body):
    """Beside a panel of 324 px, all of what is framed is above the traces; at 1280 x 800 over 200 px."""
    model = BODIES[body].build().compile()
    data, framing = mujoco.MjData(model), Framing(model, BODIES[body].tips, ASPECT)
    look.pose(model, data, look.rest_pose(model))
    camera = framing.camera(data, {})
    axes, half = view_axes(camera.azimuth, camera.elevation), float(np.radians(model.vis.global_.fovy)) / 2
    for width, height in ((956, 800), (1276, 1000), (700, 600)):
        eye, middle, _ = above_traces(camera, 2 * half, ASPECT, (width, height))
        np.testing.assert_allclose(axes[2], (middle - eye) / np.linalg.norm(middle - eye), atol=1e-6)
        right, up, depth = axes @ (framing.points(data, {}) - eye).T
        focal = 0.5 * height / np.tan(half)  # px
        rows, columns = 0.5 * height - focal * up / depth, 0.5 * width + focal * right / depth
        assert rows.min() >= 0.0
        assert rows.max() <= height - TRACES_HEIGHT + 1.0
        assert columns.min() >= 0.0
        assert columns.max() <= width
        if height == 800:
            assert max(np.ptp(rows), np.ptp(columns)) > 200.0


@pytest.mark.parametrize("key", TASKS)
def test_no_policy_of_another_task_is_offered(key):
    for policy in policies_for(TASKS[key], "random"):
        note = note_on(policy, TASKS[key])
        if note:
            trained = re.search(r"(my|mot)o\w+-v\d", note)[0]
            assert trained.rpartition("-")[0] == TASKS[key].name
            assert ("another version" in note) == (trained != key)


def test_a_preset_changes_the_patient_and_not_the_twin(sessions):
    """Each one moves at least one knob, cites where that is from, and the next one begins from health."""
    for session in sessions.values():
        healthy = {n: session.patient.value(k, session.twin) for n, k in session.patient.knobs.items()}
        assert len(offered(session.patient)) >= 3
        for name in offered(session.patient):
            session.become(name)
            assert re.search(r"\((19|20)\d\d\)", PRESETS[name].source)
            ours = {n: session.patient.value(k, session.world) for n, k in session.patient.knobs.items()}
            moved = {n.split()[0] for n in ours if abs(ours[n] - healthy[n]) > 1e-6}
            assert moved == {PRESETS[name].condition}
            twin = {n: session.patient.value(k, session.twin) for n, k in session.patient.knobs.items()}
            assert twin == healthy
        session.become("as it began")


def test_fatigue_of_a_preset_is_that_of_the_model(sessions):
    """dM_F/dt = F M_A - R M_F with M_A = 1 - M_F, in small steps."""
    patient = sessions[ELBOW].patient
    rates = (patient.knobs[f"fatigue_3ccr {name}"] for name in ("fatigue_rate", "recovery_rate"))
    fatigue, recovery = (knob.parameter.values(0).astype(float) for knob in rates)
    found, dt = np.zeros(len(fatigue)), 1e-3
    for _ in range(60_000):
        found += dt * (fatigue * (1.0 - found) - recovery * found)
    np.testing.assert_allclose(fatigued_after(60.0, patient), found, atol=1e-5)
    assert found.min() > 0.2


def test_a_preset_that_is_unknown_or_does_not_suit_is_one_sentence(sessions):
    session = sessions[ELBOW]
    with pytest.raises(ValueError, match=r"^preset 'pirate' unknown; available: older adult, "):
        session.become("pirate")
    with pytest.raises(ValueError, match=r"needs tendon_tear of FPL, which this body cannot have; available"):
        session.become("FPL torn")
    assert session.preset == "as it began"
    with pytest.raises(ValueError, match=r"^preset 'pirate' unknown; available: older adult, "):
        View(Said(Setup(task=ELBOW, device="cpu")), preset="pirate")()


def test_a_slider_without_effect_says_why(sessions):
    session = sessions[ELBOW]
    patient, worlds = session.patient, range(session.twin)
    rate, affected = (patient.knobs[f"fatigue_3ccr {name}"] for name in ("fatigue_rate", "affected"))
    initial = patient.knobs["fatigue_3ccr initial"]
    says = "No effect while 'share that tires' is 0."
    assert patient.idle(rate, 0) == says
    assert patient.idle(affected, 0) == patient.idle(patient.knobs["sarcopenia strength"], 0) == ""
    patient.set(affected, 0.5, worlds, ["BIClong"])
    assert patient.idle(rate, 0, ["BIClong"]) == ""
    assert patient.idle(rate, 0, ["TRIlong"]) == says
    assert patient.idle(initial, 0, ["BIClong"]) == "Acts from the next episode on: press Reset."
    session.become("as it began")


def test_every_slider_has_a_meaning_and_round_ends(sessions):
    units = {}
    for session in sessions.values():
        for name, knob in session.patient.knobs.items():
            assert len(knob.doc) > 10, name
            assert f"{knob.high:g}".lstrip("0.").rstrip("0")[:1] in "125", name
            assert len(f"{knob.high - knob.step:g}") <= 6, name
            units[name] = knob.unit
    assert units["load mass"] == "kg"
    assert units["fatigue_3ccr fatigue_rate"] == "1/s"
    assert units["sarcopenia strength"] == ""


@pytest.mark.parametrize("key", [ELBOW, HAND])
def test_quantities_agree_with_mujoco(sessions, key):
    """Moment arms with finite differences of lengths, torques with -dl/dq F of MuJoCo C's matrix."""
    session = sessions[key]
    readings = Readings(session)
    for _ in range(4):
        session.step()
    moment, model = readings.read(), session.sim.full_model
    data = mujoco.MjData(model)
    data.qpos[:] = moment.seen[0].qpos
    mujoco.mj_fwdPosition(model, data)
    muscles, arms = readings.kinds["activation"].items, readings.kinds["moment arm"].items
    lengths = data.ten_length.copy()
    tendons = [int(model.actuator(name).trnid[0]) for name in muscles]
    np.testing.assert_allclose(moment.values["musculotendon length"][0], lengths[tendons], atol=ROUNDING)
    table = dict(zip(arms, moment.values["moment arm"][0], strict=True))
    step, torque = 1e-6, {}
    for joint in readings.kinds["joint angle"].items:
        ends = []
        for sign in (1.0, -1.0):
            data.qpos[:] = moment.seen[0].qpos
            data.qpos[model.joint(joint).qposadr[0]] += sign * step
            mujoco.mj_fwdPosition(model, data)
            ends.append(data.ten_length[tendons].copy())
        found = -(ends[0] - ends[1]) / (2 * step)
        for muscle, arm in zip(muscles, found, strict=True):
            assert abs(table.get(f"{muscle} at {joint}", 0.0) - arm) < ROUNDING
        torque[joint] = found @ moment.values["force"][0]
    assert np.ptp(list(table.values())) > 100 * ROUNDING
    expected = [torque[joint] for joint in readings.kinds["muscle torque"].items]
    np.testing.assert_allclose(moment.values["muscle torque"][0], expected, atol=2e-3, rtol=1e-3)
    assert moment.values["reward term"][0, 0] == pytest.approx(session.sim.transition.reward.numpy()[0])
    assert np.isnan(moment.values["force"][1]).all()
    places = [model.joint(j).qposadr[0] for j in readings.kinds["joint angle"].items]
    np.testing.assert_allclose(moment.targets["joint angle"], np.degrees(moment.seen[0].ghost[places]))
    np.testing.assert_allclose(moment.values["joint angle"][0], np.degrees(moment.seen[0].qpos[places]))


def test_moment_arms_over_a_coordinate_are_those_of_opensim(tmp_path):
    """Muscles whose fitted path is exact have OpenSim's moment arms; followers move a muscle, too."""
    convert(OSIM / "arm26.osim", tmp_path, OurStep, workers=1)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    known, along = OpenSimArms(tmp_path / "model.xml"), np.linspace(0.1, 2.2, 30)
    assert len(known.pairs()) == 9
    for muscle in ("BICshort", "BIClong", "TRIlong"):
        theirs = known.of(muscle, "r_elbow_flex", along)
        assert np.ptp(theirs) > 50 * EXACT
        np.testing.assert_allclose(moment_arm(model, muscle, "r_elbow_flex", along), theirs, atol=EXACT)
    assert known.of("BRA", "r_shoulder_elev", along) is None
    assert np.isnan(known.of("BIClong", "r_elbow_flex", np.array([4.0]))).all()
    assert OpenSimArms(OSIM / "arm26.osim").pairs() == []  # no report beside it
    (tmp_path / "report.json").write_text("{")  # it is being written
    assert OpenSimArms(tmp_path / "model.xml").pairs() == []


def test_a_pose_holds_until_it_plays(sessions):
    session = sessions[ELBOW]
    qpos = np.array([1.2])
    session.pose(qpos)
    for world in (session.world, session.twin):
        assert session.seen(world).qpos[0] == pytest.approx(1.2)
    expected = mujoco.MjData(session.sim.full_model)
    expected.qpos[:] = qpos
    mujoco.mj_fwdPosition(session.sim.full_model, expected)
    lengths = Readings(session).read().values["musculotendon length"][0]
    np.testing.assert_allclose(lengths, expected.ten_length[: len(lengths)], atol=ROUNDING)


def test_history_looks_back_and_is_a_table(sessions):
    session = sessions[ELBOW]
    readings, history = Readings(session), History()
    session.restart()
    session.beside = True
    for step in range(6):
        session.step() if step != 3 else session.restart()
        history.add(readings.read())
        history.add(readings.read())  # no time has passed
    session.beside = False
    assert len(history.moments) == 5
    assert history.back(0.0) is history.moments[-1]
    assert history.back(2 * session.sim.scene.control_dt) is history.moments[-3]
    assert len(history.borders) == 1
    table = history.table(
        readings.kinds, [("force", "BIClong"), ("moment arm", readings.kinds["moment arm"].items[0])], True
    )
    lines = table.splitlines()
    assert lines[0].startswith(
        "time [s],episode,force of BIClong [N],force of BIClong before [N],moment arm of "
    )
    rows = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    biceps = readings.kinds["force"].items.index("BIClong")
    assert rows.shape == (5, 6)
    np.testing.assert_allclose(
        rows[:, 2],
        history.values("force", biceps, False),
        rtol=1e-6,
    )


def charts():
    times = np.linspace(0.0, 2.0, 41)
    wave = np.sin(times)
    wave[20] = np.nan
    curves = [Curve("a<b", wave, "#1d4ed8"), Curve("a before", 1.0 - wave, "#f472b6", (6, 4))]
    return [Chart("force / N", times, curves, borders=[1.5]), Chart("angle / rad", times, curves[:1])]


def test_charts_are_drawn_where_they_belong():
    """Two areas side by side, gaps and borders break curves, dashes are dashed, text is text."""
    root = ElementTree.fromstring(as_svg(charts(), 800, 150))
    lines = [e for e in root if e.tag.endswith("polyline")]
    first = [e for e in lines if e.get("stroke") == "#1d4ed8" and len(e.get("points").split()) > 2]
    assert len(first) == 3 + 2
    twin = [e for e in lines if e.get("stroke") == "#f472b6"]
    assert all(e.get("stroke-dasharray") for e in twin)
    places = np.array([[float(n) for n in p.split(",")] for e in lines for p in e.get("points").split()])
    assert places.min() >= 0
    assert places[:, 0].max() <= 800
    assert places[:, 1].max() <= 150
    assert "a<b" in [e.text for e in root]


def test_a_png_shows_the_curves():
    picture = np.asarray(Image.open(io.BytesIO(as_png(charts(), 400, 150)))).astype(int)
    assert picture.shape == (300, 800, 3)
    for color in ((0x1D, 0x4E, 0xD8), (0xF4, 0x72, 0xB6)):
        assert (np.abs(picture - color).max(axis=2) < 40).sum() > 100

"""Figures show what recordings, models and tables hold."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from myowarp.apps.cli.main import main
from myowarp.apps.reports import figures
from myowarp.apps.reports.motion_curves import curves
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.inks import INKS
from myowarp.motion.storage import Storage, write_storage
from myowarp.osim.bundle.couplings import couplings
from myowarp.sim.build import oracle_model

pytest.importorskip("matplotlib")
BEND = Path(__file__).parents[2] / "examples/arm_bend.mot"
GAIT = Path(__file__).parents[1] / "data/osim/gait10dof18musc.osim"
ELBOW = "myoElbowPose1D6MRandom-v0"


def run(capsys, monkeypatch, *arguments):
    monkeypatch.setattr("sys.argv", ["myowarp", *map(str, arguments)])
    status = 0
    try:
        main()
    except SystemExit as end:
        status = end.code
    return status, " ".join(capsys.readouterr().err.split())


@pytest.fixture(scope="module")
def elbow():
    return oracle_model(TASKS[ELBOW])


def test_moment_arms_are_those_of_mujoco(elbow):
    """Of the elbow, and of a hand's wrist: no joint follows another there."""
    for model in (elbow, oracle_model(TASKS["myoHandPoseRandom-v0"])):
        assert not couplings(model)
        data, joint = mujoco.MjData(model), model.njnt // 2
        angles, arms = figures.arms_over_range(model, joint, 5)
        np.testing.assert_allclose(angles[[0, -1]], model.jnt_range[joint])
        moment = np.zeros((model.nu, model.nv))
        for angle, arm in zip(angles, arms, strict=True):
            data.qpos[:] = model.qpos0
            data.qpos[model.jnt_qposadr[joint]] = angle
            mujoco.mj_fwdPosition(model, data)
            mujoco.mju_sparse2dense(
                moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
            )
            np.testing.assert_allclose(arm, -moment[:, model.jnt_dofadr[joint]], atol=2e-5)


def test_moment_arms_of_a_joint_that_leads_others():
    """The joint that follows moves along: l = |x + 2 x| with y = 2 x."""
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><worldbody><site name="a"/>
      <body><joint name="x" type="slide" axis="1 0 0" range="1 2"/><geom size="0.01"/>
        <body><joint name="y" type="slide" axis="1 0 0"/><geom size="0.01"/><site name="b"/></body></body>
    </worldbody>
    <equality><joint joint1="y" joint2="x" polycoef="0 2 0 0 0"/></equality>
    <tendon><spatial name="t"><site site="a"/><site site="b"/></spatial></tendon>
    <actuator><muscle tendon="t" lengthrange="1 6"/></actuator></mujoco>""")
    _, arms = figures.arms_over_range(model, 0, 3)
    np.testing.assert_allclose(arms, -3.0, atol=1e-8)


@pytest.mark.parametrize("what", ["force-length", "force-velocity"])
def test_force_curves_are_those_of_mujoco(elbow, what):
    norm, tension, peak, names = figures.contraction_curves(Setup(task=ELBOW), what)
    assert names == tuple(elbow.actuator(i).name for i in range(elbow.nu))
    for muscle in range(elbow.nu):
        prm, span = elbow.actuator_gainprm[muscle], elbow.actuator_lengthrange[muscle]
        optimal = (span[1] - span[0]) / (prm[1] - prm[0])
        for value, passive, full in zip(norm[1, ::20, muscle], *tension[:, ::20, muscle], strict=True):
            length, speed = (value, 0.0) if what == "force-length" else (1.0, value)
            # MuJoCo divides the velocity by l_0 v_max, too.
            where = (span[0] + (length - prm[0]) * optimal, speed * optimal * prm[6], span)
            acc0 = elbow.actuator_acc0[muscle]
            gain = mujoco.mju_muscleGain(*where, acc0, prm[:9])
            bias = mujoco.mju_muscleBias(where[0], span, acc0, elbow.actuator_biasprm[muscle, :9])
            assert passive == pytest.approx(-bias, abs=2e-4 * float(peak[muscle]))
            assert full == pytest.approx(-gain - bias, abs=2e-4 * float(peak[muscle]))


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """The same run as .npz, .parquet and .csv: two worlds, two episodes."""
    from myowarp.apps.rollouts.recording import recording
    from myowarp.bridge_gym import MyoWarpVectorEnv

    folder = tmp_path_factory.mktemp("recordings")
    paths = [folder / "run.npz"]
    pytest.importorskip("pyarrow")
    paths += [folder / "run.parquet", folder / "run.csv"]
    for path in paths:
        env = MyoWarpVectorEnv(
            ELBOW,
            2,
            device="cpu",
            progress=False,
            autoreset_mode="same_step",
            max_episode_steps=4,
            conditions="fatigue_3ccr",
        )
        with recording(env.sim, path) as recorder:
            env.reset(seed=0)
            for step in range(6):
                env.step(np.full((2, 6), 0.1 * step, dtype=np.float32))
                recorder.add()
        env.close()
    return paths


def test_signals_of_a_world_over_an_episode(recordings):
    with np.load(recordings[0]) as file:
        activation, time, muscles = file["activation"], file["time"], file["muscles"]
    courses = [figures.read_course(path, "activation", 1, None) for path in recordings]
    for course in courses:
        np.testing.assert_allclose(course.values, activation[:4, 1], rtol=1e-6)
        np.testing.assert_allclose(course.time, time[:4, 1])
        assert course.muscles == tuple(muscles)
        axes = figures.over_time(course, ["BRA"]).axes[0]
        np.testing.assert_allclose(axes.lines[0].get_ydata(), course.values[:, list(muscles).index("BRA")])
        assert axes.get_ylabel() == "activation [1]"
    second = figures.read_course(recordings[1], "fatigue", 1, 2)
    assert len(second.time) == 2
    for path in recordings:
        with pytest.raises(ValueError, match="signal 'pain' unknown; available: activation"):
            figures.read_course(path, "pain", 0, None)
        with pytest.raises(ValueError, match="has no world 7"):
            figures.read_course(path, "force", 7, None)
        with pytest.raises(ValueError, match="world 0 has no episode 9; available: 1, 2"):
            figures.read_course(path, "force", 0, 9)


def test_learning_curves(tmp_path):
    path = tmp_path / "progress.csv"
    path.write_text("samples,return,success_percent,name\n0,1.5,0,a\n100,2.5,,b\n")
    panels = figures.learning([path]).axes
    assert [axes.get_ylabel() for axes in panels] == ["return", "success percent"]
    np.testing.assert_array_equal(panels[0].lines[0].get_xdata(), [0, 100])
    np.testing.assert_array_equal(panels[0].lines[0].get_ydata(), [1.5, 2.5])
    with pytest.raises(ValueError, match="column 'loss' unknown; available: return, success_percent"):
        figures.learning([path], ["loss"])
    path.write_text("steps,return\n0,1\n")
    with pytest.raises(ValueError, match="must be a CSV with a column 'samples'"):
        figures.learning([path])


def test_curves_of_a_motion_are_sides_over_their_cycles(tmp_path):
    """Moments over mass, forces over weight; each side over the times of its own cycle; by hand."""
    time = np.linspace(0.0, 2.0, 21)
    labels = "knee_angle_r_moment", "pelvis_ty_force", "knee_angle_l_moment"
    values = np.stack([70.0 * time, 70.0 * 9.80665 * time, -140.0 * time], axis=1)
    path = tmp_path / "moments.sto"
    write_storage(path, "joint moments", Storage(labels, time, values))
    cycles = {"": (0.5, 1.5), "l": (1.0, 2.0)}
    figure = curves(path, ["knee_angle_moment", "pelvis_ty_force"], cycles, 70.0)
    knee, pelvis = figure.axes
    (right, left), (weight,) = knee.lines, pelvis.lines
    for line, first, factor in ((right, 0.5, 1.0), (left, 1.0, -2.0), (weight, 0.5, 1.0)):
        x, y = line.get_data()
        np.testing.assert_allclose(x, np.linspace(0.0, 100.0, 11), atol=1e-9)
        np.testing.assert_allclose(y, factor * (first + np.linspace(0.0, 1.0, 11)), rtol=1e-6)
    assert (knee.get_ylabel(), pelvis.get_ylabel()) == ("[N m/kg]", "[BW]")
    assert right.get_color() != left.get_color()
    assert [text.get_text() for text in figure.legends[0].texts] == ["right", "left"]
    (whole, _) = curves(path, ["knee_angle_moment"]).axes[0].lines
    np.testing.assert_allclose(whole.get_data(), (time, 70.0 * time), rtol=1e-6)


def test_muscles_stand_in_the_groups_of_their_model(tmp_path):
    """Both sides of a muscle have its color; groups by hand, in order of the forces."""
    groups = {"R_knee_ext": "rect_fem_r vasti_r", "L_knee_ext": "rect_fem_l vasti_l", "ankle_r": "soleus_r"}
    xml = [f"<ObjectGroup name='{name}'><members>{g}</members></ObjectGroup>" for name, g in groups.items()]
    osim = tmp_path / "model.osim"
    osim.write_text(GAIT.read_text().replace("<groups />", f"<groups>{''.join(xml)}</groups>", 1))
    time = np.linspace(0.0, 1.0, 11)
    forces = {"rect_fem_r": 100.0, "vasti_r": 900.0, "rect_fem_l": 200.0, "vasti_l": 800.0, "soleus_r": 1.0}
    table = Storage(tuple(forces), time, np.outer(1.0 + time, list(forces.values())))
    path = tmp_path / "forces.sto"
    write_storage(path, "forces of muscles, N", table)
    for figure in (curves(path, osim=osim), curves(path, ["knee_ext=rect_fem,vasti", "ankle=soleus"])):
        knee, ankle = figure.axes
        assert [axes.get_title() for axes in (knee, ankle)] == ["knee_ext", "ankle"]
        drawn = {line.get_ydata()[0]: (line.get_color(), line.get_linestyle()) for line in knee.lines}
        assert drawn == {
            **{900.0: (INKS[0], "-"), 800.0: (INKS[0], "--")},
            **{100.0: (INKS[1], "-"), 200.0: (INKS[1], "--")},
        }
        assert [text.get_text() for text in knee.get_legend().texts] == ["vasti", "rect_fem"]
        assert knee.get_ylabel() == "[N]"
    with pytest.raises(ValueError, match="quantity 'pain' unknown; available: rect_fem, vasti, soleus"):
        curves(path, ["knee_ext=rect_fem,pain"])


def test_joint_reactions_are_drawn_as_resultants(tmp_path):
    """3, 4 and 12 N make 13 N; a component that is asked for is its column."""
    time = np.linspace(0.0, 1.0, 3)
    labels = [f"knee_r_on_tibia_r_in_ground_{part}{axis}" for part in "fmp" for axis in "xyz"]
    values = np.broadcast_to(9.80665 * np.array([3.0, 4.0, 12.0, *range(6)]), (3, 9))
    path = tmp_path / "trial_ReactionLoads.sto"
    write_storage(path, "joint reactions", Storage(tuple(labels), time, values))
    (knee,) = curves(path, mass=13.0).axes
    np.testing.assert_allclose(knee.lines[0].get_ydata(), 1.0)
    assert (knee.get_title(), knee.get_ylabel()) == ("knee", "[BW]")
    (component,) = curves(path, ["knee_on_tibia_in_ground_fy"]).axes
    np.testing.assert_allclose(component.lines[0].get_ydata(), 4.0 * 9.80665)
    with pytest.raises(ValueError, match=r"--mass is for forces .* got a column with the unit 'm'"):
        curves(path, ["knee_on_tibia_in_ground_px"], mass=13.0)


def test_a_motion_has_the_size_of_a_journal(capsys, monkeypatch, tmp_path):
    """183 mm at 300 dpi."""
    from PIL import Image

    status, said = run(capsys, monkeypatch, "plot", "motion", BEND, "-o", tmp_path / "bend.png")
    assert status == 0, said
    assert Image.open(tmp_path / "bend.png").width == pytest.approx(183 / 25.4 * 300, rel=0.01)


@pytest.mark.parametrize("suffix", [".png", ".pdf"])
def test_command_writes_the_figure(capsys, monkeypatch, tmp_path, suffix):
    path = tmp_path / "new" / f"plot{suffix}"
    status, said = run(capsys, monkeypatch, "plot", "force-length", ELBOW, "--muscles", "BRA", "-o", path)
    assert status == 0, said
    assert path.read_bytes()[:4] in (b"\x89PNG", b"%PDF")


def test_models_stand_side_by_side():
    """The curves of each panel are those of its model alone."""
    models = ("mujoco", "millard2012_rigid")
    panels = figures.contraction(Setup(task=ELBOW), "elbow", "force-length", ["BRA"], models).axes
    assert [axes.get_title(loc="left") or axes.get_title() for axes in panels] == list(models)
    for axes, model in zip(panels, models, strict=True):
        _, tension, _, names = figures.contraction_curves(Setup(task=ELBOW, muscle=model), "force-length")
        np.testing.assert_array_equal(axes.lines[0].get_ydata(), tension[1, :, names.index("BRA")])


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["moment-arms", ELBOW, "--joint", "knee"], "joint 'knee' unknown; available: r_elbow_flex"),
        (["moment-arms", ELBOW, "--muscles", "soleus"], "soleus"),
        (["moment-arms", ELBOW, "-o", "a.svg"], "must end in .png or .pdf"),
        (["force-length", "nothing"], "task 'nothing' unknown"),
        (["force-length", "motorFingerReachRandom-v0"], "the body has none"),
        (["out/none"], "plot needs WHAT and a SOURCE behind it, such as activation run.parquet, got"),
        (
            ["force", "nowhere.npz"],
            "'nowhere.npz' does not exist; `myowarp rollout ID --signals run.parquet` writes one",
        ),
        (["force", __file__], "needs a recording, .parquet, .csv or .npz, got "),
        (["assistance", "none"], "'none' does not exist; `myowarp cohort` writes one"),
        (["force", __file__, __file__], "plot force shows one recording, body or cohort, got 2"),
        (["learning", "nowhere.csv"], "nowhere.csv"),
        (["motion", "nowhere.sto"], "nowhere.sto"),
        (["motion", BEND, "--columns", "knee"], "quantity 'knee' unknown; available: shoulder"),
        (
            ["motion", BEND, "--cycle", 0.5, 3],
            "a cycle must be two times, one after the other, within 0 and 1 s",
        ),
        (
            ["motion", BEND, "--cycle", 0.5, 0.501],
            "a cycle needs two rows or more, got 1 from 0.5 to 0.501 s",
        ),
        (["motion", BEND, "--cycle-left", 0, 1], "--cycle-left needs --cycle"),
        (["motion", BEND, "--mass", 70], "--mass is for forces [N], moments [N m] and powers [W]"),
        (["motion", BEND, "--mass", 0], "--mass must be positive"),
        (["learning", "a.csv", "--mass", 70], "--mass belongs to plot motion, got plot learning"),
    ],
)
def test_bad_input_is_one_sentence(capsys, monkeypatch, tmp_path, arguments, text):
    monkeypatch.chdir(tmp_path)
    status, said = run(capsys, monkeypatch, "plot", *arguments)
    assert status == 2
    assert text in said
    assert not list(tmp_path.rglob("*.*"))

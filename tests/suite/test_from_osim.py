"""A model of OpenSim as itself: bodies, joints, muscles and paths as its file says, nothing fitted."""

import logging
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from muscle_bench import hold

import myowarp
from myowarp.coordinates.step import step_of
from myowarp.definitions.body import BODIES
from myowarp.models.bodies.from_file import register_body
from myowarp.osim.body.hill_muscle import HillMuscle, known
from myowarp.osim.convert.load import load
from myowarp.osim.document.read import model as reading
from myowarp.osim.document.read.model import read_model
from myowarp.process import warn_once
from myowarp.sim.build import compile_scene, full_spec, stepped_of
from myowarp.sim.simulation import Simulation
from myowarp.view.drawing.snapshot import snapshot
from myowarp.view.drawing.style import muscle_tendons, pose

OSIM = Path(__file__).parents[1] / "data" / "osim"


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """Keep what is loaded in a folder of the test."""
    monkeypatch.setenv("MYOWARP_CACHE_DIR", str(tmp_path / "cache"))


def stepped(task, count=3):
    """Return a scene after a physics step of the engine's stages, all muscles at work."""
    scene = compile_scene(task, count, device="cpu", muscle="thelen2003_rigid")
    scene.muscles.activation.fill_(0.5)
    step_of(stepped_of(scene)).launches()()
    return scene


def test_a_task_on_a_model_of_opensim():
    task = myowarp.from_osim(OSIM / "gait10dof18musc.osim", "osimGaitRandom-v0", replace=True)
    scene = stepped(task)
    assert np.isfinite(scene.data.qacc.numpy()).all()
    assert len(scene.muscles.names) == 18
    # Points that move are no bodies; only what the file weighs is there.
    names = [scene.oracle.body(i).name for i in range(scene.oracle.nbody)]
    assert not [name for name in names if re.search(r"-P\d", name)]
    model = read_model(OSIM / "gait10dof18musc.osim")
    table = BODIES[task.body].muscles.parameters
    for name, muscle in model.muscles.items():
        assert table["optimal_fiber_length"][name] == muscle.optimal_fiber_length


def test_another_patient_has_other_paths(tmp_path):
    text = (OSIM / "arm26.osim").read_text()
    other = tmp_path / "patient.osim"
    other.write_text(
        re.sub(r"<radius>([\d.]+)</radius>", lambda m: f"<radius>{float(m[1]) * 1.1}</radius>", text)
    )
    lengths = []
    for path in (OSIM / "arm26.osim", other):
        task = myowarp.from_osim(path, f"osimPatient{path.stem.title()}-v0", replace=True)
        lengths.append(stepped(task).data.ten_length.numpy()[0].copy())
    assert 1e-4 < np.abs(lengths[1] - lengths[0]).max() < 0.01


def test_what_is_left_out_is_said_once_and_again_in_another_process(caplog, tmp_path):
    text = (OSIM / "arm26.osim").read_text()
    force = '<HuntCrossleyForce name="floor"><appliesForce>true</appliesForce></HuntCrossleyForce>'
    path = tmp_path / "floor.osim"
    path.write_text(
        re.sub(r"(<ForceSet.*?<objects>)", lambda m: m[1] + force, text, count=1, flags=re.DOTALL)
    )
    sentence = "floor.osim: left out, or not as in OpenSim: HuntCrossleyForce"
    for _ in range(2):  # made, and from the cache
        warn_once.cache_clear()
        with caplog.at_level(logging.WARNING, "myowarp"):
            load(path)
        assert [line for line in caplog.messages if line.startswith(sentence)]
        caplog.clear()


def test_a_model_without_masses_is_said(caplog, tmp_path):
    path = tmp_path / "weightless.osim"
    text = (OSIM / "arm26.osim").read_text()
    path.write_text(re.sub(r"<mass>[^<]*</mass>", "<mass>0</mass>", text))
    with caplog.at_level(logging.WARNING, "myowarp"):
        load(path)
    (line,) = (line for line in caplog.messages if "gives no body a mass" in line)
    assert line.startswith("weightless.osim gives")
    assert line.endswith("use the model for paths and forces, not for motion")


def test_meshes_that_come_later_are_seen(tmp_path):
    """The folder Geometry is not there at the first load; then it is, and then its bone is another one."""
    text = (OSIM / "arm26.osim").read_text().replace("ground_ribs.vtp", "bone.obj")
    assert "bone.obj" in text
    (tmp_path / "arm.osim").write_text(text)
    pyramid = "v 0 0 0\nv {0} 0 0\nv 0 {0} 0\nv 0 0 {0}\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    assert "<mesh " not in load(tmp_path / "arm.osim").read_text()
    (tmp_path / "Geometry").mkdir()
    for size in (1, 2):
        (tmp_path / "Geometry/bone.obj").write_text(pyramid.format(size))
        model = load(tmp_path / "arm.osim")
        assert '<mesh name="bone"' in model.read_text()
        assert (model.parent / "meshes/bone.obj").read_text() == pyramid.format(size)


def test_a_file_is_read_once(monkeypatch):
    found = load(OSIM / "arm26.osim")
    monkeypatch.setattr(reading, "read_model", lambda path: pytest.fail(f"{path} is read again"))
    assert load(OSIM / "arm26.osim") == found
    names = {file.name for file in found.parent.iterdir()}
    assert names == {
        *("model.xml", "coordinates.json", "couplings.json", "paths.json", "muscles.csv", "left_out.json"),
        "accelerations.json",
    }


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("x.osim", None, "model '.*x.osim' is no file; give the path of an .osim file"),
        ("x.osim", "<OpenSimDocument", "x.osim.*"),
        ("x.osim", "<mujoco/>", "x.osim.*"),
        ("x.xml", "<mujoco/>", "path must be that of an .osim file, got .*x.xml"),
    ],
)
def test_errors_are_one_sentence(tmp_path, name, text, message):
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        myowarp.from_osim(path)
    assert "\n" not in str(caught.value)


def test_a_range_that_runs_backwards_is_one_sentence(tmp_path):
    """OpenSim 4.6 loads such a file, and fails when it is asked for a length."""
    path = tmp_path / "back.osim"
    text = (OSIM / "arm26.osim").read_text()
    path.write_text(re.sub(r"<range>\s*-1\s+-1\s*</range>", "<range>3 1</range>", text, count=1))
    message = r"back.osim:\d+: <PathWrap name='TRIlong.*'> has a range from point 3 back to 1, .*; swap them$"
    with pytest.raises(ValueError, match=message):
        register_body(path)


def test_a_muscle_out_of_bounds_changes_itself_alone(tmp_path, caplog):
    """A paralysed muscle, as OpenSim has it: its force is 0, those of the others stay bit for bit."""
    text, forces = (OSIM / "arm26.osim").read_text(), {}
    weak = tmp_path / "paralysed.osim"
    given = text.index("<max_isometric_force>", text.index('<Thelen2003Muscle name="BIClong">'))
    end = text.index("</max_isometric_force>", given)
    weak.write_text(f"{text[:given]}<max_isometric_force>0{text[end:]}")
    warn_once.cache_clear()
    for path in (OSIM / "arm26.osim", weak):
        scene = compile_scene(myowarp.from_osim(path, replace=True), 1, device="cpu", physics="parity")
        model = read_model(path)
        lengths = {
            name: muscle.tendon_slack_length + 0.9 * muscle.optimal_fiber_length
            for name, muscle in model.muscles.items()
        }
        length = np.array([[lengths[name] for name in scene.muscles.names]])
        found = hold(scene.muscles, length, np.full(length.shape, 0.5))[0]
        forces[path.stem] = dict(zip(scene.muscles.names, found.tolist(), strict=True))
    healthy, paralysed = forces.values()
    assert healthy.pop("BIClong") > 50.0
    assert abs(paralysed.pop("BIClong")) < 1e-5
    assert healthy == paralysed
    said = "max_isometric_force of muscle 'BIClong' must be from 1e-06 to inf, got 0; it is taken as 1e-06"
    assert [r.getMessage() for r in caplog.records] == [f"paralysed.osim: {said}"]


LIGHT = """<OpenSimDocument Version="40600"><Model name="light"><BodySet><objects><Body name="rod">
<mass>{mass}</mass><mass_center>0.1 0 0</mass_center><inertia>{inertia} {inertia} {inertia} 0 0 0</inertia>
</Body></objects></BodySet><JointSet><objects><PinJoint name="hinge">
<socket_parent_frame>/ground</socket_parent_frame><socket_child_frame>/bodyset/rod</socket_child_frame>
<coordinates><Coordinate name="angle"/></coordinates></PinJoint></objects></JointSet><ForceSet><objects>
<CoordinateActuator name="motor"><coordinate>angle</coordinate><optimal_force>{force}</optimal_force>
<min_control>-2</min_control><max_control>1</max_control></CoordinateActuator>
<Millard2012EquilibriumMuscle name="flexor"><GeometryPath><PathPointSet><objects><PathPoint name="a">
<socket_parent_frame>/ground</socket_parent_frame><location>0 0.3 0</location></PathPoint><PathPoint name="b">
<socket_parent_frame>/bodyset/rod</socket_parent_frame><location>0.1 0 0</location></PathPoint></objects>
</PathPointSet></GeometryPath><max_isometric_force>100</max_isometric_force>
<optimal_fiber_length>0.1</optimal_fiber_length><tendon_slack_length>0.18</tendon_slack_length>
</Millard2012EquilibriumMuscle></objects></ForceSet></Model></OpenSimDocument>"""


def test_a_model_that_cannot_move_says_so(tmp_path, caplog):
    """A rod without inertia under its muscle; a motor by its torque over the inertia about the hinge."""
    path = tmp_path / "light.osim"

    def said(**numbers):
        warn_once.cache_clear()
        caplog.clear()
        path.write_text(LIGHT.format(**{"mass": 1.0, "inertia": 0.01, "force": 5.0} | numbers))
        load(path)
        return caplog.messages

    assert said() == []
    fast = 2.0 * 60.0 / (0.01 + 0.1**2)
    assert said(force=60.0) == [
        f"light.osim: at full control motors throw light bodies, by up to {fast:.2g} rad/s^2, which may end "
        "in faults: motor; give them less optimal force, or bound their controls"
    ]
    light = {"mass": 1e-6, "inertia": 1e-10, "force": 1e-6}
    found = said(**light).copy()
    muscle = known(HillMuscle.of(read_model(path).muscles["flexor"]))[0]
    length = np.hypot(0.3, 0.1)
    moment = 100.0 * float(muscle.tendon_force(0.01, length)) * 0.3 * 0.1 / length - 1e-6 * 9.80665 * 0.1
    rest = moment / (1e-10 + 1e-6 * 0.1**2)
    assert rest > 1e6
    assert found == [
        f"light.osim: at rest in its default pose angle accelerates by {rest:.2g} rad/s^2: bodies have next "
        "to no inertia, no time step follows them, and the model cannot move"
    ]
    assert said(**light) == found, "from the cache, too"


def test_a_model_without_muscles_is_named_as_the_user_does(tmp_path):
    path = tmp_path / "bones.osim"
    text = (OSIM / "arm26.osim").read_text()
    path.write_text(re.sub(r"<ForceSet.*</ForceSet>", "", text, flags=re.DOTALL))
    message = f"model {str(path)!r} has no actuators; a policy needs muscles or motors"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        myowarp.from_osim(path)


def test_a_joint_that_nobody_knows_is_one_sentence(tmp_path):
    path = tmp_path / "odd.osim"
    path.write_text((OSIM / "arm26.osim").read_text().replace("CustomJoint", "OddJoint"))
    with pytest.raises(ValueError, match="OddJoint") as caught:
        register_body(path)
    assert "\n" not in str(caught.value)


def test_pictures_show_wrapped_paths():
    """Points of OpenSim's path where bodies are now, of which wrap points are chords of its arcs."""
    task = myowarp.from_osim(OSIM / "arm26.osim", "osimPicture-v0", replace=True)
    sim = Simulation(task, 2, device="cpu", progress=False)
    sim.reset(seeds=np.arange(2))
    for _ in range(3):
        sim.action.fill_(0.3)
        sim.step()
    seen, scene = snapshot(sim, 1), sim.scene
    model = full_spec(task).compile()
    tendons = muscle_tendons(model)
    data = mujoco.MjData(model)
    pose(model, data, seen.qpos, paths=seen.paths)
    drawn = data.ten_length[tendons].copy()
    exact = scene.data.ten_length.numpy()[1, [scene.oracle.tendon(model.tendon(t).name).id for t in tendons]]
    assert (exact > drawn - 1e-6).all()
    assert (exact < 1.05 * drawn).all()
    assert (exact - drawn).max() > 1e-4
    pose(model, data, seen.qpos)
    assert (exact - data.ten_length[tendons]).max() > 1e-3
    ends = data.wrap_xpos.reshape(-1, 3)[data.ten_wrapadr[tendons]]
    np.testing.assert_allclose([path[0] for path in seen.paths], ends, atol=1e-5)
    sim.close()

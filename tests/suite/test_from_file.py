"""Models from files: `myowarp rollout --model`, what its task asks for, and how bad files are refused."""

import json
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pytest

from myowarp.definitions.body import BODIES
from myowarp.definitions.task import TASKS
from myowarp.engine.slim import slim
from myowarp.kernels.action import CENTER, STEEPNESS
from myowarp.osim.bundle.couplings import couplings, follow
from myowarp.osim.bundle.mjcf import mjcf
from myowarp.osim.convert.compose.convert import convert
from myowarp.osim.document.read.model import read_model
from myowarp.process import warn_once
from myowarp.sim import build
from myowarp.sim.simulation import Simulation
from myowarp.sim.starts import posture_joints
from myowarp.tasks.from_file import from_mjcf, pose_task
from myowarp.view.drawing.framing import Framing
from myowarp.view.drawing.style import pose

OSIM = Path(__file__).parents[1] / "data" / "osim"

ENGINE = 2e-5
"""rad over 10 control steps of 10 physics steps in float32, against MuJoCo C in float64."""
EXACT = 1e-9
"""rad or m; two models in MuJoCo C that differ in what does not act."""

PLAIN = """
<mujoco model="plain 1">
  <option timestep="0.005" integrator="{integrator}"/>
  <worldbody>
    <body name="root" pos="0 0 1"><freejoint/><geom size=".1"/>
      <site name="a" pos="0 .05 0"/>
      <body name="upper">
        <joint name="shoulder" axis="0 1 0" range="-60 90"/>
        <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02"/>
        <site name="b" pos=".03 0 -.1"/><site name="c" pos=".03 0 -.25"/>
        <body name="lower" pos="0 0 -.3">
          <joint name="elbow" axis="0 1 0" damping=".1"/>
          <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02"/>
          <site name="d" pos=".02 0 -.05"/><site name="e"/><site name="seen"/>
          <body name="wheel" pos=".1 0 0"><joint name="wheel" axis="1 0 0"/><geom size=".03"/></body>
          <body name="cap" pos="-.1 0 0"><joint name="cap" range="-90 90"/><geom size=".03"/></body>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="cap" joint2="elbow" polycoef="0 .5 .25 0 0"/></equality>
  <tendon>
    <spatial name="muscle"><site site="c"/><site site="d"/></spatial>
    <spatial name="cable"><site site="a"/><site site="b"/></spatial>
  </tendon>
  <actuator>
    <muscle name="muscle" tendon="muscle" lengthrange=".05 .2" force="50" timeconst=".01 .04"/>
    <motor name="cable" tendon="cable" gear="-5"/>
    <motor name="push" site="e" gear="0 0 1 0 0 0"/>
  </actuator>
  <sensor><framepos objtype="site" objname="seen"/></sensor>
  <keyframe><key qpos="0 0 2 1 0 0 0 .1 .2 0 .11"/></keyframe>
</mujoco>
""".replace("<geom ", '<geom contype="0" conaffinity="0" ')


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The file of a converted arm, geometry only: it takes no time."""
    path = tmp_path_factory.mktemp("arm") / "model.xml"
    path.write_text(mjcf(convert(read_model(OSIM / "arm26.osim")).spec))
    return path


@pytest.fixture
def run(run):
    """Run `myowarp rollout`; see `run` in conftest."""
    return partial(run, "rollout")


@pytest.fixture
def plain(tmp_path):
    path = tmp_path / "plain.xml"
    path.write_text(PLAIN.format(integrator="Euler"))
    return path


def test_rollout_of_a_converted_model(arm, run, tmp_path):
    data, signals = tmp_path / "data.npz", tmp_path / "signals.npz"
    arguments = ("--model", arm, "--num-worlds", 3, "--steps", 4, "--device", "cpu", "--json")
    status, out, err = run(*arguments, "--save", data, "--signals", signals, "--policy", "zero")
    assert status == 0, err
    figures = json.loads(out)
    assert figures["task"].startswith("MyoWarp/arm26_")
    assert (figures["steps"], figures["faults"]) == (4, 0)
    with np.load(data) as saved:
        obs, columns = saved["obs"], saved["columns"].tolist()
        assert columns[:6] == [f"{name}[{i}]" for name in ("qpos", "qvel", "pose_err") for i in range(2)]
        assert saved["muscles"].tolist() == ["TRIlong", "TRIlat", "TRImed", "BIClong", "BICshort", "BRA"]
    target = obs[:, :, :2] + obs[:, :, 4:6]
    low, high = np.array([(-1.57079633, 3.14159265), (0.0, 2.26892803)]).T  # of the coordinates in arm26.osim
    assert ((low <= target) & (target <= high)).all()
    np.testing.assert_allclose(target, np.broadcast_to(target[0], target.shape), atol=1e-6)
    assert np.ptp(target[0], axis=0).min() > 0.1
    assert signals.exists()


def test_steps_are_those_of_the_file(arm):
    """MuJoCo C with the file's own step and integrator moves alike; with another integrator it does not."""
    sim = Simulation(pose_task(arm), 2, device="cpu", progress=False, autoreset="disabled")
    models = {name: mujoco.MjModel.from_xml_path(str(arm)) for name in ("file", "EULER")}
    assert models["file"].opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    models["EULER"].opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    states = {name: [mujoco.MjData(model) for _ in range(2)] for name, model in models.items()}
    random = np.random.default_rng(0)
    for _ in range(10):
        action = random.uniform(-1, 1, sim.action.shape).astype(np.float32)
        sim.action.assign(action)
        sim.step()
        excitation = 1 / (1 + np.exp(-float(STEEPNESS) * (action - float(CENTER))))
        for name, model in models.items():
            for data, control in zip(states[name], excitation, strict=True):
                data.ctrl[:] = control
                mujoco.mj_step(model, data, nstep=10)
    found = sim.scene.data.qpos.numpy()
    error = {name: np.abs(found - [data.qpos for data in both]).max() for name, both in states.items()}
    assert error["file"] < ENGINE < 10 * ENGINE < error["EULER"]


def test_targets_are_of_joints_that_actuators_move(plain):
    """Not of the root, of what follows another joint, or of what turns freely."""
    task = pose_task(plain)
    model = mujoco.MjModel.from_xml_path(str(plain))
    assert [model.joint(j).name for j in task.joints] == ["shoulder", "elbow"]
    start = model.key_qpos[0, 8]
    np.testing.assert_allclose(task.target_low, (-np.pi / 3, start - np.pi / 4))
    np.testing.assert_allclose(task.target_high, (np.pi / 2, start + np.pi / 4))
    assert sum(column.size for column in task.columns(model.nq, model.nv, 1)) == model.nq + model.nv + 2 + 1
    assert (task.physics_dt, task.num_substeps, task.integrator) == (0.005, 4, "EULER")
    assert pose_task(plain) == task
    assert [model.joint(j).name for j in posture_joints(model)] == ["shoulder"]


def test_only_joints_with_a_target_count():
    """Two joints of four, in another order: their errors are observed, scored, and end the episode."""
    far = 0.5  # rad; the other joints start 0.75 rad off
    options = {"joints": (3, 0), "target_low": (0.4, -0.1), "target_high": (0.4, -0.1), "far": far}
    task = replace(TASKS["myoFingerPoseFixed-v0"], start_pose=(0.0, 0.75, 0.75, 0.2), **options)
    sim = Simulation(task, 2, device="cpu", graph=False, progress=False, autoreset="disabled")
    names = [column.name for column in sim.columns for _ in range(column.size)]
    error = [i for i, name in enumerate(names) if name == "pose_err"]
    np.testing.assert_allclose(sim.transition.obs.numpy()[:, error], [(0.2, -0.1)] * 2, atol=1e-6)
    assert not sim.transition.terminated.numpy().any()
    sim.scene.data.qpos.assign(np.array([(0.0, 0.0, 0.0, 0.2), (0.45, 0.0, 0.0, 0.2)]))
    sim.shards[0].launch_scoring()
    distance = np.hypot(0.2, (0.1, 0.55))
    np.testing.assert_allclose(sim.transition.terms.numpy()[:, 0], -distance, atol=1e-6)
    assert sim.transition.terminated.numpy().tolist() == [False, True]


def test_what_acts_survives_slimming(plain):
    """Sites of tendons and site motors stay, sensors go; the motion is the same."""
    full = BODIES[pose_task(plain).body].build()
    models = [full.compile(), slim(full, ()).compile()]
    ends = []
    for model in models:
        data = mujoco.MjData(model)
        data.qpos[:] = models[0].key_qpos[0]
        data.ctrl[:] = 0.4, 0.7, -0.6
        mujoco.mj_step(model, data, nstep=100)
        ends.append(data.qpos.copy())
        assert model.actuator("cable").ctrlrange.tolist() == [-1.0, 1.0]
    assert np.abs(ends[0] - models[0].key_qpos[0])[7:].max() > 0.1
    np.testing.assert_allclose(*ends, atol=EXACT)


def test_camera_finds_bodies_without_geoms():
    """Muscle paths in the default pose are framed, also where the root can slide far away."""
    spec = convert(read_model(OSIM / "leg6dof9musc.osim")).spec
    root = spec.joint("pelvis_tx")
    root.limited, root.range = mujoco.mjtLimited.mjLIMITED_TRUE, (-50.0, 50.0)
    model = spec.compile()
    framing, data = Framing(model), mujoco.MjData(model)
    pose(model, data, model.key_qpos[0])
    camera = framing.camera(data, {})
    assert np.linalg.norm(camera.lookat - data.body("femur_r").xpos) < 1.0
    assert 0.3 < framing.radius < 1.5
    assert framing.follows


@pytest.mark.parametrize(
    ("muscle", "group", "tires"),
    [
        ("BIClong", "elbow flexors", True),
        ("recfem_r", "right knee extensors", True),
        ("soleus_l", "left ankle plantarflexors", True),
        ("sternocleidomastoid", "", False),
    ],
)
def test_muscles_have_the_facts_of_their_limb(plain, muscle, group, tires):
    """Those of an arm by their names, those of a leg likewise; of others nothing is known."""
    plain.write_text(plain.read_text().replace('<muscle name="muscle"', f'<muscle name="{muscle}"'))
    body = BODIES[from_mjcf(plain).body]
    assert body.group_of(muscle) == group
    assert (muscle.removesuffix("_r") in body.fatigue_rates) == tires
    assert body.group_of("OP") == ("thumb opposers" if muscle == "BIClong" else "")


def test_another_content_is_another_body(plain, tmp_path):
    first = pose_task(plain)
    plain.write_text(plain.read_text().replace('force="50"', 'force="51"'))
    assert pose_task(plain).body != first.body
    assert first.body.startswith("plain_1_")


def test_joints_follow_their_drivers():
    """Along a chain, whatever the order in the file, as MuJoCo's own solver settles them."""
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody>"
        + "".join(f'<body><joint name="{n}" ref="20"/><geom size=".1"/></body>' for n in "abcd")
        + '</worldbody><equality><joint joint1="c" joint2="b" polycoef=".1 0 2 0 0"/>'
        '<joint joint1="b" joint2="a" polycoef="0 -.5 0 1 0"/><joint joint1="d" polycoef=".3 0 0 0 0"/>'
        "</equality></mujoco>"
    )
    assert [model.joint(c.joint).name for c in couplings(model)] == ["b", "d", "c"]
    zero = model.qpos0[0]
    qpos = model.qpos0 + 0.4
    follow(model, qpos)
    b = -0.5 * 0.4 + 0.4**3
    np.testing.assert_allclose(qpos - zero, (0.4, b, 0.1 + 2 * b**2, 0.3), atol=1e-12)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    assert np.abs(data.efc_pos[: data.ne]).max() < 1e-12


def bad(old, new):
    """The plain model with a change."""
    assert old in PLAIN
    return PLAIN.format(integrator="Euler").replace(old, new)


BAD = {
    "no file": (None, "must be an MJCF file; MuJoCo says: "),
    "no XML": ("hello", "must be an MJCF file; MuJoCo says: XML parse error"),
    "no MJCF": (
        "<osim/>",
        "must be an MJCF file; MuJoCo says: XML Error: Unrecognized XML model type: 'osim'",
    ),
    "no mesh": (
        '<mujoco><asset><mesh file="no.stl"/></asset></mujoco>',
        "must be an MJCF file; MuJoCo says: Error: Error opening file",
    ),
    "no actuators": (
        '<mujoco><worldbody><body><joint/><geom size="1"/></body></worldbody></mujoco>',
        "has no actuators; a policy needs muscles or motors",
    ),
    "integrator": (
        PLAIN.format(integrator="RK4"),
        "has integrator RK4; muscles need one of EULER, IMPLICITFAST",
    ),
    "state": (
        bad('<motor name="cable" tendon', '<intvelocity name="cable" actrange="-1 1" tendon'),
        "has actuator 'cable' with a state that is no MuJoCo muscle; what runs are MuJoCo's muscles, and",
    ),
    "nothing moves": (
        '<mujoco><worldbody><body name="b"><freejoint/><geom size="1"/><site name="s"/></body></worldbody>'
        '<actuator><motor site="s"/></actuator></mujoco>',
        "has no free hinge or slide that its actuators move",
    ),
}


MOTOR = (
    '<mujoco model="x"><option timestep="{step}"/><worldbody><body><joint name="j" range="-60 60"/>'
    '<geom size=".1" mass="{mass}"/></body></worldbody><actuator><motor joint="j" gear="{gear}"/></actuator>'
    '<keyframe><key qpos="{start}"/></keyframe></mujoco>'
)
USUAL = {"step": "0.005", "mass": "1", "gear": "1", "start": "0"}
NUMBERS = {
    "step of zero": ({"step": "0"}, "must have a time step above 0 s, got 0 s"),
    "step back": ({"step": "-1"}, "must have a time step above 0 s, got -1 s"),
    "step NaN": ({"step": "nan"}, "must have a time step above 0 s, got nan s"),
    "mass": (
        {"mass": "inf"},
        "must have numbers that are finite in float32; in actuator_acc0, body_inertia, body",
    ),
    "mass in float32": ({"mass": "1e39"}, "must have numbers that are finite in float32; in body_"),
    "gear": (
        {"gear": "nan"},
        "must have numbers that are finite in float32; in actuator_acc0, actuator_gear, ",
    ),
    "start": ({"start": "nan"}, "must have numbers that are finite in float32; in key_qpos they are not"),
}
for case, (numbers, sentence) in NUMBERS.items():
    BAD[case] = MOTOR.format(**USUAL | numbers), sentence


@pytest.mark.parametrize("case", BAD)
def test_bad_file(run, tmp_path, case):
    text, sentence = BAD[case]
    path = tmp_path / "model.xml"
    if text is not None:
        path.write_text(text)
    assert_refused(run("--model", path, "--device", "cpu"), f"myowarp: model '{path}' ", sentence)


def test_another_encoding(tmp_path):
    path = tmp_path / "model.xml"
    text = MOTOR.format(**USUAL).replace('model="x"', 'model="\xe9"')
    path.write_bytes(b'<?xml version="1.0" encoding="latin-1"?>' + text.encode("latin-1"))
    with pytest.raises(ValueError, match=r"^model '.*model.xml' must be written in UTF-8; save it as that$"):
        from_mjcf(path)
    path.write_text(text, encoding="utf-8")
    from_mjcf(path)


def test_muscles_in_another_encoding(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(MOTOR.format(**USUAL))
    path.with_name("muscles.csv").write_bytes("name,class,\nm\xfcscle,x,\n".encode("latin-1"))
    with pytest.raises(ValueError, match=r"^file '.*muscles.csv' must be written in UTF-8; save it as that$"):
        from_mjcf(path)


ARGUMENTS = [
    ({"path": None}, "path must be that of an MJCF file, got None"),
    ({"targets": 5}, "targets must be names of joints or sites, got 5"),
    ({"targets": [["j"]]}, "targets must be names of joints or sites, got [['j']]"),
    ({"horizon": "x"}, "horizon must be a positive number, got 'x'"),
    ({"control_dt": "x"}, "control_dt must be a positive number, got 'x'"),
    ({"far": np.nan}, "far must be a positive number, got nan"),
    (
        {"control_dt": 1e9},
        "control_dt must be at most 10000 of the file's time steps, 0.005 s each, got 1e+09 s",
    ),
    ({"rewards": 5}, "rewards must be a mapping from names, got 5"),
    ({"doc": 5}, "doc must be a sentence, got 5"),
]


@pytest.mark.parametrize(("options", "message"), ARGUMENTS)
def test_wrong_arguments(tmp_path, options, message):
    path = tmp_path / "model.xml"
    path.write_text(MOTOR.format(**USUAL))
    before = list(TASKS)
    with pytest.raises(ValueError, match="^" + re.escape(message) + "$"):
        from_mjcf(**{"path": path} | options)
    assert list(TASKS) == before


def test_a_step_of_a_billionth(tmp_path):
    """A control step would take ten million of it."""
    path = tmp_path / "model.xml"
    path.write_text(MOTOR.format(**USUAL | {"step": "1e-9"}))
    message = "control_dt must be at most 10000 of the file's time steps, 1e-09 s each, got 0.02 s"
    with pytest.raises(ValueError, match="^" + re.escape(message) + "$"):
        from_mjcf(path)


def test_a_large_model_is_announced(plain, monkeypatch, caplog):
    """Before what takes long, and once."""
    monkeypatch.setattr(build, "MANY_DOFS", 10)
    monkeypatch.setattr(build, "calibrate", lambda *_: pytest.fail(caplog.text))
    warn_once.cache_clear()
    task = pose_task(plain)
    for _ in range(2):
        with pytest.raises(
            pytest.fail.Exception, match=r"6 bodies, 10 degrees of freedom\): its first start takes"
        ):
            build.compile_scene(task, 1, device="cpu")
    assert len(caplog.messages) == 1


@pytest.mark.parametrize("arguments", [(), ("myoElbowPose1D6MRandom-v0", "--model", "a.xml")])
def test_task_or_model(run, arguments):
    got = "'myoElbowPose1D6MRandom-v0' and 'a.xml'" if arguments else "neither"
    sentence = f"what to run is a task id or --model with a file, one of them; got {got}"
    assert_refused(run(*arguments), "myowarp: ", sentence)


def assert_refused(result, beginning, sentence):
    status, out, err = result
    assert (status, out) == (2, "")
    said = [line for line in err.splitlines() if line.startswith("myowarp: ")]
    assert len(said) == 1
    assert said[0].startswith(beginning)
    assert sentence in said[0]
    assert "Traceback" not in err

"""Contact as OpenSim computes it, in the simulation: what OpenSim 4.6 recorded, and closed forms.

The table is from `tests/data/record_opensim_contacts.py`.
"""

import dataclasses
import logging
from pathlib import Path

import numpy as np
import pytest

import myowarp
from myowarp.coordinates.step import step_of
from myowarp.definitions.body import BODIES
from myowarp.definitions.setup import Setup
from myowarp.osim.bundle.contacts import DocumentContacts
from myowarp.sim.build import compile_scene, stepped_of
from myowarp.tasks.setups import complete

DATA = Path(__file__).parents[1] / "data"
MODEL = DATA / "osim/contacts.osim"
RECORDED = np.load(DATA / "opensim/contacts.npz")

MEDIAN, WORST = 2e-5, 3e-4
"""Of an acceleration: poses in float32 move stiff surfaces by 1e-7 m. Measured 7e-6 and 9e-5."""


def test_accelerations_are_those_that_opensim_recorded():
    """All contact forces act at once, in a step so short that none is smoothed."""
    task = myowarp.from_osim(MODEL, "contactsOpen-v0", stops=False, contact="opensim", replace=True)
    scene = compile_scene(task, len(RECORDED["values"]), device="cpu", physics="parity")
    places = [scene.oracle.joint(name).qposadr[0] for name in RECORDED["coordinates"]]
    for array, values in ((scene.data.qpos, RECORDED["values"]), (scene.data.qvel, RECORDED["speeds"])):
        rows = np.zeros(array.shape, np.float32)
        rows[:, places] = values
        array.assign(rows)
    scene.model.opt.timestep.fill_(1e-9)
    step_of(stepped_of(scene)).launches()()
    found, wanted = scene.data.qacc.numpy()[:, places], RECORDED["accelerations"]
    error = np.linalg.norm(found - wanted, axis=1) / np.linalg.norm(wanted, axis=1)
    assert np.median(error) < MEDIAN
    assert error.max() < WORST


SLED = """<OpenSimDocument Version="40600"><Model name="sled"><gravity>0 -9.81 0</gravity>
<BodySet><objects><Body name="sled"><mass>2</mass><mass_center>0 0 0</mass_center>
<inertia>0.01 0.01 0.01 0 0 0</inertia></Body></objects></BodySet><JointSet><objects>
<CustomJoint name="rail"><socket_parent_frame>/ground</socket_parent_frame>
<socket_child_frame>/bodyset/sled</socket_child_frame><coordinates><Coordinate name="way">
<range>-1 1</range></Coordinate><Coordinate name="height"><range>0 1</range></Coordinate></coordinates>
<SpatialTransform><TransformAxis name="translation1"><coordinates>way</coordinates><axis>1 0 0</axis>
<LinearFunction><coefficients>1 0</coefficients></LinearFunction></TransformAxis>
<TransformAxis name="translation2"><coordinates>height</coordinates><axis>0 1 0</axis>
<LinearFunction><coefficients>1 0</coefficients></LinearFunction></TransformAxis></SpatialTransform>
</CustomJoint></objects></JointSet><ForceSet><objects>
<CoordinateActuator name="tow"><coordinate>way</coordinate></CoordinateActuator>
<HuntCrossleyForce name="runner"><HuntCrossleyForce::ContactParametersSet><objects>
<HuntCrossleyForce::ContactParameters><geometry>floor skid</geometry><stiffness>1e6</stiffness>
<dissipation>5</dissipation><static_friction>0.5</static_friction>
<dynamic_friction>0.5</dynamic_friction></HuntCrossleyForce::ContactParameters></objects>
</HuntCrossleyForce::ContactParametersSet><transition_velocity>0.0005</transition_velocity>
</HuntCrossleyForce></objects></ForceSet><ContactGeometrySet><objects>
<ContactHalfSpace name="floor"><socket_frame>/ground</socket_frame>
<orientation>0 0 -1.5707963267948966</orientation></ContactHalfSpace>
<ContactSphere name="skid"><socket_frame>/bodyset/sled</socket_frame><radius>0.1</radius></ContactSphere>
</objects></ContactGeometrySet></Model></OpenSimDocument>"""


@pytest.fixture
def sled(tmp_path):
    """Return the file of a sled that slides on a floor, rubbing like 2e4 N s/m below 0.5 mm/s."""
    path = tmp_path / "sled.osim"
    path.write_text(SLED)
    return path


def test_friction_stops_a_sled(sled):
    """It slides as far as v^2 / (2 u g), and then rests; taken in explicitly, friction would throw it."""
    task = myowarp.from_osim(sled, "sledTow-v0", contact="opensim", replace=True)
    scene = compile_scene(task, 1, device="cpu", physics="parity")
    k = 0.5 * 1e6 ** (2 / 3)
    depth = (2 * 9.81 / (4 / 3 * np.sqrt(0.1) * k**1.5)) ** (2 / 3)
    scene.data.qpos.assign(np.array([[0.0, 0.1 - depth]], np.float32))
    scene.data.qvel.assign(np.array([[1.0, 0.0]], np.float32))
    launch = step_of(stepped_of(scene)).launches()
    for _ in range(round(0.4 / scene.oracle.opt.timestep)):
        launch()
    way, height = scene.data.qpos.numpy()[0]
    assert way == pytest.approx(0.5 / (0.5 * 9.81), rel=0.01)
    assert height == pytest.approx(0.1 - depth, abs=1e-6)
    assert np.abs(scene.data.qvel.numpy()).max() < 1e-5


def bounce(height, speed, duration):
    """Return how a sled of 2 kg that falls flat moves: height of its centre, by Runge and Kutta's rule."""
    k, step = 0.5 * 1e6 ** (2 / 3), 1e-5

    def rate(state):
        depth = 0.1 - state[0]
        hertz = 4 / 3 * k * max(depth, 0.0) * np.sqrt(0.1 * k * max(depth, 0.0))
        return np.array([state[1], max(hertz * (1.0 - 1.5 * 5.0 * state[1]), 0.0) / 2.0 - 9.81])

    state = np.array([height, speed])
    for _ in range(round(duration / step)):
        one = rate(state)
        two = rate(state + step / 2 * one)
        three = rate(state + step / 2 * two)
        four = rate(state + step * three)
        state = state + step / 6 * (one + 2 * two + 2 * three + four)
    return state[0]


def test_damping_of_contact_is_of_second_order(sled):
    """Speeds of the step are half a step behind places. All of h D in M would leave an error as long as h."""
    height, speed, duration, errors = 0.1002, -0.05, 0.048, []
    wanted = bounce(height, speed, duration)
    for step in (2e-3, 1e-3):
        task = myowarp.from_osim(sled, "sledDrop-v0", contact="opensim", replace=True)
        task = dataclasses.replace(task, physics_dt=step, num_substeps=1)
        scene = compile_scene(task, 1, device="cpu", physics="parity")
        scene.data.qpos.assign(np.array([[0.0, height]], np.float32))
        scene.data.qvel.assign(np.array([[0.0, speed + 9.81 * step / 2]], np.float32))
        launch = step_of(stepped_of(scene)).launches()
        for _ in range(round(duration / step)):
            launch()
        errors.append(abs(scene.data.qpos.numpy()[0, 1] - wanted))
    assert errors[0] < 1e-4
    assert errors[0] > 3.0 * errors[1]


def test_the_start_says_how_long_steps_are(sled, caplog):
    with caplog.at_level(logging.WARNING, "myowarp"):
        luge = sled.with_name("luge.osim")
        luge.write_text(SLED.replace('Model name="sled"', 'Model name="luge"'))
        myowarp.from_osim(luge, contact="opensim", replace=True)
    said = [record.getMessage() for record in caplog.records]
    assert any(line.startswith("luge.osim: contact is OpenSim's; physics steps are 2 ms") for line in said)
    assert not any("left out" in line for line in said)


def test_a_stiff_contact_shortens_steps(sled):
    soft = myowarp.from_osim(sled, contact="opensim", replace=True)
    sled.write_text(SLED.replace("<stiffness>1e6", "<stiffness>1e9"))
    stiff = myowarp.from_osim(sled, contact="opensim", replace=True)
    assert stiff.physics_dt < soft.physics_dt == pytest.approx(0.002)
    assert BODIES[stiff.body].coarse_step.dt < BODIES[soft.body].coarse_step.dt


def test_the_option_travels(sled):
    """From a setup to the body; MuJoCo's contact of the same geometry is off, and on by default."""
    found = complete(Setup(task=sled, contact="opensim"))
    plain = complete(Setup(task=sled))
    models = [BODIES[setup.spec.body].build().compile() for setup in (found, plain)]
    assert [bool(model.geom_contype.any()) for model in models] == [False, True]
    assert [DocumentContacts.of(model) is None for model in models] == [False, True]


@pytest.mark.parametrize(
    ("task", "sentence"),
    [
        ("myoElbowPose1D6MRandom-v0", "contact is an option of a model's file; give it with --model FILE"),
        (Path("full_body"), "contact is an option of a model's file; 'full_body' is a body with its own"),
        (DATA / "osim/arm26.osim", "needs a SmoothSphereHalfSpaceForce or HuntCrossleyForce in the file; "),
    ],
)
def test_a_model_without_contact_forces(task, sentence):
    with pytest.raises(ValueError, match=sentence):
        complete(Setup(task=task, contact="opensim"))

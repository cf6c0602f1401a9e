"""Joint stops: ranges stop the joints of a file, or none, as in OpenSim."""

import logging
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import myowarp
from myowarp.apps.policies.checkpoint import trained_setup
from myowarp.coordinates.step import step_of
from myowarp.definitions.body import BODIES
from myowarp.definitions.setup import Setup
from myowarp.process import warn_once
from myowarp.sim.build import compile_scene, stepped_of
from myowarp.tasks.setups import complete

ARM = Path(__file__).parents[1] / "data/osim/arm26.osim"
ROD = """<OpenSimDocument Version="40600"><Model name="rod"><gravity>0 -9.81 0</gravity>
<BodySet><objects><Body name="rod"><mass>2</mass><mass_center>0.3 0 0</mass_center>
<inertia>0.01 0.02 0.03 0 0 0</inertia></Body></objects></BodySet><JointSet><objects>
<PinJoint name="hinge"><socket_parent_frame>/ground</socket_parent_frame>
<socket_child_frame>/bodyset/rod</socket_child_frame><coordinates><Coordinate name="angle">
<range>-0.5 0.5</range><clamped>true</clamped></Coordinate></coordinates></PinJoint></objects></JointSet>
<ForceSet><objects><CoordinateActuator name="motor"><coordinate>angle</coordinate></CoordinateActuator>
</objects></ForceSet></Model></OpenSimDocument>"""
OFF = 0.015
"""rad: half a step of 2 ms at 28 rad/s^2, for half a second, by which the step's speeds lead."""


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """Keep what is loaded in a folder of the test."""
    monkeypatch.setenv("MYOWARP_CACHE_DIR", str(tmp_path / "cache"))
    warn_once.cache_clear()


@pytest.fixture
def rod(tmp_path):
    """Return the file of a rod on a hinge, clamped to half a radian."""
    path = tmp_path / "rod.osim"
    path.write_text(ROD)
    return path


def fallen(task):
    """Return the angles of half a second from level, at rest, without control, and the model."""
    scene = compile_scene(task, 1, device="cpu", physics="parity")
    scene.data.qpos.zero_()
    scene.data.qvel.zero_()
    launch, angles = step_of(stepped_of(scene)).launches(), []
    for _ in range(250):
        launch()
        angles.append(float(scene.data.qpos.numpy()[0, 0]))
    return np.array(angles[9::10]), scene.oracle


@pytest.mark.slow
def test_without_stops_a_rod_falls_on(rod):
    """As the pendulum of the textbook does; with stops it stays within its range."""
    inertia = 0.03 + 2 * 0.3**2
    times = 0.02 * np.arange(1, 26)

    def falling(_, state):
        return state[1], -2 * 9.81 * 0.3 * np.cos(state[0]) / inertia

    law = solve_ivp(falling, (0, 0.5), (0, 0), "DOP853", times, rtol=1e-10)
    free, model = fallen(myowarp.from_osim(rod, "rodFree-v0", stops=False, replace=True))
    np.testing.assert_allclose(free, law.y[0], atol=OFF)
    assert not model.jnt_limited.any()
    stopped, limited = fallen(myowarp.from_osim(rod, "rodStopped-v0", replace=True))
    assert law.y[0].min() < -1.5
    assert -0.55 < stopped.min() < -0.49
    np.testing.assert_array_equal(limited.jnt_range, model.jnt_range)


def test_targets_stay_within_ranges(rod):
    stopped = myowarp.from_osim(rod, "rodStopped-v0", replace=True)
    free = myowarp.from_osim(rod, "rodFree-v0", stops=False, replace=True)
    assert (free.target_low, free.target_high) == (stopped.target_low, stopped.target_high)
    assert (free.target_low, free.target_high) == ((-0.5,), (0.5,))
    assert free.body != stopped.body, "scenes are kept by name"
    limited = [BODIES[task.body].build().compile().jnt_limited.any() for task in (stopped, free)]
    assert limited == [True, False]


def test_the_start_says_which_holds(rod, caplog):
    with caplog.at_level(logging.WARNING, "myowarp"):
        for stops in (True, False, True):
            myowarp.from_osim(rod, stops=stops, replace=True)
    assert [record.getMessage() for record in caplog.records] == [
        "rod.osim: 1 clamped joints stop at their ranges, unlike in OpenSim's simulations; --no-stops, or "
        "stops=False, lets them go on",
        "rod.osim: no range stops a joint, as in OpenSim's simulations",
    ]


def test_the_option_travels(rod):
    """From a setup to the body, to the settings of a checkpoint and back."""
    said = Setup(task=rod, stops=False)
    found = complete(said)
    assert not BODIES[found.spec.body].build().compile().jnt_limited.any()
    assert complete(found) == found
    assert complete(Setup(task=rod)).spec.body != found.spec.body
    manifest = {"task": str(rod), "model": True, "settings": said.plain()}
    again = trained_setup(manifest)
    assert (again.task, again.stops) == (rod, False)
    assert complete(again).spec.body == found.spec.body
    assert trained_setup(manifest | {"settings": {}}).stops is None, "of before"


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ("myoElbowPose1D6MRandom-v0", "stops are an option of a model's file; give it with --model FILE"),
        (Path("full_body"), "stops are an option of a model's file; 'full_body' is a body with its own"),
    ],
)
def test_what_has_its_own_stops_keeps_them(task, message):
    with pytest.raises(ValueError, match=message):
        complete(Setup(task=task, stops=False))
    with pytest.raises(ValueError, match="stops must be True or False, got 'no'"):
        myowarp.from_osim(ARM, stops="no")


def test_the_command(rod, run, caplog):
    status, _, _ = run("describe", "--model", rod, "--no-stops")
    assert status == 0
    assert "rod.osim: no range stops a joint, as in OpenSim's simulations" in caplog.messages
    status, _, said = run("record", "--model", rod, "--no-stops", "--motion", "walk.mot", "-o", "film.mp4")
    assert status != 0
    assert "--no-stops is of a simulation; leave it out where a recorded motion is played" in said

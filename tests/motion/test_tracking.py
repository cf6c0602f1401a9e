"""Computed muscle control: the simulation is that of the equations of motion, and follows what it shall."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from myowarp.apps.cli.motion.track import FILES, Track
from myowarp.motion.movement import write_angles
from myowarp.motion.storage import read_storage
from myowarp.motion.tool_setup import read_tool_setup
from myowarp.motion.tracking import (
    KP,
    KP_LIGHT,
    LIGHT,
    MET,
    SUBSTEPS,
    WINDOW,
    Activation,
    controlled,
    equations,
    gains_of,
    illinois_root,
    track,
)
from myowarp.osim.body.hill_muscle import HillMuscle
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document import dynamics
from myowarp.osim.document.read.model import read_model
from myowarp.process import warn_once

ARM = Path(__file__).parents[1] / "data/osim/arm26.osim"
TIME = np.linspace(0.0, 0.2, 21)
OFF = 0.5
"""[°] root mean square."""


@pytest.fixture(scope="module")
def bones():
    return Bones(read_model(ARM))


def wave(amplitude=0.4):
    """Return shoulder and elbow of an arm that bends and stretches."""
    return 0.7 + amplitude * np.stack([0.3 * np.sin(8.0 * TIME), np.sin(6.0 * TIME)], axis=1)


def reserves(bones, force=1.0):
    return dict.fromkeys(bones.coordinates, force)


@pytest.fixture(scope="module")
def followed(bones):
    """Return the arm as it is, and with muscles half as strong."""
    return track(bones, TIME, wave(), reserves=reserves(bones), strength=np.array([[1.0] * 6, [0.5] * 6]))


def test_equations_of_motion(bones):
    """Those of the converter in NumPy, whose accelerations are OpenSim's."""
    random = np.random.default_rng(0)
    q, u = 0.7 + 0.5 * random.normal(size=(7, 2)), 3.0 * random.normal(size=(7, 2))
    mass, bias = equations(bones, q, u, [])
    wanted = dynamics.equations(bones.model, dict(zip(bones.coordinates, q.T, strict=True)), u)
    np.testing.assert_allclose(mass, wanted[0], atol=1e-10)
    np.testing.assert_allclose(bias, wanted[1], atol=1e-9)


def test_activations_against_a_solver(bones):
    """da/dt over a window, integrated by SciPy."""
    muscles = [HillMuscle.of(muscle) for muscle in bones.model.muscles.values()]
    law, random = Activation(muscles), np.random.default_rng(2)
    a, u = random.uniform(0.05, 0.9, (5, 6)), random.uniform(0.0, 1.0, (5, 6))
    after = a
    for _ in range(SUBSTEPS):
        after = law.step(after, u, WINDOW / SUBSTEPS)

    def rate(_, flat):
        now = flat.reshape(a.shape)
        slow = 0.5 + 1.5 * now
        return ((u - now) / np.where(u > now, law.up * slow, law.down / slow)).ravel()

    exact = solve_ivp(rate, (0.0, 0.01), a.ravel(), rtol=1e-9, atol=1e-9).y[:, -1].reshape(a.shape)
    np.testing.assert_allclose(after, exact, atol=0.005)
    assert np.abs(after - a).max() > 0.2


def test_the_excitation_that_reaches_a_force():
    """Of steep and flat curves; the nearer end where none does."""
    whole, target = np.array([[900.0, 50.0, 2000.0, 10.0, 10.0]]), np.array([[700.0, 3.0, 0.5, 12.0, -1.0]])
    low, high = np.full(whole.shape, 0.02), np.ones(whole.shape)

    def off(excitation):
        return whole * excitation ** np.array([1.0, 3.0, 0.5, 1.0, 1.0]) - target

    found = illinois_root(off, low, high, off(low), off(high))
    np.testing.assert_allclose(off(found)[0, :2], 0.0, atol=MET)
    np.testing.assert_array_equal(found[0, 2:], [0.02, 1.0, 0.02])


def test_the_arm_follows(followed):
    """With a small reserve; where muscles are half as strong the reserve gives more."""
    assert np.degrees(followed.off()).max() < OFF
    assert np.degrees(np.ptp(followed.wanted[:, 1])) > 10 * OFF
    assert np.abs(followed.reserve[..., 1]).max() < 0.5, (
        "N m at the elbow; the arm lacks muscles at the shoulder"
    )
    assert ((followed.excitation >= 0.0) & (followed.excitation <= 1.0)).all()
    most = np.abs(followed.reserve[..., 0]).max(axis=0)
    assert most[1] > 1.2 * most[0], "at the shoulder, where the weak ones give less"


def test_replays(bones, followed):
    """The same again; a weak arm that goes elsewhere; one without muscles, which falls as SciPy says."""
    own = {name: np.repeat(getattr(followed, name)[:, :1], 3, axis=1) for name in ("excitation", "reserve")}
    for array in own.values():
        array[:, 2] = 0.0
    strength = np.array([[1.0] * 6, [0.9] * 6, [0.0] * 6])
    replayed = track(
        bones, TIME, wave(), reserves=reserves(bones), replay=replace(followed, **own), strength=strength
    )
    np.testing.assert_allclose(replayed.values[:, 0], followed.values[:, 0], atol=1e-9)
    assert np.degrees(np.abs(replayed.values[:, 1] - replayed.values[:, 0])).max() > 0.2

    def rate(_, state):
        q, u = state[None, :2], state[None, 2:]
        mass, bias = dynamics.equations(bones.model, dict(zip(bones.coordinates, q.T, strict=True)), u)
        return np.concatenate([u[0], np.linalg.solve(mass[0], -bias[0])])

    start = np.concatenate([replayed.values[0, 2], [0.4 * 0.3 * 8.0, 0.4 * 6.0]])
    exact = solve_ivp(rate, (0.0, TIME[-1]), start, t_eval=replayed.time, rtol=1e-8, atol=1e-8).y[:2].T
    assert np.abs(exact - wave()).max() > 0.2
    np.testing.assert_allclose(replayed.values[:, 2], exact, atol=1e-3)


def test_light_bodies_come_back_faster(bones):
    """A hinge with little inertia has the greater gain, unless one is stated; and a gain acts."""
    light, heavy = LIGHT / 2, 2 * LIGHT
    np.testing.assert_array_equal(gains_of(bones, np.array([heavy, light]), {}), [KP, KP_LIGHT])
    stated = gains_of(bones, np.array([heavy, light]), {"r_elbow_flex": 7.0})
    np.testing.assert_array_equal(stated, [KP, 7.0])
    strength = 0.5 * np.ones((1, 6))
    options = {"reserves": reserves(bones), "strength": strength, "span": (0.0, 0.1)}
    usual = track(bones, TIME, wave(), **options)
    quick = track(bones, TIME, wave(), gains=dict.fromkeys(bones.coordinates, 2500.0), **options)
    assert np.abs(quick.values - usual.values).max() > 1e-4


def test_a_set_up_file_of_cmc(bones, tmp_path):
    """Gains of its tasks and least excitations of its constraints; both act."""
    task = '<CMC_Joint name="{0}"><on>{1}</on><kp>{2} 1 1</kp><kv>40 1 1</kv></CMC_Joint>'
    tasks = task.format("r_shoulder_elev", "true", 400) + task.format("r_elbow_flex", "false", 9)
    (tmp_path / "tasks.xml").write_text(f"<CMC_TaskSet><objects>{tasks}</objects></CMC_TaskSet>")
    control = '<ControlLinear name="BRA.excitation"><default_min>0.3</default_min></ControlLinear>'
    (tmp_path / "constraints.xml").write_text(f"<ControlSet><objects>{control}</objects></ControlSet>")
    (tmp_path / "cmc.xml").write_text(
        '<OpenSimDocument Version="40000"><CMCTool name="c"><task_set_file>tasks.xml</task_set_file>'
        "<constraints_file>constraints.xml</constraints_file></CMCTool></OpenSimDocument>"
    )
    said = read_tool_setup(tmp_path / "cmc.xml")
    assert said.gains == {"r_shoulder_elev": 400.0}
    assert said.controls == {"BRA": (0.3, 1.0)}
    write_angles(tmp_path / "wave.mot", bones.model, bones.coordinates, TIME, wave())
    Track(ARM, motion=tmp_path / "wave.mot", setup=tmp_path / "cmc.xml", reserve=1.0,
           span=(0.0, 0.04), output=tmp_path / "out")()  # fmt: skip
    excitation = read_storage(tmp_path / "out/excitations.sto")
    assert excitation.values[:, excitation.labels.index("BRA")].min() >= 0.3
    assert excitation.values.min() < 0.1
    for controls, message in (
        ({"BIC": (0.0, 1.0)}, "controls of 'BIC': unknown; available: TRIlong"),
        ({"BRA": (0.5, 0.2)}, "controls of 'BRA' must be within 0 and 1, got 0.5 to 0.2"),
    ):
        with pytest.raises(ValueError, match=message):
            controlled(bones, controls)


def test_the_command(bones, tmp_path, capsys, caplog):
    write_angles(tmp_path / "wave.mot", bones.model, bones.coordinates, TIME, wave())
    options = {
        "motion": tmp_path / "wave.mot",
        "reserve": 1.0,
        "span": (0.1, 0.14),
        "output": tmp_path / "out",
    }
    Track(ARM, **options, strength=("BIClong=0.5", "BRA=0"))()
    assert {path.name for path in (tmp_path / "out").iterdir()} == set(FILES)
    force = read_storage(tmp_path / "out/forces.sto")
    assert len(force.time) == 5
    assert force.values[:, force.labels.index("BRA")].max() == 0.0
    said = capsys.readouterr().err
    assert "rms off the motion" in said
    assert "reserve at" in said
    warn_once.cache_clear()
    for change, message in (
        (
            {"reserve": 0.0},
            "tracking needs a reserve on every coordinate, such as --reserve 1; 'r_shoulder_elev' has none",
        ),
        ({"strength": ("BIC=90",)}, "muscle 'BIC' unknown; available: TRIlong"),
        ({"gain": ("wrist=9",)}, "gain of 'wrist': unknown; available: r_shoulder_elev, r_elbow_flex"),
        ({"gain": ("r_elbow_flex=0",)}, "the gain of 'r_elbow_flex' must be above 0 and finite, got 0"),
        ({"strength": ("BRA",)}, r"--strength must be like soleus_r=0\.9, got 'BRA'"),
        ({"span": (0.1, 9.0)}, r"the span must lie within 0 to 0\.2 s, got 0\.1 to 9 s"),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            Track(ARM, **{**options, **change}, overwrite=True)()
        assert "\n" not in str(caught.value)
    assert "the strength BIC of 90 is 90 times the model's; for 90 % write 0.9" in caplog.messages

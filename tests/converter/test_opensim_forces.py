"""Limits of coordinates, ligaments and path actuators in the step: against OpenSim 4.6, recorded."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from myowarp.coordinates.step import step_of
from myowarp.osim.bundle.coordinate_map import CoordinateMap
from myowarp.osim.bundle.forces import PassiveForces
from myowarp.osim.bundle.mjcf import mjcf
from myowarp.osim.convert.compose.convert import convert
from myowarp.osim.convert.load import load
from myowarp.osim.document.read.model import read_model
from myowarp.sim.build import compile_scene, stepped_of
from myowarp.tasks.from_file import from_mjcf, from_osim

DATA = Path(__file__).parents[1] / "data"
MODEL = DATA / "osim" / "forces.osim"
RECORDED = np.load(DATA / "opensim" / "forces.npz")

DEVICES, BESIDE = DATA / "osim" / "devices.osim", np.load(DATA / "opensim" / "devices.npz")
AT = 0.37
"""s: time of the recorded states."""
RESTING = ("push", "twist")
"""Actuators that the tests leave alone; the reaction of the second is on ground, not on its body."""
DEVICES_TOLERANCE = 1e-5
"""Of the greatest force of all, float32."""

TOLERANCE = 2e-5
"""Of the greatest force of a kind, float32; short ligaments multiply rounding by their stiffness."""

LAST, MOVED = 26, 0.01
"""Samples of the motion, 10 ms apart, and rad or m that steps of 2 ms take it off (half a second: 0.006)."""

KINDS = {
    "CoordinateLimitForce": ["cart_stop", "hip_stop", "hip_friction", "knee_stop", "knee_end", "cap_stop"],
    "Ligament": ["behind", "beside"],
    "Blankevoort1991Ligament": ["across"],
    "PathSpring": ["band"],
    "PathActuator": ["cable"],
}


def alone(kind, tmp_path):
    """Return a file in which no force but those of a kind and the push acts."""
    text = MODEL.read_text()
    off = "<appliesForce>false</appliesForce>"
    for other, names in KINDS.items():
        for name in names if other != kind else ():
            text = text.replace(f'<{other} name="{name}">', f'<{other} name="{name}">{off}')
    path = tmp_path / f"{kind}.osim"
    path.write_text(text)
    return path


def acting(task, coordinates, worlds=None, recorded=RECORDED, at=0.0):
    """Return what passive forces and actuators do about the free coordinates in the recorded states."""
    free, names = recorded["free"].tolist(), recorded["coordinates"].tolist()
    rows = np.arange(len(recorded["values"])) if worlds is None else worlds
    scene = compile_scene(task, len(rows), device="cpu", physics="parity")
    values = dict(zip(names, recorded["values"][rows].T, strict=True))
    rates = dict(zip(names, recorded["rates"][rows].T, strict=True))
    qpos, slope = coordinates.rates(scene.oracle, {name: values[name] for name in free})
    order = coordinates.free()
    speeds = np.stack([rates[name] for name in order], axis=1)
    control = dict(zip(recorded["forces"].tolist(), recorded["control"].tolist(), strict=True))
    ctrl = np.zeros(scene.data.ctrl.shape, np.float32)
    for number in range(scene.oracle.nu):
        if (name := scene.oracle.actuator(number).name) not in RESTING:
            ctrl[:, number] = control[name]
    launch = step_of(stepped_of(scene)).launches()
    for _ in range(2):  # what the first step leaves must not count in the second
        scene.data.qpos.assign(qpos)
        scene.data.qvel.assign(np.einsum("nij,nj->ni", slope, speeds))
        scene.data.ctrl.assign(ctrl)
        scene.data.time.fill_(at)
        launch()
    force = scene.data.qfrc_passive.numpy() + scene.data.qfrc_actuator.numpy()
    found = np.einsum("nij,ni->nj", slope, force)
    return found[:, [order.index(name) for name in free]]


def expected(kinds):
    """Return what OpenSim's forces of some kinds do about the free coordinates, shape (n, f)."""
    names = RECORDED["forces"].tolist()
    chosen = [names.index(name) for kind in kinds for name in KINDS[kind]]
    return RECORDED["acting"][:, chosen].sum(axis=1)


@pytest.mark.parametrize("kind", KINDS)
def test_forces_are_those_of_opensim(kind, tmp_path):
    path = alone(kind, tmp_path)
    coordinates = CoordinateMap.read(load(path).with_name("coordinates.json"))
    task = from_osim(path, replace=True)
    found, theirs = acting(task, coordinates), expected([kind])
    assert np.abs(theirs).max() > 1.0
    assert (np.abs(theirs).max(axis=1) > 1e-3).mean() > 0.4
    np.testing.assert_allclose(found, theirs, atol=TOLERANCE * np.abs(theirs).max())


@pytest.fixture(scope="module")
def devices():
    """Return what everything in a model of devices does at once, and what each does in OpenSim."""
    coordinates = CoordinateMap.read(load(DEVICES).with_name("coordinates.json"))
    found = acting(from_osim(DEVICES, replace=True), coordinates, None, BESIDE, AT)
    names = BESIDE["forces"].tolist()
    return found, {name: BESIDE["acting"][:, k] for k, name in enumerate(names) if name not in RESTING}


def test_devices_do_what_those_of_opensim_do(devices):
    """Bushings, formulas, between points, along functions, prescribed: none is missing or doubled."""
    found, each = devices
    theirs = sum(each.values())
    off = np.abs(found - theirs).max()
    assert off < DEVICES_TOLERANCE * np.abs(theirs).max()
    assert min(np.abs(one).max() for one in each.values()) > 10 * off


def test_a_converted_model_has_no_springs_besides(tmp_path):
    """Those that stand for limits and ligaments in plain MuJoCo are off, and act there."""
    converted = convert(read_model(MODEL))
    path = tmp_path / "model.xml"
    path.write_text(mjcf(converted.spec))
    (tmp_path / "couplings.json").write_text(converted.couplings.as_json())
    (tmp_path / "paths.json").write_text(converted.paths.as_json())
    (tmp_path / "forces.json").write_text(converted.forces.as_json())
    found = acting(from_mjcf(path, replace=True), converted.coordinates)
    theirs = expected(KINDS)
    np.testing.assert_allclose(found, theirs, atol=2 * TOLERANCE * np.abs(theirs).max())
    plain = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(plain)
    data.qpos[plain.joint("cart_x").qposadr] = 0.2
    mujoco.mj_forward(plain, data)
    assert data.qfrc_spring[plain.joint("cart_x").dofadr[0]] < -50.0


def test_a_world_does_not_depend_on_its_neighbours(tmp_path):
    coordinates = CoordinateMap.read(load(MODEL).with_name("coordinates.json"))
    task = from_osim(MODEL, replace=True)
    together, one = acting(task, coordinates), acting(task, coordinates, np.array([17]))
    np.testing.assert_array_equal(together[17:18], one)


@pytest.mark.slow
def test_a_motion_is_that_of_opensim():
    """From rest: the cart hits its stop, the knee its own, ligaments hold and swing."""
    coordinates = CoordinateMap.read(load(MODEL).with_name("coordinates.json"))
    task, names = from_osim(MODEL, replace=True), RECORDED["coordinates"].tolist()
    motion, free = RECORDED["motion"][:LAST], coordinates.free()
    errors = []
    for dt in (0.002, 0.001):
        scene = compile_scene(task, 1, device="cpu", physics="parity")
        scene.model.opt.timestep.fill_(dt)
        start = dict(zip(names, motion[:1].T, strict=True))
        qpos, _ = coordinates.rates(scene.oracle, {name: start[name] for name in free})
        scene.data.qpos.assign(qpos)
        ctrl = [dict(cable=0.4, push=0.6)[scene.oracle.actuator(k).name] for k in range(scene.oracle.nu)]
        scene.data.ctrl.assign(np.array([ctrl]))
        launch, rows = step_of(stepped_of(scene)).launches(), [qpos[0]]
        for _ in motion[1:]:
            for _ in range(round(0.01 / dt)):
                launch()
            rows.append(scene.data.qpos.numpy()[0].copy())
        found = np.array(rows)
        address = [scene.oracle.joint(name).qposadr[0] for name in free]
        errors.append(np.abs(found[:, address] - motion[:, [names.index(name) for name in free]]).max())
    assert np.ptp(motion, axis=0).max() > 0.3
    assert errors[0] < MOVED
    assert errors[1] < 0.6 * errors[0]


BROKEN = [
    ("limits", 0, "joint", "elsewhere", "no hinge or slide of that name"),
    ("limits", 0, "transition", 0.0, "a transition above 0"),
    ("limits", 1, "low_stiffness", "nan", "needs finite numbers"),
    ("ligaments", 0, "tendon", "elsewhere", "no tendon of that name"),
    ("ligaments", 1, "resting_length", 0.0, "a resting length above 0"),
    ("ligaments", 1, "curves", [[[0.0], [[]]]], "as many pieces as breaks"),
    ("limits", 0, "colour", 1, "must be JSON with 'limits', 'ligaments', 'springs' and 'dampers'"),
]


@pytest.mark.parametrize(("kind", "number", "name", "value", "reason"), BROKEN)
def test_broken_texts_are_one_sentence(kind, number, name, value, reason, tmp_path):
    folder = load(MODEL).parent
    for file in folder.iterdir():
        if file.is_file():
            (tmp_path / file.name).write_bytes(file.read_bytes())
    entry = json.loads((tmp_path / "forces.json").read_text())
    entry[kind][number][name] = float(value) if value == "nan" else value
    (tmp_path / "forces.json").write_text(json.dumps(entry))
    with pytest.raises(ValueError, match=reason) as error:
        from_mjcf(tmp_path / "model.xml", replace=True)
    assert "must belong to model.xml" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_text_is_read_as_it_was_written():
    forces = convert(read_model(MODEL)).forces
    again = PassiveForces.read(forces.as_json())
    assert again.limits == forces.limits
    assert again.as_json() == forces.as_json()
    assert PassiveForces.of(mujoco.MjModel.from_xml_string("<mujoco/>")) is None

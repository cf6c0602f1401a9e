"""Bodies against the compiled models of MyoSuite 3.0.0, recorded field by field."""

import json
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from myowarp.definitions.body import BODIES

DATA = Path(__file__).parents[1] / "data" / "myosuite"

RECORDED = {
    "finger": "myoFingerPoseFixed-v0",
    "motor_finger": "motorFingerPoseFixed-v0",
    "elbow": "myoElbowPose1D6MFixed-v0",
    "elbow_exo": "myoElbowPose1D6MExoFixed-v0",
    "hand": "myoHandPoseFixed-v0",
    "arm": "myoArmReachFixed-v0",
    "legs": "myoLegStandRandom-v0",
    "torso": "myoTorsoPoseFixed-v0",
    "torso_exo": "myoTorsoExoPoseFixed-v0",
}

COMPILED = 1e-10
"""Relative to the largest entry of the field. Same model files and same MuJoCo compiler (4.0.0), so
the deviation is 0; room for another build of the same arithmetic."""

PER_BODY = ("body_mass", "body_inertia", "body_ipos", "body_pos", "body_quat")


@lru_cache
def compiled(body):
    """Return the compiled model of a body."""
    return BODIES[body].build().compile()


@lru_cache
def recording(body):
    """Return the recorded fields of MyoSuite's model without their prefix, and its metadata."""
    with np.load(DATA / f"{RECORDED[body]}.npz") as file:
        fields = {key.removeprefix("model_"): file[key] for key in file if key.startswith("model_")}
        return fields, json.loads(str(file["meta"]))


@pytest.mark.parametrize("body", RECORDED)
def test_names_and_time_step(body):
    model, (_, meta) = compiled(body), recording(body)
    assert [model.joint(i).name for i in range(model.njnt)] == meta["joints"]
    assert [model.actuator(i).name for i in range(model.nu)] == meta["actuators"]
    assert [model.tendon(i).name for i in range(model.ntendon)] == meta["tendons"]
    assert meta["tip_sites"] in ([], list(BODIES[body].tips))  # the torso's task marks no tip
    assert model.opt.timestep == meta["timestep"]


@pytest.mark.parametrize("body", RECORDED)
def test_moving_bodies_are_all_there(body):
    """Decorations may be missing; what a joint moves may not."""
    model, (_, meta) = compiled(body), recording(body)
    ours = {model.body(i).name for i in range(model.nbody)}
    moving = {model.body(i).name for i in range(model.nbody) if model.body_weldid[i]}
    assert moving
    assert moving <= set(meta["bodies"])
    assert len(set(meta["bodies"]) & ours) >= len(moving)


EDITED = {("elbow_exo", "actuator_ctrlrange")}
"""What differs from MyoSuite on purpose, compared in a test of its own."""

FIELDS = [(body, field) for body in RECORDED for field in recording(body)[0] if (body, field) not in EDITED]


@pytest.mark.parametrize(("body", "field"), FIELDS, ids=map("-".join, FIELDS))
def test_field_equals_myosuite(body, field):
    model, (fields, meta) = compiled(body), recording(body)
    expected = fields[field].astype(np.float64)
    ours = np.asarray(getattr(model, field), dtype=np.float64)
    if field in PER_BODY:
        common = [name for name in meta["bodies"] if name in _body_names(model)]
        expected = expected[[meta["bodies"].index(name) for name in common]]
        ours = ours[[model.body(name).id for name in common]]
    assert ours.shape == expected.shape
    scale = np.abs(expected).max(initial=1e-300)
    assert np.abs(ours - expected).max(initial=0.0) <= COMPILED * scale


def _body_names(model):
    """Return the names of all bodies of a model."""
    return {model.body(i).name for i in range(model.nbody)}


def test_recordings_tell_models_apart():
    """The gears of the motors, our one edit of a number, are seen by the comparison above."""
    fields, _ = recording("motor_finger")
    gears = compiled("motor_finger").actuator_gear[:, 0]
    assert np.array_equal(np.sort(gears), [20.0, 20.0, 40.0, 40.0, 80.0])
    assert np.array_equal(fields["actuator_gear"][:, 0], gears)
    muscle_gears = recording("finger")[0]["actuator_gear"][:, 0]
    assert np.abs(muscle_gears - gears).max() > 1.0


def test_strong_motors_differ_in_nothing_but_gears():
    """Those of myo-sim 0.2.4, read in its wheel; the finger is the same."""
    weak, strong = compiled("motor_finger"), compiled("strong_motor_finger")
    names = [strong.actuator(i).name for i in range(strong.nu)]
    gears = {"extn": 160.0, "adabR": 80.0, "adabL": 80.0, "mflx": 160.0, "dflx": 160.0}
    assert dict(zip(names, strong.actuator_gear[:, 0].tolist(), strict=True)) == gears
    assert np.array_equal(strong.actuator_gear[:, 0] / weak.actuator_gear[:, 0], [2.0, 4.0, 4.0, 4.0, 4.0])
    for field in ("body_mass", "body_pos", "jnt_range", "dof_damping", "actuator_ctrlrange", "tendon_range"):
        assert np.array_equal(getattr(weak, field), getattr(strong, field)), field


def test_bounds_of_the_exoskeleton():
    """Its control is unlimited in MyoSuite, whose actions stay within the bounds that ours has."""
    expected, ours = recording("elbow_exo")[0]["actuator_ctrlrange"], compiled("elbow_exo").actuator_ctrlrange
    assert not expected[0].any()
    assert np.array_equal(ours[0], (-1.0, 1.0))
    assert np.array_equal(ours[1:], expected[1:])


@pytest.mark.parametrize("body", BODIES)
def test_every_body_is_fresh_and_complete(body):
    first, second = BODIES[body].build(), BODIES[body].build()
    tip = BODIES[body].tips[0]
    first.site(tip).pos = (9.0, 9.0, 9.0)
    assert not np.array_equal(second.site(tip).pos, first.site(tip).pos)
    model = compiled(body)
    for name in BODIES[body].tips:
        assert model.body_weldid[model.site(name).bodyid[0]] > 0, "a tip that cannot move"
    assert np.all(model.actuator_ctrllimited), "a policy needs bounds for every actuator"

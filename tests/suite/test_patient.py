"""Knobs: what a condition declares can be changed while the worlds are stepped, in one world alone."""

import numpy as np
import pytest

from myowarp.definitions.task import TASKS
from myowarp.sim.patient import Patient, every_condition
from myowarp.sim.signals import Signals
from myowarp.sim.simulation import Simulation

STEPS = 30
KEYS = ("myoElbowPose1D6MRandom-v0", "myoHandPoseRandom-v0")
SEEDS = np.array([5, 5])


def steps(sim, signals):
    """Return muscle signals over time, (T, 2, num_muscles) each: effort, not that of all alike, then rest."""
    rows, effort = [], np.float32([0.6 if i % 4 == 0 else 1.0 for i in range(sim.action.shape[1])])
    for step in range(STEPS):
        level = effort if step < STEPS // 2 else -np.ones_like(effort)
        sim.action.assign(np.tile(level, (2, 1)))
        sim.step()
        muscles = signals.muscles
        shown = (
            muscles.excitation,
            muscles.activation,
            muscles.force,
            muscles.length,
            *signals.info.values(),
        )
        rows.append([array.numpy().reshape(2, -1).copy() for array in shown])
    return [np.stack([row[k] for row in rows]) for k in range(len(rows[0]))]


@pytest.fixture(scope="module", params=KEYS)
def session(request):
    spec = TASKS[request.param]
    sim = Simulation(
        spec,
        2,
        device="cpu",
        conditions=every_condition(spec),
        autoreset="disabled",
        adjustable=True,
        progress=False,
    )
    return sim, Signals(sim)


def test_every_knob_acts_on_its_world_alone(session):
    sim, signals = session
    healthy = Simulation(sim.scene.spec, 2, device="cpu", autoreset="disabled", progress=False)
    plain = Signals(healthy)
    healthy.reset(seeds=SEEDS)
    expected = steps(healthy, plain)
    for name, knob in Patient(sim).knobs.items():
        patient = Patient(sim)
        before = {k: k.parameter.values(0).copy() for k in patient.knobs.values()}
        beside = [k for k in patient.knobs.values() if k.condition == knob.condition and k is not knob]
        neutral = type(next(c for c in sim.conditions if c.name == knob.condition)).NEUTRAL
        # A rate matters to a muscle that tires, a mass to a limb that no stiff spring holds.
        changes = []
        for others in (beside, [k for k in beside if k.field not in neutral]):
            for k, values in before.items():
                k.parameter.set(values, [0, 1], range(len(values)))
            for other in others:
                patient.set(other, other.high if other.field in neutral else other.high / 4, [0, 1])
            low = knob.low if abs(patient.value(knob, 0) - knob.low) > 1e-6 else knob.high
            patient.set(knob, low, [0])
            assert patient.value(knob, 0) == pytest.approx(low)
            sim.reset(seeds=SEEDS)
            found = steps(sim, signals)
            changes.append(max(np.abs(s[:, 0] - s[:, 1]).max() / max(np.abs(s).max(), 1e-9) for s in found))
        assert max(changes) > 0.1, f"{name} moves nothing: {changes}"
        if not beside:
            for ours, theirs in zip(found[:4], expected[:4], strict=True):
                np.testing.assert_array_equal(ours[:, 1], theirs[:, 1], err_msg=name)
        for k, values in before.items():
            k.parameter.set(values, [0, 1], range(len(values)))
    assert len(before) >= 8


def test_one_muscle_of_many(session):
    sim = session[0]
    patient = Patient(sim)
    knob, names = patient.knobs["sarcopenia strength"], sim.scene.muscles.names
    patient.set(knob, 0.25, [0], [names[1]])
    sim.step()
    strength = sim.scene.muscles.anatomy.strength.numpy()
    np.testing.assert_array_equal(strength[0], np.where(np.arange(len(names)) == 1, 0.25, 1.0))
    np.testing.assert_array_equal(strength[1], 1.0)
    patient.set(knob, 1.0, [0])


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_what_is_out_of_range_changes_nothing(session, value):
    patient = Patient(session[0])
    knob = patient.knobs["sarcopenia strength"]
    with pytest.raises(ValueError, match="sarcopenia strength must be"):
        patient.set(knob, value, [0])
    assert patient.value(knob, 0) == 1.0


def test_what_cannot_act_together_is_put_back(session):
    patient = Patient(session[0])
    if "tendon_transfer affected" not in patient.knobs:
        pytest.skip("of hands alone")
    first, second = (patient.knobs[f"{name} affected"] for name in ("tendon_transfer", "reafferentation"))
    patient.set(first, 1.0, [0])
    with pytest.raises(ValueError, match="cannot have both"):
        patient.set(second, 1.0, [0])
    assert patient.value(second, 0) == 0.0
    patient.set(first, 0.0, [0])


def test_given_conditions_come_first():
    spec = TASKS[KEYS[0]]
    names = [condition.name for condition in every_condition(spec, ["fatigue_ma2009"])]
    assert "fatigue_ma2009" in names
    assert "fatigue_3ccr" not in names

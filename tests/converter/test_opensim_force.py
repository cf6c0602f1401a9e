"""MuJoCo's muscle fitted to OpenSim's: forces in MuJoCo C against recorded OpenSim forces, and the gates."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from opensim_muscles import load
from reference import mujoco_muscle as reference

from myowarp.osim.body.activation import activation_dynamics
from myowarp.osim.body.hill_curves import SPLINES
from myowarp.osim.body.hill_muscle import HillMuscle

pytest.importorskip("scipy")

from myowarp.osim.convert.tendon import force

GATES = {"arm26": 0.02, "leg6dof9musc": 0.025, "gait10dof18musc": 0.025}
"""Mean error of the force map over the muscles [max_isometric_force]; the converter's promise."""

CURVE_TOLERANCE = 1e-12
"""The same operations in double precision, in another order."""

FORCE_TOLERANCE = 1e-9
"""MuJoCo's parameters go through ranges of length and back [max_isometric_force]."""


def engine_force(fit, length, velocity=0.0, activation=1.0):
    """Return the force of MuJoCo C's muscle with fitted parameters [N]."""
    length, velocity, activation = np.broadcast_arrays(length, velocity, activation)
    gain, bias, range_ = np.array(fit.gainprm[:9]), np.array(fit.biasprm[:9]), np.array(fit.length_range)
    forces = [
        -(a * mujoco.mju_muscleGain(x, v, range_, 1.0, gain) + mujoco.mju_muscleBias(x, range_, 1.0, bias))
        for x, v, a in zip(length.ravel(), velocity.ravel(), activation.ravel(), strict=True)
    ]
    return np.reshape(forces, length.shape)


@pytest.mark.parametrize("model", GATES)
def test_force_map_of_opensim(model):
    """The fit knows lengths of 200 poses; MuJoCo C is compared with OpenSim's forces in 12 of them.

    Of the gait model, only the right side: the left one is its mirror image.
    """
    data, muscles = load(model)
    active = data["activation"] >= 0.05  # below, OpenSim holds activation at its floor
    errors, promised, start = [], [], []
    for i, muscle in enumerate(muscles[: len(muscles) // (2 if model.startswith("gait") else 1)]):
        fit = force.fit_force(muscle, data["pose_length"][:, i])
        found = engine_force(fit, data["length"][:, i, None], 0.0, data["activation"][active])
        error = (found - data["tendon_force"][:, active, i]) / muscle.values["max_isometric_force"]
        errors.append(np.sqrt(np.mean(error**2)))
        promised.append(fit.rms)
        start.append(fit.start_rms)
        assert fit.num_samples == len(data["pose_length"])
        assert fit.num_masked == 0
    assert np.mean(promised) < GATES[model]
    assert np.mean(errors) < 1.3 * GATES[model], "12 poses scatter around the mean"
    assert np.mean(start) > 2.0 * np.mean(promised)


def test_parameters_are_those_of_the_fit():
    """`gainprm` and `biasprm` in MuJoCo C give the map that the error was measured on."""
    data, muscles = load("arm26")
    muscle, lengths = muscles[0], data["pose_length"][:, 0]
    fit = force.fit_force(muscle, lengths)
    between = np.quantile(lengths.astype(float), np.linspace(0.0, 1.0, 2 * force.NUM_LENGTHS + 1)[::2])
    found = engine_force(fit, between, 0.0, force.ACTIVATIONS[:, None])
    peak = muscle.values["max_isometric_force"]
    error = found / peak - muscle.tendon_force(force.ACTIVATIONS[:, None], between)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(fit.rms, abs=FORCE_TOLERANCE)
    assert np.abs(error).max() == pytest.approx(fit.max_error, abs=FORCE_TOLERANCE)
    assert np.sqrt(np.mean(error[-1] ** 2)) == pytest.approx(fit.full_activation_rms, abs=FORCE_TOLERANCE)


def test_a_muscle_of_mujocos_shape_is_found_again(monkeypatch):
    """Forces that MuJoCo's muscle can make come back with no error but the pull to the start."""
    target = np.array([1.1, 0.6, 0.7, 0.95, 1.2, 0.4, 1.5])
    muscle = load("arm26")[1][0]
    slack, optimal = muscle.values["tendon_slack_length"], muscle.values["optimal_fiber_length"]

    def tendon_force(self, activation, length, velocity=0.0):
        x = (length - slack) / optimal
        static = activation * target[3] * force.bump(x, *target[:3])[0]
        scaled = force.hill_curve(velocity / (0.6 * muscle.velocity_scale), 1.5)
        return static * scaled + target[6] * force.toe(x, *target[4:6])[0]

    monkeypatch.setattr(HillMuscle, "tendon_force", tendon_force)
    lengths = slack + optimal * np.linspace(0.4, 1.9, 300)
    fit = force.fit_force(muscle, lengths)
    assert fit.rms < 0.002
    assert fit.start_rms > 0.05
    assert fit.velocity_rms < 0.01
    unit = fit.gainprm[6] * (fit.length_range[1] - fit.length_range[0]) / (fit.gainprm[1] - fit.gainprm[0])
    assert unit == pytest.approx(0.6 * muscle.velocity_scale, rel=0.02)
    assert fit.gainprm[8] == pytest.approx(1.5, rel=0.02)


def test_force_velocity_is_fitted():
    """MuJoCo's own numbers (vmax of the muscle, fvmax 1.4) are not those of the Hill muscle."""
    data, muscles = load("arm26")
    muscle, lengths = muscles[0], data["pose_length"][:, 0]
    fit = force.fit_force(muscle, lengths)
    unit = (fit.length_range[1] - fit.length_range[0]) / (fit.gainprm[1] - fit.gainprm[0])
    speed = muscle.values["max_contraction_velocity"] * muscle.values["optimal_fiber_length"]
    plain = replace(
        fit, gainprm=(*fit.gainprm[:6], speed / unit, fit.gainprm[7], 1.4, 0.0), biasprm=fit.biasprm
    )
    velocity = np.linspace(-0.9, 0.9, 19)[:, None] * speed
    length = np.quantile(lengths, [0.2, 0.4, 0.6, 0.8])
    peak = muscle.values["max_isometric_force"]
    expected = muscle.tendon_force(1.0, length, velocity)
    rms = [
        np.sqrt(np.mean((engine_force(each, length, velocity) / peak - expected) ** 2))
        for each in (fit, plain)
    ]
    assert rms[0] < 0.1
    assert rms[1] > 1.5 * rms[0]


@pytest.mark.parametrize("shape", [(0.9, 0.5, 0.8), (1.2, 1.1, 0.3)])
def test_curves_are_mujocos(shape):
    peak, rise, fall = shape
    length = np.linspace(-0.5, 2.5, 301)
    normalized = 1.0 + (length - peak) / rise
    expected = reference.force_length(normalized, 0.0, 1.0 + fall / rise)
    assert force.bump(length, *shape)[0] == pytest.approx(expected, abs=CURVE_TOLERANCE)
    start, width = 1.1, 0.4
    expected = reference.passive_force(1.0 + (length - start), 1.0 + 2.0 * width, 1.0)
    assert force.toe(length, start, width)[0] == pytest.approx(expected, abs=CURVE_TOLERANCE)
    assert force.hill_curve(length - 1.0, 1.3) == pytest.approx(
        reference.force_velocity(length - 1.0, 1.3), abs=CURVE_TOLERANCE
    )


def test_derivatives_of_the_map():
    p = np.array([1.05, 0.6, 0.8, 0.9, 1.15, 0.5, 1.3])
    length, activation = np.linspace(0.3, 2.2, 77), np.full(77, 0.7)
    _, found = force.static_force(p, length, activation)
    for i, step in enumerate(np.eye(7) * 1e-6):
        ahead = force.static_force(p + step, length, activation)[0]
        behind = force.static_force(p - step, length, activation)[0]
        assert found[i] == pytest.approx((ahead - behind) / 2e-6, abs=1e-5)
        assert np.abs(found[i]).max() > 0.1


def test_differential_evolution_is_an_option():
    data, muscles = load("arm26")
    lengths = data["pose_length"][:, 0]
    tied = force.fit_force(muscles[0], lengths, "differential_evolution")
    free = force.fit_force(muscles[0], lengths)
    assert free.rms < 0.7 * tied.rms < 0.7 * tied.start_rms * 2.0
    assert tied.biasprm[:2] == pytest.approx(tied.gainprm[:2]), "gain and bias are tied"


def test_no_pose_shows_the_fiber():
    """A constant length, and lengths in which the muscle is slack: the numbers stay near the start."""
    muscle = load("arm26")[1][0]
    v = muscle.values
    fit = force.fit_force(muscle, np.full(20, v["tendon_slack_length"] + v["optimal_fiber_length"]))
    assert fit.rms < 0.01
    assert fit.length_range[1] - fit.length_range[0] == pytest.approx(1e-3)
    slack = force.fit_force(muscle, np.linspace(0.5, 0.9, 50) * v["tendon_slack_length"])
    assert np.abs(engine_force(slack, 0.7 * v["tendon_slack_length"])) < 0.02 * v["max_isometric_force"]
    for each in (fit, slack):
        assert 0.0 <= each.gainprm[4] < 1.0 < each.gainprm[5]


def test_what_no_length_shows_stays_near_the_start():
    """No pose of arm26 stretches its brachialis past the peak: the fall must not run off."""
    data, muscles = load("arm26")
    brachialis = next(i for i, muscle in enumerate(muscles) if muscle.name == "BRA")
    fit = force.fit_force(muscles[brachialis], data["pose_length"][:, brachialis])
    assert fit.gainprm[5] < 2.5


def test_unknown_class():
    data, muscles = load("arm26")
    unknown = HillMuscle("m", "MeyerFregly2016Muscle", muscles[0].values)
    fit = force.fit_force(unknown, data["pose_length"][:, 0])
    assert fit.gainprm == force.fit_force(muscles[0], data["pose_length"][:, 0]).gainprm
    assert "MeyerFregly2016Muscle" in fit.notes[0].rule


def test_samples():
    muscle = load("arm26")[1][0]
    length = muscle.values["tendon_slack_length"] + muscle.values["optimal_fiber_length"]
    lengths = np.append(np.linspace(0.9, 1.1, 30) * length, [np.nan, np.inf])
    fit = force.fit_force(muscle, lengths)
    assert (fit.num_samples, fit.num_masked) == (30, 2)
    with pytest.raises(ValueError, match=f"muscle '{muscle.name}' has no finite length among 2 poses"):
        force.fit_force(muscle, lengths[-2:])
    stretched = force.fit_force(muscle, np.linspace(1.0, 2.5, 30) * length)
    assert "poses stretch it to more than 3 times" in stretched.notes[-1].rule
    assert not fit.notes


def rates(muscle, excitation, activation):
    """Return da/dt of a class whose activation MuJoCo can only come close to, from its paper [1/s]."""
    v, z = muscle.values, 0.5 + 1.5 * activation
    if muscle.kind == "DeGrooteFregly2016Muscle":
        f = 0.5 * np.tanh(0.1 * (excitation - activation))
        up, down = v["activation_time_constant"], v["deactivation_time_constant"]
        return ((f + 0.5) / (up * z) + (0.5 - f) * z / down) * (excitation - activation)
    rising = (v["activation1"] * excitation + v["activation2"]) / v["time_scale"]
    falling = v["activation2"] / v["time_scale"]
    return np.where(excitation >= activation, rising, falling) * (excitation - activation)


def test_activation_dynamics():
    thelen = load("arm26")[1][0]
    assert activation_dynamics(thelen) == ((0.01, 0.04, 0.0), ())
    instant = HillMuscle("m", thelen.kind, {**thelen.values, "ignore_activation_dynamics": 1.0})
    assert activation_dynamics(instant) == (None, ())

    degroote = next(m for m in load("variants")[1] if m.kind == "DeGrooteFregly2016Muscle")
    numbers = {"time_scale": 0.1, "activation1": 7.667, "activation2": 1.459854}
    kind = "Schutte1993Muscle_Deprecated"
    schutte = HillMuscle("m", kind, {**thelen.values, **numbers}, SPLINES[kind])
    excitation, activation = np.array([1.0, 0.0])[:, None], np.linspace(0.05, 0.95, 19)
    for muscle, bound in ((degroote, 1.3), (schutte, 2.5)):
        constants, notes = activation_dynamics(muscle)
        found = reference.activation_rate(excitation, activation, *constants)
        ratio = found / rates(muscle, excitation, activation)
        assert ratio.max() < bound
        assert ratio.min() > 1.0 / bound
        assert len(notes) == 1
        if muscle is schutte:
            assert ratio[:, activation.size // 2] == pytest.approx(1.0, abs=1e-9), "at activation 0.5"

"""`myowarp.muscle`: forces beside OpenSim, gradients beside differences, arrays, bad input, the example."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from opensim_muscles import load
from reference import hill as reference

from myowarp.definitions.muscle import MUSCLES
from myowarp.muscle import NAMES, NEEDED, Muscles

EXAMPLE = Path(__file__).parents[2] / "examples" / "identify_flexors.py"
FLEXORS = {
    "max_isometric_force": [624.3, 435.6],
    "optimal_fiber_length": [0.1157, 0.1321],
    "tendon_slack_length": [0.2723, 0.1923],
    "pennation_angle_at_optimal": [0.2, 0.4],
}
ACTIVATION = np.array([[0.05, 0.5], [0.7, 0.9], [0.3, 0.2]])
LENGTH = np.array([[0.40, 0.34], [0.39, 0.33], [0.37, 0.30]])
VELOCITY = np.array([[0.1, -0.2], [-0.3, 0.1], [0.04, 0.05]])  # not 0, where Thelen's f_V has a corner
FORCE = 1e-6  # of the maximum isometric force
TENDON = ("FmaxTendonStrain", "tendon_strain_at_one_norm_force")
GRADIENT = 1e-3  # of the greatest of an array


def device_array(values):
    return wp.array(values, dtype=wp.float64, device="cpu", requires_grad=True)


@pytest.mark.parametrize("model", ["arm26", "gait10dof18musc", "variants"])
def test_forces_are_opensims(model):
    """Each recorded muscle by itself, under its own law."""
    data, muscles = load(model)
    for i, muscle in enumerate(muscles):
        law = {"Th": "thelen2003", "Mi": "millard2012", "De": "degroote_fregly2016"}[muscle.kind[:2]]
        own = {name: value for name, value in muscle.values.items() if name in MUSCLES[law].PARAMETERS}
        expected = data["tendon_force"][:, :, i] / muscle.values["max_isometric_force"]
        taut = (data["length"][:, i] > muscle.values["tendon_slack_length"]) & np.isfinite(expected).all(
            axis=1
        )
        activation, length = np.meshgrid(data["activation"], data["length"][taut, i])
        found = Muscles(law, **own).equilibrium(activation[..., None], length[..., None]).tendon_force[..., 0]
        assert found / muscle.values["max_isometric_force"] == pytest.approx(expected[taut], abs=FORCE)


@pytest.mark.parametrize("model", NAMES)
def test_curves_have_their_landmarks_and_energy_is_kept(model):
    muscles = Muscles(model, **FLEXORS)
    assert muscles.active_force_length(1.0) == pytest.approx([1.0, 1.0], abs=2e-2)
    assert muscles.force_velocity(0.0) == pytest.approx([1.0, 1.0], abs=1e-2)
    assert muscles.force_velocity(-1.0) == pytest.approx([0.0, 0.0], abs=1e-2)
    assert muscles.tendon_force([[-0.01], [0.0]]) == pytest.approx(np.zeros((2, 2)), abs=1e-9)
    held = muscles.equilibrium(ACTIVATION, LENGTH, VELOCITY)
    moving = muscles.contraction(ACTIVATION, LENGTH, VELOCITY, 0.98 * held.fiber_length)
    given = -moving.tendon_force * VELOCITY
    assert moving.fiber_power + moving.tendon_power == pytest.approx(given, rel=1e-9, abs=1e-9)
    assert np.abs(moving.fiber_power).max() > 1.0
    times = {"activation_time_constant": 0.02, "deactivation_time_constant": 0.05}
    up, down = Muscles(model, **FLEXORS, **times).activation_rate([[1.0], [0.1]], 0.5)[:, 0]
    if model.startswith("degroote"):  # equation 1 of the paper
        z, f = 1.25, 0.5 * np.tanh(0.1 * np.array([0.5, -0.4]))
        expected = ((0.5 + f) / (0.02 * z) + (0.5 - f) * z / 0.05) * [0.5, -0.4]
    else:
        expected = 0.5 / (0.02 * 1.25), -0.4 * 1.25 / 0.05
    assert (up, down) == pytest.approx(tuple(expected), rel=1e-9)


def test_thelens_curves_are_the_papers():
    """Against float64 NumPy from the paper."""
    p = {"FmaxTendonStrain": 0.033, "KshapePassive": 4.0, "FmaxMuscleStrain": 0.6, "KshapeActive": 0.5}
    active, passive, tendon, _ = reference.thelen(p)
    muscles = Muscles("thelen2003", **{name: FLEXORS[name][0] for name in NEEDED}, **p)
    x = np.linspace(0.4, 1.6, 41)[:, None]
    assert muscles.active_force_length(x) == pytest.approx(active(x), abs=1e-12)
    assert muscles.passive_force(x) == pytest.approx(passive(x), abs=1e-10)
    strain = np.linspace(-0.01, 0.05, 41)[:, None]
    assert muscles.tendon_force(strain) == pytest.approx(tendon(1.0 + strain), abs=1e-10)


@pytest.mark.parametrize("model", NAMES)
def test_gradients_are_central_differences(model):
    """Of everything that comes out, by every parameter and every state."""
    muscles = Muscles(model, requires_grad=True, **FLEXORS)
    fiber = 0.99 * muscles.equilibrium(ACTIVATION, LENGTH, VELOCITY).fiber_length
    states = {
        name: device_array(values)
        for name, values in (("a", ACTIVATION), ("l", LENGTH), ("v", VELOCITY), ("fiber", fiber))
    }
    a, path, v, own = states.values()
    seeds = np.random.default_rng(0).normal(size=ACTIVATION.shape)
    runs = [(lambda k=k: muscles.equilibrium(a, path, v)[k]) for k in range(2)]
    runs += [(lambda k=k: muscles.contraction(a, path, v, own)[k]) for k in range(4)]
    runs.append(lambda: muscles.activation_rate(path, a))
    inputs, moved = {**muscles.parameters, **states}, set()
    for run in runs:
        for array in inputs.values():
            array.grad.zero_()
        with wp.Tape() as tape:
            out = run()
        tape.backward(grads={out: wp.array(seeds, dtype=wp.float64, device="cpu")})
        for name, array in inputs.items():
            found, x, expected = array.grad.numpy().copy(), array.numpy().copy(), np.zeros(array.shape)
            for at in np.ndindex(x.shape):
                step = 1e-6 * max(abs(x[at]), 0.1)
                sides = []
                for sign in (1.0, -1.0):
                    y = x.copy()
                    y[at] += sign * step
                    array.assign(y)
                    sides.append((run().numpy() * seeds).sum())
                expected[at] = (sides[0] - sides[1]) / (2.0 * step)
            array.assign(x)
            most = np.abs(expected).max()
            if most > 1e-6:
                moved.add(name)
                assert np.abs(found - expected).max() < GRADIENT * most, name
    still = {"minimum_activation"} | ({"fiber", *TENDON} if "rigid" in model else set())
    assert inputs.keys() - moved <= still | (set() if model.startswith("millard") else {"fiber_damping"})


def test_arrays_come_back_as_they_are():
    torch = pytest.importorskip("torch")
    muscles = Muscles("millard2012", **FLEXORS)
    expected = muscles.equilibrium(0.5, LENGTH).tendon_force
    found = muscles.equilibrium(0.5, torch.tensor(LENGTH, dtype=torch.float32)).tendon_force
    assert found.dtype == torch.float32
    assert found.numpy() == pytest.approx(expected, rel=1e-4)
    found = muscles.equilibrium(0.5, device_array(LENGTH)).tendon_force
    assert isinstance(found, wp.array)
    assert found.numpy() == pytest.approx(expected, rel=1e-12)
    one = muscles.equilibrium(0.5, [0.4, 0.34]).tendon_force
    assert one.tolist() == expected[0].tolist()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"tendon_slack_length": None}, "muscles need .*; tendon_slack_length is missing"),
        ({"max_isometric_force": [624.0, -1.0]}, "max_isometric_force must be numbers, .*, got -1"),
        ({"pennation_angle_at_optimal": np.pi / 2}, "pennation_angle_at_optimal must be .*, got 1.5708"),
        ({"optimal_fiber_length": np.nan}, "optimal_fiber_length must be .*, got nan"),
        ({"optimal_fiber_length": np.inf}, "optimal_fiber_length must be .*, got inf"),
        ({"max_contraction_velocity": [1.0, 2.0, 3.0]}, "must be one number or 3, got 2"),
        ({"mass": 1.0}, "parameter of muscle model 'millard2012' 'mass' unknown"),
    ],
)
def test_bad_parameters_are_refused(given, said):
    parameters = {name: value for name, value in {**FLEXORS, **given}.items() if value is not None}
    with pytest.raises(ValueError, match=said):
        Muscles("millard2012", **parameters)


def test_bad_arrays_are_refused():
    muscles = Muscles("millard2012", **FLEXORS)
    with pytest.raises(ValueError, match=r"broadcast with 2 muscles on the last axis, got .* length \(3,\)"):
        muscles.equilibrium(0.5, [0.3, 0.3, 0.3])
    with pytest.raises(
        ValueError, match=r"length must be a float64 Warp array \(\.\.\., 2\), .*, got float32"
    ):
        muscles.equilibrium(0.5, wp.array(LENGTH, dtype=wp.float32, device="cpu"))


CALLS = {
    "active_force_length": {"norm_length": 0.9},
    "passive_force": {"norm_length": 1.2},
    "tendon_force": {"strain": 0.02},
    "force_velocity": {"norm_velocity": -0.1, "activation": 0.5},
    "equilibrium": {"activation": 0.5, "length": 0.4, "velocity": 0.1},
    "contraction": {"activation": 0.5, "length": 0.4, "velocity": 0.1, "fiber_length": 0.11},
    "activation_rate": {"excitation": 0.4, "activation": 0.5},
}
"""Every method, with arguments at which all results are finite."""


@pytest.mark.parametrize("model", NAMES)
@pytest.mark.parametrize("method", CALLS)
def test_what_is_not_finite_gives_no_number(model, method):
    """NaN in one muscle of one row makes that muscle's results NaN, and no other's; and so does infinity."""
    muscles, own = Muscles(model, **FLEXORS), CALLS[method]
    expected = np.array(
        getattr(muscles, method)(**{name: np.full((2, 2), value) for name, value in own.items()})
    )
    assert np.isfinite(expected).all()
    for name in own:
        for lost in (np.nan, np.inf, -np.inf) if name not in ("activation", "excitation") else (np.nan,):
            given = {other: np.full((2, 2), value) for other, value in own.items()}
            given[name][1, 0] = lost
            found = np.array(getattr(muscles, method)(**given))
            assert np.isnan(found[..., 1, 0]).all(), (name, lost, found[..., 1, 0])
            found[..., 1, 0] = expected[..., 1, 0]
            np.testing.assert_array_equal(found, expected)
            on_device = np.array(
                [
                    a.numpy()
                    for a in _tuple(
                        getattr(muscles, method)(**{n: device_array(v) for n, v in given.items()})
                    )
                ]
            )
            assert np.isnan(on_device[..., 1, 0]).all()


def _tuple(found):
    return found if isinstance(found, tuple) else (found,)


@pytest.mark.parametrize(
    ("length", "said"),
    [
        (None, "length must be numbers, got None"),
        ("0.4", "length must be numbers, got '0.4'"),
        (0.4 + 0j, r"length must be numbers, got \(0.4\+0j\)"),
        (10**400, "length must be numbers, got an integer beyond float64"),
        ([0.4, None], r"length must be numbers, got \[0.4, None\]"),
        ([[0.4], [0.3, 0.3]], r"length must be numbers, got \[\[0.4\], \[0.3, 0.3\]\]"),
        (
            np.array([0.4, 0.3], dtype=object),
            r"length must be numbers, got array\(.*dtype=object\)",
        ),
        ({}, r"length must be numbers, got \{\}"),
    ],
    ids=str,
)
def test_what_is_no_number_is_refused(length, said):
    muscles = Muscles("millard2012", **FLEXORS)
    with pytest.raises(ValueError, match=f"^{said}$"):
        muscles.equilibrium(0.5, length)
    with pytest.raises(ValueError, match=f"^{said.replace('length', 'tendon_slack_length')}$"):
        Muscles("millard2012", **(FLEXORS | {"tendon_slack_length": length}))


def test_tensors_without_values_are_refused():
    torch = pytest.importorskip("torch")
    muscles = Muscles("millard2012", **FLEXORS)
    for tensor in (
        torch.empty(2, device="meta"),
        torch.eye(2).to_sparse(),
        torch.ones(2, dtype=torch.complex64),
    ):
        with pytest.raises(ValueError, match="length must be numbers, got "):
            muscles.equilibrium(0.5, tensor)


@pytest.mark.parametrize("kind", [np.array, device_array])
def test_activation_beyond_its_range_is_refused(kind):
    """Below 0 a law would take its least activation, above 1 it would pull with more than it has."""
    muscles = Muscles("millard2012", **FLEXORS)
    for wrong in (-1.0, 2.0, np.inf):
        with pytest.raises(ValueError, match=rf"^activation must be from 0 to 1, got {wrong:g}$"):
            muscles.equilibrium(kind([0.5, wrong]), kind([0.4, 0.34]))
        with pytest.raises(ValueError, match=rf"^excitation must be from 0 to 1, got {wrong:g}$"):
            muscles.activation_rate(kind([wrong, 0.5]), kind([0.5, 0.5]))
    rounded = muscles.equilibrium(np.array([0.0, 1.0 + 1e-9]), [0.4, 0.34]).tendon_force
    np.testing.assert_allclose(rounded, muscles.equilibrium([0.0, 1.0], [0.4, 0.34]).tendon_force, rtol=1e-6)


def test_the_example_finds_the_flexors():
    """All of six parameters within twice their intervals, most of them within; it starts 15 % off."""
    found, width = runpy.run_path(str(EXAMPLE))["identify"]()
    assert (np.abs(found - 1.0) < 2.0 * width).all()
    assert (np.abs(found - 1.0) < width).sum() >= 4
    assert width.max() < 0.05

"""Hill muscles against OpenSim 4.6 (recorded), against the papers' equations, and against landmarks."""

import numpy as np
import pytest
from opensim_muscles import DATA, load, read_muscles, write_muscles
from reference import hill as reference

from myowarp.osim.body.hill_curves import PASSIVE, SPLINES
from myowarp.osim.body.hill_muscle import HillMuscle, known
from myowarp.osim.document.model import Muscle
from myowarp.osim.document.read.muscle_defaults import DEFAULTS

MODELS = [path.stem.removeprefix("muscles_") for path in sorted(DATA.glob("muscles_*.npz"))]
MODELS.remove("moving")

TOLERANCE = 1e-6
"""Of the maximum isometric force. OpenSim stops at 1e-8, the tables of the reference are good to 1e-8."""

CURVE_TOLERANCE = 1e-10
"""Closed forms and Bezier curves in float64."""

VELOCITY_TOLERANCE = 1e-7
"""OpenSim inverts f_V: Thelen's in closed form, Millard's damped fiber by a search."""

VELOCITY_LIMIT = 0.85
"""Speeds below which OpenSim's f_V of an undamped fiber is the inverse of the curve that it inverts."""

SPLINE_TOLERANCE = 0.02
"""Newton; these classes of OpenSim stop at 0.01 N."""

LANDMARK_TOLERANCE = {
    "Thelen2003Muscle": 1e-12,
    "Millard2012EquilibriumMuscle": 1e-12,
    "DeGrooteFregly2016Muscle": 0.02,  # a fit to three bells, and of f_V to a logarithm
    "Schutte1993Muscle_Deprecated": 0.03,  # splines through points beside 1
    "Delp1990Muscle_Deprecated": 0.03,
    "RigidTendonMuscle": 0.03,
}

SLOPE_TOLERANCE = 1e-5
"""Of the slope, or of 1: truncation of the difference; a corner may be met once or twice in forty."""

COMMON_DEFAULTS = {
    "max_isometric_force": 1000.0,
    "optimal_fiber_length": 0.1,
    "tendon_slack_length": 0.2,
    "pennation_angle_at_optimal": 0.0,
    "max_contraction_velocity": 10.0,
    "ignore_tendon_compliance": 0.0,
    "ignore_activation_dynamics": 0.0,
}


def agree(found, data, muscles):
    """Compare forces [max_isometric_force], shape (poses, activations, muscles), with OpenSim's.

    A slack muscle of De Groote's class has none here, where OpenSim finds no equilibrium or lets it push.
    """
    expected = data["tendon_force"] / [muscle.values["max_isometric_force"] for muscle in muscles]
    slack = data["length"] <= [muscle.values["tendon_slack_length"] for muscle in muscles]
    degroote = np.array([muscle.kind.startswith("DeGroote") for muscle in muscles])
    left_out = degroote & (slack[:, None] | np.isnan(expected))
    assert found[left_out].max(initial=0.0) < TOLERANCE
    assert np.isfinite(expected[~left_out]).all()
    assert expected[~left_out].max() > 0.3
    assert np.abs(found - expected)[~left_out].max() < TOLERANCE


def floor(muscle, activation):
    """Return the activation after OpenSim's limit; De Groote's muscle has none."""
    return np.maximum(activation, muscle.values.get("minimum_activation", 0.0))


@pytest.mark.parametrize("model", MODELS)
def test_tendon_force_is_opensims(model):
    data, muscles = load(model)
    forces = [
        muscle.tendon_force(floor(muscle, data["activation"]), data["length"][:, i, None])
        for i, muscle in enumerate(muscles)
    ]
    agree(np.stack(forces, axis=-1), data, muscles)


@pytest.mark.parametrize("model", MODELS)
def test_the_papers_equations_fed_with_the_table_are_opensims(model, tmp_path):
    data, muscles = load(model)
    write_muscles(tmp_path / "muscles.csv", muscles)
    forces = [
        reference.tendon_force(
            kind, p, *np.meshgrid(floor(muscles[i], data["activation"]), data["length"][:, i])
        )
        for i, (_, kind, p) in enumerate(reference.read(tmp_path / "muscles.csv"))
    ]
    agree(np.stack(forces, axis=-1), data, muscles)


def test_live():
    """The same with OpenSim at hand, at lengths that nobody recorded."""
    opensim = pytest.importorskip("opensim")
    from data import record_opensim_muscles as recorder

    opensim.Logger.setLevelString("Off")
    model = recorder.variant_model()
    state = model.initSystem()
    live = [model.getMuscles().get(i) for i in range(model.getMuscles().getSize())]
    lengths, forces = [], []
    for _ in recorder.poses(model, state, 8, seed=7):
        lengths.append([muscle.getLength(state) for muscle in live])
        forces.append(recorder.static(model, state, live))
    muscles = [HillMuscle(m.getName(), m.getConcreteClassName(), recorder.parameters(m)) for m in live]
    data = {"length": np.array(lengths), "tendon_force": np.array(forces)}
    activation = np.array(recorder.ACTIVATIONS)
    found = [m.tendon_force(floor(m, activation), data["length"][:, i, None]) for i, m in enumerate(muscles)]
    agree(np.stack(found, axis=-1), data, muscles)


def moving():
    """Yield every recorded muscle with (a, L, l, dl/dt, f_L, f_P, f_V, tendon force) of its moving fibers."""
    _, muscles = load("variants")
    with np.load(DATA / "muscles_moving.npz") as file:
        state = file["state"]
    for index in np.unique(state[:, 0]):
        yield muscles[int(index)], state[state[:, 0] == index, 1:].T


def test_curves_are_opensims():
    count = 0
    for muscle, (a, _, fiber, speed, active, passive, factor, _) in moving():
        length = fiber / muscle.values["optimal_fiber_length"]
        velocity = speed / muscle.velocity_scale
        curves = muscle.curves
        assert curves.active_force_length(length)[0] == pytest.approx(active, abs=CURVE_TOLERANCE)
        assert curves.passive_force(length)[0] == pytest.approx(passive, abs=CURVE_TOLERANCE)
        inside = np.abs(velocity) < VELOCITY_LIMIT
        found = curves.force_velocity(velocity, a)[0]
        assert found[inside] == pytest.approx(factor[inside], abs=VELOCITY_TOLERANCE)
        count += inside.sum()
    assert count > 100


def test_a_moving_fiber_pulls_like_opensims():
    for muscle, (a, length, fiber, speed, _, _, _, force) in moving():
        along = np.sqrt(fiber**2 - muscle.fiber_width**2)
        inside = np.abs(speed / muscle.velocity_scale) < VELOCITY_LIMIT
        pull, _ = muscle.fiber_force(along, a, speed * fiber / along)
        expected = force / muscle.values["max_isometric_force"]
        assert np.ptp(expected[inside]) > 0.1
        assert pull[inside] == pytest.approx(expected[inside], abs=VELOCITY_TOLERANCE)
        # OpenSim's tendon has the length that the state leaves it.
        stretched = (length - along) / muscle.values["tendon_slack_length"]
        assert muscle.curves.tendon_force(stretched)[0] == pytest.approx(expected, abs=CURVE_TOLERANCE)


KINDS = {muscle.name: muscle for model in ("variants",) for muscle in load(model)[1]} | {
    kind: HillMuscle(kind, kind, {**COMMON_DEFAULTS, **DEFAULTS[kind]}, SPLINES[kind]) for kind in SPLINES
}


@pytest.mark.parametrize("name", KINDS)
def test_landmarks(name):
    muscle = KINDS[name]
    curves, one = muscle.curves, np.ones(1)
    assert curves.active_force_length(one)[0] == pytest.approx(1.0, abs=LANDMARK_TOLERANCE[muscle.kind])
    assert curves.force_velocity(0.0 * one, one)[0] == pytest.approx(1.0, abs=1e-9)
    assert curves.force_velocity(-one, one)[0] == pytest.approx(0.0, abs=LANDMARK_TOLERANCE[muscle.kind])
    assert curves.force_velocity(one, one)[0] > 1.15
    if not muscle.rigid_tendon:
        assert curves.tendon_force(one)[0] == pytest.approx(0.0, abs=1e-15)
        assert curves.tendon_force(1.1 * one)[0] > 1.0


@pytest.mark.parametrize("name", KINDS)
def test_slopes(name):
    """Against central differences, away from the corners of the curves (splines: their knots)."""
    muscle = KINDS[name]
    h, curves = 1e-6, muscle.curves
    activation = np.full(40, 0.6)
    grids = {
        curves.active_force_length: np.linspace(0.3, 2.1, 40),
        curves.passive_force: np.linspace(0.51, 1.57, 40),
        curves.tendon_force: np.linspace(0.99, 1.07, 40),
        lambda v: curves.force_velocity(v, activation): np.linspace(-1.33, 1.37, 40),
    }
    for curve, x in grids.items():
        difference = (curve(x + h)[0] - curve(x - h)[0]) / (2 * h)
        slope = curve(x)[1]
        rough = SLOPE_TOLERANCE * np.maximum(1.0, np.abs(difference))
        assert (np.abs(slope - difference) < rough).mean() > 0.95


def test_equilibrium_balances_fiber_and_tendon():
    """A steady velocity: more force lengthening, less shortening, by f_V where the tendon is rigid."""
    muscle = KINDS["variant4"]
    assert muscle.rigid_tendon
    v = muscle.values
    width, along = muscle.fiber_width, np.sqrt(v["optimal_fiber_length"] ** 2 - muscle.fiber_width**2)
    cosine = along / v["optimal_fiber_length"]
    speed = np.array([-0.3, 0.0, 0.3])
    found = muscle.tendon_force(1.0, along + v["tendon_slack_length"], speed * muscle.velocity_scale / cosine)
    factor = muscle.curves.force_velocity(speed, np.ones(3))[0]
    assert width > 0.0
    assert found == pytest.approx((factor + v["fiber_damping"] * speed) * cosine, abs=1e-9)

    elastic = KINDS["variant0"]
    found = elastic.tendon_force(1.0, 0.3, np.array([-0.5, 0.0, 0.5]))
    assert found[0] < 0.8 * found[1] < found[1] < 0.9 * found[2]


def test_slope_of_the_fiber_force():
    muscle, h = KINDS["variant0"], 1e-7
    z, activation, velocity = np.linspace(0.06, 0.14, 9), np.full(9, 0.7), np.linspace(-0.5, 0.5, 9)
    ahead, behind = (muscle.fiber_force(z + step, activation, velocity)[0] for step in (h, -h))
    found = muscle.fiber_force(z, activation, velocity)[1]
    assert found == pytest.approx((ahead - behind) / (2 * h), abs=1e-5)
    assert np.ptp(found) > 1.0


def test_bounds():
    """OpenSim's rules: no damping below 0.001, then slanted ends of f_V (half of 0.25 and 0.15)."""
    damped, undamped = KINDS["variant2"], KINDS["variant3"]
    ends = np.array([-1.0, 1.0])
    assert damped.curves.force_velocity(ends, ends)[1] == pytest.approx([0.0, 0.0], abs=1e-12)
    # As files state it; the recorded numbers are those that OpenSim replaced it by.
    stated = {f"ForceVelocityCurve.{side}_slope_at_vmax": 0.0 for side in ("concentric", "eccentric")}
    undamped = HillMuscle("m", undamped.kind, {**undamped.values, **stated})
    assert undamped.curves.force_velocity(ends, ends)[1] == pytest.approx([0.125, 0.075], abs=1e-12)
    little = HillMuscle("m", damped.kind, {**damped.values, "fiber_damping": 5e-4})
    assert little.damping == 0.0
    schutte = KINDS["Schutte1993Muscle_Deprecated"]
    fast = HillMuscle("m", schutte.kind, {**schutte.values, "time_scale": 0.05}, schutte.functions)
    assert fast.velocity_scale == pytest.approx(0.1 / 0.05)
    thelen = KINDS["variant0"]
    rigid = HillMuscle("m", thelen.kind, {**thelen.values, "ignore_tendon_compliance": 1.0})
    slack = thelen.values["tendon_slack_length"]
    assert rigid.tendon_force(1.0, [0.9 * slack, slack + 0.1]) == pytest.approx([0.0, 0.9], abs=0.15)
    assert rigid.tendon_force(1.0, 0.9 * slack) == 0.0


@pytest.mark.parametrize(
    ("kind", "relaxed", "half_active"),
    [
        (
            "Schutte1993Muscle_Deprecated",
            [0.33239661, 17.72915060, 81.40982708, 681.07390063],
            [84.38545193, 508.94567171, 506.32402276, 773.77142404],
        ),
        (
            "Delp1990Muscle_Deprecated",
            [0.0, 0.0, 104.08561287, 769.62818665],
            [84.09521906, 495.65882288, 522.23311920, 863.59482117],
        ),
        (
            "RigidTendonMuscle",
            [0.0, 0.0, 120.0, 1170.0],
            [89.88850892, 499.43459904, 523.95357770, 1266.91050000],
        ),
    ],
)
def test_spline_muscles_are_opensims(kind, relaxed, half_active):
    """Static force [N] of default muscles, 1000 N, at activation 0 and 0.5, as OpenSim 4.6 printed it."""
    length = np.array([0.25, 0.3, 0.32, 0.35])
    assert 1000.0 * KINDS[kind].tendon_force(0.0, length) == pytest.approx(relaxed, abs=SPLINE_TOLERANCE)
    assert 1000.0 * KINDS[kind].tendon_force(0.5, length) == pytest.approx(half_active, abs=SPLINE_TOLERANCE)


def test_table_round_trip(tmp_path):
    muscles = [*load("gait10dof18musc")[1], *KINDS.values()]
    write_muscles(tmp_path / "muscles.csv", muscles)
    assert read_muscles(tmp_path / "muscles.csv") == muscles
    header = (tmp_path / "muscles.csv").read_text().splitlines()[0].split(",")
    assert header[:2] == ["name", "class"]
    assert {"max_isometric_force [N]", "tendon_slack_length [m]", "fiber_damping [1]"} < set(header)


def test_muscles_of_a_file():
    """What the file states, OpenSim's defaults for the rest, in either form of the class."""
    thelen = Muscle(
        name="m",
        type="Schutte1993Muscle_Deprecated",
        path=None,
        max_isometric_force=10.0,
        optimal_fiber_length=0.1,
        tendon_slack_length=0.2,
        pennation_angle_at_optimal=0.0,
        max_contraction_velocity=10.0,
        ignore_tendon_compliance=False,
        ignore_activation_dynamics=True,
        control_range=(0.02, 0.9),
        applies_force=True,
        parameters={"time_scale": 0.1, "damping": 0.1},
        curves={"passive_force_length_curve": PASSIVE},
        given=frozenset(),
    )
    muscle = HillMuscle.of(thelen)
    assert muscle.values["min_control"] == 0.02
    assert muscle.values["max_control"] == 0.9
    assert muscle.values["ignore_activation_dynamics"] == 1.0
    assert muscle.functions == {**SPLINES[thelen.type], "passive_force_length_curve": PASSIVE}
    assert muscle.tendon_force(1.0, 0.31) > 0.5


def test_unknown_class():
    values = {**KINDS["variant0"].values, "KshapeActive": 0.7}
    unknown = HillMuscle("m", "MeyerFregly2016Muscle", values)
    with pytest.raises(
        NotImplementedError, match="muscle 'm' is a MeyerFregly2016Muscle, which has no equations"
    ):
        _ = unknown.curves
    replaced, notes = known(unknown)
    assert replaced.kind == "Thelen2003Muscle"
    assert replaced.curves.active_width == 0.7
    assert "MeyerFregly2016Muscle has no equations" in notes[0].rule
    assert known(KINDS["variant0"]) == (KINDS["variant0"], ())

"""Forward kinematics against OpenSim 4.6: recorded everywhere, live where its wheel is installed."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from myowarp.osim.body.path_solution import locations
from myowarp.osim.document.functions import (
    GCVSpline,
    Multiplier,
    PiecewiseLinear,
    Polynomial,
    SimmSpline,
    Sine,
    Step,
    ToeThenLine,
    affine,
)
from myowarp.osim.document.kinematics import (
    complete,
    forward,
    random_poses,
    station,
)
from myowarp.osim.document.read.model import read_model

DATA = Path(__file__).parents[1] / "data"
MODELS = sorted(path.stem for path in (DATA / "osim").glob("*.osim"))
FOLDER = Path(os.environ.get("MYOWARP_OSIM_DIR", Path(__file__).parents[2] / ".." / "shared" / "osim"))

ROUNDING = 1e-13
"""m and 1: chains of a dozen frames of about 1 m in float64."""
KNOTS_X, KNOTS_Y = (-1.0, -0.3, 0.2, 0.9, 1.4), (0.4, -0.2, 0.1, 0.5, -0.3)
FUNCTIONS = {
    "simm": SimmSpline(KNOTS_X, KNOTS_Y),
    "simm of 3": SimmSpline(KNOTS_X[:3], KNOTS_Y[:3]),
    "gcv": GCVSpline(KNOTS_X, KNOTS_Y),
    "polynomial": Polynomial((0.3, -0.2, 0.5, 0.1)),
    "piecewise": PiecewiseLinear(KNOTS_X, KNOTS_Y),
    "sine": Sine(0.3, 2.0, 0.4, 0.1),
    "step": Step(-0.5, 0.8, 0.2, -0.4),
    "multiplier": Multiplier(SimmSpline(KNOTS_X, KNOTS_Y), 0.7),
    "toe": ToeThenLine(5.0, 0.06),
}


@pytest.mark.parametrize("name", MODELS)
def test_frames_equal_recorded(name):
    model = read_model(DATA / "osim" / f"{name}.osim")
    recorded = np.load(DATA / "opensim" / f"frames_{name}.npz")
    given = dict(zip(recorded["coordinates"], recorded["values"].T, strict=True))
    assert set(given) == set(model.coordinates)
    chosen = {key: given[key] for key in model.independent}
    values = complete(model, chosen, len(recorded["values"]))
    for key, value in values.items():
        np.testing.assert_allclose(value, given[key], atol=ROUNDING, err_msg=key)
    frames = forward(model, values)
    copies = {constraint.name for constraint in model.constraints}  # of bodies in loops
    assert set(recorded["bodies"]) == set(model.bodies) - copies
    for index, body in enumerate(recorded["bodies"]):
        np.testing.assert_allclose(frames[body][1], recorded["origin"][:, index], atol=ROUNDING, err_msg=body)
        np.testing.assert_allclose(
            frames[body][0], recorded["rotation"][:, index], atol=ROUNDING, err_msg=body
        )
    assert set(recorded["markers"]) == set(model.markers)
    for index, key in enumerate(recorded["markers"]):
        place = station(frames, model.markers[key].body, model.markers[key].location)
        np.testing.assert_allclose(place, recorded["marker"][:, index], atol=ROUNDING, err_msg=key)
    for index, key in enumerate(recorded["points"]):
        muscle, number = key.split("/")
        place = locations(model.muscles[muscle].path, frames, values)[:, int(number)]
        np.testing.assert_allclose(place, recorded["point"][:, index], atol=ROUNDING, err_msg=key)


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.osim")), ids=lambda path: path.stem)
def test_frames_equal_live(path, tmp_path):
    """Also for models that are not part of the project."""
    opensim = pytest.importorskip("opensim")
    sys.path.insert(0, str(DATA))
    try:
        import record_opensim
    finally:
        sys.path.remove(str(DATA))
    opensim.Logger.setLevelString("Off")
    record_opensim.record(path, tmp_path)
    recorded = np.load(tmp_path / f"frames_{path.stem}.npz")
    model = read_model(path)
    given = dict(zip(recorded["coordinates"], recorded["values"].T, strict=True))
    frames = forward(model, given)
    for index, body in enumerate(recorded["bodies"]):
        np.testing.assert_allclose(frames[body][1], recorded["origin"][:, index], atol=ROUNDING, err_msg=body)


def test_poses_stay_in_range_and_follow_couplers():
    model = read_model(DATA / "osim" / "joints.osim")
    poses = random_poses(model, 50, 3)
    for name in model.independent:
        low, high = model.coordinates[name].sampling_range
        assert low <= poses[name].min() < poses[name].max() <= high
    np.testing.assert_array_equal(poses["stuck"], 0.4)
    np.testing.assert_allclose(poses["patella_2"], 0.05 * poses["patella"] + 0.01)
    assert model.coordinates["patella"].sampling_range == pytest.approx((0.1 - np.pi / 2, 0.1 + np.pi / 2))
    with pytest.raises(ValueError, match="coordinate 'bent' unknown; available: slide, "):
        complete(model, {"bent": np.zeros(1)}, 1)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_slopes_are_central_differences(name):
    function, step = FUNCTIONS[name], 1e-6
    # Between the knots, and beyond both ends.
    x = np.array([-1.6, -0.71, -0.13, 0.46, 1.03, 1.11, 1.9])
    slope = (function.value(x + step) - function.value(x - step)) / (2 * step)
    np.testing.assert_allclose(function.derivative(x), slope, atol=1e-6 * max(1, np.abs(slope).max()))
    assert function.value(x[:, None]).shape == (len(x), 1)


@pytest.mark.parametrize("name", ["simm", "simm of 3", "gcv", "piecewise"])
def test_splines_pass_their_knots(name):
    function = FUNCTIONS[name]
    np.testing.assert_allclose(function.value(function.x), function.y, atol=1e-12)


def test_splines_keep_polynomials():
    """Four knots of a cubic give the cubic; a quintic natural spline keeps parabolas, outside too."""
    x, probe = np.array([-1.0, 0.1, 0.4, 1.3]), np.linspace(-1, 1.3, 7)[:-1]
    cubic = np.array([0.3, -0.5, 0.2, 0.1])
    spline = SimmSpline(tuple(x), tuple(np.polyval(cubic, x)))
    np.testing.assert_allclose(spline.value(probe), np.polyval(cubic, probe), atol=1e-12)
    # Straight outside, with the slope of the end.
    end = np.polyval(cubic, 1.3) + 0.5 * np.polyval(np.polyder(cubic), 1.3)
    assert spline.value(1.8) == pytest.approx(end)
    parabola = GCVSpline(tuple(x), tuple(np.polyval(cubic[1:], x)))
    np.testing.assert_allclose(
        parabola.value([-2.0, 0.7, 2.0]), np.polyval(cubic[1:], [-2.0, 0.7, 2.0]), atol=1e-10
    )


REPEATED = (-5.0, 0.0, 0.401, 0.602, 1.0, 1.1, 1.15, 1.15, 1.4, 2.0, 2.0)
"""Knots of which two repeat, inside and at the end, as in published muscle curves."""
REPEATED_Y = (0.0, 0.0, 0.1, 0.3, 0.5, 0.2, 0.3, 0.31, 0.6, 0.7, 0.75)
OPENSIM_THERE = [
    (-6.0, -489.1463654475517, 489.1463654475517),
    (-4.615384615384615, 173.51610098167325, 413.1688479404179),
    (-2.3076923076923075, 604.2544121343328, -38.7287334104044),
    (-0.23076923076923084, 106.55278636486784, -439.6213004718994),
    (0.601999999, 0.3000027769561112, -2776.9562072336653),
    (1.1000000010000002, 0.19996423971242883, -35760.28518183046),
    (1.1500001, 0.3200000048764284, 100000.01223611257),
    (1.999999999, 0.69950000013056, 499999.84849990613),
    (3.0, 500000.8985295146, 500000.1485295146),
]
"""x, value and slope of OpenSim 4.6's SimmSpline."""


def test_repeated_knots_are_opensims():
    spline = SimmSpline(REPEATED, REPEATED_Y)
    x, value, slope = np.array(OPENSIM_THERE).T
    np.testing.assert_allclose(spline.value(x), value, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(spline.derivative(x), slope, rtol=1e-5, atol=1e-9)


def test_straight_lines_are_found():
    assert affine(Multiplier(SimmSpline((0.0, 1.0), (1.0, 3.0)), 2.0)) == pytest.approx((4.0, 2.0))
    assert affine(Polynomial((0.0, 2.0, 1.0))) == (2.0, 1.0)
    assert affine(Polynomial((1e-9, 2.0, 1.0))) is None
    assert affine(PiecewiseLinear((0.0, 1.0, 2.0), (0.0, 1.0, 2.1))) is None

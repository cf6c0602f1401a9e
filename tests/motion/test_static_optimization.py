"""The dual solver against SciPy, bounded least squares, and what it must not do."""

import numpy as np
import pytest
from host_least_squares import bounded_least_squares
from scipy import optimize

from myowarp.motion import static_optimization
from myowarp.motion.dual_newton import TOLERANCE
from myowarp.motion.static_optimization import optimal_activations
from myowarp.osim.body.skeleton import Bones

FRAMES, MUSCLES, ROWS = 33, 9, 3
LANES = 1e-7
"""Between two Newton methods, each of which ends with 1e-9 of a row."""


def problem(seed=0, reserve=2.0):
    """Return entries, matrix and moments that random activations give; the last unknowns are reserves."""
    random = np.random.default_rng(seed)
    rows = [[k % ROWS, (k + 1) % ROWS] for k in range(MUSCLES)] + [[r, -1] for r in range(ROWS)]
    effects = np.zeros((FRAMES, MUSCLES + ROWS, 2))
    effects[:, :MUSCLES] = random.normal(size=(FRAMES, MUSCLES, 2)) * 30
    effects[:, MUSCLES:, 0] = reserve
    matrix = np.zeros((FRAMES, ROWS, MUSCLES + ROWS))
    for number, pair in enumerate(rows):
        for slot, row in enumerate(pair):
            if row >= 0:
                matrix[:, row, number] += effects[:, number, slot]
    wanted = np.einsum("nij,nj->ni", matrix[:, :, :MUSCLES], random.uniform(size=(FRAMES, MUSCLES)))
    lower = np.array([0.0] * MUSCLES + [-np.inf] * ROWS)
    upper = np.array([1.0] * MUSCLES + [np.inf] * ROWS)
    return rows, effects, matrix, wanted, lower, upper


@pytest.mark.parametrize("exponent", [2.0, 3.0, 1.5])
def test_the_least_cost(exponent):
    """SciPy's SLSQP finds nothing cheaper; and every equation is met."""
    rows, effects, matrix, wanted, lower, upper = problem()
    found = optimal_activations(rows, effects, wanted, lower, upper, exponent)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", matrix, found.activation), wanted, atol=1e-5)
    np.testing.assert_allclose(found.missing, 0.0, atol=1e-5)
    assert ((found.activation >= lower) & (found.activation <= upper)).all()
    assert (found.activation[:, :MUSCLES] == 0).any()
    for frame in range(0, FRAMES, 8):
        best = optimize.minimize(
            lambda a: (np.abs(a) ** exponent).sum(),
            np.full(MUSCLES + ROWS, 0.3),
            method="SLSQP",
            bounds=list(zip(lower, upper, strict=True)),
            constraints={"type": "eq", "fun": lambda a, frame=frame: matrix[frame] @ a - wanted[frame]},
            options={"maxiter": 500, "ftol": 1e-12},
        )
        cost = (np.abs(found.activation[frame]) ** exponent).sum()
        assert cost <= best.fun + 1e-6 * (1 + best.fun)
        np.testing.assert_allclose(found.activation[frame], best.x, atol=2e-3)


def test_a_linear_cost_uses_as_few_muscles_as_it_can():
    rows, effects, _, wanted, lower, upper = problem()
    linear = optimal_activations(rows, effects, wanted, lower, upper, 1.0)
    square = optimal_activations(rows, effects, wanted, lower, upper, 2.0)
    assert np.abs(linear.activation).sum() < np.abs(square.activation).sum()
    assert (np.abs(linear.activation) > 1e-6).sum() < (np.abs(square.activation) > 1e-6).sum()
    np.testing.assert_allclose(linear.missing, 0.0, atol=1e-4)


def test_squares_are_bounded_least_squares():
    """The house's kernel with a small ridge solves the same problem."""
    rows, effects, matrix, wanted, lower, upper = problem(3)
    found = optimal_activations(rows, effects, wanted, lower, upper).activation
    bounds = np.maximum(lower, -100.0), np.minimum(upper, 100.0)
    x, _ = bounded_least_squares(matrix, wanted, *bounds, 1e-5, rounds=1000)
    np.testing.assert_allclose(found, x, atol=0.01)
    assert ((found**2).sum(axis=1) <= (x**2).sum(axis=1) + 1e-6).all(), (
        "the stiff problem ends beside its optimum"
    )


def test_what_muscles_cannot_hold_is_missing():
    """Without reserves, ten times too much: bounds hold, and the rest is said."""
    rows, effects, matrix, wanted, lower, upper = problem()
    cut = slice(None, MUSCLES)
    found = optimal_activations(rows[cut], effects[:, cut], 10 * wanted, lower[cut], upper[cut])
    assert ((found.activation >= 0) & (found.activation <= 1)).all()
    np.testing.assert_allclose(
        found.missing, 10 * wanted - np.einsum("nij,nj->ni", matrix[:, :, cut], found.activation), atol=1e-9
    )
    assert (np.abs(found.missing).max(axis=1) > 1.0).all()


@pytest.mark.parametrize("much", [1.0, 10.0])
def test_lanes_give_what_the_kernel_gives(monkeypatch, much):
    """Where muscles hold a frame and where not; with a scale, bounds of each frame, and two recordings."""
    rows, effects, _, wanted, lower, upper = problem(5)
    random = np.random.default_rng(6)
    scale = random.uniform(0.5, 1.5, size=(FRAMES, MUSCLES + ROWS))
    lower = lower + 0.1 * random.uniform(size=scale.shape)
    cut = slice(None, MUSCLES if much > 1.0 else None)
    given = rows[cut], effects[:, cut], much * wanted, lower[:, cut], upper[cut]
    options = {"sequence": 20, "scale": scale[:, cut]}
    found = optimal_activations(*given, **options)
    monkeypatch.setattr(static_optimization, "in_lanes", lambda exponent: False)
    kernel = optimal_activations(*given, **options)
    np.testing.assert_allclose(found.activation, kernel.activation, atol=LANES)
    np.testing.assert_allclose(found.missing, kernel.missing, atol=100 * LANES)
    assert (found.residual < TOLERANCE).all() or much > 1.0
    same = optimal_activations(rows[cut], effects[:, cut] * scale[:, cut, None], *given[2:], sequence=20)
    np.testing.assert_allclose(found.activation, same.activation, atol=LANES)


def test_a_frame_that_is_no_number_leaves_the_others_alone():
    rows, effects, _, wanted, lower, upper = problem()
    good = optimal_activations(rows, effects, wanted, lower, upper).activation
    lower = np.where(np.isfinite(lower), lower, -1e6)
    wanted = wanted.copy()
    wanted[4, 1] = np.nan
    found = optimal_activations(rows, effects, wanted, lower, upper)
    assert np.isinf(found.residual[4])
    assert np.isfinite(found.activation).all()
    others = np.arange(FRAMES) != 4
    np.testing.assert_allclose(found.activation[others], good[others], atol=1e-12)


def test_bad_options():
    rows, effects, _, wanted, lower, upper = problem()
    with pytest.raises(ValueError, match=r"must be at least 1 and finite, got 0\.5"):
        optimal_activations(rows, effects, wanted, lower, upper, 0.5)
    with pytest.raises(ValueError, match="must be at most the upper ones"):
        optimal_activations(rows, effects, wanted, upper, lower)


def test_another_device_is_refused():
    """Before anything is built: neither the arrays of the problem nor those of a model."""
    rows, effects, _, wanted, lower, upper = problem()
    sentence = "run on the CPU, got device 'cuda:0'; leave device out$"
    with pytest.raises(ValueError, match=f"^optimal activations {sentence}"):
        optimal_activations(rows, effects, wanted, lower, upper, device="cuda:0")
    with pytest.raises(ValueError, match=f"^recorded motions {sentence}"):
        Bones(None, "cuda:0")

"""Metabolic rates beside OpenSim 4.6's probes, and beside Umberger's figure of 2003."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp

from myowarp.kernels.metabolics import bhargava2004, muscle_mass, umberger2010

RECORD = Path(__file__).parents[1] / "data/opensim/metabolics.npz"
STATES = (
    *("excitation", "activation", "norm_fiber_length", "active_force_length_multiplier", "fiber_velocity"),
    *("active_fiber_force", "fiber_force"),
)
FIGURE = 1.0  # W/kg, how well the printed curves can be read; tolerance of OpenSim's own test
CURVES = {  # OpenSim/Simulation/Test/testMuscleMetabolicsProbes.cpp: fits of Umberger 2003, fig. 1
    "soleus": (
        (-54693.72433, -73876.93352, -41460.1508, -13203.6807, -2682.925993, 51.39363659),
        (-187.6077328, -553.9650747, -194.9721769, 332.9105995),
    ),
    "rectus femoris": (
        (-10181.27442, -13652.40864, -8368.687834, -2747.369194, 109.028979),
        (-404.1161485, -1267.967225, -744.3435788, 362.7505521),
    ),
}
MUSCLES = {  # peak force [N], optimal fiber length [m], Hill's A and B, slow share, mass [kg]
    "soleus": (3127.0, 0.055, 0.18, 2.16, 0.8, 0.805),
    "rectus femoris": (1118.0, 0.084, 0.36, 4.32, 0.35, 0.4275),
}


@wp.kernel(enable_backward=False)
def rates(
    mass: Any,
    ratio: Any,
    optimum: Any,
    fastest: Any,
    aerobic: Any,
    u: wp.array[Any],
    a: wp.array[Any],
    n: wp.array[Any],
    curve: wp.array[Any],
    v: wp.array[Any],
    active: wp.array[Any],
    force: wp.array[Any],
    out: wp.array3d[Any],
):
    i = wp.tid()
    heat, work = bhargava2004(mass, ratio, u[i], n[i], v[i], active[i], force[i])
    out[i, 0, 0] = heat
    out[i, 0, 1] = work
    power = -active[i] * v[i]
    heat, work = umberger2010(
        mass, ratio, u[i], a[i], n[i], curve[i], v[i] / optimum, fastest, power, aerobic
    )
    out[i, 1, 0] = heat
    out[i, 1, 1] = work


def rates_of(kind, mass, ratio, optimum, fastest, aerobic, states):
    """Return heat and work by both laws, shape (states, 2, 2)."""
    own = [wp.array(states[name], dtype=kind, device="cpu") for name in STATES]
    out = wp.full((len(own[0]), 2, 2), np.nan, dtype=kind, device="cpu")
    numbers = [kind(value) for value in (mass, ratio, optimum, fastest, aerobic)]
    wp.launch(rates, dim=len(own[0]), inputs=[*numbers, *own], outputs=[out], device="cpu")
    return out.numpy()


@pytest.mark.parametrize(("kind", "least"), [(wp.float64, 1e-12), (wp.float32, 1e-5)])
def test_rates_are_those_of_opensims_probes(kind, least):
    """Of a Millard muscle in 400 random states, lengthening ones among them."""
    record = dict(np.load(RECORD))
    mass = muscle_mass(record["max_isometric_force"], record["optimal_fiber_length"])
    assert mass == pytest.approx(record["muscle_mass"], rel=1e-12)
    found = rates_of(
        kind,
        mass,
        record["slow_twitch_ratio"],
        record["optimal_fiber_length"],
        record["max_contraction_velocity"],
        1.5,
        record,
    )
    for i, law in enumerate(("bhargava2004", "umberger2010")):
        assert record[law].max() > 200.0
        assert (np.abs(record[law]) < 1e-9).sum() > 20  # where work is taken up, no rate is negative
        np.testing.assert_allclose(found[:, i].sum(axis=1), record[law], atol=least * record[law].max())
    np.testing.assert_allclose(
        found[:, 0, 1], -record["active_fiber_force"] * record["fiber_velocity"], rtol=1e-5
    )


@pytest.mark.parametrize("name", MUSCLES)
def test_rates_of_full_activation_are_those_of_umbergers_figure(name):
    force, optimum, hill_a, hill_b, ratio, mass = MUSCLES[name]
    speed = -np.linspace(0.0, 1.0, 21)  # of the greatest one
    tension = force * hill_a * (1.0 + speed) / (hill_a - speed)
    fastest = hill_b / hill_a
    full = np.ones(21)
    states = dict.fromkeys(STATES, full) | {
        "fiber_velocity": speed * fastest * optimum,
        "active_fiber_force": tension,
        "fiber_force": tension,
    }
    found = rates_of(wp.float64, mass, ratio, optimum, fastest, 1.0, states)[:, 1].sum(axis=1) / mass
    slow, fast = CURVES[name]
    printed = np.where(speed >= -0.4, np.polyval(slow, speed), np.polyval(fast, speed))
    assert np.ptp(printed) > 100.0 * FIGURE
    np.testing.assert_allclose(found, printed, atol=FIGURE)

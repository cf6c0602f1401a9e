"""Metabolic rates beside OpenSim 4.6's probes, Umberger's figure of 2003, and in running worlds."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp
from reference import mujoco_muscle as reference
from reference.bhargava import bhargava

import myowarp
from myowarp.definitions.muscle import FiberStates, new_fiber_states
from myowarp.definitions.setup import Setup
from myowarp.laws.metabolics import bhargava2004, muscle_mass, umberger2010
from myowarp.sim.metabolics import LAWS
from myowarp.sim.simulation import Simulation

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


ELBOW = "myoElbowPose1D6MRandom-v0"


def worlds(muscle, task=ELBOW, number=5, **fields):
    """Return worlds after some random steps, and their signals."""
    setup = Setup.of(task, muscle=muscle, device="cpu", seed=0, physics="parity", **fields)
    sim = Simulation(setup, number, autoreset="same_step", progress=False)
    signals = myowarp.Signals(sim)
    sim.reset(seeds=np.arange(number))
    for step in range(8):
        draws = np.random.default_rng(step).uniform(-1.0, 1.0, sim.action.shape)
        sim.action.assign(draws.astype(np.float32))
        sim.step()
    return sim, signals


def test_rates_of_mujocos_muscle_follow_from_the_path():
    """Its fibers are in line with a rigid tendon."""
    sim, signals = worlds("mujoco")
    model, ids, seen = sim.scene.oracle, sim.scene.muscles.actuator_id, signals.muscles
    gain = model.actuator_gainprm[ids]
    ranges, peak = model.actuator_lengthrange[ids], reference.peak_force(model.actuator_acc0[ids], gain)
    optimal = (ranges[:, 1] - ranges[:, 0]) / (gain[:, 1] - gain[:, 0])
    n = gain[:, 0] + (seen.length.numpy() - ranges[:, 0]) / optimal
    assert ((n > 0.5) & (n < 1.5)).mean() > 0.5
    u, v, force = seen.excitation.numpy(), seen.velocity.numpy(), seen.force.numpy()
    prm = [(r, acc, g[:9]) for r, acc, g in zip(ranges, model.actuator_acc0[ids], gain, strict=True)]
    active = [
        [-a * reference.gain(x, w, *p) for a, x, w, p in zip(*row, prm, strict=True)]
        for row in zip(seen.activation.numpy(), seen.length.numpy(), v, strict=True)
    ]
    own = bhargava(muscle_mass(peak, optimal), u, n, v, np.array(active), force)
    np.testing.assert_allclose(seen.bhargava2004.numpy(), own, rtol=1e-3, atol=1e-3)
    assert own.max() > 5.0
    total = seen.bhargava2004.numpy().sum(axis=1) + 1.2 * signals.body_mass
    np.testing.assert_allclose(signals.whole_body["bhargava2004"].numpy(), total, rtol=1e-5)
    per_kg = signals.whole_body["bhargava2004_per_kg"].numpy()
    np.testing.assert_allclose(per_kg, total / signals.body_mass, rtol=1e-5)


@pytest.mark.parametrize("muscle", [m for m in myowarp.MUSCLES if not m.startswith("mujoco")])
def test_rates_are_those_of_the_fibers(muscle):
    """Work of the fibers is what reaches path and tendon; heat is the law's of these fibers."""
    sim, signals = worlds(muscle)
    muscles, seen, states = sim.scene.muscles, signals.muscles, new_fiber_states(sim.scene.muscles.activation)
    muscles.length.assign(seen.length)
    muscles.velocity.assign(seen.velocity)
    muscles.read_fibers(states)
    found = {name: getattr(states, name).numpy().astype(float) for name in FiberStates.vars}
    rows, force = muscles.parameters.numpy(), found["active_force"] + found["passive_force"]
    fiber = found["norm_length"] * rows["optimal_fiber_length"]
    cosine = np.sqrt(1.0 - (rows["fiber_width"] / fiber) ** 2)
    taut = seen.force.numpy() > 1e-3 * rows["max_isometric_force"]
    balance = np.abs(force * cosine - seen.force.numpy()) / rows["max_isometric_force"]
    assert balance[taut].max() < 1e-3
    assert taut.mean() > 0.5
    mass = muscle_mass(rows["max_isometric_force"], rows["optimal_fiber_length"])
    own = bhargava(
        mass, seen.excitation.numpy(), found["norm_length"], found["velocity"], found["active_force"], force
    )
    np.testing.assert_allclose(seen.bhargava2004.numpy(), own, rtol=1e-3, atol=1e-3)
    assert np.abs(found["velocity"]).max() > 0.01
    assert own.max() > 5.0


@pytest.mark.parametrize("muscle", ["mujoco", "millard2012"])
def test_rates_can_be_rewarded_and_observed(muscle):
    terms = {name: (0.01, getattr(myowarp, f"minus_{name}"), "W") for name in LAWS}
    spec = myowarp.extend(
        ELBOW, "myElbowThriftyRandom-v9", rewards=terms, observations={"rate": "umberger2010"}, replace=True
    )
    sim, signals = worlds(muscle, spec)
    names = [term.name for term in sim.terms]
    for name in LAWS:
        own = getattr(signals.muscles, name).numpy()
        scored = sim.transition.terms.numpy()[:, names.index(name)]
        np.testing.assert_allclose(scored, -own.sum(axis=1), rtol=1e-5)
    seen = signals.muscles.umberger2010.numpy()
    np.testing.assert_allclose(sim.transition.obs.numpy()[:, -seen.shape[1] :], seen, rtol=1e-5)


class Untold(myowarp.MujocoMuscle):
    """A muscle with more state than the package knows of."""

    STATE = (*myowarp.MujocoMuscle.STATE, "more")

    def __init__(self, *args):
        super().__init__(*args)
        self.more = wp.zeros_like(self.activation)


@pytest.mark.usefixtures("registered")
def test_a_muscle_that_tells_nothing_of_its_fibers_has_no_rate():
    myowarp.MUSCLES.add("untold", Untold)
    _, signals = worlds("untold", number=1)
    assert np.isnan(signals.muscles.bhargava2004.numpy()).all()
    assert np.isnan(signals.whole_body["umberger2010_per_kg"].numpy()).all()
    spec = myowarp.extend(
        ELBOW, "myElbowThriftyRandom-v9", rewards={"rate": (1.0, myowarp.minus_bhargava2004)}, replace=True
    )
    with pytest.raises(ValueError, match=r"^bhargava2004 needs a muscle model that tells .*, got Untold$"):
        worlds("untold", spec, number=1)

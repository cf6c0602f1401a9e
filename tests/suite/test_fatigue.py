"""Both models of fatigue: float64 references, closed forms, starts and resets."""

import numpy as np
import pytest
import warp as wp
from reference import fatigue_3ccr, fatigue_ma2009
from structs import fields

import myowarp.tasks  # noqa: F401
from myowarp.definitions.parameter import Ramp, Uniform
from myowarp.definitions.task import TASKS
from myowarp.models.conditions.fatigue_3ccr import Fatigue3CCR, rates_of
from myowarp.models.conditions.fatigue_ma2009 import FatigueMa2009
from myowarp.models.conditions.sarcopenia import Sarcopenia
from myowarp.sim.simulation import Simulation

ELBOW = "myoElbowPose1D6MRandom-v0"
MODELS = (Fatigue3CCR, FatigueMa2009)

STEP = 1e-6  # fractions of order one, one step or one episode in float32
LONG = 1e-6  # M_F against float64 after 1e5 steps
RATIO = 1e-6  # of forces, float32
EFFECT = 10.0
DT = 0.02  # s, control step of all tasks here


def simulation(key, num_worlds, conditions, **options):
    settings = {"device": "cpu", "graph": False, "progress": False, "horizon": 10_000} | options
    sim = Simulation(TASKS[key], num_worlds, conditions=conditions, **settings)
    sim.reset(seeds=np.arange(num_worlds))
    return sim


def fatigue_of(sim):
    """Return the fatigue that the environment shows, shape (num_worlds, num_muscles)."""
    return sim.shards[0].effects[0].info["fatigue"].numpy().copy()


def advance(sim, steps, seed=0):
    """Take random steps, the same in every simulation."""
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        sim.action.assign(rng.uniform(-1, 1, sim.action.shape).astype(np.float32))
        sim.step()


def stepped(sim, steps, seed=0):
    """Return the fatigue after random steps."""
    advance(sim, steps, seed)
    return fatigue_of(sim)


def compartments(effect):
    state = effect.state
    return [a.numpy() for a in (state.active_fraction, state.resting_fraction, state.fatigued_fraction)]


class TestMotorUnits:
    """3CC-r: one step anywhere, many steps, the table."""

    N = 37  # worlds, no multiple of 32

    def test_one_step_is_the_reference(self):
        """Over states, loads and rates; every branch and every bound of the flow is met."""
        rng = np.random.default_rng(0)
        shape = (self.N, 6)
        # The last worlds are off the simplex, where alone the guards of legal states act.
        parts = rng.dirichlet((0.6, 0.6, 0.6), shape)
        parts[-12:, :, :2] += rng.uniform(-0.4, 0.4, (12, 6, 2))
        active, fatigued = np.float32(parts[..., 0]), np.float32(parts[..., 1])
        active[:3, 0], fatigued[:3, 0] = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
        load = rng.choice(np.float32([-0.5, 0.0, 0.005, 0.01, 0.0101, 0.3, 0.9, 1.2]), shape)
        # Physiological rates never meet the bounds: some worlds tire and recover within a few steps.
        rates = [np.geomspace(*span, self.N) for span in ((0.005, 45.0), (40.0, 0.001), (1.0, 30.0))]
        rates[2] = np.minimum(rates[2], 1.0 / (DT * rates[1]))
        names = ("fatigue_rate", "recovery_rate", "rest_recovery_factor")
        sim = simulation(ELBOW, self.N, Fatigue3CCR(**dict(zip(names, rates, strict=True))))
        effect = sim.shards[0].effects[0]
        effect.state.active_fraction.assign(active)
        effect.state.fatigued_fraction.assign(fatigued)
        effect.state.resting_fraction.fill_(np.nan)
        sim.scene.data.ctrl.assign(load)
        sim.shards[0].launch_conditions()

        state = [x.astype(np.float64) for x in (active, 1.0 - active.astype(np.float64) - fatigued, fatigued)]
        load, columns = (
            load.astype(np.float64),
            [np.float32(rate)[:, None].astype(np.float64) for rate in rates],
        )
        expected = fatigue_3ccr.step(state, load, columns, (0.01, 0.04), DT)
        for got, want, before in zip(compartments(effect), expected, state, strict=True):
            np.testing.assert_allclose(got, want, atol=STEP)
            assert np.abs(want - before).max() > EFFECT * STEP
        np.testing.assert_allclose(sim.scene.data.ctrl.numpy(), expected[0], atol=STEP)

        free = fatigue_3ccr.flow(state[0], state[1], load, 0.01, 0.04, DT)
        recovery = columns[1] * np.where(load <= fatigue_3ccr.REST_LOAD, columns[2], 1.0)
        low, high = fatigue_3ccr.flow_bounds(*state, columns[0], recovery, DT)
        assert np.count_nonzero(free < low) >= 3
        assert np.count_nonzero(free > high) >= 3
        assert np.count_nonzero((free > low) & (free < high)) > 100
        assert np.count_nonzero((load > state[0]) & (state[1] <= load - state[0])) > 3

    @pytest.mark.parametrize("repeats", [100, pytest.param(1000, marks=pytest.mark.slow)])
    def test_many_steps(self, repeats):
        """1e4 or 1e5 steps, 33 minutes: the slow compartment does not stall, and the three still sum to 1."""
        loads = np.array([[1.0, 0.9, 0.5, 0.2, 0.05, 0.012], [0.8, 0.4, 0.3, 0.1, 0.02, 0.6]])
        period = 100
        sim = simulation(ELBOW, 2, "fatigue_3ccr")
        effect, data = sim.shards[0].effects[0], sim.scene.data
        works, rests = (wp.array(x, dtype=float) for x in (loads, loads * [[1.0], [0.0]]))
        # World 0 works throughout, world 1 rests in every second half of 2 s.
        with wp.ScopedCapture(device="cpu", force_module_load=False) as capture:
            for step in range(period):
                wp.copy(data.ctrl, works if step < period // 2 else rests)
                effect.act()
        rates = list(rates_of("elbow", sim.scene.muscles.names).values())
        rates = [np.array([getattr(r, n) for r in rates]) for n in vars(rates[0])]
        state = (np.zeros((2, 6)), np.ones((2, 6)), np.zeros((2, 6)))
        halves = [array.numpy().astype(np.float64) for array in (works, rests)]
        for repeat in range(repeats):
            wp.capture_launch(capture.graph)
            for step in range(period):
                state = fatigue_3ccr.step(state, halves[step >= period // 2], rates, (0.01, 0.04), DT)
            if repeat in (9, 99, 999):
                got = [x.astype(np.float64) for x in compartments(effect)]
                assert np.abs(sum(got) - 1.0).max() < STEP
                for values, expected in zip(got, state, strict=True):
                    np.testing.assert_allclose(values, expected, atol=LONG)
        assert state[2].min() > 1e4 * LONG

    def test_names(self):
        """Suffix or not; muscles outside the table."""
        rates = rates_of("hand", ("FPL", "FPL_r", "soleus_r"))
        assert [own.fatigue_rate for own in rates.values()] == [0.01235, 0.01235, 0.0097]

    def test_rates_can_be_set(self):
        """For all, by name with the table for the others, and over time."""

        def curve(value):
            return (
                simulation(ELBOW, 2, Fatigue3CCR(fatigue_rate=value)).shards[0].effects[0].params.fatigue_rate
            )

        table = np.float32([0.01559] * 3 + [0.01703] * 3)
        np.testing.assert_array_equal(curve([0.1, 0.2]).start.numpy(), np.float32([[0.1], [0.2]]))
        np.testing.assert_array_equal(curve({"BRA": 0.5}).start.numpy()[0], [*table[:5], 0.5])
        ramp = curve(Ramp({"BRA": 0.5}, 1.0))
        np.testing.assert_array_equal(ramp.start.numpy()[0], [*table[:5], 0.5])
        assert (ramp.end.numpy() == 1.0).all()

    def test_no_more_recovers_than_is_tired(self):
        """R and r are limited on their own; their product may ask for more than all in a step."""
        sim = simulation(ELBOW, 1, Fatigue3CCR(recovery_rate=30.0, rest_recovery_factor=10.0, initial=0.8))
        sim.scene.data.ctrl.zero_()
        sim.shards[0].launch_conditions()
        np.testing.assert_allclose(fatigue_of(sim), 0.0, atol=STEP)

    def test_affected_worlds_only(self):
        """0 leaves a world alone bit for bit, 1 hands over M_A, between them both count by their share."""
        sims = [simulation(ELBOW, 3, c) for c in (Fatigue3CCR(affected=[1.0, 0.0, 0.25]), "fatigue_3ccr", ())]
        for sim in sims:
            advance(sim, 4)
        mixed, tired, healthy = (sim.scene.data.ctrl.numpy() for sim in sims)
        np.testing.assert_array_equal(mixed[0], tired[0])
        np.testing.assert_array_equal(mixed[1], healthy[1])
        np.testing.assert_allclose(mixed[2], 0.75 * healthy[2] + 0.25 * tired[2], atol=STEP)
        assert np.abs(tired - healthy).min(axis=1).max() > EFFECT * STEP
        observed = [sim.transition.obs.numpy()[1] for sim in (sims[0], sims[2])]
        np.testing.assert_array_equal(*observed)
        assert not fatigue_of(sims[0])[1].any()

    def test_random_start(self):
        """M_A = n p, M_R = n (1 - p), M_F = 1 - n; another one in every episode, the same for a seed."""
        sim = simulation(ELBOW, 2000, Fatigue3CCR(initial_random=True))
        active, resting, fatigued = (x.astype(np.float64) for x in compartments(sim.shards[0].effects[0]))
        np.testing.assert_allclose(active + resting + fatigued, 1.0, atol=STEP)
        share = active / (active + resting)
        for uniform in (fatigued, share):
            assert 0.0 <= uniform.min() < 0.01
            assert 0.99 < uniform.max() <= 1.0
            np.testing.assert_allclose(uniform.mean(axis=0), 0.5, atol=5 / np.sqrt(12 * 2000))
        both = np.corrcoef(np.concatenate([fatigued, share], axis=1).T)
        assert np.abs(both - np.eye(12)).max() < 5 / np.sqrt(2000)
        sim.reset()
        assert not np.array_equal(fatigue_of(sim), fatigued)
        few = simulation(ELBOW, 5, Fatigue3CCR(initial_random=True))
        np.testing.assert_array_equal(fatigue_of(few), fatigued[:5])


class TestPeakForce:
    """Ma et al.: closed form, from the kernel to the force of a muscle."""

    def test_constant_work(self):
        """60 s of constant a f_L f_V: F_max / (1 / (1 - f0) + k c t), per world and muscle."""
        rate, initial = np.array([1.0, 0.0, 5.0]), np.array([[0.0], [0.3], [0.6]])
        force = np.array([1.0, 0.3, 0.1, 0.01, 0.7, 1.3])
        sim = simulation(ELBOW, 3, FatigueMa2009(rate=rate, initial=initial[:, 0]))
        muscles, steps = sim.scene.muscles, 3000
        np.testing.assert_allclose(fatigue_of(sim), np.repeat(initial, 6, axis=1), atol=STEP)
        work = wp.array(np.tile(force * DT, (3, 1)), dtype=float)
        for _ in range(steps):
            wp.copy(muscles.workload, work)
            sim.shards[0].launch_conditions()
        assert not muscles.workload.numpy().any()
        left = fatigue_ma2009.closed_form(force, rate[:, None] / 60.0, steps * DT, initial)
        np.testing.assert_allclose(muscles.anatomy.strength.numpy(), left, atol=STEP)
        np.testing.assert_allclose(fatigue_of(sim), 1.0 - left, atol=STEP)
        np.testing.assert_allclose(left[0, 0], 0.5, atol=1e-12)  # k = 1/min, a minute of full activity
        np.testing.assert_array_equal(muscles.anatomy.strength.numpy()[1], np.float32(left[1]))

    def test_varying_work_is_the_differential_equation(self):
        """The closed form in the integral against ds/dt = k F_act / F_max, integrated as it stands."""
        rate = np.array([[2.0], [20.0]])
        rng = np.random.default_rng(1)
        force = rng.uniform(0.0, 1.4, (50, 2, 6))
        sim = simulation(ELBOW, 2, FatigueMa2009(rate=rate[:, 0]))
        left = fatigue_ma2009.peak_force_left(force, rate / 60.0, DT)
        for c, expected in zip(force, left, strict=True):
            sim.scene.muscles.workload.assign(c * DT)
            sim.shards[0].launch_conditions()
            np.testing.assert_allclose(sim.scene.muscles.anatomy.strength.numpy(), expected, atol=STEP)
        assert np.ptp(left) > EFFECT * STEP

    def test_isometric_elbow(self):
        """A locked joint under constant activation: active force by the closed form, passive force stays."""
        rate, steps = 60.0, 25
        conditions = (FatigueMa2009(rate=rate), (), Sarcopenia(0.0))
        sims = [simulation(ELBOW, 1, c) for c in conditions]
        action = np.linspace(-0.2, 1.0, 6, dtype=np.float32)[None]
        forces = []
        for sim in sims:
            sim.scene.model.dof_armature.fill_(1e12)
            sim.scene.data.qpos.fill_(1.4)
            sim.action.assign(action)
            sim.shards[0].launch_action()
            sim.scene.muscles.activation.assign(sim.scene.data.ctrl)
            rows = []
            for _ in range(steps):
                sim.step()
                rows.append(-sim.scene.data.actuator_force.numpy()[0].astype(np.float64))
            forces.append(np.array(rows))
        tired, healthy, passive = forces
        active = healthy[0] - passive[0]
        norm_force = active / sims[0].scene.oracle.actuator_gainprm[:, 2]
        time = DT * np.arange(steps)[:, None]
        left = fatigue_ma2009.closed_form(norm_force, rate / 60.0, time)
        error = np.abs(tired - (left * active + passive)) / healthy
        assert error.max() < RATIO
        assert left[-1].min() < 0.9
        assert passive.max() > EFFECT * RATIO * healthy.max()

    def test_sarcopenia_multiplies(self):
        """Half of what fatigue leaves, and fatigue that goes by the muscle's own peak."""
        sim = simulation(ELBOW, 2, ("sarcopenia", FatigueMa2009(rate=60.0)))
        alone = simulation(ELBOW, 2, FatigueMa2009(rate=60.0))
        for either in (sim, alone):
            either.scene.muscles.workload.fill_(0.25)
            either.shards[0].launch_conditions()
        both, tired = (either.scene.muscles.anatomy.strength.numpy().copy() for either in (sim, alone))
        np.testing.assert_array_equal(both, 0.5 * tired)
        np.testing.assert_allclose(tired, 0.8, atol=STEP)
        alone.scene.muscles.anatomy.strength.fill_(0.25)
        alone.shards[0].effects[0].act()
        np.testing.assert_array_equal(alone.scene.muscles.anatomy.strength.numpy(), 0.25 * tired)


@pytest.mark.parametrize("model", MODELS)
class TestResets:
    """What begins afresh, what goes on, what comes back."""

    @pytest.mark.parametrize("autoreset", ["same_step", "next_step"])
    @pytest.mark.parametrize("carry_over", [True, False])
    def test_autoreset(self, model, carry_over, autoreset):
        """At the end of an episode fatigue starts afresh, or goes on exactly where it was."""
        sim = simulation(ELBOW, 3, model(carry_over=carry_over), horizon=4, autoreset=autoreset)
        before = stepped(sim, 3)
        assert before.min() > 0
        after = stepped(sim, 1 if autoreset == "same_step" else 2)
        assert (sim.episode.step_count.numpy() == 0).all()
        if carry_over:
            assert (after > before).all()
            assert (stepped(sim, 3) > after).all()
        else:
            assert not after.any()

    def test_states_that_carry_over_keep_it(self, model):
        """With `reset="none"` an episode's end leaves fatigue alone, bit for bit."""
        sims = [
            simulation(ELBOW, 3, model(), reset="none", autoreset="same_step", horizon=h) for h in (3, 99)
        ]
        short, whole = (stepped(sim, 8) for sim in sims)
        np.testing.assert_array_equal(short, whole)

    def test_asked_resets(self, model):
        """Carried over through a reset without a seed; a seed starts afresh, and only its worlds."""
        sim = simulation(ELBOW, 3, model(carry_over=True, initial=[0.0, 0.2, 0.4]))
        before = stepped(sim, 5)
        sim.reset()
        np.testing.assert_array_equal(fatigue_of(sim), before)
        mask = np.array([False, True, False])
        sim.reset(mask, seeds=np.arange(3))
        after = fatigue_of(sim)
        np.testing.assert_allclose(after[1], 0.2, atol=STEP)
        np.testing.assert_array_equal(after[~mask], before[~mask])
        assert before[1].min() > 0.2 + EFFECT * STEP

    def test_fresh_resets(self, model):
        """Without carry-over: initial fatigue by number, by muscle, drawn in every episode."""
        sim = simulation(ELBOW, 3, model(initial=Uniform(0.1, 0.5, each=True)))
        first = fatigue_of(sim)
        assert 0.1 <= first.min() < first.max() <= 0.5
        assert len(np.unique(first)) == 18
        stepped(sim, 3)
        sim.reset(np.array([True, False, True]))
        second = fatigue_of(sim)
        assert 0.1 <= second.min() < second.max() <= 0.5 + 1e-3
        assert (np.abs(second - first).max(axis=1) > 0.01).tolist() == [True, False, True]
        sim.reset(seeds=np.arange(3))
        np.testing.assert_array_equal(fatigue_of(sim), first)
        named = fatigue_of(simulation(ELBOW, 1, model(initial={"BRA": 0.5})))
        np.testing.assert_allclose(named, [[0.0] * 5 + [0.5]], atol=STEP)

    @pytest.mark.parametrize("carry_over", [True, False])
    def test_a_broken_world_comes_back_clean(self, model, carry_over):
        """NaN in the state of fatigue and of the body: finite again, and the others do not notice."""
        sims = [simulation(ELBOW, 4, model(carry_over=carry_over)) for _ in range(2)]
        for sim in sims:
            stepped(sim, 3)
        hurt = sims[1]
        state = fields(hurt.shards[0].effects[0].state).values()
        for array in state:
            array.numpy()[2] = np.nan
        hurt.scene.muscles.workload.numpy()[2:3] = np.nan  # empty where the model has no use for it
        hurt.scene.data.qvel.numpy()[2] = np.nan
        whole, hurt_fatigue = (stepped(sim, 1, seed=1) for sim in sims)
        assert hurt.transition.fault.numpy().tolist() == [0, 0, 1, 0]
        assert not hurt_fatigue[2].any()
        whole, hurt_fatigue = (stepped(sim, 3, seed=2) for sim in sims)
        others = np.arange(4) != 2
        np.testing.assert_array_equal(whole[others], hurt_fatigue[others])
        assert np.isfinite(hurt_fatigue).all()
        assert hurt_fatigue[2].min() > 0
        assert not hurt.transition.fault.numpy().any()
        assert all(np.isfinite(array.numpy()).all() for array in state)

    def test_a_fault_of_the_body_alone_does_not_cure(self, model):
        """With carry-over a broken state costs the episode, not the history."""
        sim = simulation(ELBOW, 2, model(carry_over=True))
        before = stepped(sim, 5)
        sim.scene.muscles.activation.numpy()[1] = np.nan
        after = stepped(sim, 2)
        assert (after[1] >= before[1]).all()
        assert np.isfinite(after).all()

    def test_observed(self, model):
        """Columns at the end of the observation, after steps and resets; the others stay as they were."""
        sim = simulation(ELBOW, 3, model(observe=True, initial=0.25))
        plain = simulation(ELBOW, 3, model(initial=0.25))
        assert [(c.name, c.size, c.unit) for c in sim.columns][-1] == ("fatigue", 6, "1")
        width = plain.transition.obs.shape[1]
        assert sim.transition.obs.shape[1] == width + 6
        np.testing.assert_allclose(sim.transition.obs.numpy()[:, width:], 0.25, atol=STEP)
        for either in (sim, plain):
            stepped(either, 4)
        obs = sim.transition.obs.numpy()
        np.testing.assert_array_equal(obs[:, width:], fatigue_of(sim))
        np.testing.assert_array_equal(obs[:, :width], plain.transition.obs.numpy())
        assert np.ptp(obs[:, width:]) > EFFECT * STEP


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (
            lambda: Fatigue3CCR(initial=0.0, initial_random=True),
            r"^fatigue_3ccr takes initial or initial_random, not both; leave one out$",
        ),
        (lambda: Fatigue3CCR(affected=1.5), r"^fatigue_3ccr affected must be in 0\.\.1, got 1\.5$"),
        (lambda: Fatigue3CCR(fatigue_rate=-1), r"^fatigue_3ccr fatigue_rate must be in 0\.\.50, got -1$"),
        (lambda: Fatigue3CCR(recovery_rate={"BRO": 1}), r"^muscle 'BRO' unknown; did you mean BRA\?$"),
        (
            lambda: Fatigue3CCR(rest_recovery_factor=-1),
            r"^fatigue_3ccr rest_recovery_factor must be >= 0, got -1$",
        ),
        (lambda: FatigueMa2009(rate=-1), r"^fatigue_ma2009 rate must be >= 0, got -1$"),
        (lambda: FatigueMa2009(initial=1.0), r"^fatigue_ma2009 initial must be in 0\.\.0\.99, got 1$"),
        (
            lambda: ("fatigue_3ccr", "fatigue_ma2009"),
            r"^conditions 'fatigue_3ccr' and 'fatigue_ma2009' both set fatigue; leave one out$",
        ),
    ],
)
def test_bad_input(build, message):
    with pytest.raises(ValueError, match=message):
        simulation(ELBOW, 2, build())

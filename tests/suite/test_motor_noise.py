"""Motor noise: against the hash and the formula in NumPy, and against the normal distribution."""

import math
import re

import numpy as np
import pytest
from reference import motor_noise as reference

import myowarp.tasks.variants  # noqa: F401  (registers the tasks)
from myowarp.definitions.parameter import Uniform
from myowarp.definitions.task import TASKS
from myowarp.models.conditions.motor_noise import MotorNoise
from myowarp.sim.simulation import Simulation

ELBOW, HAND, MOTOR = "myoElbowPose1D6MRandom-v0", "myoHandReachFixed-v0", "myoElbowPose1D6MExoFixed-v0"
SIGNAL, CONSTANT = 0.103, 0.185  # MyoSuite's preset
NUM_MUSCLES = 6

EXCITATION = 1e-6  # of order one; logarithm and cosine in float32
EFFECT = 10.0

NUM_WORLDS = 4096
SIGMAS = 4.0  # one false alarm in 16000
KOLMOGOROV = 1.95
"""Quantile of sqrt(n) D, the largest distance to the distribution function: exceeded once in 1000. The seeds
are fixed, so a failure is a change of the generator."""


def simulation(key, num_worlds, conditions, **options):
    settings = {"device": "cpu", "graph": False, "progress": False, "horizon": 10_000} | options
    sim = Simulation(TASKS[key], num_worlds, conditions=conditions, **settings)
    sim.reset(seeds=np.arange(num_worlds))
    return sim


def noisy(sim, excitation, step=0):
    """Return the excitations of one control step that were all `excitation`."""
    ctrl = sim.scene.data.ctrl
    ctrl.fill_(np.nan)
    ctrl.assign(np.broadcast_to(np.float32(excitation), ctrl.shape))
    sim.episode.step_count.fill_(step)
    sim.shards[0].launch_conditions()
    return ctrl.numpy().astype(np.float64)


def numbers(sim, step=0):
    """Return the normal numbers n2 of a simulation with signal 0 and constant 0.05."""
    return (noisy(sim, 0.5, step) - 0.5) / 0.05


def normal_distance(values):
    """Return sqrt(n) times the Kolmogorov-Smirnov distance to the normal distribution."""
    values, n = np.sort(values.ravel()), values.size
    unit = np.array([0.5 * math.erfc(-x / math.sqrt(2.0)) for x in values])
    steps = np.arange(n + 1) / n
    return np.sqrt(n) * max((steps[1:] - unit).max(), (unit - steps[:-1]).max())


class TestFormula:
    """Number by number."""

    N = 37  # worlds, no multiple of 32

    @pytest.mark.parametrize("step", [0, 1, 9999])
    def test_is_the_reference(self, step):
        """Every world and muscle its own standard deviations; any seed; clipped at both ends."""
        rng = np.random.default_rng(step)
        signal, constant = (np.float32(rng.uniform(0.0, top, (self.N, NUM_MUSCLES))) for top in (0.3, 0.5))
        signal[0], constant[1] = 0.0, 0.0
        sim = simulation(ELBOW, self.N, MotorNoise(signal, constant))
        seeds = (np.arange(self.N) * 123_456_789 - 5).astype(np.int32)
        sim.scene.keys.seed.assign(seeds)
        sim.scene.keys.episode.fill_(2)
        excitation = np.float32(rng.uniform(0.0, 1.0, (self.N, NUM_MUSCLES)))
        n1, n2 = reference.normals(seeds, 2, step, NUM_MUSCLES)
        expected = reference.noisy(excitation.astype(np.float64), signal, constant, n1, n2)
        values = noisy(sim, excitation, step)
        np.testing.assert_allclose(values, expected, atol=EXCITATION)
        assert np.median(np.abs(expected - excitation), axis=1).min() > EFFECT * EXCITATION
        assert (values == 0.0).sum() > 3
        assert (values == 1.0).sum() > 3

    def test_preset(self):
        """Without arguments it is MyoSuite's."""
        sim = simulation(ELBOW, self.N, "motor_noise")
        n1, n2 = reference.normals(np.arange(self.N), 1, 3, NUM_MUSCLES)
        expected = reference.noisy(0.5, SIGNAL, CONSTANT, n1, n2)
        np.testing.assert_allclose(noisy(sim, 0.5, 3), expected, atol=EXCITATION)

    def test_named_muscles(self):
        """The others are exact, bit for bit."""
        sim = simulation(ELBOW, 3, MotorNoise(signal={"BRA": 0.1}, constant={"TRIlat": 0.1}))
        values = noisy(sim, 0.5)
        changed = values != 0.5
        assert changed.all(axis=0).tolist() == [False, True, False, False, False, True]
        assert changed.any(axis=0).tolist() == [False, True, False, False, False, True]

    def test_worlds_without_noise(self):
        """Bit for bit, in a run."""
        sims = [simulation(ELBOW, 3, c) for c in (MotorNoise([0, 0.1, 0], [0, 0, 0.1]), ())]
        for step in range(4):
            action = np.float32(np.random.default_rng(step).uniform(-1, 1, (3, NUM_MUSCLES)))
            for sim in sims:
                sim.action.assign(action)
                sim.step()
        observed = [sim.transition.obs.numpy() for sim in sims]
        np.testing.assert_array_equal(observed[0][0], observed[1][0])
        assert (np.abs(observed[0] - observed[1])[1:].max(axis=1) > EFFECT * EXCITATION).all()

    def test_motors_are_exact(self):
        """That of the exoskeleton, whose command may be negative, beside muscles."""
        sim = simulation(MOTOR, 3, "motor_noise")
        excitations, is_muscle = noisy(sim, -0.25), np.arange(7) > 0
        np.testing.assert_array_equal(excitations[:, ~is_muscle], np.float32(-0.25))
        assert (excitations[:, is_muscle] >= 0.0).all()

    def test_drawn(self):
        """Standard deviations that every episode draws."""
        sim = simulation(ELBOW, 50, MotorNoise(0.0, Uniform(0.1, 0.2)))
        drawn = sim.shards[0].effects[0].constant.curve.start.numpy()
        assert len(np.unique(drawn)) == 50
        n2 = reference.normals(np.arange(50), 1, 0, NUM_MUSCLES)[1]
        np.testing.assert_allclose(noisy(sim, 0.5), np.clip(0.5 + drawn * n2, 0, 1), atol=EXCITATION)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"signal": -0.1}, "motor_noise signal must be >= 0, got -0.1"),
            (
                {"signal": 10},
                "motor_noise signal must be at most 4 times full excitation, got 10; for 10 % write 0.1",
            ),
            ({"constant": {"BAR": 0.1}}, "muscle 'BAR' unknown; did you mean BRA?"),
        ],
    )
    def test_bad_input(self, arguments, message):
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            simulation(ELBOW, 2, MotorNoise(**arguments))


class TestDistribution:
    """Normal, independent, and from the seed alone."""

    @pytest.mark.parametrize("noise", [(0.1, 0.0), (0.0, 0.05), (0.06, 0.04)], ids=str)
    def test_is_normal(self, noise):
        """Over 4096 worlds: mean, variance, and the whole distribution."""
        sim = simulation(ELBOW, NUM_WORLDS, MotorNoise(*noise))
        spread = math.hypot(0.5 * noise[0], noise[1])
        sample = np.concatenate([(noisy(sim, 0.5, step) - 0.5) / spread for step in range(4)])
        n = sample.size
        assert abs(sample.mean()) < SIGMAS / math.sqrt(n)
        assert abs(sample.var() - 1.0) < SIGMAS * math.sqrt(2.0 / n)
        for muscle in range(NUM_MUSCLES):
            column = sample[:, muscle]
            assert abs(column.mean()) < SIGMAS / math.sqrt(n / NUM_MUSCLES)
            assert abs(column.var() - 1.0) < SIGMAS * math.sqrt(2.0 * NUM_MUSCLES / n)
        assert normal_distance(sample) < KOLMOGOROV
        assert normal_distance(1.03 * sample) > KOLMOGOROV  # the statistic sees three percent
        assert np.abs(sample).max() > 4.0

    def test_two_numbers(self):
        """n1 and n2 of a muscle are independent."""
        n1 = (noisy(simulation(ELBOW, NUM_WORLDS, MotorNoise(0.1, 0.0)), 0.5) - 0.5) / 0.05
        n2 = numbers(simulation(ELBOW, NUM_WORLDS, MotorNoise(0.0, 0.05)))
        for a, b in ((n1, n2), (n1**2, n2**2), (n1, n2**2), (n1**2, n2)):
            assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < SIGMAS / math.sqrt(n1.size)

    def test_muscles_steps_worlds_and_episodes_are_independent(self):
        """Uncorrelated, their squares too, and no number comes twice."""
        sim = simulation(ELBOW, NUM_WORLDS, MotorNoise(0.0, 0.05))
        first, second, third = (numbers(sim, step) for step in (0, 1, 2))
        sim.reset()
        again = numbers(sim, 0)
        sim.reset(seeds=np.arange(NUM_WORLDS) + NUM_WORLDS)
        others = numbers(sim, 0)
        pairs = [(first, x) for x in (second, third, again, others)]
        pairs += [(first[:-lag], first[lag:]) for lag in (1, 2, 7)]
        pairs += [(first[:, :-lag], first[:, lag:]) for lag in (1, 2, 5)]
        pairs += [(first[:-1, :-1], second[1:, 1:])]
        for a, b in pairs:
            for power in (1, 2):
                correlation = np.corrcoef(a.ravel() ** power, b.ravel() ** power)[0, 1]
                assert abs(correlation) < SIGMAS / math.sqrt(a.size)
            assert np.mean(a == b) < 1e-3  # the float32 sum has steps of 1e-6 of the spread
        everything = np.concatenate([first, second, third, again, others])
        assert len(np.unique(everything)) > 0.9 * everything.size

    def test_seed_decides(self):
        """The same seed, the same noise, for any number of worlds and any place among them."""
        many = simulation(HAND, 40, MotorNoise(0.0, 0.05))
        values = [numbers(many, step) for step in (0, 1)]
        many.reset()
        assert not np.array_equal(numbers(many, 0), values[0])
        many.reset(seeds=np.arange(40)[::-1])
        np.testing.assert_array_equal(numbers(many, 1), values[1][::-1])
        few = simulation(HAND, 3, MotorNoise(0.0, 0.05))
        np.testing.assert_array_equal(numbers(few, 1), values[1][:3])

    def test_every_control_step_its_own(self):
        """In a run with a constant action, eager and in a graph alike."""
        runs = []
        for graph in (False, True):
            sim = simulation(ELBOW, 2, "motor_noise", graph=graph)
            sim.action.assign(np.zeros((2, NUM_MUSCLES), dtype=np.float32))
            ctrl = []
            for _ in range(5):
                sim.step()
                ctrl.append(sim.scene.data.ctrl.numpy().copy())
            runs.append(np.array(ctrl))
        np.testing.assert_array_equal(*runs)
        assert len(np.unique(runs[0])) > 0.5 * runs[0].size

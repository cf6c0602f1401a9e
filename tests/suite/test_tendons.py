"""Tendon transfer and tendon tear against MuJoCo C, operated alike."""

import re
from functools import lru_cache

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
from configurations import configurations
from hands import (
    CONTACT_HAND,
    CONTROL_DT,
    EIP,
    ELBOW,
    EPL,
    FPL,
    HAND,
    HANDS,
    States,
    act,
    compare_with_c,
    simulation,
    state,
)
from often import often
from reference import tendon_tear, tendon_transfer
from stepping import engine_alone

from myowarp.definitions.condition import resolve
from myowarp.definitions.parameter import Ramp, Uniform
from myowarp.definitions.task import PHYSICS, TASKS
from myowarp.models.conditions.tendon_tear import TendonTear
from myowarp.models.conditions.tendon_transfer import TENDON, TendonTransfer, path_range
from myowarp.sim.build import full_spec, set_physics
from myowarp.view.drawing.snapshot import snapshot

MOVED = 39  # the actuator that a transfer adds

MOMENT = 1e-4  # m, moment arms of the facts, which have four decimals
FORCE = 1e-4  # of the muscle's peak, MuJoCo C from the same state; ENGINE_FORCE of test_muscles.py
QACC = 1e-4  # of the largest of a world; float32 inertia of bones of 1e-8 kg m^2
QPOS = 1e-5  # rad, median over states, one control step
CTRL = 1e-6  # activations of order one, some steps in float32
EFFECT = 10.0
NUM_WORLDS = 7


def assert_like_c(errors):
    """Assert agreement with MuJoCo C."""
    assert errors["force"].max() < FORCE, errors
    assert errors["qacc"].max() < QACC, errors
    assert np.median(errors["qpos"]) < QPOS, errors
    assert errors["activation"].max() < CTRL, errors


@lru_cache
def transferred(key, physics="parity"):
    """Return a simulation of a body in which the worlds 0, 2, 4, 6 have a transfer, and the effect."""
    sim = simulation(key, NUM_WORLDS, TendonTransfer(affected=[1, 0, 1, 0, 0.5, 0.4, 1]), physics=physics)
    return sim, sim.shards[0].effects[0]


AFFECTED = np.array([True, False, True, False, True, False, True])


def moments(model, data, actuator):
    """Return an actuator's derivatives of length by the joints [m], from the engine."""
    first, count = (x.numpy()[0, actuator] for x in (data.moment_rowadr, data.moment_rownnz))
    row = np.zeros(model.nv)
    row[data.moment_colind.numpy()[0, first : first + count]] = data.actuator_moment.numpy()[
        0, first : first + count
    ]
    return row


class TestTransfer:
    """EIP on the thumb."""

    @pytest.mark.parametrize("key", often(HANDS, HANDS[:1]))
    def test_moment_arms(self, key):
        """Those of the facts, in the open hand."""
        sim, _ = transferred(key)
        data = sim.scene.data
        sim.reset(seeds=np.arange(NUM_WORLDS))
        data.qpos.assign(np.tile(sim.scene.oracle.qpos0, (NUM_WORLDS, 1)))
        for launch in (mjw.kinematics, mjw.com_pos, mjw.tendon, mjw.transmission):
            engine_alone(launch)(sim.scene.model, data)
        names = [sim.scene.oracle.joint(i).name for i in range(sim.scene.oracle.nv)]
        dofs = [*(names.index(n) for n in ("deviation_r", "flexion_r")), 3, 4, names.index("mp_flexion_r"), 6]
        expected = np.array(list(tendon_transfer.MOMENTS.values()))
        moved, own = (moments(sim.scene.oracle, data, actuator)[dofs] for actuator in (MOVED, EIP))
        np.testing.assert_allclose(moved, expected, atol=MOMENT)
        assert np.abs(own - expected).min() > EFFECT * MOMENT
        assert data.actuator_length.numpy()[0, MOVED] == pytest.approx(tendon_transfer.LENGTH, abs=MOMENT)

    @pytest.mark.parametrize(("key", "physics"), [*((key, "parity") for key in HANDS), (HAND, "fast")])
    def test_is_the_operated_hand(self, key, physics):
        """Force, acceleration and a control step of random states; healthy worlds beside affected ones."""
        sim, effect = transferred(key, physics)
        if PHYSICS[physics].midstep:  # what C does instead
            sim.scene.muscles.midstep, sim.scene.muscles.implicitness = False, 1.0
        spec = full_spec(TASKS[key])
        healthy, sick = spec.copy().compile(), tendon_transfer.operated(spec, effect.length_range)
        set_physics(TASKS[key], PHYSICS[physics], (healthy, sick))
        assert_like_c(compare_with_c(sim, [sick if x else healthy for x in AFFECTED]))
        swapped = compare_with_c(sim, [healthy if x else sick for x in AFFECTED])
        assert np.median(swapped["force"]) > EFFECT * FORCE
        assert np.median(swapped["qacc"]) > EFFECT * QACC
        assert np.median(swapped["qpos"]) > EFFECT * QPOS

    def test_path(self):
        """Element by element, side sites too, which few postures need."""
        paths = []
        spec = full_spec(TASKS[HAND])
        for model, name in (
            (transferred(HAND)[0].full_model, TENDON),
            (tendon_transfer.operated(spec, (0.19, 0.24)), "operated"),
        ):
            tendon = model.tendon(name).id
            elements = slice(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
            fields = (model.wrap_type, model.wrap_objid, model.wrap_prm)
            paths.append(np.stack([field[elements] for field in fields]))
        np.testing.assert_array_equal(*paths)

    def test_fibers_fit_the_path(self):
        """Without a new range of lengths EIP would hardly pull; C with the old range disagrees."""
        sim, effect = transferred(HAND)
        unfitted = tendon_transfer.operated(full_spec(TASKS[HAND]), effect.own_length_range)
        errors = compare_with_c(sim, NUM_WORLDS * [unfitted])
        assert np.median(errors["force"][AFFECTED]) > EFFECT * FORCE

    @pytest.mark.parametrize("key", HANDS)
    def test_range_of_the_path(self, key):
        """It holds the lengths of random postures, and climbing from these does not leave it."""
        model = transferred(key)[0].scene.oracle
        tendon, rng, data = model.tendon(TENDON).id, np.random.default_rng(0), mujoco.MjData(model)

        def length(qpos):
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_tendon(model, data)
            return data.ten_length[tendon]

        low, high = path_range(model, tendon)
        postures = configurations(model, model.qpos0, 2000, 0)
        lengths = np.array([length(qpos) for qpos in postures])
        assert low < lengths.min() < lengths.max() < high
        np.testing.assert_allclose((low, high), tendon_transfer.SAMPLED_RANGE, atol=5e-3)
        limits = np.where(model.jnt_limited[:, None], model.jnt_range, 0.0)
        hinge = model.jnt_qposadr
        for sign, end in ((-1, low), (1, high)):
            best = postures[np.argmax(sign * lengths)]
            for width in np.geomspace(0.3, 1e-3, 600):
                trial = best.copy()
                trial[hinge] = np.clip(best[hinge] + width * rng.normal(size=len(hinge)), *limits.T)
                best = trial if sign * length(trial) > sign * length(best) else best
            assert -1e-4 < sign * (end - length(best)) < 1e-3

    def test_healthy_worlds_do_not_notice(self):
        """Bit for bit, whatever their neighbours have; dimensions stay."""
        conditions = (TendonTransfer(affected=[1, 0, 0.5, 0.49]), ())
        sim, healthy = (simulation(CONTACT_HAND, 4, c) for c in conditions)
        affected = np.array([True, False, True, False])
        assert sim.action.shape == healthy.action.shape == (4, 39)
        for step in range(3):
            for either in (sim, healthy):
                act(either, step)
            np.testing.assert_array_equal(state(sim)[~affected], state(healthy)[~affected])
        difference = np.abs(state(sim) - state(healthy))[affected, : sim.scene.oracle.nq]
        assert difference.max(axis=1).min() > EFFECT * QPOS

    def test_slim_is_full(self):
        """The new path survives slimming, and the engine's idle kernels are left out as before."""
        sim = transferred(HAND)[0]
        slim, full = sim.scene.oracle, sim.full_model
        datas = [mujoco.MjData(model) for model in (slim, full)]
        for qpos in configurations(slim, slim.qpos0, 20, 1):
            lengths = []
            for model, data in zip((slim, full), datas, strict=True):
                data.qpos[:] = qpos
                mujoco.mj_forward(model, data)
                lengths.append(data.actuator_length[MOVED])
            assert lengths[0] == pytest.approx(lengths[1], abs=1e-12)
        assert sim.shards[0].idle_kernels == simulation(HAND, 1, ()).shards[0].idle_kernels
        assert sim.shards[0].idle_kernels

    def test_surgery_and_its_reversal(self):
        """At a time of the life: nothing before, and nothing left of it after."""
        onset = 3 * CONTROL_DT - 1e-3
        ramps = [Ramp(start, 1.0 - start, onset, of="life") for start in (0.0, 1.0)]
        for ramp, first in zip(ramps, (False, True), strict=True):
            sim = simulation(HAND, 1, TendonTransfer(ramp))
            params = sim.scene.muscles.params
            for step in range(5):
                act(sim, step)
                on = (step >= 3) != first
                force = sim.scene.data.actuator_force.numpy()[0]
                assert (force[MOVED] != 0.0) == on
                assert (force[EIP] == 0.0) == on
                assert (force[EPL] == 0.0) == on
                assert sim.scene.muscles.anatomy.path.numpy()[0, EIP] == (MOVED if on else EIP)
                lengths = (params.optimal_fiber_length, params.passive_slack_length)
                values = [array.numpy()[0, EIP] for array in lengths]
                if not on:
                    model = sim.scene.oracle
                    low, high = model.actuator_lengthrange[EIP]
                    optimal = (high - low) / 0.3
                    assert values == [np.float32(optimal), np.float32(low - 0.75 * optimal)]

    def test_drawn_anew(self):
        """Every episode draws who is affected."""
        sim = simulation(HAND, 64, TendonTransfer(Uniform(0.0, 1.0)), autoreset="same_step", horizon=1)
        drawn = []
        for step in range(3):
            act(sim, step)
            drawn.append(sim.scene.muscles.anatomy.path.numpy()[:, EIP] == MOVED)
        drawn = np.array(drawn)
        assert (np.abs(drawn.mean(axis=1) - 0.5) < 4 * 0.5 / 8).all()
        assert len(np.unique(drawn, axis=0)) == 3

    def test_pictures(self):
        """The tendon that pulls is shown, the others are not."""
        sim = transferred(HAND)[0]
        sim.shards[0].launch_conditions()
        activation = np.float32(np.linspace(0.1, 0.9, 39))
        sim.scene.muscles.activation.assign(np.tile(activation, (NUM_WORLDS, 1)))
        affected, healthy = (snapshot(sim, world).activation for world in (0, 1))
        np.testing.assert_array_equal(healthy, [*activation, np.nan])
        assert affected[MOVED] == activation[EIP]
        assert np.flatnonzero(np.isnan(affected)).tolist() == [EIP, EPL]


class TestTear:
    """Torn tendons."""

    def test_is_a_muscle_without_force(self):
        """No force, and forces, accelerations and a control step of C with gain and bias 0."""
        torn = TendonTear(("FPL", "OP_r"), transmission=[0.0, 1.0, 0.0, 0.25, 0.0, 1.0, 0.0])
        sim = simulation(HAND, NUM_WORLDS, torn)
        healthy = full_spec(TASKS[HAND]).compile()
        ids = [healthy.actuator(name).id for name in ("FPL_r", "OP_r")]
        models = []
        for left in (0.0, 1.0, 0.0, 0.25, 0.0, 1.0, 0.0):
            model = mujoco.MjModel.__copy__(healthy)
            for prm in (model.actuator_gainprm, model.actuator_biasprm):
                prm[ids, 2] *= left
            models.append(model)
        assert_like_c(compare_with_c(sim, models))
        States(sim).load(sim)
        engine_alone(mjw.forward)(sim.scene.model, sim.scene.data)
        force = sim.scene.data.actuator_force.numpy()[:, ids]
        assert (force[::2] == 0.0).all()
        assert (force[[1, 3, 5]] < -1e-3).all()
        whole = compare_with_c(sim, NUM_WORLDS * [healthy])
        assert whole["force"][::2].min() > EFFECT * FORCE
        assert whole["qacc"][::2].min() > EFFECT * QACC

    def test_torque_of_the_torn_muscle(self):
        """What the joints miss is moment times force of the muscle, by C."""
        sims = [simulation(HAND, 2, c) for c in (TendonTear("FPL"), ())]
        torques = []
        for sim in sims:
            states = States(sim)
            states.load(sim)
            engine_alone(mjw.forward)(sim.scene.model, sim.scene.data)
            torques.append(sim.scene.data.qfrc_actuator.numpy())
        model = sims[1].scene.oracle
        for world in range(2):
            data = states.in_c(model, world)
            moment = np.zeros((model.nu, model.nv))
            mujoco.mju_sparse2dense(
                moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
            )
            missing = moment[FPL] * data.actuator_force[FPL]
            tolerance = FORCE * np.abs(missing).max() + 1e-6 * np.abs(torques[1][world]).max()
            np.testing.assert_allclose((torques[1] - torques[0])[world], missing, atol=tolerance)
            assert np.abs(missing).max() > EFFECT * tolerance

    TIMES = (0.0, 0.02, 0.05, 0.06, 0.18, 0.6, 1.94)  # the last three are below their step in float32

    @pytest.mark.parametrize("of", ["episode", "life"])
    def test_time(self, of):
        """The first control step that does not begin before it, of every world its own."""
        horizon, steps = 40, 97
        tear = TendonTear("FPL", time=self.TIMES, transmission=0.25, of=of)
        sim = simulation(HAND, NUM_WORLDS, tear)
        transmission = sim.scene.muscles.anatomy.transmission
        for life in range(steps):
            for count, value in ((sim.episode.step_count, life % horizon), (sim.episode.life_count, life)):
                count.fill_(value)
            sim.shards[0].launch_conditions()
            step = life if of == "life" else life % horizon
            expected = [tendon_tear.transmission(step, CONTROL_DT, time, 0.25) for time in self.TIMES]
            values = transmission.numpy()
            np.testing.assert_array_equal(values[:, FPL], expected)
            assert (np.delete(values, FPL, axis=1) == 1.0).all()

    def test_time_late_in_a_life(self):
        """After an hour, too: float32 counts steps, but its quotients of seconds are off by some."""
        steps = np.array([32_770, 180_004, 799_999])
        sim = simulation(HAND, 6, TendonTear("FPL", time=np.tile(steps * CONTROL_DT, 2), of="life"))
        sim.episode.life_count.assign(np.concatenate([steps, steps - 1]).astype(np.int32))
        sim.shards[0].launch_conditions()
        transmission = sim.scene.muscles.anatomy.transmission.numpy()
        np.testing.assert_array_equal(transmission[:, FPL], [0.0, 0.0, 0.0, 1.0, 1.0, 1.0])

    def test_time_runs_with_the_episode_or_the_life(self):
        """Counters are those of the simulation: an episode heals, a life does not."""
        force = {}
        for of in ("episode", "life"):
            sim = simulation(HAND, 1, TendonTear("FPL", time=0.04, of=of), autoreset="same_step", horizon=3)
            force[of] = []
            for step in range(6):
                act(sim, step)
                force[of].append(bool(sim.scene.data.actuator_force.numpy()[0, FPL]))
        assert force == {"episode": [True, True, False] * 2, "life": [True, True] + 4 * [False]}

    def test_every_muscle_its_own(self):
        """Times and transmissions by name; muscles named twice tear once; two tears multiply."""
        tears = (
            TendonTear(["FPL", "EPL_r", "FPL_r"], time={"EPL": 0.02}, transmission={"FPL": 0.5}),
            TendonTear("FPL", transmission=0.5),
        )
        sim = simulation(HAND, 1, tears)
        seen = []
        for step in (0, 1):
            sim.episode.step_count.fill_(step)
            sim.shards[0].launch_conditions()
            seen.append(sim.scene.muscles.anatomy.transmission.numpy()[0, [FPL, EPL]].tolist())
        assert seen == [[0.25, 1.0], [0.25, 1.0]]
        assert resolve(tears, TASKS[HAND])

    def test_drawn_times(self):
        """Uniform in time, another one in every episode."""
        sim = simulation(HAND, 64, TendonTear("FPL", time=Uniform(0.0, 1.0)))
        drawn = [sim.shards[0].effects[0].tear.time.start.numpy().copy()]
        sim.reset()
        drawn.append(sim.shards[0].effects[0].tear.time.start.numpy().copy())
        assert len(np.unique(drawn)) == 128
        assert 0.0 <= np.min(drawn) < 0.1 < 0.9 < np.max(drawn) <= 1.0


@pytest.mark.parametrize(
    ("key", "conditions", "message"),
    [
        (
            ELBOW,
            "tendon_transfer",
            "body 'elbow' cannot have a tendon transfer; bodies that can: hand, contact_hand",
        ),
        (
            HAND,
            (TendonTransfer(), TendonTransfer()),
            "conditions 'tendon_transfer' and 'tendon_transfer' both set the path of the "
            "transferred muscle; leave one out",
        ),
        (HAND, TendonTransfer(1.2), "tendon_transfer affected must be in 0..1, got 1.2"),
        (
            HAND,
            TendonTransfer([1, 0, 1]),
            "tendon_transfer affected must be one number or of shape (2,), got shape (3,)",
        ),
        (
            ELBOW,
            "tendon_tear",
            "tendon_tear needs the muscles that tear in body 'elbow', got none",
        ),
        (HAND, TendonTear(("FPL", "EPX")), "muscle 'EPX' unknown; did you mean EPL_r, EPB_r"),
        (HAND, TendonTear(time=-1.0), "tendon_tear time of FPL_r must be >= 0, got -1"),
        (HAND, TendonTear(transmission=1.5), "tendon_tear transmission of FPL_r must be in 0..1, got 1.5"),
    ],
)
def test_bad_input(key, conditions, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
        simulation(key, 2, conditions)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"muscles": ()}, "tendon_tear needs at least one muscle, got none"),
        ({"muscles": 3}, "tendon_tear muscles must be a name or several in a list, got 3"),
        ({"of": "day"}, "tendon_tear time of 'day' unknown; available: episode, life"),
    ],
)
def test_bad_tear(arguments, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        TendonTear(**arguments)

"""Reflexes beside MyoSuite's controller, what the legs sense beside MuJoCo C, and gait files."""

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import warp as wp

from myowarp.apps.policies.find import acting, find_policy
from myowarp.apps.policies.reflex import (
    GRAVITY,
    JOINTS,
    SCALES,
    Delays,
    Gait,
    ReflexControl,
    gait_of,
    read_gait,
    unscaled,
)
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.kernels.action import excitation
from myowarp.laws.reflexes import GROUPS, Phase, Reflexes, Senses, stimulate_legs
from myowarp.sim.simulation import Simulation
from myowarp.tasks.setups import complete

RECORD = Path(__file__).parents[1] / "data/reflexes.npz"
TASK = "myoLegWalk-v0"
ONES = np.ones(len(SCALES))


@pytest.fixture(scope="module")
def record():
    """Return the recorded arrays, and the senses as those of the kernel, shape (walks, steps)."""
    with np.load(RECORD) as file:
        arrays = dict(file)
    senses = np.zeros(arrays["pitch"].shape[:2], Senses.numpy_dtype())
    arrays |= {"rotation": 0.2 * arrays["hip_rate"], "rotation_rate": 2.0 * arrays["knee_rate"]}
    ours = np.ones((len(arrays["parameter"]), 2))  # parameters of the rotators, which MyoSuite lacks
    arrays["parameter"] = np.concatenate([arrays["parameter"], ours], axis=1)
    for name in senses.dtype.names:
        senses[name] = arrays[name].reshape(senses[name].shape)
    return arrays, senses


def told(values, senses, lag=(0, 0, 0)):
    """Return the stimulation of senses (walks, steps) by parameters (walks, 48): (walks, steps, 2, 13)."""
    (walks, steps), slots = senses.shape, max(lag) + 1
    rows = np.ascontiguousarray(values).view(Reflexes.numpy_dtype())[:, 0]
    with wp.ScopedDevice("cpu"):
        reflexes = wp.array(rows, dtype=Reflexes)
        phase = wp.zeros((walks, 2), dtype=Phase)
        stimulation = wp.full((walks, 2, len(GROUPS)), np.nan, dtype=wp.float64)
        kept, found = np.zeros((walks, slots), senses.dtype), []
        for step in range(steps):
            kept[:, step % slots] = senses[:, step]
            wp.launch(
                stimulate_legs,
                dim=(walks, 2),
                inputs=[
                    reflexes,
                    wp.vec3i(*lag),
                    wp.full(walks, step, dtype=int),
                    wp.array(kept, dtype=Senses),
                ],
                outputs=[phase, stimulation],
            )
            found.append(stimulation.numpy().copy())
    return np.stack(found, axis=1)


def test_stimulation_is_that_of_myosuite(record):
    arrays, senses = record
    groups = json.loads(str(arrays["meta"]))["groups"]
    assert groups == list(GROUPS[: len(groups)])
    found = told(unscaled(arrays["parameter"]), senses)[..., : len(groups)]
    assert np.abs(found - arrays["stimulation"]).max() < 1e-12
    assert (arrays["stimulation"] > 0.02).any(axis=(0, 1, 2)).all()


def test_every_parameter_acts(record):
    arrays, senses = record
    moved = np.zeros(len(SCALES))
    for base, sensed_there in zip(arrays["parameter"], senses, strict=True):
        others = np.concatenate([base[None], base + 0.5 * np.eye(len(base))])
        found = told(unscaled(others), np.tile(sensed_there, (len(others), 1)))
        moved = np.maximum(moved, np.abs(found[1:] - found[0]).max(axis=(1, 2, 3)))
    assert [name for name, most in zip(SCALES, moved, strict=True) if most < 1e-5] == []


def test_senses_arrive_later_by_their_delays(record):
    arrays, senses = record
    lag, values = (1, 2, 4), unscaled(arrays["parameter"])
    late, steps = senses.copy(), np.arange(senses.shape[1])
    knee = ("knee", "knee_rate", "rf_force", "vas_force")
    foot = ("load", "ankle", "gas_force", "sol_force")
    for name in senses.dtype.names:
        delay = lag[1] if name in knee else lag[2] if name in foot else lag[0]
        late[name] = senses[name][:, (steps - delay).clip(0)]
    found = told(values, senses, lag)
    assert np.array_equal(found, told(values, late))
    assert np.abs(found - told(values, senses)).max() > 0.1


def test_delays_last_whole_control_steps():
    assert Delays().steps(0.01) == (0, 1, 2)
    assert Delays(0.03, 0.0, 0.029).steps(0.01) == (3, 0, 2)


def test_a_world_may_go_on_as_another_one(sim):
    """With its senses on their way to the spine, and in its phase."""
    values, delays = unscaled(ONES)[None], Delays(0.03, 0.03, 0.03)
    sim.reset()
    control, felt = ReflexControl(values, delays, sim), np.random.default_rng(0)
    for _ in range(4):  # a world that lies and one that stands
        qpos = np.tile(TASKS[TASK].start_pose, (2, 1))
        qpos[1, 2] += 1.0
        sim.scene.data.qpos.assign(qpos.astype(np.float32))
        sim.scene.data.qvel.assign(felt.normal(size=(2, sim.scene.oracle.nv)).astype(np.float32))
        control(np.zeros((2, 1)))
        sim.episode.step_count.assign(sim.episode.step_count.numpy() + 1)
    apart = control(np.zeros((2, 1)))
    control.copy(0, 1)
    alike = control(np.zeros((2, 1)))
    assert np.abs(apart[0] - apart[1]).max() > 0.01
    assert np.array_equal(alike[0], alike[1])


def test_rotators_resist_the_rotation_of_the_hip(record):
    arrays, senses = record
    values = unscaled(arrays["parameter"])
    found = told(values, senses)[..., -2:]  # internal, external rotators
    gains = values[:, None, None, -2:]
    inwards = (gains * np.stack([senses["rotation"], senses["rotation_rate"]], axis=-1)).sum(axis=-1)
    assert found[..., 0] == pytest.approx((-inwards).clip(0.01, 1.0))
    assert found[..., 1] == pytest.approx(inwards.clip(0.01, 1.0))


@pytest.fixture(scope="module")
def sim():
    """Return two worlds of legs that make a control step of one physics step."""
    return Simulation(Setup(task=replace(TASKS[TASK], num_substeps=1), device="cpu"), 2)


def control_of(sim):
    return ReflexControl(unscaled(ONES)[None], Delays(0.0, 0.0, 0.0), sim)


def sensed(sim, qpos, qvel):
    """Return what worlds sense in a state, and the state as MuJoCo has it."""
    control, model = control_of(sim), sim.scene.oracle
    data = mujoco.MjData(model)
    sim.scene.data.qpos.assign(np.tile(qpos, (sim.num_worlds, 1)))
    sim.scene.data.qvel.assign(np.tile(qvel, (sim.num_worlds, 1)))
    control(np.zeros((sim.num_worlds, 1)))
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(model, data)
    return control.legs[0].senses.numpy()[0, 0], data


def states(sim, number=5):
    """Yield states beside that of the start."""
    rng, model = np.random.default_rng(3), sim.scene.oracle
    moved = [model.joint(f"{joint}_{side}").qposadr[0] for joint in JOINTS for side in "rl"]
    for _ in range(number):
        qpos = np.array(TASKS[TASK].start_pose)
        qpos[moved] += 0.1 * rng.normal(size=len(moved))
        qpos[3:7] += 0.1 * rng.normal(size=4)
        qpos[3:7] /= np.linalg.norm(qpos[3:7])
        yield qpos, rng.normal(size=model.nv)


def test_rates_are_those_of_what_is_sensed(sim):
    sim.reset()
    model, dt = sim.scene.oracle, 1e-3
    axes = {"pitch": 4, "roll": 3}  # of the root's rotation, in its own frame
    for qpos, qvel in states(sim):
        for name in ("pitch", "roll", "hip", "knee"):
            state, rate = qpos.copy(), qvel.copy()
            rate[3:6] = 0.0
            if name in axes:  # about one axis, from upright
                state[3:7], rate[axes[name]] = TASKS[TASK].start_pose[3:7], 0.7
            before, after = state.copy(), state.copy()
            mujoco.mj_integratePos(model, before, rate, -dt)
            mujoco.mj_integratePos(model, after, rate, dt)
            change = sensed(sim, after, rate)[0][name] - sensed(sim, before, rate)[0][name]
            assert change / (2 * dt) == pytest.approx(sensed(sim, state, rate)[0][f"{name}_rate"], abs=2e-3)


def test_signs_are_those_of_the_law(sim):
    """Trunk ahead and to the right, legs ahead, apart and flexed, seen in MuJoCo's positions."""
    sim.reset()
    model = sim.scene.oracle
    place = {side: [model.body(f"{name}_{side}").id for name in ("femur", "talus")] for side in "rl"}
    for qpos, qvel in states(sim):
        qpos[3:7] = TASKS[TASK].start_pose[3:7]
        for axis, name, way in ((4, "pitch", (0.0, -1.0)), (3, "roll", (-1.0, 0.0))):  # -y ahead, -x right
            turned = qpos.copy()
            turn = np.zeros(model.nv)
            turn[axis] = 0.3
            mujoco.mj_integratePos(model, turned, turn, 1.0)
            now, data = sensed(sim, turned, qvel)
            assert now[name] == pytest.approx(0.3, abs=0.02)
            top = data.xmat[model.body("torso").id].reshape(3, 3)  # the trunk's own up
            assert max(np.dot(column[:2], way) for column in top.T) > 0.2
        now, data = sensed(sim, qpos, qvel)
        assert now["speed_ahead"] == pytest.approx(-qvel[1], abs=2e-3)
        assert now["speed_left"] == pytest.approx(qvel[0], abs=2e-3)
        for leg, side in enumerate("rl"):
            hip, ankle = data.xpos[place[side]]
            angle = np.arctan2(ankle[1] - hip[1], hip[2] - ankle[2])  # behind the hip: above 0
            leg_angle = now["hip"][leg] - 0.5 * now["knee"][leg]
            assert leg_angle - np.pi / 2 == pytest.approx(angle, abs=0.1)
    closer = []
    for adduction in (-0.2, 0.2):
        qpos, qvel = np.array(TASKS[TASK].start_pose), np.zeros(model.nv)
        for side in "rl":
            qpos[model.joint(f"hip_adduction_{side}").qposadr[0]] = adduction
        now, data = sensed(sim, qpos, qvel)
        closer.append((abs(data.xpos[place["r"][1]][0] - data.xpos[place["l"][1]][0]), now["spread"]))
    assert closer[0][0] > closer[1][0]
    assert (closer[0][1] < closer[1][1]).all()


def test_loads_are_those_of_mujocos_contacts(sim):
    """Contact forces of the feet, in weights, at the state that a physics step began with."""
    sim.reset()
    model, data = sim.scene.oracle, mujoco.MjData(sim.scene.oracle)
    control, weight, seen = control_of(sim), GRAVITY * sim.scene.oracle.body_mass.sum(), []
    feet = {model.body(f"talus_{side}").id: leg for leg, side in enumerate("rl")}
    sim.action.fill_(-0.9)
    for step in range(60):
        data.qpos[:], data.qvel[:] = sim.scene.data.qpos.numpy()[1], sim.scene.data.qvel.numpy()[1]
        data.act[:] = sim.scene.muscles.activation.numpy()[1]
        data.ctrl[:] = excitation(-0.9, True)
        sim.step()
        if step % 10 != 9:
            continue
        mujoco.mj_forward(model, data)
        loads, force = np.zeros(2), np.zeros(6)
        for i in range(data.ncon):
            mujoco.mj_contactForce(model, data, i, force)
            for geom in data.contact[i].geom:
                body = model.geom_bodyid[geom]
                while body and body not in feet:
                    body = model.body_parentid[body]
                if body:
                    loads[feet[body]] += force[0] / weight
        control(np.zeros((2, 1)))
        legs = control.legs[0]
        found = legs.senses.numpy()[1, 0]["load"]
        assert found == pytest.approx(loads, abs=0.02)
        seen.append(loads)
    assert np.max(seen) > 0.3


def test_an_episode_begins_on_the_straighter_leg(sim):
    sim.reset()
    load = sensed(sim, np.array(TASKS[TASK].start_pose), np.zeros(sim.scene.oracle.nv))[0]["load"]
    assert load.tolist() == [0.0, 1.0]


def test_worlds_have_gaits_of_their_own_and_shards_do_not_show():
    setup = Setup(task=TASK, device="cpu", seed=3)
    rng = np.random.default_rng(0)
    values, found = unscaled(rng.uniform(0.5, 1.5, (4, len(SCALES)))), []
    for shards in (1, 2):
        sim = Simulation(setup, 4, shards=shards)
        sim.reset(seeds=np.array([3, 3, 3, 3]))
        control = ReflexControl(values, Delays(), sim)
        for _ in range(20):
            sim.action.assign(control(sim.transition.obs.numpy()))
            sim.step()
        found.append(sim.scene.data.qpos.numpy().copy())
    assert np.array_equal(*found)
    assert (np.abs(found[0][1:] - found[0][0]).max(axis=1) > 1e-3).all()


def test_a_gait_file_comes_back_and_acts(tmp_path):
    gait = gait_of(ONES, Delays(0.0, 0.01, 0.03), {"cost": 3.0})
    gait.save(path := tmp_path / "gait.json")
    assert read_gait(path) == gait
    policy = find_policy(str(path), TASKS[TASK])
    sim = Simulation(Setup(task=TASK, device="cpu"), 2)
    sim.reset()
    action = acting(policy, sim)(sim.transition.obs.numpy())
    assert action.shape == (2, sim.scene.num_actions)
    assert action.min() >= -1.0
    assert action.max() > -0.5


def test_a_gait_that_was_searched_with_support_says_so(tmp_path, caplog):
    support = "pelvis_support(share=1)"
    for searched, conditions, said in (
        ([support], (), f"was searched with conditions {support} and walks with none"),
        ([], (support,), f"was searched with conditions none and walks with {support}"),
        ([support], (support,), ""),
    ):
        caplog.clear()
        path = tmp_path / f"{len(searched)}{len(conditions)}.json"
        gait_of(ONES, Delays(), {"search": {"conditions": searched}}).save(path)
        setup = complete(Setup(task=TASK, device="cpu", conditions=conditions))
        acting(find_policy(str(path), setup.spec), Simulation(setup, 1, graph=False))
        assert caplog.text.count("was searched") == bool(said)
        assert said in caplog.text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": 2}, "must be a gait: JSON with format 1, 48 parameters and delays"),
        ({"delays": {"hip": -0.1, "knee": 0.0, "foot": 0.0}}, "delays of at least 0 s"),
        ({"parameters": {"pitch": 1.0}}, "must be a gait: JSON with format 1, 48 parameters and delays"),
    ],
)
def test_what_is_no_gait_is_refused(tmp_path, change, message):
    (path := tmp_path / "gait.json").write_text("")
    Gait(dict(zip(SCALES, ONES.tolist(), strict=True))).save(path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(ValueError, match=message):
        read_gait(path)


def test_a_body_without_legs_is_refused():
    sim = Simulation(Setup(task="myoFingerPoseFixed-v0", device="cpu"), 2)
    with pytest.raises(ValueError, match="a gait moves two legs under a free root"):
        control_of(sim)

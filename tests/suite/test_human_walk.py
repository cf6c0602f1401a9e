"""Walking as people do: reward terms beside MuJoCo C and NumPy, starts, and elastic tendons."""

import mujoco
import numpy as np
import pytest
import warp as wp
from reference import mujoco_muscle as reference
from reference.bhargava import bhargava

from myowarp.definitions.muscle import MUSCLES
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.laws.metabolics import muscle_mass
from myowarp.models.muscles.mujoco import MujocoMuscle
from myowarp.sim.simulation import Simulation

KEY = "myoLegWalkHuman-v0"
LOOKING_AHEAD = np.array([0.7073882252434113, 0.0, 0.0, -0.7068252250641434])
WORLDS, STEPS = 4, 12


def walked(muscle, actions=None):
    """Return worlds after some steps, of random actions where none are given."""
    sim = Simulation(Setup(task=KEY, muscle=muscle, device="cpu"), WORLDS, autoreset="disabled")
    sim.reset(seeds=np.arange(WORLDS))
    for step in range(STEPS):
        draws = np.random.default_rng(step).uniform(-1.0, 0.0, sim.action.shape)
        sim.action.assign((draws if actions is None else actions).astype(np.float32))
        sim.step()
        yield sim


def expected(sim, world, data):
    """Return the terms of a world by name, in float64 from MuJoCo's arrays."""
    model, muscles, scene = sim.scene.oracle, sim.scene.muscles, sim.scene
    data.qpos[:], data.qvel[:] = scene.data.qpos.numpy()[world], scene.data.qvel.numpy()[world]
    data.act[:], data.ctrl[:] = muscles.activation.numpy()[world], scene.data.ctrl.numpy()[world]
    mujoco.mj_forward(model, data)
    mass, body_mass = model.body_mass, model.body_mass.sum()
    x, y = -(mass @ data.cvel[:, 3:5]) / body_mass
    speed = np.exp(-(((1.2 - y) / 0.15) ** 2)) + np.exp(-((x / 0.15) ** 2))
    turn = np.exp(-5.0 * np.linalg.norm(data.qpos[3:7] - LOOKING_AHEAD))
    ids = muscles.actuator_id
    gain, ranges = model.actuator_gainprm[ids], model.actuator_lengthrange[ids]
    peak = reference.peak_force(model.actuator_acc0[ids], gain)
    optimal = (ranges[:, 1] - ranges[:, 0]) / (gain[:, 1] - gain[:, 0])
    length, velocity = data.actuator_length[ids], data.actuator_velocity[ids]
    rows = zip(ranges, model.actuator_acc0[ids], gain[:, :9], length, velocity, strict=True)
    own = np.array([-reference.gain(own, v, r, acc, g) for r, acc, g, own, v in rows])
    rates = bhargava(
        muscle_mass(peak, optimal),
        data.ctrl[ids].clip(0.0, 1.0),
        gain[:, 0] + (length - ranges[:, 0]) / optimal,
        velocity,
        own * data.act,
        -data.actuator_force[ids],
    )
    return {"vel_reward": speed, "ref_rot": turn, "metabolic": -rates.sum() / body_mass, "sparse": speed}


def test_terms_are_those_of_mujoco_and_numpy():
    seen = []
    for sim in walked("mujoco"):
        data = mujoco.MjData(sim.scene.oracle)
        terms, names = sim.transition.terms.numpy(), [term.name for term in sim.terms]
        for world in range(WORLDS):
            wanted = expected(sim, world, data) | {"done": 0.0}
            found = dict(zip(names, terms[world].tolist(), strict=True))
            assert found == pytest.approx(wanted, rel=2e-3, abs=2e-3)
            reward = 5 * wanted["vel_reward"] + 10 * wanted["ref_rot"] + 0.2 * wanted["metabolic"]
            assert sim.transition.reward.numpy()[world] == pytest.approx(reward, abs=0.01)
            seen.append([wanted[name] for name in ("vel_reward", "ref_rot", "metabolic")])
    assert (np.ptp(seen, axis=0) > (0.2, 0.05, 2.0)).all()


def test_nothing_tells_of_a_cycle():
    columns = [column.name for column in TASKS[KEY].columns(35, 34, 80)]
    assert "phase_var" not in columns
    assert columns == [c.name for c in TASKS["myoLegWalk-v0"].columns(35, 34, 80) if c.name != "phase_var"]


@pytest.mark.parametrize("muscle", ["mujoco", "millard2012"])
def test_episodes_begin_on_a_foot_that_bears(muscle):
    """Muscles are activated a little, elastic tendons in equilibrium, and the left foot is at rest."""
    sim = Simulation(Setup(task=KEY, muscle=muscle, device="cpu"), WORLDS)
    sim.reset()
    assert sim.scene.muscles.activation.numpy() == pytest.approx(0.2)
    model, data = sim.scene.oracle, mujoco.MjData(sim.scene.oracle)
    data.qpos[:], data.qvel[:] = sim.scene.data.qpos.numpy()[0], sim.scene.data.qvel.numpy()[0]
    mujoco.mj_forward(model, data)
    speed = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, model.body("calcn_l").id, speed, 0)
    assert np.abs(speed[3:5]).max() < 0.25  # m/s, of a body that moves at 1.25
    touching = {model.body(model.geom_bodyid[geom]).name for c in data.contact for geom in c.geom}
    assert "toes_l" in touching or "calcn_l" in touching
    assert not {"toes_r", "calcn_r"} & touching
    assert model.eq_type.tolist() == [mujoco.mjtEq.mjEQ_JOINT] * model.neq
    assert np.abs(data.efc_pos[: model.neq]).max() < 1e-3  # knees and kneecaps are where they belong


def test_elastic_tendons_walk_a_while():
    """Excited to a third: all that leaves is finite, nothing breaks, and tendons pull."""
    sim = None
    for sim in walked("millard2012", np.full((WORLDS, 80), -0.33)):
        for name in ("obs", "reward", "terms"):
            assert np.isfinite(getattr(sim.transition, name).numpy()).all()
        assert not sim.transition.fault.numpy().any()
    assert (sim.scene.muscles.tension.numpy().max(axis=1) > 500.0).all()  # N
    power = sim.transition.terms.numpy()[:, [term.name for term in sim.terms].index("metabolic")]
    assert ((power < -0.5) & (power > -60.0)).all()


class Silent(MujocoMuscle):
    """A muscle with more state than the package knows of."""

    STATE = (*MujocoMuscle.STATE, "more")

    def __init__(self, *args):
        super().__init__(*args)
        self.more = wp.zeros_like(self.activation)


@pytest.mark.usefixtures("registered")
def test_a_muscle_that_tells_nothing_of_its_fibers_is_refused():
    MUSCLES.add("silent", Silent)
    with pytest.raises(ValueError, match=r"^bhargava2004 needs a muscle model that tells .*, got Silent$"):
        Simulation(Setup(task=KEY, muscle="silent", device="cpu"), 1)

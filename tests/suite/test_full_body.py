"""The whole body, and bodies of the package by their names in place of a file."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from stepping import repeated_step

from myowarp.definitions.body import BODIES
from myowarp.definitions.setup import Setup
from myowarp.models.bodies.from_file import register_body
from myowarp.sim import memory
from myowarp.sim.simulation import Simulation
from myowarp.tasks.from_file import from_mjcf
from myowarp.tasks.setups import complete

FULL = "full_body"
NUM_WORLDS, NUM_STEPS = 3, 25
QPOS_TOLERANCE = 1e-5  # rad, m; median over coordinates after 25 steps of 2 ms
WORST = 1e-3  # rad, m


def simulation(num_worlds, **options):
    """Return a simulation of the whole body."""
    setup = complete(Setup(task=Path(FULL)))
    return Simulation(setup, num_worlds, device="cpu", progress=False, **options)


def test_a_body_stands_for_a_file():
    """By its name, with its own facts; a task may steer other sites than the body's."""
    assert register_body(Path("elbow"))[0] == "elbow"
    task = from_mjcf("elbow", "elbowByName-v0", replace=True)
    assert task.body == "elbow"
    assert (task.physics_dt, len(task.target_low)) == (BODIES["elbow"].build().option.timestep, 1)
    reach = from_mjcf("finger", "fingerByName-v0", "reach", targets={"IFtip": None}, replace=True)
    assert BODIES[reach.body].tips == ("IFtip",)
    assert BODIES[reach.body].groups == BODIES["finger"].groups


def test_a_file_of_that_name_comes_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("elbow").write_text("no model")
    with pytest.raises(ValueError, match="must be an MJCF file"):
        register_body(Path("elbow"))


def test_what_is_neither_file_nor_body():
    with pytest.raises(
        ValueError, match=r"must be an MJCF file; MuJoCo says: .*; bodies are arm, .*full_body"
    ):
        register_body(Path("ful_body"))


def test_left_and_right_are_twins():
    """Each muscle of a side has one on the other, in the group of the same name, that tires as fast."""
    body = BODIES[FULL]
    model = body.build().compile()
    muscles = [model.actuator(i).name for i in range(model.nu)]
    assert (model.nu, model.nv, model.neq) == (416, 128, 51)
    rights = [name for name in muscles if not name.endswith("_l")]
    assert len(rights) == 208
    for name in rights:
        plain = name.removesuffix("_r")
        assert f"{plain}_l" in muscles
        side, _, group = body.group_of(name).partition(" ")
        assert (side, body.group_of(f"{plain}_l")) == ("right", f"left {group}"), name
        assert body.fatigue_rates.get(plain) == body.fatigue_rates.get(f"{plain}_l")
    assert sum(name.removesuffix("_r") in body.fatigue_rates for name in rights) == 63 + 15


@pytest.mark.slow
def test_moves_like_mujoco():
    """Random excitations, from the task's start, with all equalities and contacts."""
    sim = simulation(NUM_WORLDS, graph=False)
    sim.reset(seeds=np.arange(NUM_WORLDS))
    model = sim.scene.oracle
    ctrl = np.random.default_rng(0).uniform(0.0, 0.5, (NUM_WORLDS, model.nu)).astype(np.float32)
    sim.scene.data.ctrl.assign(ctrl)
    start = sim.scene.data.qpos.numpy().astype(float)
    step = repeated_step(sim.scene, sim.shards[0].stages)
    for _ in range(NUM_STEPS):
        step()
    for world in range(NUM_WORLDS):
        data = mujoco.MjData(model)
        data.qpos[:], data.ctrl[:] = start[world], ctrl[world]
        mujoco.mj_step(model, data, NUM_STEPS)
        error = np.abs(sim.scene.data.qpos.numpy()[world] - data.qpos)
        assert np.median(error) < QPOS_TOLERANCE
        assert error.max() < WORST
        assert np.abs(data.qpos - start[world]).max() > 100 * WORST


@pytest.mark.slow
def test_random_actions_break_nothing():
    sim = simulation(2)
    sim.reset(seeds=np.arange(2))
    rng = np.random.default_rng(0)
    for _ in range(500):
        sim.action.assign(rng.uniform(-1.0, 1.0, sim.action.shape).astype(np.float32))
        sim.step()
        assert not sim.transition.fault.numpy().any()
    assert np.isfinite(sim.transition.obs.numpy()).all()


@pytest.mark.slow
def test_too_many_worlds_are_refused_before_they_are_made(monkeypatch):
    """Where memory is short; a world takes 0.8 MB."""
    monkeypatch.setattr(memory, "available_memory", lambda device: 2_000_000_000)
    with pytest.raises(ValueError, match=r"3,000 worlds need at least .* GB of memory, got 2.0 GB on cpu"):
        simulation(3000)

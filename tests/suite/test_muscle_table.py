"""Parameters of muscles beside the compiled model, and muscle models from outside the package."""

import re
import shutil
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import myowarp
from myowarp.definitions.muscle import MUSCLES
from myowarp.definitions.muscle_table import MuscleTable
from myowarp.definitions.task import PHYSICS, TASKS
from myowarp.definitions.worlds import Worlds
from myowarp.models.muscles.mujoco import MujocoMuscle
from myowarp.sim.build import num_substeps_of
from myowarp.sim.signals import Signals
from myowarp.sim.simulation import Simulation
from myowarp.tasks.outside import load

TASK = "myoElbowPose1D6MRandom-v0"
NAMES = ("a_r", "b", "c")
WORLDS = Worlds.all(4)


def test_values_of_every_shape():
    by_world = np.array([[1.0], [2.0], [3.0], [4.0]])
    table = MuscleTable(
        parameters={
            "max_isometric_force": 7.0,
            "optimal_fiber_length": by_world,
            "max_contraction_velocity": np.array([[1.0, 2.0, 3.0]]),
            "passive_multiplier": {"a": [1.0, 2.0, 3.0, 4.0], "c": 5.0},
            "tendon_slack_length": {"b": -0.1},
        }
    )
    got = table.of(NAMES, WORLDS)
    nan = np.nan
    assert np.array_equal(got["max_isometric_force"], [[7.0, 7.0, 7.0]])
    assert np.array_equal(got["optimal_fiber_length"], np.repeat(by_world, 3, axis=1))
    assert np.array_equal(got["max_contraction_velocity"], [[1.0, 2.0, 3.0]])
    expected = [[1.0, nan, 5.0], [2.0, nan, 5.0], [3.0, nan, 5.0], [4.0, nan, 5.0]]
    assert np.array_equal(got["passive_multiplier"], expected, equal_nan=True)
    assert np.array_equal(got["tendon_slack_length"], [[nan, -0.1, nan]], equal_nan=True)
    part = table.of(NAMES, WORLDS.split(2)[1])
    assert np.array_equal(part["optimal_fiber_length"], by_world[2:].repeat(3, axis=1))
    assert part["max_isometric_force"].shape == (1, 3)


def test_a_body_has_a_table_of_its_own(monkeypatch):
    """What is given goes before; Hill parameters are for models that take them, as far as they know them."""
    given = MuscleTable(parameters={"max_isometric_force": {"b": 5.0}})
    own = {"max_isometric_force": {"a": 1.0, "b": 2.0}, "optimal_fiber_length": {"c": 0.1}}
    got = given.over(MuscleTable(parameters=own), NAMES, WORLDS)
    assert np.array_equal(got["max_isometric_force"], [[1.0, 5.0, np.nan]], equal_nan=True)
    assert np.array_equal(got["optimal_fiber_length"], [[np.nan, np.nan, 0.1]], equal_nan=True)
    hill = MuscleTable("", own | {"pennation_angle_at_optimal": {"a": 0.2}})
    assert given.over(hill, NAMES, WORLDS).keys() == {"max_isometric_force"}
    monkeypatch.setattr(MujocoMuscle, "TAKES_HILL", True)
    assert given.over(hill, NAMES, WORLDS).keys() == own.keys()


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"force": 1.0}, "parameter of muscle model 'mujoco' 'force' unknown; available: activation_time"),
        ({"max_isometric_force": -1.0}, "must be finite and from 0 to inf, got -1.0"),
        ({"max_isometric_force": "strong"}, "must be finite and from 0 to inf, got strong"),
        ({"max_isometric_force": np.nan}, "must be finite and from 0 to inf, got nan"),
        ({"max_isometric_force": 1e39}, "must be finite and from 0 to inf, got 1e+39"),
        (
            {"max_isometric_force": np.ones(4)},
            "shape (1 or 4, 1 or 3) or a mapping from muscles, got shape (4,)",
        ),
        ({"max_isometric_force": np.ones((2, 3))}, "got shape (2, 3)"),
        ({"max_isometric_force": {"a": [1.0, 2.0]}}, "a number or one for each of 4 worlds, got shape (2,)"),
        ({"max_isometric_force": {"a": 0.0, "x": 1.0}}, "muscle 'x' unknown; available: a_r, b, c"),
        (
            {"eccentric_multiplier": {"a": 0.5}},
            "eccentric_multiplier of muscle 'a' must be finite and from 1",
        ),
    ],
)
def test_errors(parameters, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        MuscleTable("mujoco", parameters).of(NAMES, WORLDS)


def test_unknown_model():
    with pytest.raises(ValueError, match="muscle model 'hil' unknown"):
        MuscleTable("hil")


def test_csv(tmp_path):
    path = tmp_path / "patient.csv"
    text = "\ufeffmuscle,max_isometric_force,smoothing_width\na,400,\nb,,0.1\n"
    for delimiter in ",;\t":
        path.write_text(text.replace(",", delimiter), encoding="utf-8")  # with the mark that Excel puts first
        got = MuscleTable.read("mujoco", path).of(NAMES, WORLDS)
        assert np.array_equal(got["max_isometric_force"], [[400.0, np.nan, np.nan]], equal_nan=True)
        assert np.array_equal(got["smoothing_width"], [[np.nan, 0.1, np.nan]], equal_nan=True)
    for text, message in (
        ("muscle;smoothing_width\na;0,1\n", "smoothing_width of muscle 'a' must be a number, got '0,1'"),
        ("name,max_isometric_force\na,1\n", "must have a column 'muscle', got name, max_isometric_force"),
        ("muscle,max_isometric_force\na,1\na,2\n", "one row for each muscle, got two of 'a'"),
        ("muscle,max_isometric_force\na,x\n", "max_isometric_force of muscle 'a' must be a number, got 'x'"),
        ("muscle,max_isometric_force\na,1,2\n", "must have 2 cells in each row, got more"),
        ("muscle,max_isometric_force,max_isometric_force\n", "one column 'max_isometric_force', got 2"),
        ("muscle,max_isometric_force\n\udcff,1\n", "patient.csv is not UTF-8 text"),
        ("muscle,force\na,\n", "parameter of muscle model 'mujoco' 'force' unknown"),
    ):
        path.write_text(text, encoding="utf-8", errors="surrogateescape")
        with pytest.raises(ValueError, match=re.escape(message)):
            MuscleTable.read("mujoco", path)


def run(muscle, shards, steps=5):
    """Return tensions of five elbows after some steps of full action."""
    sim = Simulation(
        TASKS[TASK], 5, shards=shards, device="cpu", muscle=muscle, reset="fixed", autoreset="disabled"
    )
    sim.reset(seeds=np.arange(5))
    signals = Signals(sim)
    sim.action.fill_(1.0)
    for _ in range(steps):
        sim.step()
    sim.close()
    return sim, signals.muscles.force.numpy().copy()


def test_worlds_have_muscles_of_their_own():
    factors = np.array([1.0, 1.0, 0.5, 2.0, 1.0])[:, None]
    healthy_sim, healthy = run("mujoco", 1)
    own = healthy_sim.scene.muscles.params.max_isometric_force.numpy()
    table = MuscleTable("mujoco", {"max_isometric_force": own * factors})
    (_, whole), (_, split) = run(table, 1), run(table, 2)
    assert np.array_equal(whole, split)
    same = factors[:, 0] == 1.0
    assert np.array_equal(whole[same], healthy[same])
    assert np.abs(whole[~same] / healthy[~same] - 1.0).max(axis=1).min() > 0.2


def test_gymnasium_takes_a_table():
    table = MuscleTable.by_muscle("mujoco_readable", {"BIClong": {"activation_time_constant": 0.03}})
    env = gym.make_vec(f"MyoWarp/{TASK}", num_envs=2, device="cpu", muscle=table, progress=False)
    muscles = env.unwrapped.sim.scene.muscles
    column = muscles.names.index("BIClong")
    assert type(muscles) is MujocoMuscle
    constants = muscles.activation_time_constant.numpy()
    assert constants[0, column] == np.float32(0.03)
    assert np.all(np.delete(constants, column, axis=1) == np.float32(0.01))
    env.close()


def test_command_lists_the_choices(run):
    status, text, _ = run("rollout", "--help")
    assert status == 0
    assert "--muscle {" in text
    assert all(name in text for name in MUSCLES)


@pytest.fixture
def elastic(tmp_path, registered):
    """Register a muscle model from a file of its own; return its name."""
    path = shutil.copy(Path(__file__).parents[1] / "outside" / "muscle.py", tmp_path)
    return load(str(path)) and "outside_elastic"


@pytest.mark.parametrize("shards", [1, 2])
def test_a_model_with_state_from_outside(elastic, shards):
    _, stiff = run("mujoco", 1, steps=1)
    sim, force = run(elastic, shards, steps=1)
    muscles, state = sim.scene.muscles, sim.scene.muscles.state
    assert set(state) == {"activation", "tendon_force"}
    assert state["tendon_force"].shape == (5, 6, 1)
    strong = stiff > 0.1 * stiff.max()
    assert np.all(force[strong] < 0.8 * stiff[strong])  # it lags behind
    assert np.array_equal(force, state["tendon_force"].numpy()[..., 0])  # and signals leave it as it is

    before = state["tendon_force"].numpy().copy()
    mask = np.array([True, False, True, False, True])
    sim.reset(mask)
    after = state["tendon_force"].numpy()
    assert np.all(after[mask] == 0.0)
    assert np.array_equal(after[~mask], before[~mask])
    assert before.max() > 1.0

    poisoned = after.copy()
    poisoned[3, 2] = np.nan
    muscles.tendon_force.assign(poisoned)
    sim.step()
    assert sim.transition.fault.numpy().tolist() == [0, 0, 0, myowarp.kernels.episode.FAULT_NONFINITE, 0]
    assert np.isfinite(state["tendon_force"].numpy()).all()  # the world was reset at once


def test_no_step_is_longer_than_it_stands(elastic, monkeypatch):
    monkeypatch.setattr(MUSCLES[elastic], "coarse_step", 0.003)
    spec = TASKS[TASK]
    assert [num_substeps_of(spec, PHYSICS["fast"], name) for name in ("mujoco", elastic)] == [2, 7]
    assert num_substeps_of(spec, PHYSICS["parity"], elastic) == spec.num_substeps


def test_state_must_be_float32_by_world_and_muscle(elastic, monkeypatch):
    elastic_muscle = MUSCLES[elastic]

    def allocate(self, model, num_worlds, parameters=None):
        MujocoMuscle.__init__(self, model, num_worlds, parameters)
        self.tendon_force = self.activation.reshape((num_worlds * len(self.names),))

    monkeypatch.setattr(elastic_muscle, "__init__", allocate)
    message = "must be float32 of shape (5, 6) or more dimensions, got float32 of shape (30,)"
    with pytest.raises(ValueError, match=re.escape(message)):
        run(elastic, 1)

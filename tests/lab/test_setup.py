"""A setup: what is put over what, what it is as JSON, and that every command takes it whole."""

import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from myowarp.apps.cli.main import COMMANDS
from myowarp.definitions.muscle import MUSCLES
from myowarp.definitions.muscle_table import MuscleTable
from myowarp.definitions.setup import DEFAULTS, OPTIONS, Setup
from myowarp.models.conditions import Sarcopenia
from myowarp.sim import build
from myowarp.sim.simulation import Simulation
from myowarp.tasks.setups import complete

pytestmark = pytest.mark.usefixtures("registered")

ELBOW = "myoElbowPose1D6MRandom-v0"
ARGUMENTS = {
    "rollout": (ELBOW,),
    "record": (ELBOW, "--output", "{folder}/film.png"),
    "describe": (ELBOW,),
    "view": (ELBOW, "--port", "0"),
    "warmup": (ELBOW,),
    "adapt": (ELBOW, "--policies", "zero", "--conditions", "sarcopenia", "--output", "{folder}/adapt"),
    "audit": (ELBOW, "--output", "{folder}/audit"),
    "cohort": ("{folder}/patients.csv", "--task", ELBOW, "--output", "{folder}/cohort"),
    "plot": ("force-length", ELBOW, "--output", "{folder}/plot.png"),
    "train": (ELBOW, "--output", "{folder}/run"),
    "improve": (f"baselines/{ELBOW}", "--output", "{folder}/improved"),
    "gait": (ELBOW, "--population", "4", "--generations", "1", "--output", "{folder}/gait"),
    "eval": (f"baselines/{ELBOW}",),
    "score": (ELBOW, "--policy", "zero", "--output", "{folder}/score"),
    "reproduce": ("exo1", "--quick", "--output", "{folder}/exo1"),
}
"""Least arguments of the commands that run a model."""


def options_of(name, run):
    """Return the help of a command."""
    status, out, _ = run(name, "--help")
    assert status == 0
    return out


@pytest.fixture
def muscles(monkeypatch):
    """Return what muscles were asked for; nobody gets any."""
    asked = []

    def note(table, *rest):
        asked.append(table)
        raise ValueError("muscles are about to be made")

    monkeypatch.setattr(build, "new_muscles", note)
    return asked


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_that_runs_a_model_takes_a_muscle_and_its_parameters(name, run, muscles, tmp_path):
    options = options_of(name, run)
    if "--muscle " not in options:
        assert name not in ARGUMENTS
        return
    parameters = tmp_path / "muscles.csv"
    parameters.write_text("muscle,max_isometric_force\nBIClong,77\n")
    (tmp_path / "patients.csv").write_text("patient,strength\nweak,0.5\n")
    other = next(model for model in MUSCLES if model != DEFAULTS.muscle)
    words = [word.format(folder=tmp_path) for word in ARGUMENTS[name]]
    words += ["--device", "cpu"] if "--device" in options else []
    run(name, *words, "--muscle", other, "--muscle-parameters", parameters)
    assert muscles, f"myowarp {name} builds no muscles"
    assert {table.model for table in muscles} == {other}
    assert all(table.parameters == {"max_isometric_force": {"BIClong": 77.0}} for table in muscles)


def test_what_is_said_is_put_over_the_rest():
    base = Setup(task=ELBOW, physics="fast", conditions=("sarcopenia",), seed=4)
    found = Setup(physics="parity", conditions=(), shards=1).over(base)
    assert (found.task, found.physics, found.conditions, found.seed) == (ELBOW, "parity", (), 4)
    assert found.over(DEFAULTS).reset == "task"
    assert Setup().over(base) == base


def test_json_and_back():
    setup = Setup(
        physics="fast", muscle="mujoco", conditions=("sarcopenia(strength=0.3)",), seed=0, horizon=7
    )
    assert Setup.from_plain(setup.plain()) == setup
    remembers = Setup(conditions=(), observe=("history=8", "parameters"))
    assert Setup.from_plain(json.loads(json.dumps(remembers.plain()))) == remembers
    assert remembers.plain() == json.loads(json.dumps(remembers.plain()))
    parts = Setup(muscle=MuscleTable("mujoco"), conditions=(Sarcopenia(), "fatigue_3ccr"))
    assert parts.plain()["conditions"] == ["fatigue_3ccr"]
    assert parts.plain()["muscle"] == "mujoco"


def test_a_new_option_is_recorded_too():
    @dataclass(frozen=True, kw_only=True)
    class Tilted(Setup):
        tilt: float | None = None

    assert Tilted(tilt=0.2).plain() == Setup().plain() | {"tilt": 0.2}
    assert Tilted.from_plain(Tilted(tilt=0.2).plain()) == Tilted(tilt=0.2, conditions=())
    assert Setup().plain().keys() == OPTIONS.keys() - {"task", "shards", "rank"}


def test_a_file_of_before_says_nothing_where_it_is_empty():
    assert Setup.from_plain({"reset": "", "device": "", "seed": 3, "samples": 8}) == Setup(seed=3)


def test_an_id_brings_its_reset_and_conditions():
    found = complete(Setup(task="myoSarcElbowPose1D6MRandom-v0", conditions=("fatigue_3ccr",)))
    assert (found.task, found.conditions) == (ELBOW, ("sarcopenia", "fatigue_3ccr"))
    assert complete("paperElbowPoseHardN-v0").reset == "none"
    assert complete(Setup(task="paperElbowPoseHardN-v0", reset="fixed")).reset == "fixed"
    assert complete(found) == found


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"physics": "slow"}, "physics 'slow' unknown; available: parity, fast"),
        ({"reset": "never"}, "reset 'never' unknown; available: task, fixed, random, none"),
        ({"muscle": "steel"}, "muscle model 'steel' unknown; available: mujoco"),
        ({"seed": -1}, "--seed must be at least 0, got -1"),
        ({"shards": 0}, "--shards must be at least 1, got 0"),
        ({"horizon": 0}, "horizon must be a positive integer, got 0"),
        ({"device": "tpu"}, "device must be cpu, cuda or cuda:N, got 'tpu'"),
        ({"conditions": ("sarcopeny",)}, "condition 'sarcopeny' unknown; did you mean sarcopenia?"),
        ({"task": None}, "what to run is a task id or --model with a file, one of them; got neither"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_built(fields, message):
    with pytest.raises(ValueError, match=message):
        complete(Setup(**{"task": ELBOW} | fields))


def test_a_simulation_carries_its_setup():
    setup = complete(Setup(task=ELBOW, horizon=3, device="cpu", shards=2))
    sim = Simulation(setup, 8)
    assert (len(sim.shards), sim.horizon, sim.setup) == (2, 3, setup)
    assert len(Simulation(setup, 8, shards=1).shards) == 1


def test_options_are_documented():
    for name, option in OPTIONS.items():
        assert option.metadata["text"].endswith("."), name
        assert f"{name}: {option.metadata['text']}" in Setup.__doc__
    assert Path("x") == Setup(task=Path("x")).task

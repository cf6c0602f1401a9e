"""The newest checkpoint of a run acts while the run goes on, and a broken one never does."""

import json
import shutil

import numpy as np
import pytest

from myowarp.apps.cli.options import Said
from myowarp.apps.cli.view import View, note_on
from myowarp.apps.policies import follow
from myowarp.apps.policies.baselines import FOLDER as BASELINES
from myowarp.apps.policies.checkpoint import POLICY, Checkpoint, CheckpointError, load_checkpoint, save_policy
from myowarp.apps.policies.follow import Following, is_run
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.process import warn_once
from myowarp.sim.simulation import Simulation

KEY = "myoElbowPose1D6MFixed-v0"


@pytest.fixture(scope="module")
def sim():
    return Simulation(Setup(task=KEY, device="cpu"), 2, progress=False)


def write(run, samples, shift):
    """Write a checkpoint whose actions are a number, below its bound by a hyperbolic tangent."""
    trained = load_checkpoint(BASELINES / KEY)
    policy = {name: array.copy() for name, array in trained.policy.items()}
    last = max(int(name.split(".")[1]) for name in policy if name.startswith("net."))
    policy[f"net.{last}.weight"][:] = 0.0
    policy[f"net.{last}.bias"][:] = np.arctanh(shift)
    assert trained.manifest["policy"]["mean_bound"] == "tanh"
    folder = run / "checkpoints" / f"{samples:012d}"
    folder.mkdir(parents=True)
    save_policy(folder, Checkpoint(folder, trained.manifest, policy))
    return folder


def test_the_next_checkpoint_acts_as_soon_as_it_is_whole(sim, tmp_path, monkeypatch, caplog):
    warn_once.cache_clear()
    monkeypatch.setattr(follow, "LOOK", 0.0)
    obs = sim.transition.obs.numpy()
    write(tmp_path, 1000, 0.25)
    act = Following(tmp_path, sim)
    np.testing.assert_allclose(act(obs), 0.25, atol=1e-6)
    whole = write(tmp_path, 2000, -0.5)
    hidden = whole.rename(whole.with_name("000000002000.part"))  # it is being written
    np.testing.assert_allclose(act(obs), 0.25, atol=1e-6)
    hidden.rename(whole)
    np.testing.assert_allclose(act(obs), -0.5, atol=1e-6)
    broken = write(tmp_path, 3000, 0.75)
    (broken / POLICY).write_bytes((broken / POLICY).read_bytes()[:100])
    for _ in range(2):
        np.testing.assert_allclose(act(obs), -0.5, atol=1e-6)
    (line,) = [record.message for record in caplog.records if "acts on" in record.message]
    assert "damaged" in line
    shutil.rmtree(broken)
    write(tmp_path, 4000, 0.75)
    np.testing.assert_allclose(act(obs), 0.75, atol=1e-6)
    assert note_on(str(tmp_path), TASKS[KEY]).endswith("; its policy of 4000 samples acts.")


def test_a_run_in_place_of_a_task_is_its_task_and_policy(tmp_path):
    write(tmp_path, 1000, 0.25)
    assert is_run(str(tmp_path))
    command = View(Said(Setup(task=str(tmp_path), device="cpu"))).of_run()
    assert command.policy == str(tmp_path)
    assert command.title == KEY
    assert View(Said(Setup(task=KEY))).of_run() is None


def test_a_run_without_a_whole_checkpoint_is_one_sentence(tmp_path):
    folder = write(tmp_path, 1000, 0.25)
    folder.rename(folder.with_name("000000001000.part"))
    with pytest.raises(CheckpointError, match="holds no checkpoint"):
        View(Said(Setup(task=str(tmp_path))))()
    folder = write(tmp_path, 2000, 0.25)
    (folder / "manifest.json").write_text(json.dumps({}))
    with pytest.raises(CheckpointError, match="checkpoint"):
        View(Said(Setup(task=str(tmp_path))))()

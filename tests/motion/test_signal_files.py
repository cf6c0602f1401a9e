"""Recordings of signals: what pandas and NumPy read back, long ones, failed ones."""

import contextlib
import json
import re

import numpy as np
import pytest

from myowarp.apps.policies.find import Policy
from myowarp.apps.rollouts import recording as record
from myowarp.apps.rollouts.recording import recording, sample_of
from myowarp.apps.rollouts.rollout import roll_out
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.task import TASKS
from myowarp.extras import to_install
from myowarp.sim.signals import JOINT_UNITS, UNITS
from myowarp.sim.simulation import Simulation

ELBOW = "myoElbowPose1D6MRandom-v0"


def simulation(key, num_worlds=3, **options):
    settings = {"device": "cpu", "autoreset": "same_step", "progress": False} | options
    return Simulation(TASKS[key], num_worlds, **settings)


def steps(sim, count):
    """Reset and step with random actions, each world's its own; yields after every step."""
    n = sim.num_worlds
    sim.reset(seeds=np.arange(n))
    for step in range(count):
        draws = [
            np.random.default_rng((world, step)).uniform(-1, 1, sim.action.shape[1]) for world in range(n)
        ]
        sim.action.assign(np.array(draws, dtype=np.float32))
        sim.step()
        yield step


def recorded(path, every=1, count=7, horizon=3, conditions=(), **options):
    """Record a rollout; return the signals and all samples, taken by hand."""
    sim = simulation(ELBOW, horizon=horizon, conditions=conditions, **options)
    samples = []
    with recording(sim, path, every) as recorder:
        for _ in steps(sim, count):
            recorder.add()
            samples.append(sample_of(recorder.signals))
    return recorder.signals, {name: np.stack([sample[name] for sample in samples]) for name in samples[0]}


def test_npz_reads_back(tmp_path):
    path = tmp_path / "run.npz"
    signals, samples = recorded(path, every=2, autoreset="next_step")
    with np.load(path) as saved:
        assert set(saved.files) == {*samples, "muscles", "groups", "joints", "control_dt"}
        for name, values in samples.items():
            expected = values[1::2].copy()
            if values.ndim == 3:
                expected[~samples["valid"][1::2]] = np.nan
            np.testing.assert_array_equal(saved[name], expected, err_msg=name)
        assert saved["muscles"].tolist() == list(signals.names)
        assert saved["groups"].tolist() == 3 * ["elbow extensors"] + 3 * ["elbow flexors"]
        assert saved["joints"].tolist() == ["r_elbow_flex"]
        assert saved["control_dt"] == 0.02
        assert not saved["valid"].all()
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_mode & 0o444 == 0o444


def test_parquet_reads_back_in_pandas(tmp_path):
    """Every row is the sample of its world, episode, time and muscle; worlds in reset are left out."""
    pd = pytest.importorskip("pandas")
    path = tmp_path / "run.parquet"
    signals, samples = recorded(
        path, conditions=("fatigue_ma2009", "exoskeleton"), autoreset="next_step", horizon=3
    )
    table, joints = pd.read_parquet(path), pd.read_parquet(tmp_path / "run_joints.parquet")
    assert list(table) == ["world", "episode", "time", "muscle", "group", *UNITS, "fatigue", "exo_torque"]
    assert list(joints) == ["world", "episode", "time", "joint", *JOINT_UNITS]
    assert table["muscle"].cat.categories.tolist() == list(signals.names)
    assert table["group"].cat.categories.tolist() == ["elbow extensors", "elbow flexors"]
    assert len(table) == samples["valid"].sum() * 6 == 6 * len(joints) < 7 * 3 * 6
    keyed = table.set_index(["world", "episode", "time", "muscle"])
    assert keyed.index.is_unique
    for (sample, world), valid in np.ndenumerate(samples["valid"]):
        if valid:
            where = (world, samples["episode"][sample, world], samples["time"][sample, world])
            for name in [*UNITS, "fatigue", "exo_torque"]:
                found = [keyed.loc[(*where, muscle), name] for muscle in signals.names]
                np.testing.assert_array_equal(found, samples[name][sample, world].astype(np.float32))
    assert table["fatigue"].max() > 0
    assert table["exo_torque"].abs().max() > 0.1
    assert joints["angle"].tolist() == samples["angle"][samples["valid"]][:, 0].tolist()
    means = table.groupby(["group", "time"], observed=True)["force"].mean()
    assert means.shape == (2 * 3,)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.parquet", "run_joints.parquet"]


def test_parquet_says_its_units(tmp_path):
    pq = pytest.importorskip("pyarrow.parquet")
    recorded(tmp_path / "run.parquet", count=1)
    schema = pq.read_schema(tmp_path / "run.parquet")
    assert schema.field("power").metadata == {b"unit": b"W"}
    assert json.loads(schema.metadata[b"units"]) == UNITS | {"time": "s"}


@pytest.mark.parametrize("suffix", ["npz", "parquet"])
def test_long_recordings_go_to_disk_in_pieces(tmp_path, monkeypatch, suffix):
    """Pieces or not, the file has the same contents."""
    if suffix == "parquet":
        pd = pytest.importorskip("pandas")
    recorded(tmp_path / f"whole.{suffix}", every=2)
    monkeypatch.setattr(record, "CHUNK", 2 * 3 * 6)
    written, opened = [], record.FORMATS[f".{suffix}"]

    @contextlib.contextmanager
    def counting(*arguments):
        with opened(*arguments) as write:
            yield lambda samples: (written.append(len(samples["time"])), write(samples))

    monkeypatch.setitem(record.FORMATS, f".{suffix}", counting)
    recorded(tmp_path / f"pieces.{suffix}", every=2)
    assert written == [2, 1]
    if suffix == "parquet":
        pd.testing.assert_frame_equal(
            pd.read_parquet(tmp_path / "whole.parquet"), pd.read_parquet(tmp_path / "pieces.parquet")
        )
    else:
        with np.load(tmp_path / "whole.npz") as whole, np.load(tmp_path / "pieces.npz") as pieces:
            assert whole.files == pieces.files
            for name in whole.files:
                np.testing.assert_array_equal(whole[name], pieces[name])


@pytest.mark.parametrize("suffix", ["npz", "parquet"])
def test_a_failed_rollout_leaves_the_older_file(tmp_path, suffix, monkeypatch):
    if suffix == "parquet":
        pytest.importorskip("pyarrow")
    monkeypatch.setattr(record, "CHUNK", 1)
    path = tmp_path / f"run.{suffix}"
    path.write_bytes(b"older")
    sim = simulation(ELBOW)

    def fail():
        with recording(sim, path) as recorder:
            for step in steps(sim, 4):
                recorder.add()
                if step == 2:
                    raise RuntimeError("the policy gave up")

    with pytest.raises(RuntimeError, match="the policy gave up"):
        fail()
    assert path.read_bytes() == b"older"
    assert list(tmp_path.iterdir()) == [path]


def test_rollout_records(tmp_path):
    """What `myowarp rollout --signals` does."""
    path = tmp_path / "run.npz"
    env = MyoWarpVectorEnv(ELBOW, 2, device="cpu", autoreset_mode="same_step", max_episode_steps=4)
    with recording(env.sim, path) as recorder:
        roll_out(env.sim, Policy("random"), 6, recorder)
    with np.load(path) as saved:
        np.testing.assert_allclose(saved["time"][:, 0], 0.02 * np.array([1, 2, 3, 4, 1, 2]))
        assert saved["episode"][:, 1].tolist() == [1, 1, 1, 1, 2, 2]
        assert saved["force"].shape == (6, 2, 6)
        assert saved["force"].max() > 1


def test_command(tmp_path, run):
    path = tmp_path / "run.npz"
    arguments = ("--signals", path, "--signals-every", 2, "--num-worlds", 3, "--steps", 6, "--device", "cpu")
    status, _, err = run("rollout", ELBOW, "--policy", "hold", *arguments)
    assert status == 0
    assert f"Saved {path}" in err.replace("\n", "")
    assert "6/6" in err
    with np.load(path) as saved:
        np.testing.assert_allclose(saved["time"], np.repeat([[0.04], [0.08], [0.12]], 3, axis=1))


@pytest.mark.parametrize(
    ("name", "every", "message"),
    [
        ("run.txt", 1, r"^output '.*run\.txt' must end in \.parquet or \.csv or \.npz or \.sto$"),
        ("run.npz", 0, r"^every must be a positive number of control steps, got 0$"),
        ("run.npz", 1.5, r"^every must be a positive number of control steps, got 1\.5$"),
    ],
)
def test_bad_recordings(tmp_path, name, every, message):
    sim = simulation(ELBOW, num_worlds=1, graph=False)
    with pytest.raises(ValueError, match=message), recording(sim, tmp_path / name, every):
        pass
    assert not list(tmp_path.iterdir())


def test_parquet_without_pyarrow(tmp_path, monkeypatch):
    monkeypatch.setattr(record.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(
        ImportError,
        match=r"^output '.*run\.parquet' needs pyarrow, which is not installed; "
        rf"run {re.escape(to_install('cohort'))} or write \.npz$",
    ):
        record.check_recording(tmp_path / "run.parquet", 1)

"""A cohort in chunks over a cluster is that of one process, bit for bit, whatever dies meanwhile."""

import contextlib
import json
import os

import numpy as np
import pytest
from clusters import PATIENCE, fill_store, kill_worker, replace_node, start, wait_until

pd = pytest.importorskip("pandas")
dataset = pytest.importorskip("pyarrow.dataset")

from myowarp.apps.studies.cohort import chunks, run_cohort  # noqa: E402
from myowarp.disk import locked  # noqa: E402

ELBOW = "myoElbowPose1D6MRandom-v0"
STEPS = 12


def patients(path, number):
    """Write a table of patients of every kind; few have torn tendons, some chunks none."""
    rng = np.random.default_rng(number)
    columns = {
        "patient": [f"patient {i}" for i in range(number)],
        "strength": rng.uniform(0.3, 1.0, number),
        "fatigue_rate": rng.uniform(0.0, 0.2, number),
        "noise_signal": rng.uniform(0.0, 0.2, number),
        "tendon_tear": ["BRA+TRIlat" if i == number // 2 else "" for i in range(number)],
        "load_mass": rng.uniform(0.0, 2.0, number),
    }
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def command(table, output, *options):
    """Return the command of a cohort in chunks."""
    task = ("--task", ELBOW, "--steps", STEPS, "--seed", 3, "--device", "cpu")
    return ("cohort", table, *task, "--output", output, "--ray", *options)


def finished(output):
    """Return how many chunks are done."""
    return len(list((output / "summary").glob("part-*.parquet")))


def check_same(output, table, **options):
    """Compare a dataset with the cohort in one process, bit for bit."""
    one = run_cohort(table, ELBOW, steps=STEPS, seed=3, device="cpu", **options)
    for folder, frame in (("results", one.samples), ("summary", one.summary)):
        parts = dataset.dataset(output / folder).to_table().to_pandas()
        assert list(parts) == list(frame)
        for name in frame:
            mine, other = parts[name], frame[name]
            if mine.dtype.kind in "fib":
                np.testing.assert_array_equal(mine.to_numpy(), other.to_numpy(), err_msg=name)
            else:
                assert mine.fillna("").tolist() == other.astype(object).fillna("").tolist(), name
    assert len(one.summary["strength"].unique()) > 1
    assert one.samples["total_force"].nunique() > len(one.summary)


@pytest.mark.slow
def test_chunks_over_two_nodes_are_the_cohort(cluster, tmp_path):
    table, output = patients(tmp_path / "patients.csv", 37), tmp_path / "out"
    process = start(*command(table, output, "--chunk", 16, "--trials", 2, "--address", cluster.address))
    said, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, said
    assert finished(output) == 3
    check_same(output, table, trials=2)


@pytest.mark.scale
def test_ten_thousand_patients_once_each_whatever_dies(cluster, tmp_path):
    table, output = patients(tmp_path / "patients.csv", 10_000), tmp_path / "out"
    words = command(table, output, "--chunk", 250, "--address", cluster.address)
    full = fill_store(cluster)
    first = start(*words)
    wait_until(lambda: finished(output) >= 4 and kill_worker(cluster), first)
    wait_until(lambda: finished(output) >= 10, first)
    replace_node(cluster)
    wait_until(lambda: finished(output) >= 18, first)
    first.kill()
    first.communicate()
    full.communicate()
    before = {path.name: path.stat().st_ino for path in (output / "summary").iterdir()}
    assert 18 <= len(before) < 40
    second = start(*words)
    said, _ = second.communicate(timeout=PATIENCE)
    assert second.returncode == 0, said
    after = {path.name: path.stat().st_ino for path in (output / "summary").iterdir()}
    assert before.items() <= after.items()
    assert "10,000 rows of 10,000 patients" in said
    check_same(output, table)


@pytest.mark.slow
def test_damaged_chunks_are_simulated_again(run, tmp_path, monkeypatch):
    """Without Ray: the chunks are simulated here, one after the other."""
    simulated = []

    def each(work, pieces, **options):
        for name, arguments in pieces:
            simulated.append(name)
            yield name, work(*arguments), ""

    monkeypatch.setattr(chunks, "each", each)
    monkeypatch.setattr(chunks, "connected", lambda address, folder: contextlib.nullcontext())
    table, output = patients(tmp_path / "patients.csv", 12), tmp_path / "out"
    words = command(table, output, "--chunk", 2)
    assert run(*words)[0] == 0
    assert simulated == [f"chunk {i}" for i in range(6)]
    summary, results = (sorted((output / folder).iterdir()) for folder in ("summary", "results"))
    summary[0].write_bytes(b"")
    summary[1].write_bytes(summary[1].read_bytes()[:100])
    results[2].write_bytes(b"")
    results[3].unlink()
    summary[4].write_bytes(summary[5].read_bytes())
    simulated.clear()
    status, _, err = run(*words)
    assert (status, f"5 damaged chunks in {output} are simulated again" in " ".join(err.split())) == (0, True)
    assert simulated == [f"chunk {i}" for i in range(5)]
    check_same(output, table)
    simulated.clear()
    assert run(*words)[0] == 0
    assert simulated == []
    for content in ("{", "[]", "[5]", None):
        path = output / "settings.json"
        path.unlink(missing_ok=True) if content is None else path.write_text(content)
        status, _, err = run(*words)
        assert (status, "holds a cohort whose settings.json is damaged or missing (" in err) == (2, True)


def test_what_is_refused(run, tmp_path):
    table, output = patients(tmp_path / "patients.csv", 4), tmp_path / "out"
    for options, message in (
        (("--chunk", 0), "--chunk must be at least 1, got 0"),
        (("--overwrite",), "--ray writes parquet and goes on with what is there"),
        (("--format", "csv"), "--ray writes parquet and goes on with what is there"),
        (("--address", "127.0.0.1:9"), "has no Ray cluster"),
    ):
        status, _, err = run(*command(table, output, *options))
        assert (status, message in err) == (2, True), err
    (output / "summary" / "part-00000.parquet").touch()
    settings = json.loads((output / "settings.json").read_text())
    assert settings["patients"] == 4
    status, _, err = run(*command(table, output, "--chunk", 2))
    assert status == 2
    assert "holds a cohort of other settings (chunk is 4096 there and 2 here)" in err
    with locked(output / ".lock", wait=False):
        process = start(*command(table, output))
        said, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2
    assert f"is in use by process {os.getpid()} on" in " ".join(said.split())

"""`benchmarks.gpu`: what it measures and how it reports, on the CPU with a few elbows."""

import json
import os
import time
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from benchmarks import gpu
from benchmarks.gpu_cases import (
    Environment,
    Options,
    agreement,
    differences,
    random_actions,
    rates,
    repeats,
    trajectory,
)
from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation

ELBOW = "myoElbowPose1D6MRandom-v0"
OPTIONS = Options(
    device="cpu", tasks=(ELBOW,), sizes=(4,), seconds=1e-3, rounds=2, checked_worlds=4, checked_steps=2
)
MOVED = 1e-4  # rad at least between worlds under different actions


@pytest.mark.slow
def test_rates():
    (row,) = rates(ELBOW, "parity", OPTIONS)
    assert row["num_worlds"] == 4
    for name in ("env_steps_per_s", "engine_steps_per_s", "ratio_to_engine"):
        assert row[name] > 0, name
    assert isinstance(row["memory_bytes"], int)  # below 0 where the process gave back what others had used
    assert row["launches"]["engine"] > row["launches"]["environment"] > TASKS[ELBOW].num_substeps
    assert row["start_seconds"]["until_first_step"] > row["start_seconds"]["capture"] > 0
    assert row["footprint"]["host_reads"] == 0  # views of arrays on the CPU are made once


@pytest.mark.slow
def test_host_reads_are_counted():
    env = Environment(ELBOW, "parity", 4, wp.get_device("cpu"))
    stock = env.step
    env.step = lambda: (stock(), env.sim.transition.obs.numpy())
    stock()
    assert env.footprint(steps=5)["host_reads"] == 5


def test_memory_that_does_not_suffice_is_a_row(monkeypatch):
    """Larger batches are not tried."""

    def measure_size(task, physics, num_worlds, options):
        if num_worlds > 8:
            raise RuntimeError("Failed to allocate 123 bytes on device 'cuda:0'\nand more")
        return {"num_worlds": num_worlds}

    monkeypatch.setattr("benchmarks.gpu_cases.measure_size", measure_size)
    rows = list(rates(ELBOW, "parity", replace(OPTIONS, sizes=(8, 16, 32))))
    failed = "RuntimeError: Failed to allocate 123 bytes on device 'cuda:0'"
    assert rows == [{"num_worlds": 8}, {"num_worlds": 16, "failed": failed}]


def test_the_cpu_agrees_with_itself():
    (row,) = agreement(ELBOW, "parity", OPTIONS)
    assert set(row["difference_to_cpu"]) == {"obs", "reward", "qpos"}
    assert all(
        figure == 0.0
        for steps in row["difference_to_cpu"].values()
        for figures in steps.values()
        for figure in figures.values()
    )


def test_differences_show():
    sim = Simulation(TASKS[ELBOW], 4, device="cpu", progress=False)
    actions = random_actions(sim, 2)
    found = differences(trajectory(sim, actions), trajectory(sim, -actions))
    assert found["qpos"]["after_2"]["worst"] > MOVED
    assert found["qpos"]["after_2"]["worst"] > found["qpos"]["after_2"]["median"] > 0.0
    ones, other = {"obs": np.ones((4, 3, 2))}, {"obs": np.ones((4, 3, 2))}
    other["obs"][3, 1, 1] = 3.0
    expected = {f"after_{step}": {"worst": 2.0 * (step == 4), "median": 0.0} for step in (1, 4)}
    assert differences(ones, other) == {"obs": expected}


def test_repeats():
    rows = list(repeats(ELBOW, "fast", OPTIONS))
    assert [row["deterministic"] for row in rows] == [False, True]
    assert all(row["same_bits"] and row["env_steps_per_s"] > 0 for row in rows)


def crash(task, physics, options):
    yield {"num_worlds": 4}
    os._exit(3)


def hang(task, physics, options):
    yield {"num_worlds": 4}
    time.sleep(600.0)


@pytest.fixture
def forked(monkeypatch):
    """Have cases run in forked processes, which know the functions above."""
    stock = gpu.multiprocessing.get_context
    monkeypatch.setattr(gpu.multiprocessing, "get_context", lambda method: stock("fork"))


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_report_survives_what_goes_wrong(forked, monkeypatch, tmp_path):
    kinds = {"crash": crash, "hang": hang, "never": hang}
    monkeypatch.setattr(gpu, "KINDS", kinds)
    monkeypatch.setattr(gpu, "ORDER", tuple((kind, "parity") for kind in kinds))
    options = replace(OPTIONS, output=tmp_path / "new" / "gpu.json", budget=3.0, tests="2 passed")
    report = gpu.run(options)
    assert report == json.loads(options.output.read_text()) | {"sizes": (4,)}
    assert report["dry_run_on_cpu"]
    assert report["device"]["alias"] == "cpu"
    assert report["tests"] == "2 passed"
    crashed, hung = report["cases"]
    assert crashed["rows"] == [{"num_worlds": 4}, {"failed": "the process ended with exit code 3"}]
    assert hung["rows"] == [{"num_worlds": 4}, {"stopped": "the time budget is used up"}]
    assert report["left_out"] == [f"never of {ELBOW}, parity"]


def test_goals():
    def entry(task, share, rate):
        row = {"num_worlds": gpu.HAND_WORLDS, "ratio_to_engine": share, "env_steps_per_s": rate}
        failed = {"num_worlds": gpu.HAND_WORLDS, "failed": "no memory"}
        return {"kind": "rates", "task": task, "rows": [row | {"num_worlds": 1}, row, failed]}

    entries = [entry(gpu.HAND, 0.95, 1e5), entry(gpu.HAND, 0.97, 2e5), entry(ELBOW, 0.93, 1e6)]
    assert [goal["got"] for goal in gpu.goals(entries)] == [0.93, 2e5]
    assert [goal["got"] for goal in gpu.goals([])] == [None, None]

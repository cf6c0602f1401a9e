"""`benchmarks.gpu`: what it measures and how it reports, on the CPU with a few elbows."""

import json
import os
import time
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from benchmarks import gpu, gpu_cases
from benchmarks.cuda_step import CUDA_STAGES
from benchmarks.gpu_cases import (
    Case,
    Environment,
    Options,
    agreement,
    bandwidth,
    cores,
    differences,
    kernels,
    random_actions,
    rates,
    record,
    repeats,
    trajectory,
    whole_step,
)
from myowarp.definitions.task import TASKS
from myowarp.sim import shard
from myowarp.sim.simulation import Simulation

ELBOW = "myoElbowPose1D6MRandom-v0"
OPTIONS = Options(
    device="cpu", tasks=(ELBOW,), sizes=(4,), seconds=1e-3, rounds=2, checked_worlds=4, checked_steps=6
)
CASE = Case("rates", ELBOW, "parity", 4)
MOVED = 1e-4  # rad at least between worlds under different actions


@pytest.mark.slow
def test_rates():
    (row,) = rates(CASE, OPTIONS)
    for name in ("env_steps_per_s", "engine_steps_per_s", "ratio_to_engine"):
        assert row[name] > 0, name
    assert isinstance(row["memory_bytes"], int)  # below 0 where the process gave back what others had used
    assert row["start_seconds"]["until_first_step"] > row["start_seconds"]["capture"] > 0
    assert row["footprint"]["host_reads"] == 0  # views of arrays on the CPU are made once


@pytest.mark.slow
def test_host_reads_are_counted():
    env = Environment(CASE, wp.get_device("cpu"))
    stock = env.step
    env.step = lambda: (stock(), env.sim.transition.obs.numpy())
    stock()
    assert env.footprint(steps=5)["host_reads"] == 5


def test_rates_beside_the_gpu():
    (found,) = cores(CASE, OPTIONS)
    assert found["env_steps_per_s"] > 0
    (copied,) = bandwidth(Case("bandwidth"), OPTIONS)
    assert 1e-4 < copied["tb_per_s"] < 10.0
    (listed,) = kernels(CASE, OPTIONS)
    assert listed["rows"][1] >= listed["rows"][0] >= 0.0


def test_agreement_with_what_was_recorded(tmp_path):
    """The CPU agrees with itself bit for bit; a reference of other motions shows."""
    file = tmp_path / "references.npz"
    record([CASE], OPTIONS, file)
    recorded = replace(OPTIONS, references=file)
    for options in (OPTIONS, recorded):
        (row,) = agreement(CASE, options)
        assert row["agrees"] == {5: True}
        assert row["moved"] > MOVED
        assert row["same_bits_twice"]
        assert all(
            figure == 0.0
            for steps in row["difference_to_cpu"].values()
            for figures in steps.values()
            for figure in figures.values()
        )
    with np.load(file) as kept:
        values = {name: array + MOVED * 2.0 for name, array in kept.items()}
    np.savez(file, **values)
    (row,) = agreement(CASE, recorded)
    assert row["agrees"] == {5: False}


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


def test_unrolled_graphs_step_alike(monkeypatch):
    runs = []
    for prepare in (None, gpu_cases.unroll):
        monkeypatch.setattr(shard, "repeat", shard.repeat)
        if prepare:
            prepare()
        sim = gpu_cases.simulation(CASE, "cpu", stages=CUDA_STAGES)
        runs.append(trajectory(sim, random_actions(sim, 2))["qpos"])
    np.testing.assert_array_equal(*runs)


@pytest.mark.slow  # compiles a step whole, as tests/engine/test_whole_step.py does
def test_whole_step():
    (row,) = whole_step(CASE, OPTIONS)
    assert row["ratio_to_stages"] > 0
    assert row["apart"] == 0.0


def test_repeats():
    (row,) = repeats(CASE, OPTIONS)
    assert row["same_bits"]
    assert row["env_steps_per_s"] > 0


def test_plan_begins_with_what_tells_most():
    cases = gpu.plan(Options())
    kinds = list(dict.fromkeys(case.kind for case in cases))
    assert kinds == list(gpu.KINDS)
    rated = [case.num_worlds for case in cases if case.kind == "rates"]
    assert rated == sorted(rated)
    assert not [case for case in gpu.plan(replace(OPTIONS, training=0.0)) if case.task not in (ELBOW, "")]


@pytest.mark.slow
def test_training():
    options = replace(OPTIONS, training=600.0)  # it ends when the elbow has learned, long before
    (row,) = gpu_cases.training(Case("training", ELBOW, num_worlds=64), options)
    assert row["iterations"] > 0, row
    assert int(row["last"]["samples"]) > 0


def crash(case, options):
    yield {}
    os._exit(3)


def hang(case, options):
    yield {}
    time.sleep(600.0)


def fail(case, options):
    raise RuntimeError("Failed to allocate 123 bytes on device 'cuda:0'\nand more")


@pytest.fixture
def forked(monkeypatch):
    """Have cases run in forked processes, which know the functions above."""
    stock = gpu.multiprocessing.get_context
    monkeypatch.setattr(gpu.multiprocessing, "get_context", lambda method: stock("fork"))


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_report_survives_what_goes_wrong(forked, monkeypatch, tmp_path):
    """A size that fails ends its kind and task: larger ones are not tried."""
    kinds = {"crash": crash, "fail": fail, "hang": hang, "never": hang}
    monkeypatch.setattr(gpu, "KINDS", kinds)
    cases = [Case(kind, ELBOW, num_worlds=n) for kind in kinds for n in ((8, 16) if kind == "fail" else (8,))]
    monkeypatch.setattr(gpu, "plan", lambda options: cases)
    options = replace(OPTIONS, output=tmp_path / "new" / "gpu.json", budget=3.0)
    report = gpu.run(options)
    assert report == json.loads(options.output.read_text()) | {"sizes": (4,)}
    assert report["dry_run_on_cpu"]
    assert report["device"]["alias"] == "cpu"
    crashed, failed, hung = (entry["rows"] for entry in report["cases"])
    assert crashed == [{}, {"failed": "the process ended with exit code 3"}]
    assert failed == [{"failed": "RuntimeError: Failed to allocate 123 bytes on device 'cuda:0'"}]
    assert hung == [{}, {"stopped": "the time budget is used up"}]
    assert report["left_out"] == [str(cases[2]), str(cases[4])]


def test_goals():
    def entry(kind, task, rate, **row):
        return {
            "kind": kind,
            "task": task,
            "rows": [{"failed": "no memory"}, row | {"env_steps_per_s": rate}],
        }

    entries = [entry("rates", gpu.HAND, 1e5, ratio_to_engine=1.5)]
    entries += [entry("rates", gpu.HAND, 2e5, ratio_to_engine=2.5)]
    entries += [entry("rates", gpu.KEY, 6e4), entry("cores", gpu.KEY, 2e4), entry("rates", gpu.WALK, 1e4)]
    assert [goal["got"] for goal in gpu.goals(entries)] == [2.5, 3.0, None]
    assert [goal["got"] for goal in gpu.goals([])] == [None, None, None]

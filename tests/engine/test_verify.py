"""What verification found is kept, and found again where the entry is damaged or foreign."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import pytest

from myowarp.definitions.task import TASKS
from myowarp.engine.idle import idle_kernels
from myowarp.engine.step import Step
from myowarp.engine.verify import Verdict
from myowarp.engine.verify import _cached_verdict as cached_verdict
from myowarp.models.conditions import Sarcopenia
from myowarp.sim.build import compile_scene, stepped_of
from myowarp.tasks.outside import load

KEY = "myoElbowPose1D6MRandom-v0"


@pytest.fixture
def counted(tmp_path, monkeypatch):
    """Return a step, a verdict about it, and a function that counts how often it was asked for."""
    monkeypatch.setenv("MYOWARP_CACHE_DIR", str(tmp_path))
    step = Step(stepped_of(compile_scene(TASKS[KEY], 1, device="cpu")))
    verdict = Verdict(idle_kernels(step.stepped), frozenset())
    assert verdict.idle
    calls = []

    def verify():
        calls.append(1)
        return verdict

    return step, verdict, verify, calls


def test_verified_once(counted):
    step, verdict, verify, calls = counted
    assert cached_verdict(step, (), verify) == verdict
    assert cached_verdict(step, (), verify) == verdict
    assert len(calls) == 1


@pytest.mark.parametrize(
    "entry",
    [
        "",
        "5",
        "[[], []]",
        '{"idle": []}',
        '{"idle": 3, "stages": []}',
        json.dumps({"idle": ["_no_such_kernel"], "stages": []}),
        json.dumps({"idle": [], "stages": ["NoSuchStage"]}),
    ],
)
def test_a_damaged_entry_is_verified_again(counted, tmp_path, entry):
    step, verdict, verify, calls = counted
    cached_verdict(step, (), verify)
    (path,) = (file for file in tmp_path.glob("*.cache") if b'"stages"' in file.read_bytes())
    written = path.read_bytes()
    path.write_bytes(hashlib.sha256(entry.encode()).digest() + entry.encode())  # what an older version kept
    assert cached_verdict(step, (), verify) == verdict
    assert len(calls) == 2
    assert path.read_bytes() == written


def test_another_model_is_another_verdict(counted):
    step, _, verify, calls = counted
    cached_verdict(step, (), verify)
    step.stepped.oracle.opt.timestep *= 2
    cached_verdict(step, (), verify)
    assert len(calls) == 2


def test_an_edited_condition_of_the_users_is_another_verdict(counted, tmp_path):
    step, _, verify, calls = counted
    path = tmp_path / "condition.py"
    path.write_text(
        (Path(__file__).parents[1] / "outside" / "condition.py").read_text().split("myowarp.COND")[0]
    )
    fading = load(str(path)).Fading()
    for conditions in ((), (fading,), (fading,), (Sarcopenia(),)):
        cached_verdict(step, (), verify, conditions)
    assert len(calls) == 2
    path.write_text(path.read_text().replace("RATE = 2.0", "RATE = 3.0"))
    cached_verdict(step, (), verify, (fading,))
    assert len(calls) == 3


def test_what_worlds_have_for_themselves_is_not_idle():
    """Zeros of the model say nothing then: a condition may write friction, springs or weight into worlds."""
    stepped = stepped_of(compile_scene(TASKS[KEY], 1, device="cpu"))
    for kernel, field in {
        "_friction_dof": "dof_frictionloss",
        "_gravity_force": "body_gravcomp",
        "_spring_damper_tendon_passive": "tendon_stiffness",
    }.items():
        assert kernel in idle_kernels(stepped)
        assert kernel not in idle_kernels(replace(stepped, batched=stepped.batched | {field}))


def test_a_task_names_what_its_worlds_have_for_themselves():
    scene = compile_scene(TASKS["myoHandKeyTurnRandom-v0"], 1, device="cpu")
    assert scene.spec.batched
    assert set(scene.spec.batched) < stepped_of(scene).batched

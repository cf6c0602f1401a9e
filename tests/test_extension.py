"""What CONTRIBUTING promises, done from outside the package: one file in a folder of one's own."""

import importlib.util
import sys

import numpy as np
import pytest

from myowarp.sim.build import oracle_model
from myowarp.sim.shards import simulate
from myowarp.spec.body import BODIES
from myowarp.spec.condition import CONDITIONS
from myowarp.spec.task import TASKS

MINE = '''
"""A body, a condition, a task family and a variant of it."""

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

import mujoco
import warp as wp

from myowarp.kernels.observe import pack
from myowarp.kernels.random import GOAL, RandomKeys, open_stream
from myowarp.spec.body import BODIES, Body
from myowarp.spec.condition import CONDITIONS, Condition, Effect, Stage
from myowarp.spec.program import Program
from myowarp.spec.task import TaskSpec, blocks, task, weighted

TAG = "{tag}"
MODEL = """<mujoco><worldbody><body name="arm">
  <joint name="hinge" axis="0 1 0" range="-1 1" limited="true" damping="{damping}"/>
  <geom type="capsule" size="0.03" fromto="0 0 0 0 0 -0.4" contype="0" conaffinity="0"/>
  <site name="insertion" pos="0.03 0 -0.2"/><site name="{tag}_tip" pos="0 0 -0.4"/></body>
  <site name="origin" pos="0.05 0 0.3"/></worldbody>
  <tendon><spatial name="muscle"><site site="origin"/><site site="insertion"/></spatial></tendon>
  <actuator><muscle name="muscle" tendon="muscle" force="200" lengthrange="0.3 0.6"/></actuator></mujoco>"""


def arm():
    return mujoco.MjSpec.from_string(MODEL)


BODIES.add("{tag}_arm", Body(arm, tips=("{tag}_tip",)))


@dataclass(frozen=True, eq=False)
class Paralysis(Condition):
    """Nothing pulls."""

    STAGE = Stage.STRENGTH
    NEUTRAL: ClassVar = {{}}

    def bind(self, scene, clock):
        return ParalysisEffect(scene)


class ParalysisEffect(Effect):
    def __init__(self, scene):
        self.strength = scene.muscles.anatomy.strength

    def act(self):
        self.strength.fill_(0.0)


CONDITIONS.add("{tag}_paralysis", Paralysis)

Obs = IntEnum("Obs", "qpos target", start=0)
Term = IntEnum("Term", "error", start=0)


@wp.kernel(enable_backward=False)
def sample_{tag}(
    # In:
    keys: RandomKeys,
    mask: wp.array[bool],
    # Out:
    target: wp.array2d[float],
):
    """target ~ U(-1, 1)."""
    worldid = wp.tid()
    if mask[worldid]:
        target[worldid, 0] = wp.randf(open_stream(keys, worldid, GOAL), -1.0, 1.0)


@wp.kernel(enable_backward=False)
def observe_{tag}(
    # Params:
    first: wp.array[int],
    # Data in:
    qpos_in: wp.array2d[float],
    # In:
    target: wp.array2d[float],
    mask: wp.array[bool],
    # Out:
    obs: wp.array2d[float],
):
    """obs = [qpos, target]."""
    worldid = wp.tid()
    if mask[worldid]:
        pack(obs, worldid, first[Obs.qpos], qpos_in, 1.0)
        pack(obs, worldid, first[Obs.target], target, 1.0)


@wp.kernel(enable_backward=False)
def score_{tag}(
    # Data in:
    qpos_in: wp.array2d[float],
    # In:
    target: wp.array2d[float],
    near: float,
    # Out:
    terms: wp.array2d[float],
    solved: wp.array[bool],
    failed: wp.array[bool],
):
    """error = -|target - qpos|."""
    worldid = wp.tid()
    error = wp.abs(target[worldid, 0] - qpos_in[worldid, 0])
    terms[worldid, Term.error] = -error
    solved[worldid] = error < near
    failed[worldid] = False


class MyProgram(Program):
    def __init__(self, spec, scene):
        super().__init__(spec, scene)
        self.target = wp.zeros((scene.num_worlds, 1), dtype=float)

    def sample_goal(self, mask):
        self.launch(sample_{tag}, mask=mask)

    def observe(self, mask, obs):
        self.launch(observe_{tag}, mask=mask, obs=obs)

    def score(self, step_count, terms, solved, failed):
        self.launch(score_{tag}, terms=terms, solved=solved, failed=failed)


@dataclass(frozen=True, kw_only=True)
class MyTask(TaskSpec):
    """Bring the arm to an angle."""

    program: ClassVar[type] = MyProgram
    num_substeps: int = 5
    horizon: int = 20
    near: float

    @property
    def sites(self):
        return ("{tag}_tip",)

    def edit(self, spec):
        pass

    def columns(self, nq, nv, num_muscles):
        return blocks({{Obs.qpos: (nq, "rad"), Obs.target: (1, "rad")}})

    def reward_terms(self):
        return weighted({{Term.error: 2.0}})


@task("{tag}Wide-v0")
def wide():
    """Bring the arm near an angle."""
    return MyTask(body="{tag}_arm", near=0.3)


@task("{tag}Narrow-v0")
def narrow():
    """Bring the arm to an angle."""
    return MyTask(body="{tag}_arm", near=0.01)
'''


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """Return a function that imports the user's file, with some damping; what it registers goes again."""
    before = [(registry, dict(registry._entries)) for registry in (TASKS, BODIES, CONDITIONS)]

    def load(damping=0.1, tag="mine"):
        for registry, entries in before:
            registry._entries = dict(entries)
        path = tmp_path / "mine.py"
        path.write_text(MINE.format(tag=tag, damping=damping))
        definition = importlib.util.spec_from_file_location("mine", path)
        module = importlib.util.module_from_spec(definition)
        monkeypatch.setitem(sys.modules, "mine", module)
        definition.loader.exec_module(module)
        return module

    yield load
    for registry, entries in before:
        registry._entries = entries


def rolled(key, **options):
    """Return the observations of 40 steps, and the last rewards and whether worlds are solved."""
    sim = simulate(TASKS[key], 5, device="cpu", progress=False, **options)
    sim.reset(seeds=np.arange(5))
    seen = []
    for step in range(40):
        sim.action.fill_(1.0 if step % 10 < 5 else -1.0)
        sim.step()
        seen.append(sim.transition.obs.numpy().copy())
    return np.array(seen), sim.transition.reward.numpy().copy(), sim.transition.solved.numpy().copy()


def test_family_variant_body_and_condition_from_outside(mine):
    mine()
    obs, reward, solved = rolled("mineWide-v0", shards=1, autoreset="disabled")
    np.testing.assert_allclose(reward, -2.0 * np.abs(obs[-1, :, 1] - obs[-1, :, 0]), atol=1e-6)
    np.testing.assert_array_equal(solved, np.abs(obs[-1, :, 1] - obs[-1, :, 0]) < 0.3)
    assert len(np.unique(obs[0, :, 1])) == 5
    np.testing.assert_array_equal(rolled("mineWide-v0", shards=2, autoreset="disabled")[0], obs)
    np.testing.assert_array_equal(rolled("mineNarrow-v0", autoreset="disabled")[0], obs)
    weak, *_ = rolled("mineWide-v0", autoreset="disabled", conditions="mine_paralysis")
    assert np.abs(weak[:, :, 0] - obs[:, :, 0]).max() > 0.01


def test_an_edited_file_is_a_new_model(mine):
    """Compiled models are kept on disk: what one's own file says counts, not its names."""
    mine(damping=0.1)
    first = oracle_model(TASKS["mineWide-v0"])
    mine(damping=0.7)
    second = oracle_model(TASKS["mineWide-v0"])
    assert first.dof_damping[0] == 0.1
    assert second.dof_damping[0] == 0.7

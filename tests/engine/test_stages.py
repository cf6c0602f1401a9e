"""Every stage of ours: used where it applies, equal to the engine's, refused where it is not."""

import ast
import importlib
import logging
import sys
import types
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from often import covering, often
from stepping import step

from myowarp.definitions.task import TASKS
from myowarp.engine import stage as stage_module
from myowarp.engine.idle import idle_kernels
from myowarp.engine.stage import STAGES, Stage, load
from myowarp.engine.stages.muscle_path import MusclePath, MusclePaths
from myowarp.engine.step import ORDER, uncovered
from myowarp.engine.verify import verified_stages
from myowarp.osim.bundle.mjcf import mjcf
from myowarp.osim.convert.compose.convert import convert
from myowarp.osim.document.read.model import read_model
from myowarp.process import warn_once
from myowarp.sim.build import stepped_of
from myowarp.sim.simulation import Simulation
from myowarp.tasks.from_file import pose_task

OSIM = Path(__file__).parents[1] / "data" / "osim"
BODY_TASKS = {TASKS[key].body: key for key in reversed(list(TASKS))}
SCENES = {TASKS[key].scene_key: key for key in TASKS}.values()
ONE_PER_BODY = {TASKS[key].body: key for key in SCENES}.values()
CONDITIONED = (
    ("myoElbowPose1D6MRandom-v0", "exoskeleton"),
    ("myoHandPoseFixed-v0", "tendon_transfer"),
)

AFTER_STEPS = 1e-4
"""rad after five control steps from the same start: float32 sums in another order, grown by the dynamics."""


def simulation(key, num_worlds=4, **options):
    return Simulation(TASKS[key], num_worlds, device="cpu", graph=False, progress=False, **options)


def kinds(stages):
    return {type(one) for one in stages}


class Brake(Stage):
    """A stage that is wrong: it changes the velocities."""

    REPLACES = ("rne",)
    OBSTACLES: ClassVar = {}

    def launch(self, model, data):
        data.qvel.fill_(1.0)
        ORDER["rne"](model, data)


class Standstill(Stage):
    """A stage that is wrong: positions stay where they are."""

    REPLACES = ("integrate",)
    OBSTACLES: ClassVar = {}

    def launch(self, model, data):
        before = wp.clone(data.qpos)
        ORDER["integrate"](model, data)
        wp.copy(data.qpos, before)


@pytest.mark.slow
@pytest.mark.parametrize("key", often(SCENES, ONE_PER_BODY))
def test_all_that_apply_are_used(key, caplog, monkeypatch, tmp_path):
    """The self-check finds every stage equal to the stock step: none is left out, none is logged.

    Nor does it find that a kernel which the model has idle changes a state.
    """
    monkeypatch.setenv("MYOWARP_CACHE_DIR", str(tmp_path))  # no verdict of an earlier run
    with caplog.at_level(logging.WARNING, logger="myowarp"):
        sim = simulation(key)
    assert kinds(sim.shards[0].stages) == kinds(sim.shards[0].physics_step.stages())
    assert sim.shards[0].idle_kernels == idle_kernels(stepped_of(sim.scene))
    assert sim.shards[0].stages or not sim.scene.muscles.names
    assert not caplog.records


@pytest.mark.slow
def test_each_applies_somewhere():
    """A stage that no registered task can use would be dead code."""
    stepped = [stepped_of(simulation(key, 1, stages=()).scene) for key in BODY_TASKS.values()]
    assert [name for name in STAGES if None not in map(load(name).obstacle, stepped)] == []


def test_a_place_has_one_stage():
    """Two stages of one place would undo each other, or run out of order."""
    places = [place for name in STAGES for place in load(name).REPLACES]
    assert len(places) == len(set(places))
    assert set(places) <= set(ORDER)


@pytest.mark.slow
@pytest.mark.parametrize(("key", "condition"), CONDITIONED)
def test_bodies_with_conditions(key, condition):
    assert MusclePath in kinds(simulation(key, conditions=condition).shards[0].stages)


@pytest.mark.parametrize(
    "key", ["myoElbowPose1D6MRandom-v0", pytest.param("myoFingerPoseFixed-v0", marks=pytest.mark.slow)]
)
def test_steps_are_those_of_the_engine(key):
    """With random actions, the same trajectory; the finger pushes its tendons to their limits."""
    ends, start = [], None
    for stages in ((), tuple(STAGES)):
        sim = simulation(key, stages=stages)
        assert bool(sim.shards[0].stages) == bool(stages)
        rng = np.random.default_rng(0)
        sim.reset(seeds=np.arange(4))
        start = sim.scene.data.qpos.numpy().copy()
        for _ in range(5):
            sim.action.assign(rng.uniform(-1.0, 1.0, sim.action.shape))
            sim.step()
        ends.append(sim.scene.data.qpos.numpy().copy())
    assert np.abs(ends[0] - start).max() > 100 * AFTER_STEPS
    np.testing.assert_allclose(ends[1], ends[0], atol=AFTER_STEPS, rtol=0)


@pytest.mark.parametrize("wrong", [Brake, Standstill])
def test_a_wrong_stage_is_left_out(wrong, caplog):
    sim = simulation("myoElbowPose1D6MRandom-v0", stages=())
    with caplog.at_level(logging.WARNING, logger="myowarp"):
        step = sim.shards[0].physics_step
        assert verified_stages(step, (wrong(step.stepped),)) == ()
    assert f"{wrong.__name__} is left to mujoco-warp" in caplog.text


@pytest.mark.parametrize("num_worlds", [1, 32])
def test_a_stage_that_computes_nothing_is_left_out(num_worlds, monkeypatch, caplog):
    """Not even where the arrays still hold what the stock step wrote for the same states."""
    sim = simulation("myoElbowPose1D6MRandom-v0", num_worlds, stages=())
    step = sim.shards[0].physics_step
    stages = step.stages(["muscle_path"])
    assert verified_stages(step, stages) == stages
    monkeypatch.setattr(MusclePaths, "launch", lambda self: None)
    with caplog.at_level(logging.WARNING, logger="myowarp"):
        assert verified_stages(step, stages) == ()
    assert "MusclePath is left to mujoco-warp" in caplog.text


@pytest.mark.slow
def test_stiff_equalities_are_no_reason(tmp_path, monkeypatch, caplog):
    """A converted model follows splines by equalities that turn roundings into more than the tolerance."""
    path = tmp_path / "model.xml"
    path.write_text(mjcf(convert(read_model(OSIM / "gait10dof18musc.osim")).spec))
    sim = Simulation(pose_task(path), 4, device="cpu", graph=False, progress=False, stages=())
    step = sim.shards[0].physics_step
    stages = step.stages()
    assert len(stages) > 2
    with caplog.at_level(logging.WARNING, logger="myowarp"):
        assert verified_stages(step, stages) == stages
        assert not caplog.records
        assert verified_stages(step, (Brake(step.stepped),)) == ()
    monkeypatch.setattr("myowarp.engine.verify.ROUNDINGS", 0)
    assert verified_stages(step, stages) != stages


def test_none_on_request():
    sim = simulation(BODY_TASKS["elbow"], 1, stages=())
    assert sim.shards[0].physics_step.stages()
    assert sim.shards[0].stages == ()


@pytest.mark.parametrize(
    ("inside", "reason"),
    [
        ("<equality><connect site1='a' site2='b'/></equality>", "an equality between sites"),
        ("", "no tendons"),
    ],
)
def test_obstacles_of_the_muscle_path(inside, reason):
    assert MusclePath.obstacle(SimpleNamespace(oracle=model_with(inside), paths=None)) == reason


def model_with(inside="", options=""):
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco>{options}<worldbody><site name="a"/><body pos="1 0 0"><freejoint/><geom size="1"/>
        <site name="b"/></body></worldbody>{inside}</mujoco>"""
    )


@pytest.mark.parametrize(
    ("inside", "options", "reason"),
    [
        ("<sensor><framepos objtype='site' objname='a'/></sensor>", "", "there are sensors"),
        (
            "<tendon><spatial armature='1'><site site='a'/><site site='b'/></spatial></tendon>",
            "",
            "tendons or actuators have armature",
        ),
        ("", "<option><flag energy='enable'/></option>", "energy is computed"),
        (
            "",
            "<option integrator='RK4'/>",
            "the integrator takes several evaluations, or is the discrete one",
        ),
        ("", "", None),
    ],
)
def test_what_the_list_of_stages_does_not_cover(inside, options, reason):
    """There `mujoco_warp.step` runs."""
    host = model_with(inside, options)
    with wp.ScopedDevice("cpu"):
        scene = SimpleNamespace(oracle=host, model=mjw.put_model(host))
        assert uncovered(scene) == reason
        if reason is None:
            scene.model.opt.run_collision_detection = False
            assert uncovered(scene) == "the user makes the contacts"
            scene.model.opt.run_collision_detection = True
            scene.model.callback.sensor = print
            assert uncovered(scene) == "the user has sensors"


STAGE_FILES = sorted((Path(stage_module.__file__).parent / "stages").glob("*.py"))


def private_names():
    """Return (file, module, name) of all that our stages import from inside the engine."""
    for path in STAGE_FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mujoco_warp._src"):
                yield from ((path, node.module, alias.name) for alias in node.names)


PRIVATE = sorted(set(private_names()))


def test_private_names_are_found():
    assert len(PRIVATE) > 10


@pytest.mark.parametrize(
    "gone",
    often(PRIVATE, covering(PRIVATE, lambda one: (one[1],))),
    ids=lambda one: f"{one[0].stem}-{one[2]}",
)
def test_a_private_name_that_is_gone(gone, monkeypatch, caplog):
    """The stages that need it are left to the engine, each with one warning; the step stays the engine's."""
    _, module, name = gone
    real = importlib.import_module(module)
    stand_in = types.ModuleType(module)
    stand_in.__dict__.update({key: value for key, value in vars(real).items() if key != name})
    monkeypatch.setitem(sys.modules, module, stand_in)
    parent, _, child = module.rpartition(".")
    monkeypatch.setattr(importlib.import_module(parent), child, stand_in)
    if f"{module}.{name}" in sys.modules:
        monkeypatch.setitem(sys.modules, f"{module}.{name}", None)
    for loaded in [key for key in sys.modules if key.startswith("myowarp.engine.stages.")]:
        monkeypatch.delitem(sys.modules, loaded)
    load.cache_clear()
    warn_once.cache_clear()
    try:
        with caplog.at_level(logging.WARNING, logger="myowarp"):
            left = [stage for stage in STAGES if load(stage) is None]
            assert left == [stage for stage in STAGES if load(stage) is None]
        assert left
        assert [record.getMessage().split()[0] for record in caplog.records] == left
        key = "myoElbowPose1D6MRandom-v0"
        sim = Simulation(TASKS[key], 2, device="cpu", graph=False, progress=False)
        assert not {STAGES[stage] for stage in left} & {type(one).__name__ for one in sim.shards[0].stages}
        start = sim.scene.data.qpos.numpy().copy()
        sim.action.fill_(1.0)
        sim.step()
        assert np.isfinite(sim.scene.data.qpos.numpy()).all()
        assert np.abs(sim.scene.data.qpos.numpy() - start).max() > AFTER_STEPS
    finally:
        load.cache_clear()
        warn_once.cache_clear()


def test_damped_tendons_keep_their_velocity():
    """Damping reads the velocities of tendons, which the muscle path leaves to the engine there."""
    host = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><site name="a" pos="0 0.1 0.3"/><body><joint axis="1 0 0"/>
        <geom size="0.1" pos="0 0 -0.3"/><site name="b" pos="0 0.1 -0.2"/></body></worldbody>
        <tendon><spatial name="t" damping="20"><site site="a"/><site site="b"/></spatial></tendon>
        <actuator><motor tendon="t"/></actuator></mujoco>"""
    )
    ends = []
    with wp.ScopedDevice("cpu"):
        for ours in (False, True):
            model, data = mjw.put_model(host), mjw.make_data(host, nworld=2)
            scene = SimpleNamespace(
                oracle=host, model=model, data=data, device=wp.get_device("cpu"), paths=None
            )
            assert uncovered(scene) is None
            assert MusclePath.obstacle(scene) is None
            data.qvel.fill_(3.0)
            step(scene, [MusclePath(scene)] if ours else [])
            ends.append(data.qvel.numpy().copy())
    data = mujoco.MjData(host)
    data.qvel[:] = 3.0
    mujoco.mj_step(host, data)
    np.testing.assert_allclose(ends, np.full((2, 2, 1), data.qvel[0]), rtol=1e-5)
    host.tendon_damping[:] = 0.0
    free = mujoco.MjData(host)
    free.qvel[:] = 3.0
    mujoco.mj_step(host, free)
    assert abs(free.qvel[0] - data.qvel[0]) > 1e-4 * abs(data.qvel[0])

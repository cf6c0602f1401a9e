"""Every registered fusion: used where it applies, equal to the stock step, refused where it is not."""

import contextlib
import logging
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from myowarp.engine.idle import pruned
from myowarp.engine.stages import FUSIONS, Fusion, applicable_fusions, verified_fusions
from myowarp.engine.stages.muscle_path import MusclePathFusion
from myowarp.engine.stages.path_program import MusclePaths
from myowarp.opensim.build.convert import convert
from myowarp.opensim.build.mjcf import mjcf
from myowarp.opensim.read.model import read_model
from myowarp.sim.simulation import Simulation
from myowarp.spec.task import TASKS
from myowarp.tasks.from_file import pose_task

OSIM = Path(__file__).parent / "data" / "osim"
BODY_TASKS = {TASKS[key].body: key for key in reversed(list(TASKS))}
CONDITIONED = (
    ("myoElbowPose1D6MRandom-v0", "exoskeleton"),
    ("myoHandPoseFixed-v0", "tendon_transfer"),
)

AFTER_STEPS = 1e-4
"""rad after five control steps from the same start: float32 sums in another order, grown by the dynamics."""


def simulation(key, num_worlds=4, **options):
    return Simulation(TASKS[key], num_worlds, device="cpu", graph=False, progress=False, **options)


def kinds(fusions):
    return {type(fusion) for fusion in fusions}


class Brake(Fusion):
    """A fusion that is wrong: it changes the velocities."""

    @classmethod
    def obstacle(cls, scene):
        return None

    def __init__(self, scene):
        self.data = scene.data

    @contextlib.contextmanager
    def installed(self):
        self.data.qvel.fill_(1.0)
        yield


class Standstill(Brake):
    """A fusion that is wrong: positions stay where they are."""

    @contextlib.contextmanager
    def installed(self):
        with pruned(frozenset({"_next_position"})):
            yield


@pytest.mark.parametrize("body", BODY_TASKS)
def test_all_that_apply_are_used(body, caplog, monkeypatch, tmp_path):
    """The self-check finds every fusion equal to the stock step: none is left out, none is logged."""
    monkeypatch.setenv("MYOWARP_CACHE_DIR", str(tmp_path))  # no verdict of an earlier run
    with caplog.at_level(logging.WARNING, logger="myowarp"):
        sim = simulation(BODY_TASKS[body])
    assert kinds(sim.fusions) == kinds(applicable_fusions(sim.scene, FUSIONS))
    assert sim.fusions or not sim.scene.muscles.names
    assert not caplog.records


@pytest.mark.parametrize("name", FUSIONS)
def test_each_applies_somewhere(name):
    """A fusion that no registered task can use would be dead code."""
    scenes = [simulation(key, 1, fusions=()).scene for key in BODY_TASKS.values()]
    obstacles = {FUSIONS[name].obstacle(scene) for scene in scenes}
    assert None in obstacles
    assert all(reason is None or len(reason) > 10 for reason in obstacles)


@pytest.mark.slow
@pytest.mark.parametrize(("key", "condition"), CONDITIONED)
def test_bodies_with_conditions(key, condition):
    assert MusclePathFusion in kinds(simulation(key, conditions=condition).fusions)


@pytest.mark.parametrize("key", ["myoElbowPose1D6MRandom-v0", "myoFingerPoseFixed-v0"])
def test_steps_are_those_of_the_engine(key):
    """With random actions, the same trajectory; the finger pushes its tendons to their limits."""
    ends, start = [], None
    for fusions in ((), tuple(FUSIONS)):
        sim = simulation(key, fusions=fusions)
        assert bool(sim.fusions) == bool(fusions)
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
def test_a_wrong_fusion_is_left_out(wrong, caplog):
    sim = simulation("myoElbowPose1D6MRandom-v0", fusions=())
    with caplog.at_level(logging.WARNING, logger="myowarp"):
        assert verified_fusions(sim.scene, (wrong(sim.scene),), sim._launch_physics) == ()
    assert f"{wrong.__name__} is left to mujoco-warp" in caplog.text


@pytest.mark.parametrize("num_worlds", [1, 32])
def test_a_fusion_that_computes_nothing_is_left_out(num_worlds, monkeypatch, caplog):
    """Not even where the arrays still hold what the stock step wrote for the same states."""
    sim = simulation("myoElbowPose1D6MRandom-v0", num_worlds, fusions=())
    fusions = applicable_fusions(sim.scene, ["muscle_path"])
    assert verified_fusions(sim.scene, fusions, sim._launch_physics) == fusions
    monkeypatch.setattr(MusclePaths, "launch", lambda self: None)
    with caplog.at_level(logging.WARNING, logger="myowarp"):
        assert verified_fusions(sim.scene, fusions, sim._launch_physics) == ()
    assert "MusclePathFusion is left to mujoco-warp" in caplog.text


@pytest.mark.slow
def test_stiff_equalities_are_no_reason(tmp_path, monkeypatch, caplog):
    """A converted model follows splines by equalities that turn roundings into more than the tolerance."""
    path = tmp_path / "model.xml"
    path.write_text(mjcf(convert(read_model(OSIM / "gait10dof18musc.osim")).spec))
    sim = Simulation(pose_task(path), 4, device="cpu", graph=False, progress=False, fusions=())
    fusions = applicable_fusions(sim.scene, FUSIONS)
    assert len(fusions) > 2
    with caplog.at_level(logging.WARNING, logger="myowarp"):
        assert verified_fusions(sim.scene, fusions, sim._launch_physics) == fusions
        assert not caplog.records
        assert verified_fusions(sim.scene, (Brake(sim.scene),), sim._launch_physics) == ()
    monkeypatch.setattr("myowarp.engine.stages.ROUNDINGS", 0)
    assert verified_fusions(sim.scene, fusions, sim._launch_physics) != fusions


def test_none_on_request():
    sim = simulation(BODY_TASKS["elbow"], 1, fusions=())
    assert applicable_fusions(sim.scene, FUSIONS)
    assert sim.fusions == ()


@pytest.mark.parametrize(
    ("inside", "reason"),
    [
        (
            "<sensor><framepos objtype='site' objname='a'/></sensor>",
            "sensors, which may read sites within a step",
        ),
        ("<equality><connect site1='a' site2='b'/></equality>", "an equality between sites"),
        (
            "<tendon><spatial armature='1'><site site='a'/><site site='b'/></spatial></tendon>",
            "armature of a",
        ),
        ("", "no tendons"),
    ],
)
def test_obstacles_of_the_muscle_path(inside, reason):
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><site name="a"/><body pos="1 0 0"><freejoint/><geom size="1"/><site name="b"/>
        </body></worldbody>{inside}</mujoco>"""
    )
    assert MusclePathFusion.obstacle(SimpleNamespace(oracle=model)).startswith(reason)

"""Every registered fusion: it applies to every body, gives the stock step, and is refused if it does not."""

import logging
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from myowarp.fusions import FUSIONS, applicable_fusions, verified_fusions
from myowarp.fusions.muscle_path import MusclePathFusion
from myowarp.models.path_program import MusclePaths
from myowarp.sim import Simulation
from myowarp.spec import TASKS

BODY_TASKS = {TASKS[key].body: key for key in reversed(list(TASKS))}
CONDITIONED = (
    ("myoElbowPose1D6MRandom-v0", "exoskeleton"),
    ("myoHandPoseFixed-v0", "tendon_transfer"),
)

AFTER_STEPS = 1e-4
"""rad after five control steps from the same start: float32 sums in another order, grown by the dynamics."""


def trusted(sim):
    return {type(fusion) for fusion in sim._fusions}


def simulation(key, num_worlds=4, **options):
    return Simulation(TASKS[key], num_worlds, device="cpu", graph=False, progress=False, **options)


@pytest.mark.parametrize(
    "body", [pytest.param(b, marks=[pytest.mark.slow] * ("hand" in b)) for b in BODY_TASKS]
)
def test_every_fusion_is_trusted_on_every_body(body):
    sim = simulation(BODY_TASKS[body])
    applicable = {FUSIONS[name] for name in FUSIONS if FUSIONS[name].obstacle(sim.scene) is None}
    assert MusclePathFusion in applicable
    assert trusted(sim) == applicable


@pytest.mark.slow
@pytest.mark.parametrize(("key", "condition"), CONDITIONED)
def test_bodies_with_conditions(key, condition):
    assert MusclePathFusion in trusted(simulation(key, conditions=condition))


@pytest.mark.parametrize("key", ["myoElbowPose1D6MRandom-v0", "myoFingerPoseFixed-v0"])
def test_steps_are_those_of_the_engine(key):
    """With random actions, the same trajectory; the finger pushes its tendons to their limits."""
    ends, start = [], None
    for fusions in ((), tuple(FUSIONS)):
        sim = simulation(key, fusions=fusions)
        assert bool(sim._fusions) == bool(fusions)
        rng = np.random.default_rng(0)
        sim.reset(seeds=np.arange(4))
        start = sim.scene.data.qpos.numpy().copy()
        for _ in range(5):
            sim.action.assign(rng.uniform(-1.0, 1.0, sim.action.shape))
            sim.step()
        ends.append(sim.scene.data.qpos.numpy().copy())
    assert np.abs(ends[0] - start).max() > 100 * AFTER_STEPS
    np.testing.assert_allclose(ends[1], ends[0], atol=AFTER_STEPS, rtol=0)


@pytest.mark.parametrize("num_worlds", [1, 32])
def test_a_fusion_that_computes_nothing_is_not_trusted(num_worlds, monkeypatch, caplog):
    """Not even where the arrays still hold what the stock step wrote for the same states."""
    sim = simulation("myoElbowPose1D6MRandom-v0", num_worlds, fusions=())
    fusions = applicable_fusions(sim.scene, ["muscle_path"])
    assert verified_fusions(sim.scene, fusions, sim._launch_physics) == fusions
    monkeypatch.setattr(MusclePaths, "launch", lambda self: None)
    with caplog.at_level(logging.WARNING, logger="myowarp"):
        assert verified_fusions(sim.scene, fusions, sim._launch_physics) == ()
    assert "MusclePathFusion is left to mujoco-warp" in caplog.text


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

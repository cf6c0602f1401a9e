"""Kernels of ours in the engine's step: used where they apply, and refused where they would be wrong."""

import contextlib
import logging

import pytest
import warp as wp

from myowarp.fusions import FUSIONS, Fusion, applicable_fusions, verified_fusions
from myowarp.sim import Simulation
from myowarp.spec import TASKS

SCENES = tuple({TASKS[key].body: key for key in TASKS}.values())
NUM_WORLDS = 3


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


@pytest.mark.parametrize("key", SCENES)
def test_all_that_apply_are_used(key, caplog):
    """The self-check finds every fusion equal to the stock step: none is left out, none is logged."""
    with caplog.at_level(logging.WARNING, logger="myowarp"):
        sim = Simulation(TASKS[key], NUM_WORLDS, device="cpu", progress=False, graph=False)
    expected = {type(fusion) for fusion in applicable_fusions(sim.scene, FUSIONS)}
    assert {type(fusion) for fusion in sim.fusions} == expected
    assert not caplog.records


@pytest.mark.parametrize("name", FUSIONS)
def test_each_applies_somewhere(name):
    """A fusion that no registered task can use would be dead code."""
    obstacles = set()
    for key in SCENES:
        scene = Simulation(TASKS[key], 1, device="cpu", progress=False, graph=False, fusions=()).scene
        obstacles.add(FUSIONS[name].obstacle(scene))
    assert None in obstacles
    assert all(reason is None or len(reason) > 10 for reason in obstacles)


def test_a_wrong_fusion_is_left_out(caplog):
    sim = Simulation(TASKS[SCENES[0]], NUM_WORLDS, device="cpu", progress=False, graph=False, fusions=())
    with caplog.at_level(logging.WARNING, logger="myowarp"), wp.ScopedDevice("cpu"):
        assert verified_fusions(sim.scene, (Brake(sim.scene),), sim._launch_physics) == ()
    (record,) = caplog.records
    assert "Brake is left to mujoco-warp" in record.getMessage()


def test_none_on_request():
    key = next(key for key in SCENES if "Pen" in key)
    sim = Simulation(TASKS[key], 1, device="cpu", progress=False, graph=False, fusions=())
    assert applicable_fusions(sim.scene, FUSIONS)
    assert sim.fusions == ()

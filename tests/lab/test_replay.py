"""Files of OpenSim that play: a trajectory of Moco, from `record_opensim_trajectory.py`, and motors alone."""

import logging
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from myowarp.apps.policies.replay import Replay
from myowarp.kernels.action import excitation
from myowarp.motion.movement import read_motion
from myowarp.motion.storage import Storage, read_storage
from myowarp.osim.body.skeleton import Bones
from myowarp.process import warn_once

DATA = Path(__file__).parents[1] / "data"
TRAJECTORY = DATA / "opensim/trajectory.sto"
STEP = 0.01
MUSCLES = ("TRIlong", "TRIlat", "TRImed", "BIClong", "BICshort", "BRA")


def simulated(muscles, motors="", done=0):
    """Return the parts of a simulation that a replay reads, after some control steps of two worlds."""
    xml = f"<mujoco><worldbody><body><joint name='j'/><geom size='.1'/></body></worldbody>{motors}</mujoco>"
    oracle = mujoco.MjModel.from_xml_string(xml)
    scene = SimpleNamespace(
        muscles=SimpleNamespace(names=muscles, actuator_id=np.arange(len(muscles))),
        spec=SimpleNamespace(key="arm", linear_excitation=False),
        oracle=oracle,
        control_dt=STEP,
        num_actions=max(len(muscles), oracle.nu),
    )
    steps = SimpleNamespace(numpy=lambda: np.array([done, done + 7]))
    return SimpleNamespace(scene=scene, episode=SimpleNamespace(step_count=steps))


def test_a_trajectory_of_moco_plays_from_its_begin(caplog):
    """It covers 0.5 to 0.8 s of a trial; states beside the controls are no excitations."""
    with caplog.at_level(logging.WARNING, "myowarp"):
        play = Replay("moco.sto", read_storage(TRAJECTORY), simulated(MUSCLES, done=9))
    assert "moco.sto begins at 0.5 s; that is the begin of an episode" in caplog.text
    actions = play(np.zeros((2, 1)))
    found = [[excitation(action, False) for action in row] for row in actions.tolist()]
    knots = np.linspace(0.5, 0.8, 7)
    for world, time in enumerate((0.6, 0.67)):
        law = [np.interp(time, knots, 0.3 + 0.2 * np.sin(9.0 * knots + k)) for k in range(6)]
        np.testing.assert_allclose(found[world], law, atol=1e-6)


def test_its_states_are_a_motion():
    motion = read_motion(TRAJECTORY, Bones.read(DATA / "osim/arm26.osim"))
    law = np.stack([0.3 + 0.3 * np.sin(4.0 * motion.time), 1.2 + 0.6 * np.cos(4.0 * motion.time)], axis=1)
    np.testing.assert_allclose(motion.values, law, atol=1e-9)


@pytest.mark.parametrize(
    ("time", "done", "said"),
    [
        ((0.0, 0.3), 22, ()),
        ((0.0, 0.3), 30, ("moco.sto ends after 0.3 s of an episode; its last row holds from there on",)),
        (
            (0.0, 300.0),
            0,
            ("the recording 'moco.sto' lasts 300 s at 0.0033 Hz; is its time in ms, or in percent?",),
        ),
    ],
)
def test_a_file_that_ends_or_hardly_begins_is_said(caplog, time, done, said):
    warn_once.cache_clear()
    table = Storage(MUSCLES, np.array(time), np.array([6 * [0.1], 6 * [0.5]]))
    with caplog.at_level(logging.WARNING, "myowarp"):
        Replay("moco.sto", table, simulated(MUSCLES, done=done))(np.zeros((2, 1)))
    assert tuple(caplog.messages) == said


def test_motors_alone_play():
    """As RRA's controls are, of a model whose muscles were taken out."""
    motors = "<actuator><motor name='hip' joint='j' ctrlrange='-2 2' ctrllimited='true'/></actuator>"
    table = Storage(("hip",), np.array([0.0, 1.0]), np.array([[0.0], [2.0]]))
    actions = Replay("rra.sto", table, simulated((), motors, done=24))(np.zeros((2, 1)))
    np.testing.assert_allclose(actions[:, 0], [0.25, 0.32], rtol=1e-6)
    with pytest.raises(ValueError, match="drives muscles or motors; it has no column of one of 'arm'"):
        Replay("rra.sto", table, simulated(()))

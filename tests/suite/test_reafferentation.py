"""Reafferentation: where commands go, and beside a tendon transfer."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from hands import EIP, ELBOW, EPL, HAND, act, simulation, state

from myowarp.definitions.condition import resolve
from myowarp.definitions.parameter import Parameter, Ramp, Uniform
from myowarp.definitions.task import TASKS
from myowarp.definitions.worlds import Worlds
from myowarp.models.conditions.reafferentation import Reafferentation, check_apart
from myowarp.models.conditions.tendon_transfer import TendonTransfer
from myowarp.tasks.variants import variants

CTRL = 1e-6  # excitations of order one in float32
EFFECT = 10.0


class TestReafferentation:
    """The command for EIP at EPL."""

    def test_controls(self):
        """Two worlds of three, nothing else than two numbers."""
        sim = simulation(HAND, 3, Reafferentation(affected=[1.0, 0.49, 0.5]))
        ctrl = np.float32(np.random.default_rng(0).uniform(0.1, 1.0, (3, 39)))
        ctrl[:, EPL] = np.nan
        sim.scene.data.ctrl.assign(ctrl)
        sim.shards[0].launch_conditions()
        expected = ctrl.copy()
        expected[[0, 2], EPL], expected[[0, 2], EIP] = ctrl[[0, 2], EIP], 0.0
        np.testing.assert_array_equal(sim.scene.data.ctrl.numpy(), expected)

    def test_beside_a_transfer(self):
        """One batch with a transfer, a reafferentation, neither, in any order of naming."""
        both = (Reafferentation(affected=[0, 1, 0]), TendonTransfer(affected=[1, 0, 0]))
        alone = [simulation(HAND, 3, c) for c in ("tendon_transfer", "reafferentation", ())]
        for conditions in (both, both[::-1]):
            sims = [simulation(HAND, 3, conditions), *alone]
            for sim in alone:
                sim.reset(seeds=np.arange(3))
            for step in range(2):
                for sim in sims:
                    act(sim, step)
            mixed, *separate = (state(sim) for sim in sims)
            for world, one in enumerate(separate):
                np.testing.assert_array_equal(mixed[world], one[world])
                assert np.abs(mixed - one).max(axis=1)[np.arange(3) != world].min() > EFFECT * CTRL


@pytest.mark.parametrize(
    ("reafferentation", "transfer", "world"),
    [
        (1.0, 1.0, 0),
        ([0, 1], 1.0, 1),
        ([1, 0], [0, 1], None),
        (1.0, Ramp(0.0, 1.0, onset=3.0), 0),
        (1.0, Ramp(0.0, 0.4, onset=3.0), None),
        (Ramp(1.0, 0.0, onset=3.0), Ramp(0.0, 1.0, onset=3.0), None),
        (Ramp(1.0, 0.0, onset=3.0), Ramp(0.0, 1.0, onset=2.9), 0),
        (Ramp(1.0, 0.0, duration=4.0), Ramp(0.0, 1.0, duration=2.0), 0),
        (Ramp(1.0, 0.0, duration=2.0), Ramp(0.0, 1.0, duration=4.0), None),
        (Ramp(1.0, 0.0, onset=3.0), Ramp(0.0, 1.0, onset=2.9, of="life"), None),
        (Uniform(0.0, 1.0), 1.0, None),
    ],
)
def test_both_in_one_world(reafferentation, transfer, world):
    """Refused where it is known beforehand, at any time."""
    scene = SimpleNamespace(
        worlds=Worlds.all(2),
        control_dt=0.02,
        zeros=lambda name, *shape: wp.zeros((2, *shape)),
        parameters=[],
    )
    parameters = [
        Parameter(f"{name} affected", value, scene, (), neutral=0.0)
        for name, value in (("reafferentation", reafferentation), ("tendon_transfer", transfer))
    ]
    if world is None:
        check_apart(*parameters)
        return
    message = (
        f"world {world} cannot have both 'reafferentation' and 'tendon_transfer'; "
        "set affected of one of them to 0 there, with one entry per world"
    )
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        check_apart(*parameters)


@pytest.mark.parametrize(
    ("key", "conditions", "message"),
    [
        (
            ELBOW,
            "reafferentation",
            "body 'elbow' cannot have reafferentation; bodies that can: hand, contact_hand",
        ),
        (HAND, ("reafferentation", "tendon_transfer"), "world 0 cannot have both"),
        (
            HAND,
            ("reafferentation", "reafferentation"),
            "conditions 'reafferentation' and 'reafferentation' both set the command of "
            "the lost muscle; leave one out",
        ),
        (HAND, Reafferentation(-0.1), "reafferentation affected must be in 0..1, got -0.1"),
    ],
)
def test_bad_input(key, conditions, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
        simulation(key, 2, conditions)


def test_ids_are_upstreams():
    """`myoReafHand...` ids stand for the condition."""
    variant = variants()["MyoWarp/myoReafHandPoseFixed-v0"]
    assert variant.conditions == ("reafferentation",)
    assert resolve(variant.conditions, TASKS[variant.task])

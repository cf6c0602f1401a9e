"""Nerve crossing: commands change places, and a body cannot tell it from a policy that swaps its actions."""

import re

import numpy as np
import pytest
from hands import ELBOW, HAND, simulation, state

from myowarp.definitions.body import BODIES
from myowarp.definitions.muscle import muscle_index
from myowarp.models.conditions import NerveCrossing, Ramp, Reafferentation

CHANGED = 1e-3  # of a state, which float32 has to 1e-6


def swapped(sim, pairs):
    """Return the order of actuators in which every pair has changed places."""
    names, order = sim.scene.muscles.names, np.arange(sim.action.shape[1])
    for one, other in ([muscle_index(name, names) for name in pair] for pair in pairs):
        order[[one, other]] = order[[other, one]]
    return order


@pytest.mark.parametrize("key", [ELBOW, HAND])
@pytest.mark.parametrize("named", [False, True])
def test_as_swapped_actions(key, named):
    """From the step of its onset on, in some worlds; all others go as without it."""
    pairs = BODIES["elbow" if key == ELBOW else "hand"].antagonists[: 1 if named else None]
    affected = Ramp(0.0, [1.0, 0.49, 0.5], onset=0.04)
    sim = simulation(key, 3, NerveCrossing(affected, pairs if named else None))
    plain = simulation(key, 3, ())
    order, rng = swapped(plain, pairs), np.random.default_rng(0)
    apart = 0.0
    for step in range(4):
        actions = np.float32(rng.uniform(-1.0, 1.0, (3, sim.action.shape[1])))
        told = actions.copy()
        if step >= 2:
            told[[0, 2]] = told[[0, 2]][:, order]
            apart = max(apart, np.abs(told - actions).max())
        for each, own in ((sim, actions), (plain, told)):
            each.action.assign(own)
            each.step()
        np.testing.assert_array_equal(state(sim), state(plain))
    assert apart > CHANGED


def test_before_reafferentation():
    """The donor's command comes from where its crossed nerve brought it."""
    pairs = [("EIP", "FDS2"), ("FDP3", "EDC3")]
    sim = simulation(HAND, 2, (Reafferentation(), NerveCrossing([1.0, 0.0], pairs)))
    names = sim.scene.muscles.names
    given = np.float32(np.random.default_rng(0).uniform(0.1, 1.0, (2, 39)))
    sim.scene.data.ctrl.assign(given)
    sim.shards[0].launch_conditions()
    donor, lost = (muscle_index(name, names) for name in ("EIP", "EPL"))
    expected = given.copy()
    expected[0] = given[0, swapped(sim, pairs)]
    expected[:, lost], expected[:, donor] = expected[:, donor], 0.0
    np.testing.assert_array_equal(sim.scene.data.ctrl.numpy(), expected)


@pytest.mark.parametrize(
    "pairs",
    [(), 5, (5,), "FPL", ("FPL", "EPL"), (("FPL", "EPL", "APL"),), (("FPL", 3),), {"FPL": "EPL"}, ("ab",)],
)
def test_no_pairs(pairs):
    message = f"nerve_crossing needs pairs of muscles such as [('FDP2', 'EDC2')], got {pairs!r}"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        NerveCrossing(pairs=pairs)


@pytest.mark.parametrize(
    ("key", "condition", "message"),
    [
        (
            HAND,
            'nerve_crossing(pairs=(("FPL", "FPL_r"),))',
            "nerve_crossing needs pairs of different muscles, got 'FPL_r' twice",
        ),
        (
            HAND,
            NerveCrossing(pairs=(("FPL", "EPL"), ("FPL_r", "APL"))),
            "nerve_crossing needs pairs of different muscles, got 'FPL_r' twice",
        ),
        (HAND, NerveCrossing(pairs=(("FPL", "EPX"),)), "muscle 'EPX' unknown; did you mean"),
        (
            "motorFingerReachFixed-v0",
            NerveCrossing(pairs=[("dflx", "extn")]),
            "muscle 'dflx' unknown; available: none",
        ),
        (HAND, NerveCrossing(1.1), "nerve_crossing affected must be in 0..1, got 1.1"),
        (
            "myoTorsoPoseFixed-v0",
            NerveCrossing(),
            "body 'torso' cannot cross nerves without pairs of muscles; bodies that can: hand, ",
        ),
    ],
)
def test_bad_input(key, condition, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
        simulation(key, 2, condition)

"""Measures of strides: closed forms, and the same by a second hand on a walk with noise."""

import dataclasses

import numpy as np
import pytest
from striding import MASS, PEAK, RATE, VALLEY, striding

from myowarp.motion.gait import CONTACT, PERCENT
from myowarp.motion.strides import GRAVITY, UNITS, is_on, muscle_groups, strides_of, within
from myowarp.motion.trial_walk import belt_velocity, over_ground

SPEED, PERIOD, WIDTH, REACH, HEIGHT, STANCE, COST = 1.3, 1.1, 0.12, 0.25, 0.95, 0.6, 4.0
RISE = 6e-3
"""Twice the time after which the force passes the threshold [s], and rounding."""


def values_of(**changes):
    return strides_of(striding(**changes)).values


def test_measures_are_those_of_the_closed_form():
    found = values_of()
    expected = {
        "speed": SPEED,
        "cadence": 120.0 / PERIOD,
        "step_length": SPEED * PERIOD / 2.0,
        "step_width": WIDTH,
        "step_length_asymmetry": 0.0,
        "step_time_asymmetry": 0.0,
        "stance": 100.0 * STANCE,
        "first_peak": PEAK,
        "second_peak": PEAK,
        "valley": VALLEY,
        "margin_ahead": REACH - SPEED * np.sqrt(HEIGHT / GRAVITY),
        "margin_outwards": WIDTH / 2.0,
        "metabolic_rate": COST,
        "cost_of_transport": COST / SPEED,
    }
    near = {"stance": 100.0 * RISE / PERIOD, "margin_ahead": SPEED * RISE, "first_peak": 1e-4}
    for name, value in expected.items():
        atol = near.get(name.replace("second", "first"), 1e-6)
        np.testing.assert_allclose(found[name], value, atol=atol, err_msg=name)
    assert set(found) == set(UNITS)
    assert len(found["speed"]) == 9  # five strikes of the left foot, six of the right one


@pytest.mark.parametrize("late", [-0.05, 0.08])
def test_a_late_foot_makes_steps_unequal(late):
    """The right foot's step is (0.5 - late) of the stride, the left one's (0.5 + late)."""
    found = values_of(late=late)
    for name in ("step_length_asymmetry", "step_time_asymmetry"):
        np.testing.assert_allclose(found[name], -400.0 * late, atol=1e-6)
    np.testing.assert_allclose(found["step_length"], SPEED * PERIOD / 2.0, atol=1e-6)


def test_a_walk_that_is_faster_wider_and_slower_in_its_steps():
    found = values_of(speed=0.7, period=1.4, width=0.3, mass=50.0)
    np.testing.assert_allclose(found["step_length"], 0.49, atol=1e-6)
    np.testing.assert_allclose(found["step_width"], 0.3, atol=1e-6)
    np.testing.assert_allclose(found["cadence"], 120.0 / 1.4, atol=1e-6)
    np.testing.assert_allclose(found["first_peak"], PEAK, atol=1e-4)


def test_curves_begin_where_the_foot_comes_down():
    found = strides_of(striding(shift=0.1)).curves
    begun = 100.0 * RISE / PERIOD  # the threshold is passed so much after the foot comes down [%]
    wanted = 20.0 * np.sin(2.0 * np.pi * (PERCENT / 100.0 - 0.1))
    for side in "rl":
        np.testing.assert_allclose(
            found[f"knee_angle_{side}"][1], wanted, atol=20.0 * 2.0 * np.pi * begun / 100.0
        )
        on = within([(10.0, 50.0)])
        assert (is_on(found[f"soleus_{side}"][0]) ^ on).sum() <= 2


def by_hand(walk, side):
    """Measure the strides of a side with loops over rows, from the definitions."""
    other = {"r": "l", "l": "r"}[side]
    up, time = walk.force[side], walk.time

    def crossings(force):
        return [
            time[i] + RATE * (CONTACT - force[i]) / (force[i + 1] - force[i])
            for i in range(len(force) - 1)
            if force[i] <= CONTACT < force[i + 1]
        ]

    def at(columns, when):
        row = int(when / RATE)
        share = when / RATE - row
        return (1.0 - share) * columns[row] + share * columns[row + 1]

    rows = []
    for begin, end in zip(crossings(up), crossings(up)[1:], strict=False):
        first, last = at(walk.center, begin), at(walk.center, end)
        way = (last - first)[:2]
        ahead = way / np.hypot(*way)
        sign = {"r": 1.0, "l": -1.0}[side]
        out = sign * np.array((ahead[1], -ahead[0]))
        row = int(begin / RATE)
        velocity = [(walk.center[i + 1] - walk.center[i - 1])[:2] / (2.0 * RATE) for i in (row, row + 1)]
        share = begin / RATE - row
        pace = (1.0 - share) * velocity[0] + share * velocity[1]
        margin = at(walk.foot[side], begin) - first[:2] - pace * np.sqrt(first[2] / GRAVITY)
        here = next(t for t in crossings(walk.force[other]) if begin < t < end)
        its = at(walk.foot[other], here) - at(walk.foot[side], begin)
        own = at(walk.foot[side], end) - at(walk.foot[other], here)
        percent = [
            at(walk.curves[f"knee_angle_{side}"], begin + p / 100.0 * (end - begin)) for p in range(101)
        ]
        rows.append(
            {
                "speed": np.hypot(*way) / (end - begin),
                "cadence": 120.0 / (end - begin),
                "step_length": (its + own) @ ahead / 2.0,
                "step_width": (own - its) @ out / 2.0,
                "step_length_asymmetry": sign * 200.0 * ((own - its) @ ahead) / ((own + its) @ ahead),
                "step_time_asymmetry": sign * 200.0 * (end + begin - 2.0 * here) / (end - begin),
                "margin_ahead": margin @ ahead,
                "margin_outwards": margin @ out,
                "knee": percent,
            }
        )
    return rows


def test_a_walk_with_noise_is_measured_as_by_hand():
    noise = np.random.default_rng(1)
    walk = striding(late=0.03)
    sway = 0.03 * np.sin(2.0 * np.pi * walk.time[:, None] / PERIOD + noise.uniform(0.0, 6.0, 3))
    moved = {
        s: foot + noise.normal(0.0, 0.002, foot.shape).cumsum(axis=0) / 20.0 for s, foot in walk.foot.items()
    }
    walk = dataclasses.replace(walk, center=walk.center + sway, foot=moved)
    found = strides_of(walk)
    rows = {side: by_hand(walk, side) for side in "rl"}
    for name in set(rows["r"][0]) - {"knee"}:
        wanted = [row[name] for side in "rl" for row in rows[side]]
        np.testing.assert_allclose(found.values[name], wanted, rtol=1e-9, atol=1e-9, err_msg=name)
        assert np.ptp(wanted) > 0.0 or name == "cadence"
    for side in "rl":
        np.testing.assert_allclose(
            found.curves[f"knee_angle_{side}"], [row["knee"] for row in rows[side]], atol=1e-9
        )


def test_strides_before_a_time_do_not_count():
    late = strides_of(striding(), after=2.0)
    assert len(late.values["speed"]) == 5
    assert late.steps == strides_of(striding()).steps == 11


def test_a_stride_that_the_motion_does_not_cover_is_unknown_but_counted():
    walk = striding()
    kept = (walk.time > 1.0) & (walk.time < 3.0)
    part = {name: x[kept] for name, x in walk.curves.items()}
    feet = {side: x[kept] for side, x in walk.foot.items()}
    cut = dataclasses.replace(
        walk, time=walk.time[kept], center=walk.center[kept], foot=feet, curves=part, metabolic_rate=None
    )
    found = strides_of(cut)
    assert np.isfinite(found.values["speed"]).sum() == 1
    assert np.isfinite(found.values["first_peak"]).all()
    assert np.isfinite(found.curves["knee_angle_r"]).all(axis=1).sum() == 1
    assert "metabolic_rate" not in found.values


def test_steps_on_the_spot_are_no_strides():
    found = strides_of(striding(speed=0.0))
    assert (found.steps, found.values, found.curves) == (11, {}, {})


def test_on_a_belt_feet_say_how_fast_it_is():
    walk = striding(late=0.03)
    belt = np.array((-1.1, 0.4))
    moved = over_ground(walk, -belt)
    np.testing.assert_allclose(belt_velocity(walk), 0.0, atol=1e-9)
    np.testing.assert_allclose(belt_velocity(moved), belt, atol=1e-9)
    back, wanted = strides_of(over_ground(moved, belt)).values, strides_of(walk).values
    for name, values in wanted.items():
        np.testing.assert_allclose(back[name], values, rtol=1e-9, err_msg=name)


def test_muscles_are_found_by_the_names_of_several_models():
    names = [
        "soleus_r",
        "gasmed_r",
        "lat_gas_r",
        "bflh_l",
        "bifemsh_l",
        "glut_med2_l",
        "glmax1_l",
        "vas_int_r",
        "psoas_r",
        "soleus",
    ]
    assert muscle_groups(names) == {
        "soleus_r": [0],
        "gastrocnemius_r": [1, 2],
        "hamstrings_l": [3],
        "gluteus medius_l": [5],
        "gluteus maximus_l": [6],
        "vasti_r": [7],
    }


def test_muscles_are_on_above_a_share_of_their_range():
    ramp = np.linspace(0.1, 0.5, 101)
    assert is_on(ramp).sum() == 75
    assert not is_on(0.01 * ramp).any()
    np.testing.assert_array_equal(within([(95.0, 29.0)]), (PERCENT >= 95.0) | (PERCENT <= 29.0))
    assert not within([]).any()


def test_weight_is_what_both_feet_bear():
    whole, half = values_of()["weight"], strides_of(striding(mass=MASS, stance=0.3)).values["weight"]
    mean = 2.0 * (1.1 + 0.4 / 3.0) * 2.0 / np.pi  # of A sin + B sin 3, times both feet
    np.testing.assert_allclose(whole, 0.6 * mean, atol=0.02)
    np.testing.assert_allclose(half, 0.3 * mean, atol=0.02)

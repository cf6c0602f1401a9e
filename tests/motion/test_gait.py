"""Gait cycles: heel strikes where a known force passes the threshold, and curves over a cycle."""

import numpy as np
import pytest

from myowarp.motion.gait import (
    CONTACT,
    PERCENT,
    contacts,
    gait_cycles,
    heel_strikes,
    mirrored,
    over_cycle,
    side_of,
)
from myowarp.motion.storage import Storage, write_storage

PEAK, PERIOD = 800.0, 1.25  # N, s
RATE = 1e-3  # s
LOADS = """<OpenSimDocument Version="40000"><ExternalLoads name="l"><objects>{}</objects>
<datafile>plates.mot</datafile></ExternalLoads></OpenSimDocument>"""
LOAD = """<ExternalForce name="{0}"><applied_to_body>{0}</applied_to_body>
<force_identifier>{0}_v</force_identifier><point_identifier>{0}_p</point_identifier></ExternalForce>"""


def force(time, shift=0.0):
    """Half sines with flights between: on the ground from shift + k PERIOD on, for half of it."""
    return np.maximum(PEAK * np.sin(2.0 * np.pi * (time - shift) / PERIOD), 0.0)


def strike(k, shift=0.0):
    """When the k-th half sine passes the threshold."""
    return shift + k * PERIOD + PERIOD / (2.0 * np.pi) * np.arcsin(CONTACT / PEAK)


def test_heel_strikes_are_where_the_force_passes_the_threshold():
    time = np.arange(0.3, 4.0, RATE)
    found = heel_strikes(time, force(time))
    np.testing.assert_allclose(found, [strike(1), strike(2), strike(3)], atol=1e-6)


def test_a_foot_that_bounces_strikes_once():
    time = np.arange(-0.3, 1.0, RATE)
    bouncing = np.where((time > 0.1) & (time < 0.13), 0.0, force(time))
    np.testing.assert_allclose(heel_strikes(time, bouncing), [strike(0)], atol=1e-6)


def test_a_foot_that_brushes_the_ground_swings_on():
    time = np.arange(-0.3, 2.0, RATE)
    brushing = np.where((time > 0.85) & (time < 0.89), 100.0, force(time))
    np.testing.assert_allclose(heel_strikes(time, brushing), [strike(0), strike(1)], atol=1e-6)
    begin, end = contacts(time, brushing)
    np.testing.assert_allclose(begin, [strike(0), strike(1)], atol=1e-6)
    np.testing.assert_allclose(end[0], PERIOD / 2.0 - (strike(0)), atol=1e-6)
    assert end[1] == pytest.approx(strike(1) + end[0] - begin[0], abs=1e-5)
    standing = contacts(time[time < 0.4], force(time)[time < 0.4])
    assert standing[1].tolist() == [np.inf]


def test_cycles_are_those_of_each_foot(tmp_path):
    """Two plates under one foot count as one; a foot with one strike has none, nor has a pushed trunk."""
    time = np.arange(0.3, 4.0, RATE)
    half = 0.5 * force(time)
    forces = {"calcn_r": half, "toes_r": half, "calcn_l": force(time, 3.0) * (time > 2.9), "torso": half}
    columns, labels = [], []
    for body, up in forces.items():
        labels += [f"{body}_{part}{axis}" for part in "vp" for axis in "xyz"]
        columns += [0 * up, up, 0 * up, 0 * up, 0 * up, 0 * up]
    write_storage(tmp_path / "plates.mot", "plates", Storage(tuple(labels), time, np.stack(columns, axis=1)))
    (tmp_path / "loads.xml").write_text(LOADS.format("".join(LOAD.format(body) for body in forces)))
    found = gait_cycles(tmp_path / "loads.xml")
    assert list(found) == ["r"]
    np.testing.assert_allclose(found["r"], [(strike(1), strike(2)), (strike(2), strike(3))], atol=1e-5)


def test_over_a_cycle_a_curve_is_known_where_it_was_recorded():
    time = np.arange(0.5, 1.5, RATE)
    found = over_cycle(time, 3.0 * time, (1.0, 2.0))
    known = PERCENT < 49.9
    np.testing.assert_allclose(found[known], 3.0 * (1.0 + PERCENT[known] / 100.0), atol=1e-9)
    assert np.isnan(found[~known]).all()
    assert np.isnan(over_cycle(time, time, (np.nan, np.nan))).all()


@pytest.mark.parametrize(
    ("name", "side", "other"),
    [
        ("knee_angle_r", "r", "knee_angle_l"),
        ("hip_l_on_femur_l_in_ground_fx", "l", "hip_r_on_femur_r_in_ground_fx"),
        ("pelvis_list", "", "pelvis_list"),
        ("gap_of_femur_r_and_femur_l", "", "gap_of_femur_r_and_femur_l"),
        ("r_elbow_flex", "", "r_elbow_flex"),
    ],
)
def test_sides_are_what_names_say(name, side, other):
    assert (side_of(name)[1], mirrored(name)) == (side, other)

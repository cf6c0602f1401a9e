"""Schutte's muscle: fibers and activation as OpenSim 4.6 computes them, from the formulas of its class."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from converted import muscled
from hill_64 import Hill64, velocity_64
from opensim_muscles import read_muscles, write_muscles

import myowarp
from myowarp.kernels.structs import struct_of
from myowarp.laws.curves import CurveTables64
from myowarp.laws.muscles.hill_law import SCHUTTE
from myowarp.laws.muscles.hill_parameters import hill_parameters
from myowarp.osim.body.hill_curves import SPLINES, SplineCurves
from myowarp.osim.body.hill_muscle import HillMuscle
from myowarp.osim.document.read.muscle_defaults import DEFAULTS
from myowarp.sim.build import compile_scene

KIND = "Schutte1993Muscle_Deprecated"
DAMPING = 0.1
VELOCITY = 3e-4
"""Of the maximum contraction velocity: tables are off by 2e-5 at corners, which damping divides by 0.1."""


def opensims_velocity(a, active, velocity_force):
    """Return what OpenSim's calcFiberVelocity returns, the inverse of its f_V with damping."""
    kv, slope_k, most, d = 0.15, 0.13, 1.4, DAMPING
    gap = velocity_force - a * active
    c = kv * gap / d
    b = -kv * (velocity_force / kv + a * active + d) / d
    shortening = (-b - np.sqrt(b * b - 4 * c)) / 2
    q = slope_k * kv / (kv + 1)
    c = -q / d * gap
    b = -(velocity_force / d - most * a * active / d - q)
    with np.errstate(invalid="ignore"):
        return np.where(gap < 0, shortening, (-b + np.sqrt(b * b - 4 * c)) / 2)


@pytest.mark.parametrize("states_passive", [False, True])
def test_fibers_move_as_in_opensim(states_passive):
    splines = SPLINES["Delp1990Muscle_Deprecated" if states_passive else KIND]
    names = ("active_force_length_curve", "passive_force_length_curve", "tendon_force_length_curve")
    knots = np.full((1, 3, 2, 25), np.nan)
    for number, name in enumerate(names):
        if name in splines:
            knots[0, number, :, : len(splines[name].x)] = splines[name].x, splines[name].y
    values = {
        "max_isometric_force": np.array([[800.0]]),
        "optimal_fiber_length": np.array([[0.09]]),
        "tendon_slack_length": np.array([[0.15]]),
        "pennation_angle_at_optimal": np.array([[0.2]]),
        "max_contraction_velocity": np.array([[10.0]]),
        "fiber_damping": np.array([[DAMPING]]),
        "minimum_activation": np.array([[0.0]]),
    }
    rows, tables, spans = hill_parameters(SCHUTTE, values, real=wp.float64, knots=knots)
    rng = np.random.default_rng(0)
    curves = SplineCurves(splines[names[0]], splines.get(names[1]), splines[names[2]], None)
    a, length = rng.uniform(0.0, 1.0, 500), rng.uniform(0.4, 1.7, 500)
    active, passive = curves.active_force_length(length)[0], curves.passive_force(length)[0]
    pull = passive + rng.uniform(0.0, 1.6, 500) * np.maximum(a * active, 0.02)
    found = wp.zeros(500, dtype=wp.float64, device="cpu")
    given = (wp.array(x, dtype=wp.float64, device="cpu") for x in (a, length, pull))
    device = (wp.array(rows, dtype=Hill64, device="cpu"),)
    with wp.ScopedDevice("cpu"):
        device += (struct_of(CurveTables64, values=tables, spans=spans),)
    wp.launch(velocity_64, 500, [*device, *given, found], device="cpu")
    expected = opensims_velocity(a, active, pull - passive)
    assert np.ptp(expected) > 1.0
    assert found.numpy() == pytest.approx(expected, abs=VELOCITY)


@pytest.mark.parametrize("u", [0.1, 0.9])
def test_activation_is_that_of_opensim(tmp_path, u):
    """da/dt = (u - a) (activation1 u + activation2) / time_scale rising, without activation1 falling."""
    path = muscled(tmp_path, "arm26")
    values = {**DEFAULTS[KIND], "time_scale": 0.12, "activation1": 6.0, "activation2": 1.5}
    values["minimum_activation"] = 0.0
    own = [
        HillMuscle(m.name, KIND, {**m.values, **values}, SPLINES[KIND])
        for m in read_muscles(path.parent / "muscles.csv")
    ]
    write_muscles(path.parent / "muscles.csv", own)
    muscles = compile_scene(myowarp.from_mjcf(path), 1, device="cpu", physics="parity").muscles
    assert (muscles.parameters.numpy()["law"] == SCHUTTE).all()
    assert muscles.tables.values.shape[0] == 3
    dt, start = 0.002, np.linspace(0.0, 1.0, 6)
    muscles.activation.assign(start[None].astype(np.float32))
    length = np.array(
        [1.02 * m.values["tendon_slack_length"] + m.values["optimal_fiber_length"] for m in own]
    )
    ctrl = np.full((1, 6), u)
    zero = wp.zeros((1, 6), dtype=float, device="cpu")
    data = SimpleNamespace(
        ctrl=wp.array(ctrl, dtype=float, device="cpu"),
        actuator_length=wp.array(length[None], dtype=float, device="cpu"),
        actuator_velocity=zero,
    )
    model = SimpleNamespace(
        opt=SimpleNamespace(timestep=wp.full(1, dt, dtype=float, device="cpu")),
        actuator_biasprm=wp.zeros((1, 6), dtype=wp.types.vector(10, float), device="cpu"),
    )
    muscles.launch(model, data)
    expected = start.copy()
    for _ in range(1000):
        rate = np.where(u >= expected, 6.0 * u + 1.5, 1.5) / 0.12
        expected += dt / 1000 * rate * (u - expected)
    assert np.abs(expected - start).max() > 0.01
    assert muscles.activation.numpy()[0] == pytest.approx(expected, abs=2e-5)

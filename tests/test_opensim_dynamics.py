"""Dynamics of a document in float64 against OpenSim 4.6: recorded everywhere, live where it is installed."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from myowarp.opensim.check.engines import OurStep, States
from myowarp.opensim.check.oracle import opensim_equations
from myowarp.opensim.dynamics import equations
from myowarp.opensim.kinematics import independent, random_poses
from myowarp.opensim.mapping import CoordinateMap, MappedCoordinate
from myowarp.opensim.read.model import read_model

DATA = Path(__file__).parent / "data"

SOLVED = 1e-8
"""Share of the largest acceleration: OpenSim assembles couplers to 1e-9."""


@pytest.mark.parametrize("name", ["gait10dof18musc", "leg6dof9musc"])
def test_accelerations_equal_recorded(name):
    """In states with velocities, gravity and forces."""
    recorded = np.load(DATA / "opensim" / f"accelerations_{name}.npz")
    model = read_model(DATA / "osim" / f"{name}.osim")
    free = independent(model)
    order = [recorded["coordinates"].tolist().index(key) for key in free]
    values, speeds, forces = (recorded[key][:, order] for key in ("values", "speeds", "forces"))
    M, c = equations(model, dict(zip(free, values.T, strict=True)), speeds)
    found = np.linalg.solve(M, (forces - c)[..., None])[..., 0]
    wanted = recorded["accelerations"][:, order]
    assert np.linalg.norm(wanted, axis=1).min() > 10
    assert np.abs(found - wanted).max() < SOLVED * np.abs(wanted).max()


@pytest.mark.parametrize("name", ["arm26", "gait10dof18musc"])
def test_equations_are_those_of_opensim(name):
    pytest.importorskip("opensim")
    source = DATA / "osim" / f"{name}.osim"
    model = read_model(source)
    values = {key: value for key, value in random_poses(model, 5, 1).items() if key in independent(model)}
    speeds = np.random.default_rng(0).uniform(-3, 3, (5, len(values)))
    for found, wanted in zip(
        equations(model, values, speeds), opensim_equations(source, model, values, speeds), strict=True
    ):
        np.testing.assert_allclose(found, wanted, rtol=0, atol=SOLVED * np.abs(wanted).max())


@pytest.mark.slow
def test_step_of_more_joints_than_a_dense_jacobian_holds():
    """61 bodies on slides of their own: a = f / m, although the file asks for dense Jacobians."""
    number = 61
    spec, mass = mujoco.MjSpec(), np.linspace(1.0, 2.0, number)
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    for index in range(number):
        body = spec.worldbody.add_body(mass=mass[index], inertia=np.ones(3), explicitinertial=True)
        body.add_joint(name=str(index), type=mujoco.mjtJoint.mjJNT_SLIDE)
    ends = "free", False, 0.0, (-1.0, 1.0), False
    shown = tuple(MappedCoordinate(str(index), str(index), 1.0, *ends) for index in range(number))
    step = OurStep(CoordinateMap(shown, ()), spec, "")
    still, forces = np.zeros((2, number)), np.arange(2.0 * number).reshape(2, number)
    found = step.accelerations(States(still, still, forces, gravity=False))
    np.testing.assert_allclose(found, forces / mass, rtol=1e-6)

"""Dynamics of a document in float64 against OpenSim 4.6: recorded everywhere, live where it is installed."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from myowarp.osim.bundle.coordinate_map import CoordinateMap, MappedCoordinate
from myowarp.osim.convert.check.engines import PlainMuJoCo, States
from myowarp.osim.convert.check.oracle import opensim_equations
from myowarp.osim.convert.compose.binary import stiff
from myowarp.osim.convert.compose.convert import convert
from myowarp.osim.document.dynamics import equations
from myowarp.osim.document.kinematics import random_poses
from myowarp.osim.document.read.model import read_model
from myowarp.sim.converted_step import OurStep

DATA = Path(__file__).parents[1] / "data"

SOLVED = 1e-8
"""Share of the largest acceleration: OpenSim assembles couplers to 1e-9."""


HELD = 2e-4
"""rad or m: from 5e-5 that joints are off their equalities under Euler; `implicitfast` has 0.07."""


@pytest.mark.parametrize("name", ["gait10dof18musc", "leg6dof9musc"])
def test_accelerations_equal_recorded(name):
    """In states with velocities, gravity and forces."""
    recorded = np.load(DATA / "opensim" / f"accelerations_{name}.npz")
    model = read_model(DATA / "osim" / f"{name}.osim")
    free = model.independent
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
    values = {key: value for key, value in random_poses(model, 5, 1).items() if key in model.independent}
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
    step = OurStep(CoordinateMap(shown, ()), spec)
    still, forces = np.zeros((2, number)), np.arange(2.0 * number).reshape(2, number)
    found = step.accelerations(States(still, still, forces, gravity=False))
    np.testing.assert_allclose(found, forces / mass, rtol=1e-6)


TOP = """<OpenSimDocument Version="40000"><Model name="top"><gravity>0 -9.8 0</gravity>
<BodySet><objects><Body name="top"><mass>1</mass><mass_center>.02 -.1 .03</mass_center>
 <inertia>{inertia}</inertia></Body></objects></BodySet>
<JointSet><objects><GimbalJoint name="point"><socket_parent_frame>/ground</socket_parent_frame>
 <socket_child_frame>/bodyset/top</socket_child_frame>
 <coordinates><Coordinate name="a"/><Coordinate name="b"/><Coordinate name="c"/></coordinates>
</GimbalJoint></objects></JointSet></Model></OpenSimDocument>"""
VALUES, SPEEDS = np.array([[0.3, -0.4, 0.5]]), np.array([[1.0, -2.0, 0.7]])
FLAT = ".05 .01 .012 .002 -.003 .001"
FLAT_TURNS = 4.278684060804071, -4.87044483038205, -17.38324704167728
"""Moments that break A + B >= C, and OpenSim 4.6's accelerations there."""


def top(folder, inertia):
    """Return the document of a top with this inertia, and its conversion."""
    path = folder / "top.osim"
    path.write_text(TOP.format(inertia=inertia))
    model = read_model(path)
    return model, convert(model)


def test_model_mjb_has_moments_that_no_solid_has(tmp_path):
    """MuJoCo's compiler wants greater ones, and with these the top would turn otherwise."""
    model, converted = top(tmp_path, FLAT)
    compiled = converted.spec.compile()
    true = stiff(compiled, converted.couplings)
    states = States(VALUES, SPEEDS, np.zeros((1, 3)))
    found, raised = (
        PlainMuJoCo(converted.coordinates, host).accelerations(states)[0] for host in (true, compiled)
    )
    np.testing.assert_allclose(found, FLAT_TURNS, rtol=1e-9)
    assert np.abs(raised - found).max() > 0.1 * np.abs(found).max()
    # What MuJoCo derives from inertias when it compiles is derived again.
    M, _ = equations(model, dict(zip("abc", np.zeros((3, 1)), strict=True)), np.zeros((1, 3)))
    np.testing.assert_allclose(true.dof_M0, np.diag(M[0]), rtol=1e-9)
    np.testing.assert_allclose(true.dof_invweight0, np.diag(np.linalg.inv(M[0])), rtol=1e-9)


def test_light_joints_of_model_mjb_stay_at_their_equalities():
    """A fall of a second: knees with light bodies that muscles cross and must not pull off."""
    converted = convert(read_model(DATA / "osim" / "gait10dof18musc.osim"))
    model, worst = stiff(converted.spec.compile(), converted.couplings), []
    for integrator in (model.opt.integrator, mujoco.mjtIntegrator.mjINT_IMPLICITFAST):
        model.opt.integrator, off = integrator, 0.0
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        for _ in range(500):
            mujoco.mj_step(model, data)
            off = max(off, np.abs(data.efc_pos[: data.ne]).max())
        worst.append(off)
    assert worst[0] < HELD
    assert worst[1] > 100 * HELD


def test_the_step_has_moments_that_no_solid_has(tmp_path):
    """Also without joints that follow others; there is no spring that could hold them."""
    _, converted = top(tmp_path, FLAT)
    step = OurStep(converted.coordinates, converted.into(converted.spec))
    found = step.accelerations(States(VALUES, SPEEDS, np.zeros((1, 3))))[0]
    np.testing.assert_allclose(found, FLAT_TURNS, rtol=1e-5)


def test_a_negative_moment_that_lets_nothing_move_is_zero(tmp_path):
    """OpenSim loads the file; forces would accelerate the top against themselves."""
    _, converted = top(tmp_path, ".05 .05 -5 0 0 0")
    assert converted.couplings.bodies["top"] == (1.0, (0.0, 0.05, 0.05))
    (note,) = converted.notes
    assert note.rule.endswith(
        "in model.xml and model.mjb, and to 0 in couplings.json: no accelerations follow from them"
    )
    assert note.error_bound == "5 kg m^2"
    assert stiff(converted.spec.compile(), converted.couplings).body_inertia.min(axis=1)[-1] > 0

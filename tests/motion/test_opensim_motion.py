"""Inverse kinematics, inverse dynamics and static optimisation against OpenSim 4.6, as recorded."""

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from myowarp.motion.inverse_dynamics import Load, inverse_dynamics
from myowarp.motion.inverse_kinematics import inverse_kinematics
from myowarp.motion.markers import Markers
from myowarp.motion.muscle_forces import muscle_forces
from myowarp.motion.muscle_paths import muscle_paths
from myowarp.motion.skeleton import Bones
from myowarp.motion.smooth import derivatives
from myowarp.opensim.model.dynamics import equations
from myowarp.opensim.model.kinematics import random_poses
from myowarp.opensim.read.model import read_model

DATA = Path(__file__).parents[1] / "data"
MODELS = ("gait10dof18musc", "leg6dof9musc")

ANGLE = 1e-5
"""[rad] by which OpenSim's solution with its accuracy of 1e-9 is off."""
MOMENT = {"gait10dof18musc": 1e-6, "leg6dof9musc": 2e-4}
"""Share of the greatest moment: digits of files; OpenSim's knee is without the patella that follows it."""
ACTIVATION = 0.006
"""By which OpenSim's optimiser ends beside the optimum, at worst."""


@lru_cache
def recorded(name):
    return np.load(DATA / "opensim" / f"motion_{name}.npz")


@lru_cache
def bones(name):
    return Bones(read_model(DATA / "osim" / f"{name}.osim"))


@lru_cache
def inverted(name):
    """Return coordinates, speeds and what they take."""
    there, body = recorded(name), bones(name)
    assert body.coordinates == tuple(there["coordinates"])
    q, u, a = derivatives(there["time"], there["values"], there["time"], 6.0)
    load = Load(str(there["body"]), there["force"], there["point"], np.zeros_like(there["force"]))
    return q, u, a, inverse_dynamics(body, q, u, a, [load])


@pytest.mark.parametrize("name", MODELS)
def test_inverse_dynamics(name):
    there = recorded(name)
    scale = np.abs(there["moments"]).max(axis=0)
    assert (np.abs(inverted(name)[3].joint_moment - there["moments"]) < MOMENT[name] * scale + 1e-9).all()


@pytest.mark.parametrize("name", MODELS)
def test_loads_and_the_filter_matter(name):
    there, body = recorded(name), bones(name)
    scale = np.abs(there["moments"]).max()
    q, u, a, _ = inverted(name)
    unloaded = inverse_dynamics(body, q, u, a).joint_moment
    rough = inverse_dynamics(body, *derivatives(there["time"], there["values"], there["time"])).joint_moment
    assert np.abs(unloaded - there["moments"]).max() > 0.1 * scale
    assert np.abs(rough - unloaded).max() > 10 * MOMENT[name] * scale


@pytest.mark.parametrize("name", ["gait10dof18musc", "leg6dof9musc", "joints", "arm26"])
def test_inverse_dynamics_in_random_states(name):
    """M q'' + c of the equations of motion in NumPy, whose accelerations are OpenSim's to 1e-10."""
    body, random = bones(name), np.random.default_rng(3)
    poses = random_poses(body.model, 33, 4)
    q = np.stack([poses[c] for c in body.coordinates], axis=1)
    u, a = 3 * random.normal(size=q.shape), 20 * random.normal(size=q.shape)
    M, c = equations(body.model, dict(zip(body.coordinates, q.T, strict=True)), u)
    wanted = np.einsum("njk,nk->nj", M, a) + c
    got = inverse_dynamics(body, q, u, a).joint_moment
    np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())


def test_a_load_in_the_axes_of_a_body():
    """The same as in ground's axes; the point in the body, too."""
    body = bones("gait10dof18musc")
    q, u, a, needed = inverted("gait10dof18musc")
    there, number = recorded("gait10dof18musc"), bones("gait10dof18musc").number("calcn_r")
    turn, origin = needed.rotation[:, number], needed.origin[:, number]
    force = np.einsum("nji,nj->ni", turn, there["force"])
    point = np.einsum("nji,nj->ni", turn, there["point"] - origin)
    load = Load("calcn_r", force, point, np.zeros_like(force), "calcn_r", "calcn_r")
    np.testing.assert_allclose(
        inverse_dynamics(body, q, u, a, [load]).joint_moment, needed.joint_moment, atol=1e-9
    )


def test_inverse_kinematics():
    there, body = recorded("leg6dof9musc"), bones("leg6dof9musc")
    markers = Markers(tuple(there["markers"]), there["time"], there["seen"])
    found = inverse_kinematics(body, markers)
    np.testing.assert_allclose(found.values, there["fitted"], atol=ANGLE)
    assert np.abs(there["fitted"] - there["values"]).max() > 100 * ANGLE, "noise moves the solution"
    assert found.doubt() is None
    assert found.worst()[0][1] >= found.worst()[-1][1] > 0.0


def test_a_marker_that_was_not_seen():
    """Does not count; one that was moved does."""
    there, body = recorded("leg6dof9musc"), bones("leg6dof9musc")
    seen = there["seen"].copy()
    seen[5, 2] = np.nan
    names = tuple(there["markers"])
    gap = inverse_kinematics(body, Markers(names, there["time"], seen))
    seen[5, 2] = there["seen"][5, 2] + 0.05
    moved = inverse_kinematics(body, Markers(names, there["time"], seen))
    others = np.arange(len(seen)) != 5
    np.testing.assert_allclose(gap.values[others], there["fitted"][others], atol=ANGLE)
    assert np.isnan(gap.error[5, 2])
    assert (
        np.abs(gap.values[5] - there["fitted"][5]).max()
        < 0.2 * np.abs(moved.values[5] - there["fitted"][5]).max()
    )


def test_a_frame_without_markers_stays_where_it_was():
    there, body = recorded("leg6dof9musc"), bones("leg6dof9musc")
    seen = there["seen"].copy()
    seen[20:23] = np.nan
    found = inverse_kinematics(body, Markers(tuple(there["markers"]), there["time"], seen))
    np.testing.assert_allclose(found.values[20:23], np.tile(found.values[19], (3, 1)), atol=1e-12)
    np.testing.assert_allclose(found.values[23:], there["fitted"][23:], atol=ANGLE)


def test_millimetres_as_metres_are_doubted():
    there, body = recorded("leg6dof9musc"), bones("leg6dof9musc")
    markers = Markers(tuple(there["markers"]), there["time"][:3], 1e3 * there["seen"][:3])
    assert "check the recording's unit" in inverse_kinematics(body, markers).doubt()


def test_wanted_coordinates_and_bad_weights():
    there, body = recorded("leg6dof9musc"), bones("leg6dof9musc")
    markers = Markers(tuple(there["markers"]), there["time"][:8], there["seen"][:8])
    knee = body.coordinates.index("knee_angle_r")
    held = inverse_kinematics(
        body, markers, coordinate_weights={"knee_angle_r": 1e6}, coordinate_values={"knee_angle_r": -0.3}
    )
    np.testing.assert_allclose(held.values[:, knee], -0.3, atol=1e-5)
    with pytest.raises(ValueError, match="the model has no marker 'NOSE'"):
        inverse_kinematics(body, markers, {"NOSE": 1.0})
    with pytest.raises(ValueError, match="must be at least 0 and finite, got -1"):
        inverse_kinematics(body, markers, {markers.names[0]: -1.0})
    with pytest.raises(ValueError, match="no marker has a weight"):
        inverse_kinematics(body, markers, {markers.names[0]: 0.0})
    unseen = Markers(markers.names, markers.time, np.full_like(markers.positions, np.nan))
    with pytest.raises(ValueError, match="no frame shows 3 markers with a weight"):
        inverse_kinematics(body, unseen)
    with pytest.raises(ValueError, match="coordinate 'elbow' unknown"):
        inverse_kinematics(body, markers, coordinate_weights={"elbow": 1.0})


def test_static_optimisation():
    name = "gait10dof18musc"
    there, body = recorded(name), bones(name)
    q, u, _, needed = inverted(name)
    reserves = {c: float(there["reserve"]) * (100 if c.startswith("pelvis") else 1) for c in body.coordinates}
    paths = muscle_paths(body.model, body.coordinates, q, u)
    found = muscle_forces(
        body.model, body.coordinates, paths, needed.joint_moment, mode="opensim", reserves=reserves
    )
    place = [list(there["actuators"]).index(muscle) for muscle in found.muscles]
    controls, forces = there["controls"][:, place], there["forces"][:, place]
    strength = np.array([body.model.muscles[m].max_isometric_force for m in found.muscles])
    off = np.abs(found.activation - controls)
    assert np.median(off) < 1e-3
    assert off.max() < ACTIVATION
    assert (np.abs(found.force - forces) / strength).max() < 0.01
    assert found.feasible.all()
    assert controls.max() > 0.5
    ours = muscle_forces(body.model, body.coordinates, paths, needed.joint_moment, reserves=reserves)
    assert np.abs(ours.activation - found.activation).max() > 10 * ACTIVATION, (
        "passive force and tendons matter"
    )

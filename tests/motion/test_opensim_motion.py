"""Inverse kinematics, inverse dynamics and static optimisation against OpenSim 4.6, as recorded."""

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from myowarp.motion.inverse_dynamics import Load, inverse_dynamics
from myowarp.motion.inverse_kinematics import inverse_kinematics
from myowarp.motion.joint_reactions import joint_reactions, muscle_wrenches
from myowarp.motion.markers import Markers
from myowarp.motion.muscle_forces import muscle_forces
from myowarp.motion.smooth import derivatives
from myowarp.osim.body.moment_arm import own_reference, poses_of
from myowarp.osim.body.muscle_paths import muscle_paths
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.dynamics import equations
from myowarp.osim.document.kinematics import random_poses
from myowarp.osim.document.read.model import read_model

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


def test_a_frame_without_markers_stays_where_it_was_and_is_said(caplog):
    there, body = recorded("leg6dof9musc"), bones("leg6dof9musc")
    seen = there["seen"].copy()
    seen[20:23] = np.nan
    found = inverse_kinematics(body, Markers(tuple(there["markers"]), there["time"], seen))
    np.testing.assert_allclose(found.values[20:23], np.tile(found.values[19], (3, 1)), atol=1e-12)
    np.testing.assert_allclose(found.values[23:], there["fitted"][23:], atol=ANGLE)
    (said,) = (record.getMessage() for record in caplog.records)
    assert said == (
        f"3 of {len(seen)} frames show fewer than 3 markers with a weight, first at {there['time'][20]:.4g} "
        "s, and have a pose of the frames beside; fill them with --fill, or leave them out with --span"
    )
    caplog.clear()
    inverse_kinematics(body, Markers(tuple(there["markers"]), there["time"], there["seen"]))
    assert not caplog.records


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
    with pytest.raises(ValueError, match="no marker has a weight above 0; give at least three"):
        inverse_kinematics(body, markers, {markers.names[0]: 0.0})
    others = Markers(tuple(f"walker:{name}" for name in markers.names), markers.time, markers.positions)
    with pytest.raises(ValueError, match=r"none of the recorded markers walker.* or take a MarkerSet"):
        inverse_kinematics(body, others)
    unseen = Markers(markers.names, markers.time, np.full_like(markers.positions, np.nan))
    with pytest.raises(ValueError, match="no frame shows 3 markers with a weight"):
        inverse_kinematics(body, unseen)
    with pytest.raises(ValueError, match="coordinate 'elbow' unknown"):
        inverse_kinematics(body, markers, coordinate_weights={"elbow": 1.0})


@pytest.mark.parametrize("name", ["gait10dof18musc", "leg6dof9musc", "arm26"])
def test_paths_are_those_of_numpy(name):
    """Lengths and moment arms of the converter's path code, in more poses than are followed at once."""
    body = bones(name)
    poses = random_poses(body.model, 301, 4)
    q = np.stack([poses[c] for c in body.coordinates], axis=1)
    found = muscle_paths(body, q, np.ones_like(q))
    assert found.moment_arm.shape[:2] == found.length.shape == (301, len(found.muscles))
    for k, muscle in enumerate(found.muscles):
        path = body.model.muscles[muscle].path
        along = [body.coordinates[i] for i in found.crossed[k]]
        there = own_reference(body.model, path, poses_of(body.model, poses, along), along)
        np.testing.assert_allclose(found.length[:, k], there.length, atol=1e-12)
        wanted = np.zeros(q.shape)
        for i, coordinate in zip(found.crossed[k], along, strict=True):
            wanted[:, i] = there.moment_arm[coordinate]
        np.testing.assert_allclose(found.moment_arm[:, k], wanted, atol=SLOPE)
    np.testing.assert_allclose(found.velocity, -found.moment_arm.sum(axis=2))
    assert np.ptp(found.length, axis=0).max() > 1e-3


def test_points_that_move_stay_where_the_range_ends():
    """OpenSim places them as if coordinates did not leave their ranges; beyond, our paths are as long."""
    body = bones("gait10dof18musc")
    with np.load(DATA / "opensim/beyond_gait10dof18musc.npz") as there:
        values = dict(zip(there["coordinates"].tolist(), there["values"].T, strict=True))
        q = np.stack([values[c] for c in body.coordinates], axis=1)
        found = muscle_paths(body, q, np.zeros_like(q))
        order = [found.muscles.index(muscle) for muscle in there["muscles"].tolist()]
        np.testing.assert_allclose(found.length[:, order], there["length"], atol=1e-9)


def test_static_optimisation():
    name = "gait10dof18musc"
    there, body = recorded(name), bones(name)
    q, u, _, needed = inverted(name)
    reserves = {c: float(there["reserve"]) * (100 if c.startswith("pelvis") else 1) for c in body.coordinates}
    paths = muscle_paths(body, q, u)
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


SLOPE = 1e-6
"""[m] by which moment arms from differences of poses are off."""
REACTION = 1e-4
"""Share of the greatest reaction: OpenSim takes the accelerations that its muscle forces give."""


def test_joint_reactions():
    """At the muscle forces of OpenSim's static optimisation."""
    name = "gait10dof18musc"
    there, body = recorded(name), bones(name)
    tension = dict(zip(there["actuators"], there["forces"].T, strict=True))
    tension = {muscle: tension[muscle] for muscle in body.model.muscles}
    q, _, _, needed = inverted(name)
    found = joint_reactions(body, q, needed, tension)
    theirs = np.load(DATA / "opensim" / f"reactions_{name}.npz")
    order = [list(theirs["joints"]).index(joint) for joint in found.joints]
    force, moment, point = np.split(theirs["reactions"][:, order], 3, axis=2)
    np.testing.assert_allclose(found.point, point, atol=1e-7)
    for ours, wanted in ((found.force, force), (found.moment, moment)):
        assert np.abs(ours - wanted).max() < REACTION * np.abs(wanted).max()
    bare = joint_reactions(body, q, needed, {})
    for ours, wanted in ((bare.force, force), (bare.moment, moment)):
        assert np.abs(ours - wanted).max() > 1000 * REACTION * np.abs(wanted).max(), "muscles matter"


def test_muscles_pull_on_themselves_alone():
    """Their forces and moments on all bodies and ground add up to nothing; an arm's work is its moment."""
    body = bones("arm26")
    poses = random_poses(body.model, 9, 2)
    q = np.stack([poses[c] for c in body.coordinates], axis=1)
    random = np.random.default_rng(1)
    tension = {muscle: random.uniform(100.0, 900.0, len(q)) for muscle in body.model.muscles}
    force, torque = muscle_wrenches(body, q, tension)
    assert np.abs(force).max() > 100.0
    np.testing.assert_allclose(force.sum(axis=1), 0.0, atol=1e-9)
    # Directions are those that OpenSim remembers, from before the last round of wrapping.
    assert np.abs(torque.sum(axis=1)).max() < 0.01 * np.abs(torque).max()
    still = inverse_dynamics(body, q, np.zeros_like(q), np.zeros_like(q))
    paths = muscle_paths(body, q, np.zeros_like(q))
    pulled = np.einsum("nmk,nm->nk", paths.moment_arm, np.stack(list(tension.values()), axis=1))
    found = joint_reactions(body, q, still, tension)
    elbow = found.joints.index("r_elbow")
    joint = list(body.model.joints.values())[elbow]
    (move,) = [move for move in joint.moves if move.coordinate == "r_elbow_flex"]
    axis = still.rotation[:, elbow] @ joint.child_frame.rotation @ move.axis
    rest = still.joint_moment - pulled
    along = np.einsum("ni,ni->n", axis, found.moment[:, elbow])
    np.testing.assert_allclose(along, rest[:, body.coordinates.index("r_elbow_flex")], atol=1e-3)

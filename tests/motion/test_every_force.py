"""Each class of force in each step of a recorded motion: an arm with one of them, and a rod by closed forms.

The moments are OpenSim 4.6's, from `tests/data/record_opensim_beside.py`; contact is in `test_contacts.py`.
"""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from myowarp.motion.actuators import actuators_of
from myowarp.motion.loads import prescribed_loads
from myowarp.motion.movement import write_angles
from myowarp.motion.setup import TrialSetup
from myowarp.motion.smooth import derivatives
from myowarp.motion.steps import dynamics, forces, kinematics
from myowarp.motion.storage import read_storage
from myowarp.motion.tracking import equations
from myowarp.osim.body.model_forces import left_out
from myowarp.osim.body.muscle_paths import muscle_paths
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.read.components import READERS
from myowarp.osim.document.read.model import read_model

DATA = Path(__file__).parents[1] / "data"
ARM = (DATA / "osim/arm26.osim").read_text()
RECORDED = json.loads((DATA / "opensim/beside.json").read_text())
TIME, VALUES = np.array(RECORDED["time"]), np.array(RECORDED["values"])
BARE = np.array(RECORDED["moments"][""])
FORCES = {
    re.match(r"<(\w+)", RECORDED["forces"][name])[1]: name
    for name in RECORDED["moments"]
    if name in RECORDED["forces"] and name != "motor"
}
"""The force of each class; the actuators are in `test_model_forces.py`."""

TOLERANCE = 1e-6
"""N m: what twice differentiated splines differ by."""
WRITTEN = 2e-5
"""N m: of numbers in files."""
SHARED = 1e-3
"""N m by which a static optimisation may miss a moment."""


@pytest.fixture(params=FORCES)
def name(request):
    """Return the name of the force of a class."""
    return FORCES[request.param]


@pytest.fixture
def arm(name, tmp_path):
    """Return the arm with a force."""
    path = tmp_path / "arm.osim"
    path.write_text(ARM.replace(RECORDED["place"], RECORDED["place"] + RECORDED["forces"][name]))
    bones = Bones.read(path, "cpu")
    assert list(bones.coordinates) == RECORDED["coordinates"]
    return bones


@pytest.fixture
def recorded(arm, tmp_path):
    """Return a set-up with the recorded motion, from a file."""
    write_angles(tmp_path / "motion.mot", arm.model, arm.coordinates, TIME, VALUES)
    return TrialSetup(motion=tmp_path / "motion.mot")


@pytest.fixture
def wanted(name):
    """Return OpenSim's moments; the force changes them by far more than any tolerance."""
    theirs = np.array(RECORDED["moments"][name])
    assert np.abs(theirs - BARE).max() > 100 * SHARED
    return theirs


def test_dynamics(arm, recorded, wanted, tmp_path):
    found = dynamics(arm, recorded)
    found.write(tmp_path)
    np.testing.assert_allclose(found.needed.joint_moment, wanted, atol=WRITTEN)
    if not prescribed_loads(arm, TIME):  # which are loads, as others from outside
        np.testing.assert_allclose(found.needed.passive, BARE - wanted, atol=WRITTEN)
    table = read_storage(tmp_path / "moments.sto")
    np.testing.assert_allclose(table.values, wanted, atol=WRITTEN)


def test_forces(arm, recorded, wanted, tmp_path):
    """What muscles and reserves give together is what the bones take beside the force."""
    found = forces(arm, replace(recorded, reserves=dict.fromkeys(arm.coordinates, 1.0)))
    found.write(tmp_path)
    np.testing.assert_allclose(read_storage(tmp_path / "moments.sto").values, wanted, atol=WRITTEN)
    paths = muscle_paths(arm, found.motion.values, found.motion.speeds)
    given = np.einsum("nm,nmk->nk", found.solved.force, paths.moment_arm) + found.solved.reserve
    np.testing.assert_allclose(given, wanted, atol=SHARED)


def test_track(arm, wanted):
    """Accelerations of the simulation: M q'' + c, what muscles are asked for in each of its steps."""
    q, u, a = derivatives(TIME, VALUES, TIME, None)
    mass, bias = equations(arm, q, u, prescribed_loads(arm, TIME))
    np.testing.assert_allclose(np.einsum("njk,nk->nj", mass, a) + bias, wanted, atol=TOLERANCE)


def test_every_class_that_is_read_is_tested():
    """But contacts and actuators: passive classes of the readers."""
    fields = "ligaments", "limit_forces", "coordinate_formulas", "coordinate_springs", "bushings"
    passive = {tag for tag, (field, _) in READERS.items() if field in (*fields, "prescribed_forces")}
    assert set(FORCES) == passive


ROD = """<OpenSimDocument Version="40600"><Model name="rod"><gravity>0 0 0</gravity>
<BodySet><objects><Body name="rod"><mass>2</mass><mass_center>0.3 0 0</mass_center>
<inertia>0.01 0.02 0.03 0 0 0</inertia></Body></objects></BodySet><JointSet><objects>
<PinJoint name="hinge"><socket_parent_frame>/ground</socket_parent_frame>
<socket_child_frame>/bodyset/rod</socket_child_frame><coordinates><Coordinate name="angle">
<range>-3 3</range></Coordinate></coordinates></PinJoint></objects></JointSet><ForceSet><objects>
<BodyActuator name="hold"><socket_body>/bodyset/rod</socket_body><point>0.5 0.1 0.2</point>
<spatial_force_is_global>{in_ground}</spatial_force_is_global></BodyActuator>
</objects></ForceSet></Model></OpenSimDocument>"""


@pytest.mark.parametrize("in_ground", [True, False])
def test_a_body_actuator_is_six_motors(in_ground, tmp_path):
    """Torques, then forces at a point; names are OpenSim 4.6's of its controls."""
    path = tmp_path / "rod.osim"
    path.write_text(ROD.format(in_ground=str(in_ground).lower()))
    angle = np.array([0.0, 0.4, -1.3])
    motors = actuators_of(Bones.read(path, "cpu"), angle[:, None])
    assert motors.names == tuple(f"hold_{number}" for number in range(6))
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = (0.5 * cos - 0.1 * sin, 0.5 * sin + 0.1 * cos) if in_ground else (0.5 + 0 * cos, 0.1 + 0 * cos)
    still = np.zeros_like(angle)
    law = np.stack([still, still, still + 1.0, -y, x, still], axis=1)
    np.testing.assert_allclose(motors.effect[:, :, 0], law, atol=1e-12)


def test_constraints_that_hold_nothing_in_a_motion_are_named():
    said = left_out(read_model(DATA / "osim/loops.osim"))
    assert said.startswith(
        "left out, though OpenSim has it act: point constraint 'open_point' (open_crank_q, open_bar_q, "
        "open_rocker_q); point constraint 'jaw_point' ("
    )
    assert said.endswith(" (shut_crank_q, shut_bar_q, shut_rocker_q, shut_q)")


UNREAD = {
    "PointOnLineConstraint": """<socket_line_body>/ground</socket_line_body><line_direction_vec>1 0 0
</line_direction_vec><socket_follower_body>/bodyset/open_bar</socket_follower_body>""",
    "ConstantDistanceConstraint": """<socket_body_1>/ground</socket_body_1>
<socket_body_2>/bodyset/open_bar</socket_body_2><constant_distance>0.4</constant_distance>""",
}


@pytest.mark.parametrize("kind", UNREAD)
def test_constraints_that_nobody_reads_are_named_where_angles_and_moments_are_found(kind, tmp_path, caplog):
    """OpenSim's inverse kinematics obeys them; here a line comes before the markers are read."""
    text, path = (DATA / "osim/loops.osim").read_text(), tmp_path / "loops.osim"
    rod = f'<{kind} name="rod">{UNREAD[kind]}</{kind}>'
    path.write_text(text.replace("<PointConstraint ", rod + "<PointConstraint ", 1))
    model = read_model(path)
    named = f"{kind} 'rod' (open_crank_q, open_bar_q); point constraint 'open_point' ("
    assert left_out(model).startswith(f"left out, though OpenSim has it act: {named}")
    with pytest.raises(FileNotFoundError):
        kinematics(Bones.read(path), TrialSetup(markers=tmp_path / "none.trc"))
    assert f"loops.osim: these hold no angles here, and do in OpenSim: {named}" in caplog.text

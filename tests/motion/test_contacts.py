"""Contact forces of a model: what OpenSim 4.6 recorded in random states, and closed forms.

The table is from `tests/data/record_opensim_contacts.py`.
"""

from pathlib import Path

import numpy as np
import pytest

from myowarp.apps.cli.motion.dynamics import Dynamics
from myowarp.motion.inverse_dynamics import inverse_dynamics
from myowarp.motion.movement import write_angles
from myowarp.motion.storage import read_storage
from myowarp.osim.body.contacts import contacts_along
from myowarp.osim.body.model_forces import left_out, without
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.contacts import contact_pairs

DATA = Path(__file__).parents[1] / "data"
MODEL = DATA / "osim/contacts.osim"
RECORDED = np.load(DATA / "opensim/contacts.npz")
FORCES = RECORDED["forces"].tolist()

TOLERANCE = 1e-9
"""Of the greatest moment of a force. Normals between two ellipsoids agree to 4e-13, all else to rounding."""


@pytest.fixture(scope="module")
def bones():
    return Bones.read(MODEL, contact=True)


def states(bones):
    order = [RECORDED["coordinates"].tolist().index(name) for name in bones.coordinates]
    return order, RECORDED["values"][:, order], RECORDED["speeds"][:, order]


@pytest.mark.parametrize("force", FORCES)
def test_what_a_force_does_is_what_opensim_recorded(bones, force):
    order, values, speeds = states(bones)
    alone, unknown = without(bones.model, [name for name in FORCES if name != force])
    assert not unknown
    alone = Bones(alone)
    still = np.zeros_like(values)
    bare = inverse_dynamics(alone, values, speeds, still, passive=False).joint_moment
    did = bare - inverse_dynamics(alone, values, speeds, still).joint_moment
    wanted = RECORDED["acting"][:, FORCES.index(force)][:, order]
    touching = np.abs(wanted).max(axis=1) > 1e-6
    assert touching.sum() > 100
    assert np.abs(did - wanted).max() < TOLERANCE * np.abs(wanted).max()


def test_all_classes_and_shapes_are_recorded(bones):
    pairs = contact_pairs(bones.model)
    assert {pair.force for pair in pairs} == set(FORCES)
    kinds = {(pair.first.kind, pair.second.kind) for pair in pairs}
    assert {("plane", "sphere"), ("plane", "ellipsoid"), ("sphere", "sphere")} < kinds
    assert ("ellipsoid", "ellipsoid") in kinds
    assert ("sphere", "ellipsoid") in kinds


BALL = """<OpenSimDocument Version="40600"><Model name="ball"><gravity>0 -9.81 0</gravity>
<BodySet><objects><Body name="ball"><mass>2</mass><mass_center>0 0 0</mass_center>
<inertia>0.01 0.01 0.01 0 0 0</inertia></Body></objects></BodySet><JointSet><objects>
<SliderJoint name="rail"><socket_parent_frame>rail_offset</socket_parent_frame>
<socket_child_frame>/bodyset/ball</socket_child_frame><coordinates><Coordinate name="height">
<range>0 1</range></Coordinate></coordinates><frames><PhysicalOffsetFrame name="rail_offset">
<socket_parent>/ground</socket_parent><orientation>0 0 1.5707963267948966</orientation>
</PhysicalOffsetFrame></frames></SliderJoint></objects></JointSet>
<ForceSet><objects>{force}</objects></ForceSet><ContactGeometrySet><objects>
<ContactHalfSpace name="floor"><socket_frame>/ground</socket_frame>
<orientation>0 0 -1.5707963267948966</orientation></ContactHalfSpace>
<ContactSphere name="skin"><socket_frame>/bodyset/ball</socket_frame><radius>0.1</radius></ContactSphere>
</objects></ContactGeometrySet></Model></OpenSimDocument>"""
TOUCH = """<HuntCrossleyForce name="touch"><HuntCrossleyForce::ContactParametersSet><objects>
<HuntCrossleyForce::ContactParameters><geometry>{geometry}</geometry><stiffness>1e6</stiffness>
<dissipation>{dissipation}</dissipation></HuntCrossleyForce::ContactParameters></objects>
</HuntCrossleyForce::ContactParametersSet></HuntCrossleyForce>"""


def ball(folder, geometry="floor skin", dissipation=0.5):
    path = folder / "ball.osim"
    path.write_text(BALL.format(force=TOUCH.format(geometry=geometry, dissipation=dissipation)))
    return path


def test_a_ball_on_the_floor(tmp_path):
    """Hertz's force between equal moduli, times 1 + 3/2 c v of approach; none that pulls."""
    bones = Bones.read(ball(tmp_path), contact=True)
    height, speed = np.array([[0.09], [0.09], [0.09], [0.11]]), np.array([[0.0], [-1.0], [1.4], [0.0]])
    k = 0.5 * 1e6 ** (2 / 3)
    hertz = 4 / 3 * np.sqrt(0.1) * k**1.5 * 0.01**1.5
    found = contacts_along(bones, height, speed)
    assert found.force[:, 0, 1] == pytest.approx([hertz, 1.75 * hertz, 0.0, 0.0])
    assert found.location[0, 0] == pytest.approx([0.0, -0.005, 0.0])


def test_contact_rests_where_it_is_not_asked_for(tmp_path):
    model = Bones.read(ball(tmp_path)).model
    assert not model.contact_forces
    assert "HuntCrossleyForce 'touch' (height)" in left_out(model)


def test_a_geometry_that_is_not_there(tmp_path):
    path = ball(tmp_path, "floor foot")
    with pytest.raises(
        ValueError, match="names the contact geometry 'foot', which the model has not; it has fl"
    ):
        contacts_along(Bones.read(path, contact=True), np.zeros((1, 1)), np.zeros((1, 1)))
    assert Bones.read(path).coordinates == ("height",)


@pytest.mark.parametrize("contact", ["opensim", None])
def test_the_step_dynamics(tmp_path, contact):
    """A ball at rest on its contact takes no force; without contact the root carries its weight."""
    path = ball(tmp_path)
    k = 0.5 * 1e6 ** (2 / 3)
    depth = (2 * 9.81 / (4 / 3 * np.sqrt(0.1) * k**1.5)) ** (2 / 3)
    bones, time = Bones.read(path), np.linspace(0, 1, 11)
    write_angles(tmp_path / "rest.mot", bones.model, bones.coordinates, time, np.full((11, 1), 0.1 - depth))
    Dynamics(path, tmp_path / "rest.mot", contact=contact, output=tmp_path / "out")()
    moment = read_storage(tmp_path / "out/moments.sto").values
    assert moment == pytest.approx(0.0 if contact else 2 * 9.81, abs=1e-5)
    file = tmp_path / "out/contact_forces.sto"
    assert file.is_file() == bool(contact)
    if contact:
        table = read_storage(file)
        assert table.labels[:2] == ("touch.skin.force.X", "touch.skin.force.Y")
        assert table.values[:, 1] == pytest.approx(2 * 9.81, rel=1e-6)


def test_contact_of_a_model_without(tmp_path):
    path = DATA / "osim/arm26.osim"
    with pytest.raises(ValueError, match="--contact opensim needs a SmoothSphereHalfSpaceForce or HuntCros"):
        Dynamics(path, tmp_path / "rest.mot", contact="opensim", output=tmp_path)()

"""Contacts with height fields beside MuJoCo C, prism by prism, every world on a field of its own."""

from types import SimpleNamespace

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from stepping import engine_alone, launch_place

from myowarp.engine.ground import height_field
from myowarp.engine.stages.contact_search import ContactSearch

NUM_WORLDS = 200
MARGIN = 0.002  # m, of the pair
ROWS, COLUMNS, HIGHEST = 13, 21, 0.06  # points, points, m
DIST_TOLERANCE = 1e-4  # m; MuJoCo's polytope stops at up to 5e-5
NORMAL_TOLERANCE = 0.01  # likewise
EDGE = 1e-5  # m; contacts this close to the margin are found or not
SIZES = {"sphere": "0.05", "capsule": "0.03 0.06", "ellipsoid": "0.085 0.035 0.04"}


def field_model(kind, base):
    """Return a model of a tilted field, and a body beside it."""
    return mujoco.MjModel.from_xml_string(f"""<mujoco>
      <asset><hfield name="field" size="1.2 0.7 {HIGHEST} {base}" nrow="{ROWS}" ncol="{COLUMNS}"/></asset>
      <worldbody>
        <geom type="hfield" hfield="field" pos="0.1 -0.2 0.3" euler="5 10 40" margin="{MARGIN / 2}"/>
        <body><freejoint/>
          <geom type="{kind}" size="{SIZES.get(kind, "0.05 0.04 0.03")}" margin="{MARGIN / 2}"/></body>
      </worldbody></mujoco>""")


def states(model):
    """Return configurations near the field, some deep in it where its base is deep, and heights for each."""
    rng = np.random.default_rng(0)
    data, base = mujoco.MjData(model), model.hfield_size[0, 3]
    mujoco.mj_kinematics(model, data)
    rotation = data.geom_xmat[0].reshape(3, 3)
    lowest = 0.0 if base > 0.1 else HIGHEST
    local = rng.uniform((-1.3, -0.8, lowest), (1.3, 0.8, 0.15), (NUM_WORLDS, 3))
    quat = rng.standard_normal((NUM_WORLDS, 4))
    qpos = np.hstack([local @ rotation.T + data.geom_xpos[0], quat / np.linalg.norm(quat, axis=1)[:, None]])
    heights = rng.uniform(-0.02 if base > 0.1 else 0.0, HIGHEST, (NUM_WORLDS, ROWS, COLUMNS))
    return qpos, heights.astype(np.float32)


def contacts(model, qpos, heights):
    """Return distance, position and normal of our contacts, a list for each world."""
    device = mjw.put_model(model)
    data = mjw.make_data(model, nworld=len(qpos), nconmax=64)
    data.qpos.assign(qpos)
    engine_alone(mjw.kinematics)(device, data)
    ground = height_field(model, device)
    if ground is not None:
        ground.heights = wp.array(heights, dtype=float)
    scene = SimpleNamespace(model=device, data=data, oracle=model, ground=ground, device=wp.get_device("cpu"))
    ours = [ContactSearch(scene)] if ContactSearch.obstacle(scene) is None else []
    launch_place(scene, "collision", ours)
    number, contact = data.nacon.numpy()[0], data.contact
    found = np.hstack([contact.dist.numpy()[:, None], contact.pos.numpy(), contact.frame.numpy()[:, 0]])
    worlds = contact.worldid.numpy()[:number]
    return [found[:number][worlds == world] for world in range(len(qpos))]


def in_c(model, qpos, heights):
    """Return the same of MuJoCo C, in one world."""
    model.hfield_data[:], model.hfield_size[0, 2] = heights.ravel(), 1.0
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_fwdPosition(model, data)
    return np.hstack([data.contact.dist[:, None], data.contact.pos, data.contact.frame[:, :3]])


@pytest.mark.parametrize("base", [0.001, 0.5])
@pytest.mark.parametrize("kind", SIZES)
def test_contacts_are_those_of_mujoco(kind, base):
    model = field_model(kind, base)
    qpos, heights = states(model)
    found, normals = contacts(model, qpos, heights), []
    for world, ours in enumerate(found):
        theirs = in_c(model, qpos[world], heights[world])
        theirs = theirs[theirs[:, 0] < MARGIN - EDGE]
        ours = ours[ours[:, 0] < MARGIN - EDGE]
        assert len(ours) == len(theirs)
        np.testing.assert_allclose(ours[:, 0], theirs[:, 0], atol=DIST_TOLERANCE)
        normals += np.linalg.norm(ours[:, 4:] - theirs[:, 4:], axis=1).tolist()
    assert len(normals) > NUM_WORLDS / 2
    assert np.mean(np.array(normals) < NORMAL_TOLERANCE) > 0.98


@pytest.mark.parametrize("kind", SIZES)
def test_a_world_does_not_see_the_fields_of_others(kind):
    """Bit for bit."""
    model = field_model(kind, 0.001)
    qpos, heights = states(model)
    together = contacts(model, qpos, heights)
    flat = contacts(model, qpos, np.zeros_like(heights))
    for world in range(12):
        (alone,) = contacts(model, qpos[[world]], heights[[world]])
        np.testing.assert_array_equal(together[world], alone)
    assert sum(not np.array_equal(*pair) for pair in zip(together, flat, strict=True)) > NUM_WORLDS / 8


def test_other_shapes_are_left_to_the_engine():
    """Pairs of a field and a round body are no longer the engine's, those of a box still are."""
    box, ball = field_model("box", 0.001), field_model("sphere", 0.001)
    assert height_field(box, mjw.put_model(box)) is None
    device = mjw.put_model(ball)
    assert device.nxn_geom_pair_filtered.shape == (1,)
    assert height_field(ball, device).pairs == {(0, 1)}
    assert device.nxn_geom_pair_filtered.shape == (0,)

"""Contacts: ellipsoids against their definition by brute force in float64, closed forms against the engine.

Both beside MuJoCo C.
"""

from types import SimpleNamespace

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from often import often
from stepping import engine_alone, launch_place

from myowarp.engine.stages import contact_search
from myowarp.engine.stages.contact_filter import ContactFilter
from myowarp.engine.stages.contact_search import ContactSearch
from myowarp.engine.stages.primitive_contacts import CLOSED_FORMS

NUM_STATES = 64
MARGIN = 0.002  # m, of the pair
DIST_TOLERANCE = 3e-8  # m; bodies of a few cm in float32
NORMAL_TOLERANCE = 1e-5  # measured 3e-7
ZOOM_END = 1e-10  # rad, last radius of the random search
SIZES = {
    "sphere": ("0.01", "0.02 0.01 0.03"),
    "capsule": ("0.008 0.02", "0.012 0.008 0.02"),
    "ellipsoid": ("0.01 0.006 0.015", "0.012 0.008 0.02"),
}
DEEP = 0.3  # part of the distance over which centers are spread otherwise


def support(kind, size, n):
    """Return h(n) [m] of a body with the world's axes, n of shape (..., 3)."""
    if kind == "ellipsoid":
        return np.linalg.norm(n * size, axis=-1)
    if kind == "cylinder":
        return size[0] * np.hypot(n[..., 0], n[..., 1]) + size[1] * np.abs(n[..., 2])
    return size[0] + (size[1] * np.abs(n[..., 2]) if kind == "capsule" else 0.0)


def search(kind, size1, size2, center, rotation, other="ellipsoid"):
    """Return max and argmax of f(n) over the sphere: a grid, then a random search that closes in."""

    def f(n):
        return n @ center - support(kind, size1, n) - support(other, size2, n @ rotation)

    count = np.arange(8000) + 0.5
    polar, azimuth = np.arccos(1 - 2 * count / 8000), np.pi * (1 + 5**0.5) * count
    grid = np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], 1)
    ring = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], 1)  # where a capsule's f has its ridge
    grid = np.concatenate([grid, ring])
    best = grid[f(grid).argmax()]
    rng, radius = np.random.default_rng(0), 0.05
    while radius > ZOOM_END:
        near = best + radius * rng.standard_normal((200, 3))
        near[:100, 2] = best[2]
        near /= np.linalg.norm(near, axis=1)[:, None]
        values = f(near)
        if values.max() > f(best):
            best = near[values.argmax()]
        else:
            radius *= 0.5
    return f(best), best


def states(kind, spread):
    """Return a model of two bodies, and configurations of the second, near and in the first."""
    size1, size2 = SIZES[kind]
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><worldbody>
      <geom type="{kind}" size="{size1}" margin="{MARGIN / 2}"/>
      <body><freejoint/><geom type="ellipsoid" size="{size2}" margin="{MARGIN / 2}"/></body>
    </worldbody></mujoco>""")
    rng = np.random.default_rng(1)
    reach = model.geom_size.max(axis=1).sum()
    center = rng.uniform(-spread, spread, (NUM_STATES, 3)) * reach
    quat = rng.standard_normal((NUM_STATES, 4))
    return model, np.hstack([center, quat / np.linalg.norm(quat, axis=1)[:, None]])


def collided(model, qpos, room, ours=True, growth=0.0, before=()):
    """Return the engine's data with its contacts or ours; bodies grow from world to world.

    `before`: configurations in which contacts are searched first.
    """
    device = mjw.put_model(model, batch_sizes={"geom_size": len(qpos), "geom_margin": len(qpos)})
    device.opt.warn_overflow = False  # as in a task, whose kernels are these
    for field in (device.geom_size, device.geom_margin):
        scale = 1.0 + growth * np.arange(len(qpos)) / len(qpos)
        field.assign(field.numpy() * scale.reshape(-1, *[1] * (field.numpy().ndim - 1)))
    data = mjw.make_data(model, nworld=len(qpos), nconmax=room)
    scene = SimpleNamespace(model=device, data=data, oracle=model, ground=None, device=wp.get_device("cpu"))
    stages = [ContactSearch(scene)] if ours else []
    for configurations in (*before, qpos):
        data.qpos.assign(configurations)
        engine_alone(mjw.kinematics)(device, data)
        launch_place(scene, "collision", stages)
    return data


def engine_contacts(model, qpos):
    """Return distance, normal and position of our contacts, NaN in worlds without one."""
    data = collided(model, qpos, room=2)
    found = np.full((len(qpos), 7), np.nan)
    count = data.nacon.numpy()[0]
    worlds = data.contact.worldid.numpy()[:count]
    assert len(set(worlds)) == count
    contact = data.contact
    found[worlds, 0] = contact.dist.numpy()[:count]
    found[worlds, 1:4] = contact.frame.numpy()[:count, 0]
    found[worlds, 4:] = contact.pos.numpy()[:count]
    return found


@pytest.mark.parametrize("spread", [1.0, DEEP])
@pytest.mark.parametrize("kind", SIZES)
def test_contact_is_the_largest_separation(kind, spread):
    """Distance and normal are maximum and argmax of f; the point lies halfway between the surfaces."""
    model, qpos = states(kind, spread)
    found = engine_contacts(model, qpos)
    size1, size2 = model.geom_size
    touching = 0
    for x, (dist, *rest) in zip(qpos, found, strict=True):
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, x[3:])
        rotation = rotation.reshape(3, 3)
        expected, normal = search(kind, size1, size2, x[:3], rotation)
        assert np.isnan(dist) == (expected >= MARGIN)
        if np.isnan(dist):
            continue
        touching += 1
        assert dist == pytest.approx(expected, abs=DIST_TOLERANCE)
        np.testing.assert_allclose(rest[:3], normal, atol=NORMAL_TOLERANCE)
        local = rotation.T @ normal
        witness = x[:3] - rotation @ (size2**2 * local / np.linalg.norm(size2 * local))
        np.testing.assert_allclose(rest[3:], witness - expected / 2 * normal, atol=NORMAL_TOLERANCE)
    assert touching >= 10


@pytest.mark.parametrize("kind", SIZES)
def test_contacts_are_those_of_mujoco(kind):
    """MuJoCo C's polytope gives the same contacts; deep ones it finds too shallow, never too deep."""
    model, qpos = states(kind, 1.0)
    found, data = engine_contacts(model, qpos), mujoco.MjData(model)
    compared = 0
    for x, (dist, *rest) in zip(qpos, found, strict=True):
        data.qpos[:] = x
        mujoco.mj_fwdPosition(model, data)
        assert data.ncon == (not np.isnan(dist))
        if data.ncon and abs(dist) < MARGIN:
            compared += 1
            contact = data.contact[0]
            assert contact.dist == pytest.approx(dist, abs=2e-6)  # its tolerance is 1e-6 m
            np.testing.assert_allclose(contact.pos, rest[3:], atol=1e-4)
    assert compared >= 5


@pytest.mark.slow
def test_side_of_a_cylinder():
    """A capsule's contact with it is in closed form, and the largest separation; other contacts are not."""
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><worldbody>
      <geom type="cylinder" size="0.01 0.06" margin="{MARGIN / 2}"/>
      <body><freejoint/><geom type="capsule" size="0.008 0.02" margin="{MARGIN / 2}"/></body>
    </worldbody></mujoco>""")
    rng = np.random.default_rng(5)
    center = rng.uniform((-0.03, -0.03, -0.09), (0.03, 0.03, 0.09), (NUM_STATES, 3))
    quat = rng.standard_normal((NUM_STATES, 4))
    qpos = np.hstack([center, quat / np.linalg.norm(quat, axis=1)[:, None]])
    found, touching, ends = engine_contacts(model, qpos), 0, 0
    cylinder, capsule = model.geom_size
    for x, (dist, *rest) in zip(qpos, found, strict=True):
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, x[3:])
        expected, normal = search(
            "cylinder", cylinder, capsule, x[:3], rotation.reshape(3, 3), other="capsule"
        )
        assert np.isnan(dist) == (expected >= MARGIN)
        side = abs(normal[2]) < NORMAL_TOLERANCE and expected > -capsule[0]
        ends += not (np.isnan(dist) or side)
        if np.isnan(dist) or not side:
            continue
        touching += 1
        assert dist == pytest.approx(expected, abs=DIST_TOLERANCE)
        np.testing.assert_allclose(rest[:3], -normal, atol=NORMAL_TOLERANCE)
        witness = np.array(rest[3:]) - dist / 2 * normal
        assert np.hypot(*witness[:2]) == pytest.approx(cylinder[0], abs=NORMAL_TOLERANCE)
    assert touching >= 10
    assert collided(model, qpos, 2).ncollision.numpy()[0] == ends


def test_side_of_a_long_capsule():
    """Rounding leaves the normal a little off the side's; the contact stays there, as in MuJoCo C."""
    radius, size, rng = 0.02, np.array([0.02, 0.024, 0.027]), np.random.default_rng(2)
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><worldbody>
      <body><freejoint/><geom type="capsule" size="{radius} 0.12" margin="{MARGIN}"/></body>
      <body><freejoint/><geom type="ellipsoid" size="0.02 0.024 0.027"/></body>
    </worldbody></mujoco>""")
    count = 8 * NUM_STATES
    turns = rng.standard_normal((2, count, 4))
    turns /= np.linalg.norm(turns, axis=2)[..., None]
    frames = np.zeros((2, count, 9))
    for frame, quat in zip(frames.reshape(-1, 9), turns.reshape(-1, 4), strict=True):
        mujoco.mju_quat2Mat(frame, quat)
    frames = frames.reshape(2, count, 3, 3)
    axis = frames[0, :, :, 2]
    out = np.cross(rng.standard_normal((count, 3)), axis)
    out /= np.linalg.norm(out, axis=1)[:, None]
    reach = radius + np.linalg.norm(np.einsum("nij,ni->nj", frames[1], out) * size, axis=1)
    gap, along = rng.uniform(-0.002, 0.0, count), rng.uniform(-0.1, 0.1, count)
    center = along[:, None] * axis + (reach + gap)[:, None] * out
    qpos = np.hstack([np.zeros((count, 3)), turns[0], center, turns[1]])
    data = mujoco.MjData(model)
    for x, (dist, *rest) in zip(qpos, engine_contacts(model, qpos), strict=True):
        data.qpos[:] = x
        mujoco.mj_fwdPosition(model, data)
        assert data.contact.dist[0] == pytest.approx(dist, abs=5e-6)
        np.testing.assert_allclose(data.contact.pos[0], rest[3:], atol=2e-3)


FIELDS = ("geom", "worldid", "type", "dim", "dist", "pos", "frame", "includemargin", "friction", "solimp")
FIELDS += ("solref", "solreffriction", "adhesion", "geomcollisionid")
SHAPES = {
    "plane": "1 1 1",
    "sphere": "0.012",
    "capsule": "0.008 0.02",
    "ellipsoid": "0.012 0.008 0.02",
    "cylinder": "0.01 0.015",
    "box": "0.012 0.02 0.008",
}
PAIR = """<contact><pair geom1="first" geom2="second" margin="0.003" condim="4" friction="0.2 0.3 0.1"
  solref="0.03 0.8" solreffriction="0.04 0.7"/></contact>"""


def solids(kind, pair=""):
    """Return a model of two geoms of a kind and a sphere between them, and states in which they are close.

    Without the flag the engine has no closed form for two boxes.
    """
    first, second = (geom_type.name.lower() for geom_type in kind)
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><option><flag nativeccd="disable"/></option><worldbody>
      <geom name="first" type="{first}" size="{SHAPES[first]}" margin="{MARGIN / 2}" friction="0.7"/>
      <geom type="sphere" size="0.01" pos="0.02 0 0.02" margin="{MARGIN / 2}"/>
      <body><freejoint/>
        <geom name="second" type="{second}" size="{SHAPES[second]}" margin="{MARGIN / 2}" solimp="0.8"/>
      </body>
    </worldbody>{pair}</mujoco>""")
    rng = np.random.default_rng(3)
    center = rng.uniform((-0.015, -0.015, -0.005), (0.015, 0.015, 0.025), (NUM_STATES, 3))
    quat = rng.standard_normal((NUM_STATES, 4))
    return model, np.hstack([center, quat / np.linalg.norm(quat, axis=1)[:, None]])


def contacts_of_first(model, qpos, ours, growth=0.0):
    """Return all contacts of the first geom, sorted."""
    data = collided(model, qpos, 12, ours, growth)
    count = min(data.nacon.numpy()[0], data.naconmax)
    rows = np.hstack([getattr(data.contact, name).numpy()[:count].reshape(count, -1) for name in FIELDS])
    rows = rows[rows[:, 0] == 0]
    assert 0 < len(rows) < count, "others are of the sphere"
    return rows[np.lexsort(rows.T[::-1])]


def name_of(kind):
    return f"{kind[0].name}-{kind[1].name}".lower()


BESIDE = [kind for kind in sorted(CLOSED_FORMS) if mjw.GeomType.SPHERE in kind]
"""Their engine's kernels compile in a second each; those of the others take two to seven."""


@pytest.mark.parametrize("kind", often(sorted(CLOSED_FORMS), BESIDE), ids=name_of)
@pytest.mark.parametrize("pair", ["", PAIR], ids=["geoms", "pair"])
@pytest.mark.parametrize("growth", [0.0, 0.3])
def test_closed_forms_are_those_of_the_engine(kind, pair, growth):
    """Contact by contact, among pairs of other kinds."""
    model, qpos = solids(kind, pair)
    found, expected = (contacts_of_first(model, qpos, ours, growth=growth) for ours in (True, False))
    np.testing.assert_array_equal(found, expected)
    assert len(found) >= NUM_STATES / 2


@pytest.mark.parametrize("kind", sorted(CLOSED_FORMS), ids=name_of)
def test_closed_forms_are_as_many_as_in_mujoco(kind):
    """But for a few within rounding of the margin, or of another face."""
    model, qpos = solids(kind)
    found, data = contacts_of_first(model, qpos, ours=True), mujoco.MjData(model)
    agreeing = 0
    for world, x in enumerate(qpos):
        data.qpos[:] = x
        mujoco.mj_fwdPosition(model, data)
        agreeing += (data.contact.geom[:, 0] == 0).sum() == (found[:, 2] == world).sum()
    assert agreeing > 0.9 * NUM_STATES


CROWDS = {
    "round": ("sphere", "capsule", "ellipsoid") * 4,
    "any": ("sphere", "capsule", "ellipsoid", "cylinder", "box") * 2,
}
"""Pairs of the last two compile half a minute of the engine's kernels."""
ROOM = 200  # contacts of a world


def crowd(count, name):
    """Return a model of bodies of these kinds on a slope, and states in which each touches some others."""
    kinds = CROWDS[name]
    bodies = "".join(
        f'<body><freejoint/><geom type="{kind}" size="{SHAPES[kind]}" margin="{MARGIN / 2}"/></body>'
        for kind in kinds
    )
    slope = '<geom type="plane" size="1 1 1" pos="0.3 -0.2 -0.02" zaxis="0.1 0.2 1"/>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{slope}{bodies}</worldbody></mujoco>")
    rng = np.random.default_rng(4)
    qpos = rng.standard_normal((count, len(kinds), 7))
    qpos[..., :3] = rng.uniform(-0.035, 0.035, (count, len(kinds), 3))
    qpos[..., 3:] /= np.linalg.norm(qpos[..., 3:], axis=2)[..., None]
    return model, qpos.reshape(count, -1)


class AllPairs(ContactFilter):
    """Lists of all pairs."""

    def launch(self, model, data):
        """List them, with the lines between their centers as normals."""
        pairs, worlds = model.nxn_geom_pair_filtered.numpy(), data.nworld
        kind, center = model.geom_type.numpy(), data.geom_xpos.numpy()
        order = np.argsort(kind[pairs], axis=1, kind="stable")
        first, second = np.take_along_axis(pairs, order, axis=1).T
        lines = center[:, second] - center[:, first]
        self.near.num.fill_(len(pairs))
        self.near.pairs.assign(np.tile(np.arange(len(pairs)), (worlds, 1)))
        self.near.normals.assign(lines / np.linalg.norm(lines, axis=2, keepdims=True))


CROWDED = pytest.mark.parametrize("name", often([*CROWDS], ["round"]))


@CROWDED
def test_pairs_left_out_are_apart(name, monkeypatch):
    """Contacts are those of all pairs, each from the line between its centers; the lists hold few others."""
    model, qpos = crowd(count := 21, name)  # in lanes, and the last ones alone
    listed = {}
    for whole in (False, True):
        if whole:
            monkeypatch.setattr(contact_search, "ContactFilter", AllPairs)
        data = collided(model, qpos, ROOM)
        number = data.nacon.numpy()[0]
        columns = (data.contact.worldid, data.contact.geom, data.contact.dist, data.contact.frame)
        rows = np.hstack([column.numpy()[:number].reshape(number, -1) for column in columns])
        listed[whole] = rows[np.lexsort(rows[:, 2::-1].T)]
    np.testing.assert_array_equal(listed[False][:, :3], listed[True][:, :3])
    np.testing.assert_allclose(listed[False][:, 3:], listed[True][:, 3:], atol=NORMAL_TOLERANCE)
    assert len(listed[True]) > 10 * count


@CROWDED
def test_what_was_tried_before_hides_no_contact(name):
    """Contacts are those of a first search, bit for bit, after others elsewhere, of broken worlds, too."""
    model, qpos = crowd(21, name)
    broken, shaken = qpos.copy(), qpos.copy()
    broken[::3] = np.nan
    shaken[..., ::7] += 1e-3
    first, later = (
        collided(model, qpos, ROOM),
        collided(model, qpos, ROOM, before=(qpos[::-1], broken, shaken)),
    )
    number = first.nacon.numpy()[0]
    for field in ("dist", "pos", "frame", "geom", "worldid"):
        contacts = (
            getattr(first.contact, field).numpy()[:number],
            getattr(later.contact, field).numpy()[:number],
        )
        np.testing.assert_array_equal(*contacts)
    assert later.nacon.numpy()[0] == number > 10 * len(qpos)


def test_lists_do_not_depend_on_lanes():
    """A world alone has the pairs and the normals, bit for bit, that it has beside others."""
    model, qpos = crowd(16, "any")

    def lists(states):
        scene = SimpleNamespace(model=mjw.put_model(model), oracle=model, device=wp.get_device("cpu"))
        scene.data = mjw.make_data(model, nworld=len(states), nconmax=ROOM)
        scene.data.qpos.assign(states)
        engine_alone(mjw.kinematics)(scene.model, scene.data)
        found = ContactFilter(scene)
        found.launch(scene.model, scene.data)
        number, pairs, normals = (x.numpy() for x in (found.near.num, found.near.pairs, found.near.normals))
        return [(pairs[w, :n], normals[w, :n]) for w, n in enumerate(number)]

    together, alone = lists(qpos), [lists(one[None])[0] for one in qpos]
    for one, other in zip(together, alone, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])
    num_pairs = (model.nbody - 1) * (model.nbody - 2) // 2
    assert 0 < np.mean([len(pairs) for pairs, _ in together]) < num_pairs / 2

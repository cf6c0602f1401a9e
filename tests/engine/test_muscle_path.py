"""The muscle path kernel against MuJoCo C: lengths, moment arms, velocities, and what stands in its way."""

from types import SimpleNamespace

import mujoco
import mujoco_warp as mjw
import myo_sim
import numpy as np
import pytest
import warp as wp
from stepping import engine_alone

from myowarp.definitions.body import BODIES
from myowarp.engine.stage import first_reason
from myowarp.engine.stages.muscle_path import PATH_OBSTACLES, MusclePath, MusclePaths
from myowarp.engine.stages.rigid_body import RigidBody

LENGTH = 1e-6
"""m; positions in float32 are good to 1e-7 m at 1 m from the origin, and a path adds up ten of them."""
MOMENT_ARM = 1e-5
"""m; the direction of a segment of 10 mm is good to 1e-5, and acts at 0.1 m or more."""
DIRECTION = 2e-4
"""1; of a slide the moment arm is the direction itself, and the legs have segments of 1 mm."""
VELOCITY = 1e-5
"""m/s at 1 rad/s in 40 joints: sum of moment arms."""
JUMP = 2e-5
"""rad; MuJoCo's own paths jump where a tendon slips off its surface. Where we disagree, MuJoCo C must reach
our value within this distance, a hundred roundings of an angle."""
TRIES = 200

FIELDS = ("ten_length", "ten_J", "actuator_length", "actuator_velocity", "actuator_moment")
QUICK, THOROUGH = 200, 4000
MYO_SIM = ("myoarm", "myolegs", "myotorso")
MODELS = (*BODIES, *MYO_SIM)
QUICK_MODELS = ("finger", "elbow_exo", "hand", "myotorso")
"""Pulleys, a motor, and surfaces of which neither end is on the same body."""

HINGE, SLIDE = mujoco.mjtJoint.mjJNT_HINGE.value, mujoco.mjtJoint.mjJNT_SLIDE.value
WIDENED = 0.3
"""Share of a joint's range by which half of the states leave it, to meet more of the odd cases."""

TWO_TREES = """
<mujoco>
  <worldbody>
    <site name="wall" pos="-0.1 0.02 0.9"/>
    <body name="object" pos="0.3 0.1 1">
      <freejoint/>
      <geom name="ball" type="sphere" size="0.03" mass="1"/>
      <site name="handle" pos="0.06 0.01 0"/>
      <site name="ball_side" pos="0 0.045 0"/>
    </body>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" type="ball"/>
      <geom name="bone" type="capsule" fromto="0 0 0 0.3 0 0" size="0.01" mass="2"/>
      <geom name="roll" type="cylinder" size="0.025 0.05" pos="0.3 0.01 0" euler="0 20 10" mass="0.1"/>
      <geom name="hole" type="cylinder" size="0.04 0.05" pos="0.2 0.05 0" euler="10 5 0" mass="0.1"/>
      <geom name="ring" type="sphere" size="0.02" pos="0.1 -0.03 0.01" mass="0.1"/>
      <site name="a" pos="0.02 0.03 0.01"/>
      <site name="b" pos="0.12 0.07 0"/>
      <site name="c" pos="0.25 0.1 0.01"/>
      <site name="roll_side" pos="0.33 0.04 0"/>
      <site name="hole_inside" pos="0.2 0.06 0"/>
      <site name="ring_inside" pos="0.1 -0.025 0.01"/>
      <site name="d" pos="0.03 -0.06 0.02"/>
      <body name="lower" pos="0.3 0 0">
        <joint name="elbow" type="hinge" axis="0.1 0.2 1" range="-120 120"/>
        <geom name="shin" type="capsule" fromto="0 0 0 0.25 0 0" size="0.01" mass="1"/>
        <site name="e" pos="0.08 0.03 0.01"/>
        <site name="f" pos="0.1 -0.02 0"/>
        <body name="rod" pos="0.25 0 0">
          <joint name="reach" type="slide" axis="1 0 0.1" range="-0.05 0.05"/>
          <geom name="tip" type="sphere" size="0.01" mass="0.2"/>
          <site name="g" pos="0.02 0.01 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <spatial name="round">
      <site site="wall"/><site site="a"/><site site="b"/><geom geom="roll" sidesite="roll_side"/>
      <site site="e"/><site site="g"/>
    </spatial>
    <spatial name="either side"><site site="d"/><geom geom="roll"/><site site="f"/></spatial>
    <spatial name="through">
      <site site="wall"/><geom geom="hole" sidesite="hole_inside"/><site site="c"/>
      <geom geom="ring" sidesite="ring_inside"/><site site="g"/>
    </spatial>
    <spatial name="between trees">
      <site site="a"/><geom geom="ball" sidesite="ball_side"/><site site="g"/><site site="handle"/>
    </spatial>
    <spatial name="pulley">
      <site site="wall"/><site site="a"/><site site="b"/><pulley divisor="2"/><site site="b"/><site site="e"/>
      <pulley divisor="4"/><site site="d"/><geom geom="ball"/><site site="handle"/>
    </spatial>
  </tendon>
  <actuator>
    <motor name="motor" joint="elbow" gear="3"/>
    <motor name="first" tendon="through" gear="-2"/>
    <motor name="second" tendon="through"/>
    <motor name="third" tendon="round" gear="0.5"/>
    <motor name="rail" joint="reach" gear="7"/>
    <motor name="fourth" tendon="between trees"/>
  </actuator>
</mujoco>
"""


def obstacle_of(model):
    """Return what in a model the kernel cannot follow, None if it can all."""
    scene = SimpleNamespace(oracle=model)
    return first_reason(PATH_OBSTACLES, scene)


def compiled(name):
    """Return the full model of one of MODELS."""
    return myo_sim.load(name)[0] if name in MYO_SIM else BODIES[name].build().compile()


def random_states(model, count, seed=0):
    """Return configurations over the ranges of the joints, of odd worlds beyond them, shape (count, nq)."""
    rng = np.random.default_rng(seed)
    qpos = np.tile(model.qpos0, (count, 1))
    for joint in range(model.njnt):
        address = model.jnt_qposadr[joint]
        if model.jnt_type[joint] in (HINGE, SLIDE):
            low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-1.0, 1.0)
            beyond = np.where(np.arange(count) % 2, WIDENED * (high - low), 0.0)
            qpos[:, address] = rng.uniform(low - beyond, high + beyond)
            continue
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            qpos[:, address : address + 3] += rng.uniform(-0.1, 0.1, (count, 3))
            address += 3
        turn = rng.standard_normal((count, 4))
        qpos[:, address : address + 4] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    return qpos.astype(np.float32)


def reference(model, qpos):
    """Return lengths and the entries of ten_J from MuJoCo C for one configuration."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_tendon(model, data)
    return data.ten_length.copy(), data.ten_J.copy()


def follow_paths(model, qpos, batch_sizes=None, qvel=0.0, edit=None):
    """Return the data of all worlds after the kernel ran on their configurations."""
    worlds = len(qpos)
    with wp.ScopedDevice("cpu"):
        device_model = mjw.put_model(model, batch_sizes=batch_sizes)
        data = mjw.make_data(model, nworld=worlds, nconmax=1, njmax=256)
        if edit:
            edit(device_model)
        for name in ("moment_rownnz", "moment_rowadr", "moment_colind"):
            getattr(data, name).fill_(-1)
        paths = MusclePaths(model, device_model, data)
        data.qpos.assign(qpos)
        data.qvel.fill_(0.0)
        data.qvel.assign(np.broadcast_to(qvel, (worlds, model.nv)).astype(np.float32))
        engine_alone(mjw.kinematics)(device_model, data)
        engine_alone(mjw.com_pos)(device_model, data)
        for name in FIELDS:
            getattr(data, name).fill_(np.nan)
        paths.launch()
    return data


def moment_tolerance(model):
    """Return the tolerance of each entry of ten_J."""
    slides = model.jnt_type[model.dof_jntid[model.ten_J_colind]] == SLIDE
    return np.where(slides, DIRECTION, MOMENT_ARM)


def check_paths(model, qpos):
    """Compare lengths and moment arms of every state with MuJoCo C; return how far they vary."""
    data = follow_paths(model, qpos)
    expected = [reference(model, q) for q in qpos]
    length, moment = data.ten_length.numpy(), data.ten_J.numpy()[:, : len(model.ten_J_colind)]
    expected_length, expected_moment = (np.array(values) for values in zip(*expected, strict=True))
    tolerance = moment_tolerance(model)
    tendon = np.repeat(np.arange(model.ntendon), model.ten_J_rownnz)
    wrong = ~(np.abs(length - expected_length) <= LENGTH)
    entries = ~(np.abs(moment - expected_moment) <= tolerance)
    for world, entry in zip(*np.nonzero(entries), strict=True):
        wrong[world, tendon[entry]] = True
    assert wrong.sum() <= 2 + wrong.size // 100_000, "jumps are rare"
    for world, path in zip(*np.nonzero(wrong), strict=True):
        row = tendon == path
        ours = length[world, path], moment[world, row]
        assert _reached_nearby(model, qpos[world], path, row, ours, tolerance[row]), model.tendon(path).name
    return np.ptp(expected_length, axis=0), np.ptp(expected_moment, axis=0)


def _reached_nearby(model, qpos, path, row, ours, tolerance):
    """Return whether MuJoCo C gives our length and moment arms for a path within JUMP of a configuration."""
    rng = np.random.default_rng(0)
    for _ in range(TRIES):
        length, moment = reference(model, qpos + rng.uniform(-JUMP, JUMP, model.nq))
        if abs(length[path] - ours[0]) <= 2 * JUMP and np.all(
            abs(moment[row] - ours[1]) <= 2 * JUMP + tolerance
        ):
            return True
    return False


def check_model(name, count):
    model = compiled(name)
    length_span, moment_span = check_paths(model, random_states(model, count))
    assert np.median(length_span) > 100 * LENGTH
    assert np.sum(moment_span > 100 * MOMENT_ARM) > 0.8 * model.ntendon


@pytest.mark.parametrize("name", QUICK_MODELS)
def test_paths_equal_mujoco(name):
    check_model(name, QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_paths_equal_mujoco_in_many_states(name):
    check_model(name, THOROUGH)


def dense_moment(data, world, model):
    """Return actuator_moment of a world, shape (nu, nv)."""
    moment = np.zeros((model.nu, model.nv))
    for actuator in range(model.nu):
        first = data.moment_rowadr.numpy()[world, actuator]
        row = slice(first, first + data.moment_rownnz.numpy()[world, actuator])
        moment[actuator, data.moment_colind.numpy()[world, row]] = data.actuator_moment.numpy()[world, row]
    return moment


def check_world(data, world, model, qpos, qvel):
    """Compare all that the kernel writes of one world with MuJoCo C; returns MuJoCo's moments."""
    host = mujoco.MjData(model)
    host.qpos[:], host.qvel[:] = qpos, qvel
    mujoco.mj_fwdPosition(model, host)
    mujoco.mj_fwdVelocity(model, host)
    expected = np.zeros((model.nu, model.nv))
    mujoco.mju_sparse2dense(
        expected, host.actuator_moment, host.moment_rownnz, host.moment_rowadr, host.moment_colind
    )
    gear = np.abs(model.actuator_gear[:, 0])
    np.testing.assert_allclose(data.ten_length.numpy()[world], host.ten_length, atol=LENGTH, rtol=0)
    moments = data.ten_J.numpy()[world, : len(host.ten_J)]
    assert np.all(np.abs(moments - host.ten_J) <= moment_tolerance(model))
    error = np.abs(data.actuator_length.numpy()[world] - host.actuator_length)
    assert np.all(error <= gear * LENGTH)
    error = np.abs(dense_moment(data, world, model) - expected)
    assert np.all(
        error <= gear[:, None] * np.where(model.jnt_type == SLIDE, DIRECTION, MOMENT_ARM)[model.dof_jntid]
    )
    error = np.abs(data.actuator_velocity.numpy()[world] - host.actuator_velocity)
    assert np.all(error <= gear * model.nv * VELOCITY)
    return expected


@pytest.fixture(scope="module")
def two_trees():
    """A free object before a limb, every kind of joint, surface and side site, pulleys, two motors."""
    return mujoco.MjModel.from_xml_string(TWO_TREES)


def test_every_kind_of_path_and_actuator(two_trees):
    model = two_trees
    assert obstacle_of(model) is None
    qpos = random_states(model, 64)[::2]
    qvel = np.random.default_rng(1).uniform(-1.0, 1.0, model.nv)
    data = follow_paths(model, qpos, qvel=qvel)
    moments = np.array([check_world(data, i, model, q, qvel) for i, q in enumerate(qpos)])
    assert np.sum(np.abs(moments).max(axis=0) > 100 * MOMENT_ARM) == 28, "actuator and dof"
    rows = dict(enumerate(model.actuator(i).name for i in range(model.nu)))
    assert {name for i, name in rows.items() if np.ptp(moments[:, i], axis=0).max() > 100 * MOMENT_ARM} == {
        "first",
        "second",
        "third",
        "fourth",
    }


def test_geometry_of_each_world(two_trees):
    """64 worlds whose sites, surfaces and gears all differ, each against a MuJoCo model edited alike."""
    model, worlds = two_trees, 64
    rng = np.random.default_rng(2)
    qpos = random_states(model, 2 * worlds)[::2]
    fields = {
        "site_pos": model.site_pos + rng.uniform(-0.005, 0.005, (worlds, model.nsite, 3)),
        "geom_pos": model.geom_pos + rng.uniform(-0.005, 0.005, (worlds, model.ngeom, 3)),
        "geom_quat": model.geom_quat + rng.uniform(-0.1, 0.1, (worlds, model.ngeom, 4)),
        "geom_size": model.geom_size * rng.uniform(0.8, 1.2, (worlds, model.ngeom, 1)),
        "actuator_gear": model.actuator_gear * rng.uniform(0.5, 2.0, (worlds, model.nu, 1)),
    }
    fields["geom_quat"] /= np.linalg.norm(fields["geom_quat"], axis=2, keepdims=True)
    fields = {name: values.astype(np.float32) for name, values in fields.items()}

    def edit(device_model):
        for name, values in fields.items():
            getattr(device_model, name).assign(values)

    data = follow_paths(model, qpos, dict.fromkeys(fields, worlds), edit=edit)
    for world in range(worlds):
        edited = mujoco.MjModel.from_xml_string(TWO_TREES)
        for name, values in fields.items():
            getattr(edited, name)[:] = values[world]
        edited.geom_sameframe[:] = edited.site_sameframe[:] = 0  # read the edited positions
        check_world(data, world, edited, qpos[world], np.zeros(model.nv))
    unedited = np.array([reference(model, q)[0] for q in qpos])
    assert np.all(np.abs(unedited - data.ten_length.numpy()).max(axis=0) > 1000 * LENGTH)


@pytest.mark.parametrize("num_worlds", [2, 19])
def test_bits_of_a_world_depend_on_no_other(two_trees, num_worlds):
    """Surfaces of each world's own: the same bits in lanes, in blocks that are not full, and alone."""
    model, rng = two_trees, np.random.default_rng(3)
    qpos = random_states(model, num_worlds)
    qvel = rng.uniform(-1.0, 1.0, (num_worlds, model.nv))
    sizes = (model.geom_size * rng.uniform(0.6, 1.4, (num_worlds, model.ngeom, 1))).astype(np.float32)

    def followed(worlds):
        data = follow_paths(
            model,
            qpos[worlds],
            {"geom_size": len(worlds)},
            qvel[worlds],
            lambda device_model: device_model.geom_size.assign(sizes[worlds]),
        )
        return [getattr(data, name).numpy() for name in FIELDS]

    order = rng.permutation(num_worlds)
    together, shuffled = followed(np.arange(num_worlds)), followed(order)
    alone = [followed(np.array([world])) for world in range(num_worlds)]
    for name, values, other, *ones in zip(FIELDS, together, shuffled, *alone, strict=True):
        assert np.ptp(values, axis=0).max() > 100 * MOMENT_ARM, name
        np.testing.assert_array_equal(other, values[order], err_msg=name)
        np.testing.assert_array_equal(np.concatenate(ones), values, err_msg=name)


def test_one_launch_gives_the_bits_of_two(two_trees):
    """Rigid bodies and paths share a launch in a step, where what the first wrote is not read again."""
    model, worlds = two_trees, 11
    found = []
    with wp.ScopedDevice("cpu"):
        for together in (True, False):
            device_model, data = mjw.put_model(model), mjw.make_data(model, nworld=worlds)
            device = data.qpos.device
            scene = SimpleNamespace(oracle=model, model=device_model, data=data, sites=(), device=device)
            stages = RigidBody(scene), MusclePath(scene)
            data.qpos.assign(random_states(model, worlds))
            data.qvel.fill_(1.0)
            for name in FIELDS:
                getattr(data, name).fill_(np.nan)
            for stage in stages:
                (stage.launcher(stages) if together else stage.launch)(device_model, data)
            found.append([getattr(data, name).numpy() for name in FIELDS])
    for name, one, two in zip(FIELDS, *found, strict=True):
        assert np.isfinite(one).all(), name
        np.testing.assert_array_equal(one, two, err_msg=name)


@pytest.mark.parametrize("moved", [0.0, 1e-9, 1e-7, 1e-4])
def test_straight_through_the_centre_of_a_sphere(moved):
    """The plane of the path is undefined, or made of rounding, but its length is not."""
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco><worldbody>
      <body name="block"><joint type="slide" axis="0 0 1"/><geom name="ball" type="sphere" size="0.1"/></body>
      <site name="a" pos="-0.3 0 0"/><site name="b" pos="0.4 {moved} 0"/><site name="c" pos="0.4 {moved} 0"/>
    </worldbody><tendon><spatial>
      <site site="a"/><geom geom="ball"/><site site="b"/><site site="c"/>
    </spatial></tendon></mujoco>
    """)
    length = follow_paths(model, np.zeros((1, 1), dtype=np.float32)).ten_length.numpy()[0, 0]
    tangents = np.sqrt(0.3**2 - 0.1**2) + np.sqrt(0.4**2 - 0.1**2)
    arc = 0.1 * (np.pi - np.arccos(0.1 / 0.3) - np.arccos(0.1 / 0.4) - moved / 0.4)
    assert length == pytest.approx(tangents + arc, abs=LENGTH)
    assert length > 0.7 + 100 * LENGTH


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (
            '<spatial name="round">',
            '<fixed name="sum"><joint joint="elbow" coef="1"/></fixed><spatial name="round">',
            "a tendon that is a sum of joint angles",
        ),
        (
            '<motor name="rail" joint="reach"',
            '<motor name="rail" site="g"',
            "an actuator that is neither on a tendon nor on a joint",
        ),
        (
            '<motor name="rail" joint="reach"',
            '<motor name="rail" joint="shoulder"',
            "an actuator on a ball or free joint",
        ),
    ],
)
def test_obstacles(old, new, reason):
    assert old in TWO_TREES
    model = mujoco.MjModel.from_xml_string(TWO_TREES.replace(old, new))
    assert obstacle_of(model) == reason


def test_no_tendons_is_an_obstacle():
    assert obstacle_of(mujoco.MjModel.from_xml_string("<mujoco/>")) == "no tendons"

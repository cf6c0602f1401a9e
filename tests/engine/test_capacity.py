"""Capacities: bounds hold in motion that calibration has not seen, and closed forms for small models."""

from functools import lru_cache

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
from configurations import configurations
from often import covering, often
from stepping import engine_alone

import myowarp.sim.capacity as capacity_module
import myowarp.tasks  # noqa: F401
from myowarp.definitions.task import PHYSICS, TASKS
from myowarp.sim.build import compile_scene
from myowarp.sim.capacity import MARGIN, calibrate

NUM_POSES = 200
NUM_STEPS = 300
NUM_EPISODES = 6  # of motion with contacts
SEED = 12345  # calibration uses 0
BEYOND = 0.2  # of a joint's range, so that limits act

SCENES = {spec.key: spec for spec in {TASKS[key].scene_key: TASKS[key] for key in TASKS}.values()}


@lru_cache
def scene_of(name, physics):
    """Return a compiled scene of a few worlds."""
    return compile_scene(SCENES[name], 33, device="cpu", physics=physics)


def poses(scene, count):
    """Return configurations up to a fifth beyond the joint ranges, so that limits act."""
    return configurations(scene.oracle, scene.spec.start(scene.oracle), count, SEED, BEYOND)


def peaks(model, poses, start=None, episodes=1):
    """Return the most contacts and rows of MuJoCo C in these poses and in random-control motion.

    Controls of every second episode are at their extremes.
    """
    rng = np.random.default_rng(SEED)
    data = mujoco.MjData(model)
    met = []
    for qpos in poses:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        met.append((data.ncon, data.nefc))
    low, high = model.actuator_ctrlrange.T
    for episode in range(episodes):
        mujoco.mj_resetData(model, data)
        data.qpos[:] = model.qpos0 if start is None else start
        for step in range(NUM_STEPS):
            if step % 7 == 0:
                draw = rng.uniform(size=model.nu)
                data.ctrl[:] = low + (high - low) * (draw.round() if episode % 2 else draw)
            mujoco.mj_step(model, data)
            met.append((data.ncon, data.nefc))
    return np.max(met, axis=0)


CASES = [
    (name, physics) for name in sorted(SCENES, key=lambda name: TASKS[name].large) for physics in PHYSICS
]
ELBOWS = [name for name in SCENES if TASKS[name].body.startswith("elbow")]
FEW = covering(
    sorted(CASES, key=lambda case: case[0] not in ELBOWS), lambda case: (TASKS[case[0]].body, case[1])
)


@pytest.mark.parametrize(
    ("name", "physics"),
    [pytest.param(*case, marks=[] if case in FEW else pytest.mark.slow) for case in CASES],
)
def test_bounds_hold(name, physics):
    """In any pose; where geoms can touch, in motion: poses put them into each other as motion never does."""
    scene = scene_of(name, physics)
    start, touching = scene.spec.start(scene.oracle), scene.capacity.peak_contacts > 0
    configured = [] if touching else poses(scene, NUM_POSES)
    contacts, rows = peaks(scene.oracle, configured, start, NUM_EPISODES if touching else 1)
    assert contacts <= scene.capacity.contacts
    assert rows <= scene.capacity.rows
    assert rows > 0, "no constraint acted"
    assert bool(contacts) == touching


@pytest.mark.parametrize("name", often([*SCENES], ELBOWS))
def test_engine_does_not_overflow(name):
    """Pairs of convex bodies compile up to a minute of the engine's kernels, which few other tests need."""
    scene = scene_of(name, "parity")
    scene.data.qpos.assign(np.float32(poses(scene, scene.num_worlds)))
    scene.data.overflow.zero_()
    engine_alone(mjw.forward)(scene.model, scene.data)
    assert not scene.data.overflow.numpy().any()
    assert scene.data.nefc.numpy().max() > 0


def compiled(xml, **attributes):
    """Return the compiled model of an MJCF string with `{name}` fields."""
    return mujoco.MjModel.from_xml_string(xml.format(**attributes))


BOX = """
<mujoco>
  <worldbody>
    <geom type="plane" size="5 5 .1" condim="{condim}"/>
    <body pos="0 0 0.099"><freejoint/><geom type="box" size=".1 .1 .1" condim="{condim}"/></body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize(("condim", "rows_per_contact"), [(1, 1), (3, 4), (4, 6), (6, 10)])
def test_box_on_a_plane(condim, rows_per_contact):
    """Four corners touch; a pyramidal friction cone takes two rows for every tangential direction."""
    model = compiled(BOX, condim=condim)
    capacity = calibrate(model, model.qpos0)
    assert capacity.peak_contacts == 4
    assert capacity.contacts == 4 * MARGIN
    assert capacity.rows == 4 * MARGIN * rows_per_contact
    _, rows = peaks(model, [])
    assert rows == 4 * rows_per_contact


ROWS = """
<mujoco>
  <worldbody>
    <body name="a"><joint name="a" range="-1 1" limited="true" frictionloss="0.1"/>
      <geom size=".1" contype="0" conaffinity="0"/>
      <body name="b" pos="1 0 0"><joint name="b" axis="0 1 0" frictionloss="0.1"/>
        <geom size=".1" contype="0" conaffinity="0"/><site name="tip"/></body>
    </body>
    <body name="free" pos="0 0 3"><freejoint/>
      <geom size=".1" contype="0" conaffinity="0"/></body>
    <site name="root" pos="0 -1 0"/>
  </worldbody>
  <tendon>
    <spatial name="t" limited="true" range="0.2 0.9" frictionloss="1">
      <site site="root"/><site site="tip"/>
    </spatial>
  </tendon>
  <equality><weld body1="free" body2="world"/></equality>
</mujoco>
"""


def test_rows_without_contacts():
    """A joint limit, a tendon limit, two joint and one tendon friction, six of the weld."""
    model = compiled(ROWS)
    capacity = calibrate(model, model.qpos0)
    assert capacity.contacts == capacity.peak_contacts == 0
    assert capacity.rows == 11
    beyond = model.qpos0.copy()
    beyond[model.joint("a").qposadr] = 1.2
    _, rows = peaks(model, [beyond])
    assert rows == 11


def test_a_model_is_measured_once(monkeypatch, tmp_path):
    """Until the model, its options or the start change."""
    monkeypatch.setenv("MYOWARP_CACHE_DIR", str(tmp_path))
    measured, measure = [], capacity_module._measure
    monkeypatch.setattr(capacity_module, "_measure", lambda *args: measured.append(1) or measure(*args))
    model = compiled(ROWS)
    assert (
        calibrate(model, model.qpos0) == calibrate(compiled(ROWS), model.qpos0) == measure(model, model.qpos0)
    )
    assert len(measured) == 1
    calibrate(model, model.qpos0 + 0.1)
    model.opt.timestep *= 2
    calibrate(model, model.qpos0)
    assert len(measured) == 3


PAIR = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1" condim="1" contype="0" conaffinity="0"/>
    <body pos="0 0 0.09"><freejoint/>
      <geom name="ball" size=".1" condim="1" contype="0" conaffinity="0"/></body>
  </worldbody>
  <contact><pair geom1="floor" geom2="ball" condim="6"/></contact>
</mujoco>
"""


def test_explicit_pair_has_its_own_friction_dimension():
    model = compiled(PAIR)
    _, rows = peaks(model, [])
    assert rows == 10
    assert rows <= calibrate(model, model.qpos0).rows


def test_model_without_constraints_keeps_one_row():
    model = compiled("<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody></mujoco>")
    capacity = calibrate(model, model.qpos0)
    assert (capacity.contacts, capacity.rows, capacity.peak_contacts) == (0, 1, 0)

"""Hinges that turn like a ball, at and near the poles of their angles: against MuJoCo C in float64."""

import mujoco
import numpy as np
import pytest
from converted import simulation
from stepping import physics_of

from myowarp.coordinates.free_coordinates import FreeCoordinates
from myowarp.coordinates.hinge_triples import NEAR, RETURN, triples_of
from myowarp.osim.bundle.couplings import Couplings, couplings

ARM = """
<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="{timestep}" integrator="{integrator}"><flag contact="disable"/></option>
  <worldbody>
    <body name="humerus" pos="0 0 1" quat=".8 .2 -.5 .3">
      {joints}
      <inertial pos=".02 -.01 -.15" mass="2" diaginertia=".025 .03 .008"/>
      <body name="forearm" pos="0 0 -.3">
        <joint name="elbow" axis="0 1 0"/>
        <inertial pos=".01 .02 -.1" mass="1" diaginertia=".006 .0055 .001"/>
      </body>
    </body>
    {phantom}
  </worldbody>
  {equality}
  <actuator>{motors}</actuator>
</mujoco>
"""
HINGES = """<joint name="a" axis=".6 .8 0" pos=".01 0 .02" ref="{0}" {outer}/>
      <joint name="b" axis="0 0 1" pos=".01 0 .02" ref="{1}" {limit}/>
      <joint name="c" axis="{lean}" pos=".01 0 .02" {outer}/>"""
NAMES = ("a", "b", "c", "elbow")
PHANTOM = (
    '<body name="phantom"><joint name="ghost"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
)
TIED = '<equality><joint joint1="ghost" joint2="elbow" polycoef="0 .5 0 0 0"/></equality>'
SAID = Couplings({}, {"phantom": (0.0, (0.0, 0.0, 0.0))})
LEANS = (0.0, 0.4, np.pi)
"""rad; by which the third axis leans from the normal of the others at `ref`."""
ACCELERATION = 1e-3  # of the largest; at 1e-3 rad from a pole a rounding of b alone makes 1e-4
MOTORS = "".join(f'<motor joint="{name}" ctrlrange="-9 9"/>' for name in NAMES)


def arm(lean=0.0, timestep=0.002, integrator="Euler", tied=True, limit="", outer="", joints=None):
    """Return the text of an arm, with a massless phantom that follows the elbow or without."""
    first, second = np.array([0.6, 0.8, 0.0]), np.array([0.0, 0.0, 1.0])
    axis = np.cos(lean) * np.cross(first, second) + np.sin(lean) * first
    hinges = HINGES.format(0.3, -0.2, lean=" ".join(map(repr, axis.tolist())), limit=limit, outer=outer)
    return ARM.format(
        joints=joints or hinges,
        timestep=timestep,
        integrator=integrator,
        phantom=PHANTOM if tied else "",
        equality=TIED if tied else "",
        motors=MOTORS if joints is None else "",
    )


def simulated(folder, worlds, **settings):
    (folder / "model.xml").write_text(arm(**settings))
    (folder / "couplings.json").write_text(SAID.as_json())
    sim = simulation(folder / "model.xml", worlds)
    assert isinstance(sim.shards[0].physics_step, FreeCoordinates)
    assert sim.shards[0].physics_step.triples is not None
    return sim


def put(sim, q, u, force):
    """Put worlds into states; q, u, force are (worlds, 4)."""
    data = sim.scene.data
    for array, values in ((data.qpos, q), (data.qvel, u), (data.qfrc_applied, force)):
        array.assign(np.concatenate([values, np.zeros((len(values), 1))], axis=1))
    data.qacc_warmstart.zero_()


@pytest.mark.parametrize("lean", LEANS)
@pytest.mark.parametrize("limit", ["", 'limited="true" range="-9 -8"'])
def test_accelerations_near_a_pole(tmp_path, lean, limit):
    """Also with a limit that pushes; far from a pole, 1 and 0.03 degrees from it."""
    random, worlds = np.random.default_rng(0), 21
    q, u, force = (random.uniform(-r, r, (worlds, 4)) for r in (1.5, 3.0, 8.0))
    pole = np.pi / 2 - 0.2 - lean
    q[:, 1] = pole + np.repeat([0.9, 0.02, 5e-4], 7) * random.choice([-1, 1], worlds)
    q = q.astype(np.float32).astype(float)
    sim = simulated(tmp_path, worlds, lean=lean, limit=limit)
    put(sim, q, u, force)
    physics_of(sim)()
    model = mujoco.MjModel.from_xml_string(arm(lean=lean, tied=False, limit=limit))
    # The row of a limit is as soft as ours.
    model.dof_invweight0[:] = sim.scene.model.dof_invweight0.numpy()[0][:4]
    data = mujoco.MjData(model)
    assert (np.linalg.norm(u, axis=1) > 0.5).all()
    for world in range(worlds):
        data.qpos, data.qvel, data.qfrc_applied = q[world], u[world], force[world]
        mujoco.mj_forward(model, data)
        assert bool(data.nefc) == bool(limit)
        found = sim.scene.data.qacc.numpy()[world, :4]
        assert np.linalg.norm(found - data.qacc) < ACCELERATION * np.linalg.norm(data.qacc)


@pytest.mark.parametrize("lean", LEANS)
def test_motion_runs_through_a_pole(tmp_path, lean):
    """Orientation and angular velocity after 0.4 s as of a ball joint, with steps of 0.05 ms."""
    h, pole = 0.001, np.pi / 2 - 0.2 - lean
    sim = simulated(tmp_path, 3, lean=lean, timestep=h)
    tied = mujoco.MjModel.from_xml_string(arm(lean=lean, tied=False))
    ball = '<joint name="ball" type="ball" pos=".01 0 .02"/>'
    fine = mujoco.MjModel.from_xml_string(arm(joints=ball, tied=False, timestep=5e-5, integrator="RK4"))
    # Towards the pole, past which it goes the farther the faster the first hinge turns.
    q = np.array([[0.3, pole - 0.02, 0.1, 0.5]] * 3)
    u = np.array([[rate, 3.0, -0.3 * rate, -1.0] for rate in (0.0, 0.1, 3.0)])
    starts = []
    for world in range(3):
        data, start = mujoco.MjData(tied), mujoco.MjData(fine)
        data.qpos, data.qvel = q[world], u[world]
        mujoco.mj_forward(tied, data)
        start.qpos[4], start.qvel[3] = q[world, 3], u[world, 3]
        body = tied.body("humerus").id
        local, twist = np.zeros(4), np.zeros(6)
        conjugate = fine.body_quat[body] * [1, -1, -1, -1]
        mujoco.mju_mulQuat(local, conjugate, data.xquat[body])
        mujoco.mj_objectVelocity(tied, data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 1)
        start.qpos[:4], start.qvel[:3] = local, twist[:3]
        starts.append(start)
    put(sim, q, u, 0 * q)
    nearest, step = np.full(3, 9.0), physics_of(sim)
    for _ in range(round(0.4 / h)):
        step()
        at = sim.scene.data.qpos.numpy()[:, 1]
        nearest = np.minimum(nearest, np.abs(np.cos(at + 0.2 + lean)))
    assert (nearest < 0.003).all()
    for world, start in enumerate(starts):
        while start.time < 0.4 - 1e-9:
            mujoco.mj_step(fine, start)
        data = mujoco.MjData(tied)
        data.qpos, data.qvel = (
            array.numpy()[world, :4] for array in (sim.scene.data.qpos, sim.scene.data.qvel)
        )
        mujoco.mj_forward(tied, data)
        mujoco.mj_forward(fine, start)
        for body in ("humerus", "forearm"):
            turned = start.body(body).xmat.reshape(3, 3).T @ data.body(body).xmat.reshape(3, 3)
            angle = np.arccos(np.clip((np.trace(turned) - 1) / 2, -1, 1))
            assert angle < 0.02  # rad, of more than 1 that it turns: Euler's error at 1 ms
            both = []
            for model, of in ((tied, data), (fine, start)):
                twist = np.zeros(6)
                number = model.body(body).id
                mujoco.mj_objectVelocity(model, of, mujoco.mjtObj.mjOBJ_XBODY, number, twist, 0)
                both.append(twist[:3])
            assert np.linalg.norm(both[0] - both[1]) < 0.05 * np.linalg.norm(both[1])


def test_limits_take_no_turns_for_a_way_back(tmp_path):
    """Away from a pole, around which two angles gathered turns: limits add no energy but that of RETURN."""
    outer = 'limited="true" range="-1.5 1.5"'
    sim = simulated(tmp_path, 3, outer=outer)
    model = mujoco.MjModel.from_xml_string(arm(tied=False))
    data, pole = mujoco.MjData(model), np.pi / 2 - 0.2
    q = np.array([[a, pole - 0.45, c, 0.5] for a, c in ((60, -63.3), (3.3, -2.8), (0.2, 0.3))])
    put(sim, q, np.array([[0.0, -3.0, 0.2, 0.0]] * 3), 0 * q)
    energy, M, away, step = [], np.zeros((4, 4)), np.zeros(3), physics_of(sim)
    for _ in range(150):
        step()
        state = zip(sim.scene.data.qpos.numpy(), sim.scene.data.qvel.numpy(), strict=True)
        energy.append([])
        for position, speed in state:
            data.qpos, data.qvel = position[:4], speed[:4]
            mujoco.mj_forward(model, data)
            mujoco.mj_energyPos(model, data)
            mujoco.mj_energyVel(model, data)
            energy[-1].append(data.energy.sum())
        away = np.maximum(away, np.abs(np.cos(sim.scene.data.qpos.numpy()[:, 1] + 0.2)))
    mujoco.mj_fullM(model, data, M)
    # Two limits, each of which sends its angle back at RETURN, on top of the 3 rad/s of the start.
    added = 0.5 * (3.0 + 2.0 * RETURN) ** 2 * np.linalg.eigvalsh(M)[-1]
    assert (away**2 > NEAR).all()
    assert (np.max(energy, axis=0) - energy[0] < added).all()
    assert (np.abs(sim.scene.data.qpos.numpy()[:, [0, 2]]) < np.pi).all()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('axis="0 0 1" pos', 'axis="0 .1 1" pos'),
        ('name="c"', 'name="c" damping=".1"'),
        ('name="a"', 'name="a" armature=".1"'),
        ('name="b" axis="0 0 1" pos=".01 0 .02"', 'name="b" axis="0 0 1" pos=".01 0 .03"'),
        ('joint2="elbow"', 'joint2="b"'),
        ('name="b"', 'name="b" type="slide"'),
    ],
)
def test_what_is_no_triple(old, new):
    text = arm()
    model = mujoco.MjModel.from_xml_string(text)
    assert [joints for joints, _ in triples_of(model, couplings(model))] == [[0, 1, 2]]
    model = mujoco.MjModel.from_xml_string(text.replace(old, new))
    assert not triples_of(model, couplings(model))

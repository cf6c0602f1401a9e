"""Free coordinates of bodies with free and ball joints: against MuJoCo C in float64."""

import mujoco
import numpy as np
import pytest
from configurations import configurations
from converted import simulation
from stepping import physics_of

from myowarp.coordinates.free_coordinates import MOST_DENSE, FreeCoordinates
from myowarp.osim.bundle.couplings import NOTHING, Couplings

NUM_WORLDS = 11
CLOSE = 3e-5  # of a world's largest acceleration; float32
MOTION = 2e-4  # rad or m after 40 ms: roundings of 20 steps
EFFECT = 10.0
SLOPE, BEND = 0.03, 0.2  # of glide by knee
ROOTS = """
<mujoco model="roots">
  <option timestep=".002" integrator="{integrator}">{flags}</option>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <geom type="plane" size="2 2 .1" contype="1"/>
    <body name="trunk" pos="0 0 .5"><freejoint/>
      <inertial pos=".01 .02 .03" mass="5" diaginertia=".1 .09 .05"/>
      <geom type="sphere" size=".1" pos="0 0 -.45" conaffinity="1" condim="3"/>
      <body name="arm" pos="0 -.1 .2"><joint name="shoulder" type="ball" damping=".05"/>
        <inertial pos="0 .01 -.1" mass="1" diaginertia=".01 .012 .004"/>
        <body name="hand" pos="0 0 -.3"><joint name="elbow" axis="0 1 0" range="-60 20"/>
          <inertial pos=".02 0 -.1" mass=".6" diaginertia=".006 .007 .002"/>
        </body>
      </body>
      <body name="thigh" pos="0 .1 0"><joint name="hip" axis="0 1 0" damping=".3"/>
        <inertial pos="0 0 -.2" mass="2" diaginertia=".03 .03 .01"/>
        <body name="shank" pos="0 0 -.3">
          <joint name="glide" type="slide" axis="1 0 0" damping="4"/>
          <joint name="knee" axis="0 1 0" damping=".2"/>
          <inertial pos="0 .01 -.2" mass="1" diaginertia="{inertia}"/>
        </body>
      </body>
      {more}
    </body>
  </worldbody>
  {equality}
  <actuator><motor joint="hip" ctrlrange="-9 9"/><motor joint="knee" ctrlrange="-9 9"/></actuator>
</mujoco>
"""
TRIPLE = """<body name="other" pos="0 .1 .2">
  <joint name="a" axis="1 0 0"/><joint name="b" axis="0 1 0" range="-60 60"/><joint name="c" axis="0 0 1"/>
  <inertial pos=".02 0 .1" mass="1" diaginertia=".01 .012 .004"/></body>"""
FINGER = """<body pos=".1 0 .2"><joint axis=".6 0 .8" damping=".02"/>
  <inertial pos=".02 0 .03" mass=".05" diaginertia="1e-4 1e-4 1e-4"/></body>"""
TIE = f'<equality><joint joint1="glide" joint2="knee" polycoef="0 {SLOPE} {BEND} 0 0"/></equality>'
FREE = '<flag contact="disable" limit="disable"/>'
INERTIA = (0.02, 0.025, 0.006)  # kg m^2, in the document


def written(**changes):
    """Return the text of the body."""
    given = {
        "integrator": "Euler",
        "inertia": " ".join(map(str, INERTIA)),
        "more": "",
        "equality": "",
        "flags": "",
    }
    return ROOTS.format(**given | changes)


def simulated(folder, said, stages, **changes):
    """Return worlds of the body, in free coordinates."""
    (folder / "model.xml").write_text(written(**changes))
    (folder / "couplings.json").write_text(said.as_json())
    sim = simulation(folder / "model.xml", NUM_WORLDS, stages=stages)
    assert isinstance(sim.shards[0].physics_step, FreeCoordinates)
    assert bool(sim.shards[0].stages) == (stages is None)
    return sim


def placed(sim, model):
    """Put worlds into random states; returns them in float64."""
    rng = np.random.default_rng(0)
    qpos = configurations(model, model.qpos0, NUM_WORLDS, seed=1, beyond=0.2).astype(np.float32)
    qpos[:, :3] = rng.uniform((-0.5, -0.5, 0.45), (0.5, 0.5, 0.54), (NUM_WORLDS, 3))
    qpos[:, 3:7] = np.array((1, 0, 0, 0)) + rng.uniform(-0.2, 0.2, (NUM_WORLDS, 4))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    qvel = rng.uniform(-2, 2, (NUM_WORLDS, model.nv)).astype(np.float32)
    force = rng.uniform(-3, 3, (NUM_WORLDS, model.nv)).astype(np.float32)
    data = sim.scene.data
    for array, values in ((data.qpos, qpos), (data.qvel, qvel), (data.qfrc_applied, force)):
        array.assign(values)
    data.qacc_warmstart.zero_()
    return qpos.astype(float), qvel.astype(float), force.astype(float)


ENGINE = pytest.mark.parametrize("stages", [pytest.param((), marks=pytest.mark.slow), None])
"""The engine's kernels compile for every number of degrees of freedom; test_free_coordinates has others."""


@ENGINE
@pytest.mark.parametrize(
    ("integrator", "more"),
    [
        pytest.param("Euler", "", id="Euler"),
        pytest.param("implicitfast", "", id="implicitfast"),
        pytest.param("Euler", 50 * FINGER, id="63 dofs", marks=pytest.mark.slow),
    ],
)
def test_steps_are_those_of_mujoco_c(tmp_path, integrator, more, stages):
    """With contacts and limits; in the document a body has other moments of inertia than in the model."""
    said = Couplings({}, {"shank": (1.0, INERTIA)})
    sim = simulated(tmp_path, said, stages, integrator=integrator, inertia=".06 .06 .05", more=more)
    assert not mujoco.mj_isSparse(sim.scene.oracle)
    model = mujoco.MjModel.from_xml_string(written(integrator=integrator, more=more))
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    assert (model.nv > MOST_DENSE) == bool(more)
    qpos, qvel, force = placed(sim, model)
    # Rows of contacts are as soft as the model's masses say, as in any step of ours.
    model.body_invweight0[:] = sim.scene.model.body_invweight0.numpy()[0]
    np.testing.assert_allclose(sim.scene.model.dof_invweight0.numpy()[0], model.dof_invweight0, rtol=1e-4)
    states = [mujoco.MjData(model) for _ in range(NUM_WORLDS)]
    kinds = set()
    for world, data in enumerate(states):
        data.qpos, data.qvel, data.qfrc_applied = qpos[world], qvel[world], force[world]
    step = physics_of(sim)
    for number in range(20):
        step()
        for data in states:
            mujoco.mj_step(model, data)
            kinds |= set(data.efc_type.tolist())
        if number == 0:
            wanted, found = np.array([data.qacc for data in states]), sim.scene.data.qacc.numpy()
            size = np.abs(wanted).max(axis=1, keepdims=True)
            np.testing.assert_array_less(np.abs(found - wanted) / size, CLOSE)
    row = mujoco.mjtConstraint
    assert kinds == {row.mjCNSTR_LIMIT_JOINT.value, row.mjCNSTR_CONTACT_PYRAMIDAL.value}
    ends = np.array([data.qpos for data in states])
    assert np.abs(ends - qpos).max(axis=1).min() > EFFECT * MOTION
    assert np.median(np.abs(sim.scene.data.qpos.numpy() - ends).max(axis=1)) < MOTION


@ENGINE
def test_accelerations_of_joints_that_follow(tmp_path, stages):
    """M_r u'' = J'(forces - M a), beside a free root, a ball and three hinges that turn like one."""
    sim = simulated(tmp_path, NOTHING, stages, more=TRIPLE, equality=TIE, flags=FREE)
    assert sim.shards[0].physics_step.triples is not None
    model = mujoco.MjModel.from_xml_string(written(more=TRIPLE, flags=FREE))
    qpos, qvel, force = placed(sim, model)
    physics_of(sim)()
    glide, knee = (int(model.joint(name).dofadr[0]) for name in ("glide", "knee"))
    at = [int(model.joint(name).qposadr[0]) for name in ("glide", "knee")]
    free = [dof for dof in range(model.nv) if dof != glide]
    data, M = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    for world in range(NUM_WORLDS):
        angle, speed = qpos[world, at[1]], qvel[world, knee]
        qpos[world, at[0]] = SLOPE * angle + BEND * angle**2
        J, excess = np.eye(model.nv)[:, free], np.zeros(model.nv)
        J[glide, free.index(knee)] = SLOPE + 2 * BEND * angle
        excess[glide] = 2 * BEND * speed**2
        data.qpos, data.qvel, data.qfrc_applied = qpos[world], J @ qvel[world, free], force[world]
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, M)
        acts = data.qfrc_applied + data.qfrc_passive - data.qfrc_bias
        wanted = J @ np.linalg.solve(J.T @ M @ J, J.T @ (acts - M @ excess)) + excess
        found = sim.scene.data.qacc.numpy()[world]
        size = np.abs(wanted).max()
        assert np.abs(found - wanted).max() < CLOSE * size
        assert np.abs(data.qacc - wanted).max() > EFFECT * CLOSE * size
        moved = sim.scene.data.qpos.numpy()[world].astype(float)
        assert abs(moved[at[0]] - SLOPE * moved[at[1]] - BEND * moved[at[1]] ** 2) < 1e-6

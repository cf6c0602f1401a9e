"""Actuator forces against MuJoCo C: limits of control and force, gains, biases, shared joints."""

from types import SimpleNamespace

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from stepping import forward

from myowarp.engine.stages.affine_actuators import AffineActuators

NUM_WORLDS = 32
ROUNDING = 1e-6  # of the largest force
MODEL = """<mujoco><worldbody>
  <body><joint name="one" axis="1 0 0"/><geom size="0.1"/><site name="a" pos="0 0.1 0"/>
    <body pos="0 0 0.3"><joint name="two" type="slide"/><geom size="0.1"/>
      <site name="b" pos="0 0.2 0"/></body>
  </body><site name="c" pos="0 0.3 0.4"/></worldbody>
<tendon><spatial name="t"><site site="b"/><site site="a"/><site site="c"/></spatial></tendon>
<actuator>
  <motor joint="one" gear="3" ctrllimited="true" ctrlrange="-0.5 0.5"/>
  <position joint="two" kp="20" kv="2" forcelimited="true" forcerange="-3 1"/>
  <general tendon="t" gainprm="7" biastype="affine" biasprm="0.3 -2 -0.4" {more}/>
  {another}
</actuator></mujoco>"""


def scene_of(more="", another=""):
    """Return a model in C, and what the stage needs of a scene."""
    host = mujoco.MjModel.from_xml_string(MODEL.format(more=more, another=another))
    model, data = mjw.put_model(host), mjw.make_data(host, nworld=NUM_WORLDS)
    return host, SimpleNamespace(model=model, data=data, device=wp.get_device("cpu"))


def test_forces_are_those_of_mujoco_c():
    with wp.ScopedDevice("cpu"):
        host, scene = scene_of()
        assert AffineActuators.obstacle(scene) is None
        rng, data = np.random.default_rng(0), scene.data
        states = {"qpos": host.nq, "qvel": host.nv, "ctrl": host.nu}
        states = {name: np.float32(rng.normal(size=(NUM_WORLDS, size))) for name, size in states.items()}
        for name, values in states.items():
            getattr(data, name).assign(values)
        data.actuator_force.fill_(np.nan)
        forward(scene, [AffineActuators(scene)])
    oracle, forces, torques = mujoco.MjData(host), [], []
    for i in range(NUM_WORLDS):
        for name, values in states.items():
            getattr(oracle, name)[:] = values[i]
        mujoco.mj_forward(host, oracle)
        forces.append(oracle.actuator_force.copy())
        torques.append(oracle.qfrc_actuator.copy())
    for array, expected in ((data.actuator_force, forces), (data.qfrc_actuator, torques)):
        assert np.abs(array.numpy() - expected).max() <= ROUNDING * np.abs(expected).max()
    force, ctrl = np.array(forces), states["ctrl"]
    assert (np.abs(ctrl[:, 0]) > 0.5).any()
    assert np.isin(force[:, 1], (-3.0, 1.0)).any()


@pytest.mark.parametrize(
    ("more", "another", "reason"),
    [
        ('dyntype="filter" dynprm="0.1"', "", "actuators have states"),
        ("", '<muscle tendon="t" timeconst="0.01 0.04" lengthrange="0.1 1"/>', "actuators have states"),
        ('gaintype="affine"', "", "a gain is not a constant"),
        ("", '<general joint="one" biasprm="0 1 2"/>', "a bias that is off has parameters"),
        ("", '<motor site="a"/>', "an actuator drives neither tendon nor hinge nor slide"),
    ],
)
def test_obstacles(more, another, reason):
    with wp.ScopedDevice("cpu"):
        assert AffineActuators.obstacle(scene_of(more, another)[1]) == reason

"""A mass that hangs from one muscle, in the engine, against OpenSim 4.6 (data/record_opensim_bench.py)."""

import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from opensim_muscles import DATA

import myowarp
from myowarp.definitions.muscle_table import MuscleTable
from myowarp.sim.build import compile_scene
from myowarp.sim.present import present_muscles

MODEL = """
<mujoco model="hanging">
  <option timestep="{dt}" integrator="implicitfast" gravity="9.81 0 0"/>
  <worldbody>
    <site name="origin"/>
    <body>
      <joint name="x" type="slide" axis="1 0 0" range="0.1 0.5"/>
      <inertial pos="0 0 0" mass="5" diaginertia="1 1 1"/>
      <site name="insertion"/>
    </body>
  </worldbody>
  <tendon><spatial name="path"><site site="origin"/><site site="insertion"/></spatial></tendon>
  <actuator>
    <general name="muscle" tendon="path" dyntype="muscle" gaintype="muscle" biastype="muscle"
      dynprm="0.01 0.04 0" gainprm="0.75 1.05 100 200 0.5 1.6 1.5 1.3 1.2"
      biasprm="0.75 1.05 100 200 0.5 1.6 1.5 1.3 1.2"
      lengthrange="0.25 0.35" ctrlrange="0 1" ctrllimited="true"/>
  </actuator>
  <keyframe><key qpos="0.3"/></keyframe>
</mujoco>
"""

MASS, EVERY = 5.0, 0.01
CONTROL = ((0.0, 0.6), (0.05, 0.9), (0.2, 0.4))
PENNATIONS = (0.0, np.pi / 4)

EQUILIBRIUM = 2e-5
"""Of the peak: OpenSim's force at the start, in float32."""

TRAJECTORY = {0.0005: 0.01, 0.001: 0.02, 0.002: 0.03, 0.005: 0.08}
"""Of the range of the motion, by time step: the errors are of first order, as the engine's integrator is."""

FORCE = {0.0005: 0.0015, 0.001: 0.003, 0.002: 0.005, 0.005: 0.015}
"""RMS, of the peak."""

with np.load(DATA / "bench.npz") as _file:
    RECORDED = dict(_file)


def swing(folder, name, pennation, dt, start):
    """Return positions and tendon forces of our muscle at the recorded times."""
    path = folder / f"{name}_{dt}.xml"
    path.write_text(MODEL.format(dt=dt))
    spec = myowarp.from_mjcf(path, f"hangingPose{round(1e4 * dt)}-v0", control_dt=EVERY, replace=True)
    own = {
        "max_isometric_force": 100.0,
        "optimal_fiber_length": 0.1,
        "tendon_slack_length": 0.2,
        "pennation_angle_at_optimal": pennation,
    }
    scene = compile_scene(spec, 1, device="cpu", physics="parity", muscle=MuscleTable(name, own))
    model, data, muscles = scene.model, scene.data, scene.muscles
    assert model.opt.timestep.numpy()[0] == pytest.approx(dt)
    model.callback.control = muscles.launch
    data.qpos.fill_(start)
    muscles.activation.fill_(0.6)
    muscles.length.fill_(start)
    muscles.velocity.zero_()
    muscles.settle(wp.ones(1, dtype=bool, device="cpu"))
    rows, (edges, values) = [], zip(*CONTROL, strict=True)
    for k in range(round(0.5 / dt)):
        if k % round(EVERY / dt) == 0:
            rows.append((data.qpos.numpy()[0, 0], forces_now(muscles, scene)))
        data.ctrl.fill_(values[np.searchsorted(edges, k * dt + 1e-9, side="right") - 1])
        mjw.step(model, data)
    rows.append((data.qpos.numpy()[0, 0], forces_now(muscles, scene)))
    return np.array(rows).T


def forces_now(muscles, scene):
    """Return the tension of the present state, which stays as it is."""
    present_muscles(scene)()
    return muscles.tension.numpy()[0, 0]


OTHERS = [pytest.param(dt, marks=pytest.mark.slow) for dt in (0.0005, 0.001, 0.005)]


@pytest.mark.parametrize("dt", [0.002, *OTHERS])
@pytest.mark.parametrize("case", RECORDED)
def test_moves_as_in_opensim(tmp_path, case, dt):
    name, number = case.split()
    position, _, force = RECORDED[case].T
    assert np.ptp(position) > 0.014
    x, tension = swing(tmp_path, name, PENNATIONS[int(number)], dt, position[0])
    assert abs(tension[0] - force[0]) / 100.0 < EQUILIBRIUM
    assert np.abs(x - position).max() / np.ptp(position) < TRAJECTORY[dt]
    assert np.sqrt(np.mean((tension - force) ** 2)) / 100.0 < FORCE[dt]

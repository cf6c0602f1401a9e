"""OpenSim's own muscle bench, in the engine, against OpenSim 4.6 (data/record_opensim_bench.py).

A mass that hangs from one muscle, a ball that it pulls, and a path that is prescribed.
"""

from typing import NamedTuple

import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from opensim_muscles import DATA

import myowarp
from myowarp.definitions.muscle_table import MuscleTable
from myowarp.sim.build import compile_scene

MODEL = """
<mujoco model="bench">
  <option timestep="{dt}" integrator="implicitfast" gravity="{gravity} 0 0"/>
  <worldbody>
    <site name="origin"/>
    <body>
      <joint name="x" type="slide" axis="1 0 0" range="0.05 0.9"/>
      <inertial pos="0 0 0" mass="{mass}" diaginertia="1 1 1"/>
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

EVERY, PEAK = 0.01, 100.0
PENNATIONS = (0.0, np.pi / 4)


class Bench(NamedTuple):
    """A scene of the bench."""

    mass: float
    gravity: float
    activation: float
    control: tuple[tuple[float, float], ...]


SCENES = {
    "hanging": Bench(5.0, 9.81, 0.6, ((0.0, 0.6), (0.05, 0.9), (0.2, 0.4))),
    "ball": Bench(10.0, 0.0, 0.2, ((0.0, 0.5),)),
    "sine": Bench(10.0, 0.0, 0.2, ((0.0, 0.5),)),
}

EQUILIBRIUM = 2e-5
"""Of the peak: OpenSim's force at the start, in float32."""

TRAJECTORY = {0.0005: 0.003, 0.001: 0.005, 0.002: 0.01, 0.005: 0.02}
"""Of the range of the motion, by time step."""

FORCE = {0.0005: 0.001, 0.001: 0.002, 0.002: 0.0035, 0.005: 0.01}
"""RMS, of the peak."""

WORK = {"hanging": 0.75, "ball": 12.0}
"""Times the time step [1/s]: velocities are half a step old."""

BETWEEN = {"hanging": 0.55, "ball": 8.5}
"""Times the time step [1/s], with a rigid tendon, whose force depends on that velocity."""

ELASTIC = {"hanging": 120.0, "ball": 1000.0}
"""Times the square of the time step [1/s^2], with an elastic one."""

with np.load(DATA / "bench.npz") as _file:
    RECORDED = dict(_file)

STEPS = 0.0005, 0.001, 0.002, 0.005
QUICK = "hanging", 0.002
"""The scene and the time step that `make test` runs."""

CASES = [
    pytest.param(case, dt, marks=() if (case.split()[0], dt) == QUICK else pytest.mark.slow)
    for case in RECORDED
    for dt in STEPS
]


def bench(folder, scene, name, pennation, dt):
    """Return a scene and its control over time, its path where OpenSim's begins, at rest."""
    here = SCENES[scene]
    path = folder / f"{name}_{dt}.xml"
    path.write_text(MODEL.format(dt=dt, mass=here.mass, gravity=here.gravity))
    spec = myowarp.from_mjcf(path, f"benchPose{round(1e4 * dt)}-v0", control_dt=EVERY, replace=True)
    own = {
        "max_isometric_force": PEAK,
        "optimal_fiber_length": 0.1,
        "tendon_slack_length": 0.2,
        "pennation_angle_at_optimal": pennation,
    }
    built = compile_scene(spec, 1, device="cpu", physics="parity", muscle=MuscleTable(name, own))
    assert built.model.opt.timestep.numpy()[0] == pytest.approx(dt)
    built.model.callback.control = built.muscles.launch
    return built


def swing(folder, case, dt):
    """Return positions, velocities and tendon forces at the beginning of every step."""
    scene, name, number = case.split()
    built, here = bench(folder, scene, name, PENNATIONS[int(number)], dt), SCENES[scene]
    model, data, muscles = built.model, built.data, built.muscles
    start, speed = RECORDED[case][0, :2]
    data.qpos.fill_(start)
    data.qvel.fill_(speed)
    muscles.activation.fill_(here.activation)
    muscles.length.fill_(start)
    muscles.velocity.fill_(speed)
    muscles.settle(wp.ones(1, dtype=bool, device="cpu"))
    edges, values = zip(*here.control, strict=True)
    rows = []
    for k in range(round((len(RECORDED[case]) - 1) * EVERY / dt)):
        if scene == "sine":
            angle = 2.0 * np.pi * k * dt
            data.qpos.fill_(0.31 - 0.03 * np.cos(angle))
            data.qvel.fill_(0.06 * np.pi * np.sin(angle))
        state = data.qpos.numpy()[0, 0], data.qvel.numpy()[0, 0]
        data.ctrl.fill_(values[np.searchsorted(edges, k * dt + 1e-9, side="right") - 1])
        mjw.step(model, data)
        rows.append((*state, muscles.tension.numpy()[0, 0]))
    return np.array(rows, float).T


@pytest.mark.parametrize(("case", "dt"), CASES)
def test_moves_as_in_opensim(tmp_path, case, dt):
    """And the work of the muscle is the change of energy, with velocities as they are and those between."""
    position, _, force = RECORDED[case].T[:, :-1]
    x, v, tension = swing(tmp_path, case, dt)
    every = round(EVERY / dt)
    off = np.abs(x[::every] - position).max() / np.ptp(position)
    rms = np.sqrt(np.mean((tension[::every] - force) ** 2)) / PEAK
    assert np.ptp(position) > 0.014
    assert abs(tension[0] - force[0]) / PEAK < EQUILIBRIUM
    assert off < TRAJECTORY[dt]
    assert rms < FORCE[dt]
    scene = case.split()[0]
    if scene != "sine":
        between = np.concatenate([v[:1], 0.5 * (v[1:-1] + v[2:])])
        most = BETWEEN[scene] * dt if "rigid" in case else ELASTIC[scene] * dt**2
        assert unbalanced(case, x, v, tension) < WORK[scene] * dt
        assert unbalanced(case, x[:-1], between, tension[:-1]) < most


def unbalanced(case, x, v, tension):
    """Return how far kinetic and potential energy are off the work of the muscle, of all its work."""
    here = SCENES[case.split()[0]]
    power = 0.5 * (tension[1:] + tension[:-1]) * np.diff(x)
    work = -np.concatenate([[0.0], np.cumsum(power)])
    energy = 0.5 * here.mass * v**2 - here.mass * here.gravity * x
    return np.abs(energy - energy[0] - work).max() / np.abs(power).sum()

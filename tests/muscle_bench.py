"""OpenSim's own muscle bench in the engine, and muscles on paths that are prescribed.

The scenes are those of data/record_opensim_bench.py: a mass that hangs from one muscle, a ball that it pulls,
and a path that is prescribed. The paths are four classic experiments.
"""

from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import mujoco_warp as mjw
import numpy as np
import warp as wp
from stepping import engine_alone, repeated

import myowarp
from myowarp.definitions.muscle_table import MuscleTable
from myowarp.definitions.task import TASKS
from myowarp.engine.patch import engine_kernels_alone
from myowarp.sim.build import compile_scene

MODEL = """
<mujoco model="bench">
  <option timestep="{dt}" integrator="implicitfast" gravity="{gravity} 0 0"/>
  <worldbody>
    <site name="origin"/>
    <body>
      <joint name="x" type="slide" axis="1 0 0" range="0.05 0.9" stiffness="{spring}" springref="0.42"/>
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

EVERY, PEAK, FIBER, TENDON = 0.01, 100.0, 0.1, 0.2
PENNATIONS = (0.0, np.pi / 4)


class Bench(NamedTuple):
    """A scene of the bench: kg, m/s^2, 1, (s, 1) each, N/m."""

    mass: float
    gravity: float
    activation: float
    control: tuple[tuple[float, float], ...]
    spring: float = 0.0


SCENES = {
    "hanging": Bench(5.0, 9.81, 0.6, ((0.0, 0.6), (0.05, 0.9), (0.2, 0.4))),
    "ball": Bench(10.0, 0.0, 0.2, ((0.0, 0.5),)),
    "sine": Bench(10.0, 0.0, 0.2, ((0.0, 0.5),)),
    "light": Bench(0.01, 0.0, 0.6, ((0.0, 0.6), (0.05, 0.9), (0.2, 0.4)), 500.0),
}
"""`light`, of our own, is a light body between the muscle and a spring: stiff beside its mass."""

with np.load(Path(__file__).parent / "data" / "opensim" / "bench.npz") as _file:
    RECORDED = dict(_file)
"""Of each case, "scene model pennation": position, velocity and tendon force every 10 ms."""


class Motion(NamedTuple):
    """What was at the beginning of every step, shape (steps,) each."""

    position: np.ndarray
    velocity: np.ndarray
    tension: np.ndarray
    damping: np.ndarray

    def between(self) -> "Motion":
        """Return it with velocities of the times of the positions, and the force that the body has felt.

        The velocity that a state has is half a step older than its position. Within a step the force follows
        the velocity: the body feels the tension and its damping times the change of velocity.
        """
        x, v, tension, damping = self
        felt = tension[:-1] + damping[:-1] * np.diff(v)
        return Motion(x[:-1], 0.5 * (v[1:] + v[:-1]), felt, damping[:-1])


def parameters(pennation):
    """Return the parameters of the bench's muscle."""
    return {
        "max_isometric_force": PEAK,
        "optimal_fiber_length": FIBER,
        "tendon_slack_length": TENDON,
        "pennation_angle_at_optimal": pennation,
    }


def bench(folder, scene, name, pennation, dt):
    """Return a scene of the engine with a muscle under a model."""
    here = SCENES[scene]
    path = folder / f"{name}_{dt}.xml"
    path.write_text(MODEL.format(dt=dt, mass=here.mass, gravity=here.gravity, spring=here.spring))
    spec = myowarp.from_mjcf(path, f"benchPose{round(1e5 * dt)}-v0", control_dt=EVERY, replace=True)
    muscle = MuscleTable(name, parameters(pennation))
    built = compile_scene(spec, 1, device="cpu", physics="parity", muscle=muscle)
    assert abs(built.model.opt.timestep.numpy()[0] - dt) < 1e-9
    built.model.callback.control = built.muscles.launch
    return built


def swing(folder, case, dt, like=None):
    """Return the motion of a case, begun where OpenSim's begins, or that of another case."""
    scene, name, number = case.split()
    built, here = bench(folder, scene, name, PENNATIONS[int(number)], dt), SCENES[scene]
    model, data, muscles = built.model, built.data, built.muscles
    recorded = RECORDED[like or case]
    start, speed = recorded[0, :2]
    data.qpos.fill_(start)
    data.qvel.fill_(speed)
    muscles.activation.fill_(here.activation)
    muscles.length.fill_(start)
    muscles.velocity.fill_(speed)
    muscles.settle(wp.ones(1, dtype=bool, device="cpu"))
    edges, values = zip(*here.control, strict=True)

    def launch():
        with engine_kernels_alone():
            engine_alone(mjw.step)(model, data)

    advance = repeated(launch, "cpu")
    rows = []
    for k in range(round((len(recorded) - 1) * EVERY / dt)):
        if scene == "sine":
            angle = 2.0 * np.pi * k * dt
            data.qpos.fill_(0.31 - 0.03 * np.cos(angle))
            data.qvel.fill_(0.06 * np.pi * np.sin(angle))
        state = data.qpos.numpy()[0, 0], data.qvel.numpy()[0, 0]
        data.ctrl.fill_(values[np.searchsorted(edges, k * dt + 1e-9, side="right") - 1])
        advance()
        rows.append((*state, muscles.tension.numpy()[0, 0], muscles.damping.numpy()[0, 0]))
    return Motion(*np.array(rows, float).T)


def deviations(case, dt, motion):
    """Return how far position [of its range] and force [of the peak, RMS] are off OpenSim's at most."""
    position, _, force = RECORDED[case].T[:, :-1]
    every = round(EVERY / dt)
    off = np.abs(motion.position[::every] - position).max() / np.ptp(position)
    return off, np.sqrt(np.mean((motion.tension[::every] - force) ** 2)) / PEAK


def unbalanced(scene, motion):
    """Return how far kinetic and potential energy are off the work of the muscle, of all its work."""
    here, (x, v, tension, _) = SCENES[scene], motion
    power = 0.5 * (tension[1:] + tension[:-1]) * np.diff(x)
    work = -np.concatenate([[0.0], np.cumsum(power)])
    energy = 0.5 * here.mass * v**2 - here.mass * here.gravity * x
    return np.abs(energy - energy[0] - work).max() / np.abs(power).sum()


def step(muscles, dt, length, velocity, ctrl):
    """Let muscles act for a step on given paths."""
    ids, count = muscles.actuator_id, int(muscles.actuator_id.max()) + 1
    full = [np.zeros((len(length), count)) for _ in range(3)]
    for array, values in zip(full, (length, velocity, ctrl), strict=True):
        array[:, ids] = values
    names = "actuator_length", "actuator_velocity", "ctrl"
    arrays = [wp.array(array, dtype=float, device="cpu") for array in full]
    data = SimpleNamespace(**dict(zip(names, arrays, strict=True)))
    opt = SimpleNamespace(timestep=wp.full(1, dt, dtype=float, device="cpu"))
    forms = wp.zeros((len(length), count), dtype=wp.types.vector(10, float), device="cpu")
    with wp.ScopedDevice("cpu"):
        muscles.launch(SimpleNamespace(opt=opt, actuator_biasprm=forms), data)


def hold(muscles, length, activation):
    """Return the forces of muscles on paths that stand still."""
    wp.copy(muscles.activation, wp.array(activation, dtype=float, device="cpu"))
    wp.copy(muscles.length, wp.array(length, dtype=float, device="cpu"))
    muscles.velocity.zero_()
    muscles.settle(wp.ones(len(length), dtype=bool, device="cpu"))
    step(muscles, 0.0, length, np.zeros_like(length), activation)
    return muscles.tension.numpy()


PROTOCOLS = {
    "isometric": lambda t: 1.0 + 0.0 * t,
    "quick release": lambda t: np.where(t < 0.15, 1.05, 0.95),
    "ramp": lambda t: 0.95 + 0.4 * np.clip(t - 0.1, 0.0, 0.2),
    "sinusoid": lambda t: 1.0 + 0.08 * np.sin(2 * np.pi * 1.5 * t),
}
"""Lengths of a path over time [lengths of slack tendon and optimal fiber]."""


def trajectory(name, dt, num=4):
    """Return times and forces [F_max] of the protocols, excitation 1 from 0.02 s to 0.25 s, then 0.

    The muscles are those of the elbow whose tendons are as the model's name says.
    """
    task = TASKS["myoElbowPose1D6MRandom-v0"]
    muscles = compile_scene(task, num, device="cpu", physics="parity", muscle=name).muscles
    rows = muscles.parameters.numpy()
    rest = rows["optimal_fiber_length"] + rows["tendon_slack_length"]
    times, forces = np.arange(0.0, 0.4, dt), []
    paths = [path(times) for path in PROTOCOLS.values()]
    hold(muscles, np.array([p[0] for p in paths])[:, None] * rest, np.zeros((num, rest.shape[1])))
    for k, t in enumerate(times):
        here = np.array([p[k] for p in paths])[:, None] * rest
        # the engine moves by the velocity after it is known: a path's velocity is that of the coming step
        after = np.array([path(t + dt) for path in PROTOCOLS.values()])[:, None] * rest
        step(muscles, dt, here, (after - here) / dt, np.full(here.shape, float(0.02 <= t < 0.25)))
        forces.append(muscles.tension.numpy() / muscles.geometry().max_isometric_force)
    return times, np.array(forces)[..., rows["rigid"][0] == int(name.endswith("_rigid"))]

"""One contestant of `benchmarks.opensim_speed`: a process that simulates one model when told to.

    python benchmarks/replicas.py '{"kind": "mujoco_c", "model": "out/arm26/model.xml", "copies": 8, ...}'

It serves `benchmarks.opensim_loaded`, too.

Every muscle is there `copies` times, each with its share of the force, so that the motion stays the same.
Each episode starts in the default pose, with all activations at the constant excitation. The protocol is that
of `contestant.py`; steps are seconds of simulated time. It runs in OpenSim's environment too, so it imports
what it measures where it is measured.
"""

import json
import math
import os
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, Protocol

from benchmarks.contestant import cpu_seconds, peak_memory

EXCITATION = 0.05
WARM_UP = 0.02  # s, one control step; OpenSim has nothing to warm up, and takes half a minute for as much


class Simulator(Protocol):
    """Something that simulates episodes.

    Attributes:
        facts: What it says about itself.
    """

    facts: dict[str, object]

    def advance(self, duration: float) -> float:
        """Simulate an episode of so many seconds in every world; return the seconds of all worlds."""

    def pose(self) -> dict[str, float]:
        """Return coordinates, or joints, at the end of the last episode [rad or m], in the first world."""


def replicate(path: Path, copies: int, share: bool = True) -> str:
    """Return the MJCF of a converted model in which every muscle is there several times.

    Args:
        path: What `myowarp convert` wrote.
        copies: How often each muscle with its tendon is to be there.
        share: Whether each has its share of the peak force; otherwise the whole.

    Raises:
        ValueError: A muscle has no stored peak force or no tendon of its own.
    """
    root = ET.parse(path).getroot()
    compiler, tendons, actuators = root.find("compiler"), root.find("tendon"), root.find("actuator")
    if compiler is not None:
        compiler.set("meshdir", str((path.parent / compiler.get("meshdir", "")).resolve()))
    for actuator in actuators.findall("general[@dyntype='muscle']"):
        name, tendon = actuator.get("name"), tendons.find(f"spatial[@name='{actuator.get('tendon')}']")
        for parameters in ("gainprm", "biasprm"):
            values = actuator.get(parameters).split()
            if tendon is None or not float(values[2]) > 0:
                raise ValueError(f"muscle {name!r} needs a spatial tendon and a stored peak force")
            values[2] = repr(float(values[2]) / (copies if share else 1))
            actuator.set(parameters, " ".join(values))
        for copy in range(1, copies):
            for parent, element in ((tendons, tendon), (actuators, actuator)):
                parent.append(ET.fromstring(ET.tostring(element)))
                parent[-1].set("name", f"{element.get('name')} {copy}")
            actuators[-1].set("tendon", f"{tendon.get('name')} {copy}")
    return ET.tostring(root, encoding="unicode")


class OpenSim:
    """OpenSim's Manager with its Runge-Kutta-Merson integrator."""

    def __init__(self, model: str, copies: int, accuracy: float, **_: Any) -> None:
        import opensim

        opensim.Logger.setLevelString("Error")
        self.opensim, self.accuracy = opensim, accuracy
        self.model = opensim.Model(model)
        forces, muscles = self.model.updForceSet(), self.model.getMuscles()
        for name in [muscles.get(i).getName() for i in range(muscles.getSize())]:
            muscle = opensim.Muscle.safeDownCast(forces.get(name))
            muscle.setMaxIsometricForce(muscle.getMaxIsometricForce() / copies)
            for copy in range(1, copies):
                clone = muscle.clone()
                clone.setName(f"{name}_copy{copy}")
                forces.cloneAndAppend(clone)
        self.model.finalizeConnections()
        controller, muscles = opensim.PrescribedController(), self.model.getMuscles()
        for i in range(muscles.getSize()):
            controller.addActuator(muscles.get(i))
            controller.prescribeControlForActuator(muscles.get(i).getName(), opensim.Constant(EXCITATION))
        self.model.addController(controller)
        self.start = self.model.initSystem()
        for i in range(muscles.getSize()):
            muscles.get(i).setActivation(self.start, EXCITATION)
        self.model.equilibrateMuscles(self.start)
        self.facts: dict[str, object] = {"worlds": 1, "threads": 1, "muscles": muscles.getSize()}

    def advance(self, duration: float) -> float:
        """See `Simulator`."""
        self.manager, self.state = self.opensim.Manager(self.model), self.opensim.State(self.start)
        self.manager.setIntegratorAccuracy(self.accuracy)
        self.manager.setWriteToStorage(False)
        self.manager.initialize(self.state)
        self.manager.integrate(duration)
        return duration

    def pose(self) -> dict[str, float]:
        """See `Simulator`."""
        coordinates, end = self.model.getCoordinateSet(), self.manager.getState()
        these = (coordinates.get(i) for i in range(coordinates.getSize()))
        return {one.getName(): one.getValue(end) for one in these}


class MujocoC:
    """`mj_step` of the converted file, with its step and integrator."""

    def __init__(self, model: str, copies: int, **_: Any) -> None:
        import mujoco

        self.mujoco = mujoco
        self.model = mujoco.MjModel.from_xml_string(replicate(Path(model), copies))
        self.data = mujoco.MjData(self.model)
        self.facts: dict[str, object] = {
            "worlds": 1,
            "threads": 1,
            "muscles": self.model.na,
            "timestep": self.model.opt.timestep,
        }

    def advance(self, duration: float) -> float:
        """See `Simulator`."""
        self.mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        self.data.act[:] = EXCITATION
        self.data.ctrl[: self.model.nu] = EXCITATION * (self.model.actuator_dyntype != 0)
        steps = round(duration / self.model.opt.timestep)
        self.mujoco.mj_step(self.model, self.data, nstep=steps)
        return duration

    def pose(self) -> dict[str, float]:
        """See `Simulator`."""
        return {self.model.joint(j).name: float(self.data.qpos[j]) for j in range(self.model.njnt)}


class MyoWarp:
    """A batch of worlds with the preset `parity`: step and integrator of the file.

    A model with `copies` of 0 runs as it is, with its sidecars; it may be an .osim file.
    """

    def __init__(self, model: str, copies: int, worlds: int, device: str, shards: int, **_: Any) -> None:
        import numpy as np

        from myowarp.sim.simulation import Simulation
        from myowarp.tasks.from_file import pose_task

        with tempfile.TemporaryDirectory() as folder:
            path = Path(model)
            if copies:
                path = Path(folder) / "model.xml"
                path.write_text(replicate(Path(model), copies))
            options = {"autoreset": "disabled", "progress": False, "device": device}
            self.sim = Simulation(pose_task(path), worlds, shards=shards, **options)
        scene = self.sim.scene
        muscles = scene.muscles.activation.shape
        action = 0.5 + math.log(EXCITATION / (1.0 - EXCITATION)) / 5.0  # the inverse of kernels/action.py
        actions = np.zeros(self.sim.action.shape, np.float32)
        actions[:, scene.muscles.actuator_id] = action
        self.sim.action.assign(actions)
        self.rest = np.full(muscles, EXCITATION, np.float32)
        self.facts: dict[str, object] = {"worlds": worlds, "threads": shards, "muscles": muscles[1]}

    def advance(self, duration: float) -> float:
        """See `Simulator`."""
        scene = self.sim.scene
        self.sim.reset()
        scene.muscles.activation.assign(self.rest)
        for _ in range(round(duration / scene.control_dt)):
            self.sim.step()
        scene.data.qpos.numpy()  # waits for a GPU
        return duration * scene.num_worlds

    def pose(self) -> dict[str, float]:
        """See `Simulator`."""
        scene = self.sim.scene
        qpos = scene.data.qpos.numpy()[0]
        return {scene.oracle.joint(j).name: float(qpos[j]) for j in range(scene.oracle.njnt)}


KINDS = {"opensim": OpenSim, "mujoco_c": MujocoC, "myowarp": MyoWarp}


def measure(simulator: Simulator, duration: float, seconds: float) -> dict[str, object]:
    """Simulate whole episodes for about `seconds`, after a short untimed one."""
    if not isinstance(simulator, OpenSim):
        simulator.advance(WARM_UP)
    simulated, cpu, begin = 0.0, cpu_seconds(), time.perf_counter()
    while True:
        simulated += simulator.advance(duration)
        wall = time.perf_counter() - begin
        if wall >= seconds:
            figures = {"rate": simulated / wall, "wall": wall, "cpu": cpu_seconds() - cpu}
            return figures | {"memory": peak_memory(), "pose": simulator.pose()}


def main() -> None:
    """Serve requests until the input ends; what a contestant prints goes to the error stream."""
    options = json.loads(sys.argv[1])
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    simulator: Simulator = KINDS[options.pop("kind")](**options)
    print(json.dumps({"facts": simulator.facts}), file=answers)
    for line in sys.stdin:
        print(json.dumps(measure(simulator, options["duration"], float(line))), file=answers)


if __name__ == "__main__":
    main()

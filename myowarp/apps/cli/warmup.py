"""The command `myowarp warmup`: kernels compiled beforehand."""

from dataclasses import dataclass

from rich.console import Console

from myowarp.apps.cli.options import Device, Physics, TaskIds
from myowarp.definitions.task import TASKS
from myowarp.tasks.outside import find_task


@dataclass
class Warmup:
    """Compile the kernels of tasks now, so that later starts take seconds."""

    tasks: TaskIds = ()
    device: Device = None
    physics: Physics = "parity"

    def __call__(self) -> None:
        """Build one small simulation of every scene."""
        from myowarp.sim.simulation import Simulation

        specs = [TASKS[find_task(task).task] for task in self.tasks] or [TASKS[key] for key in TASKS]
        scenes = {(type(spec), spec.scene_key): spec for spec in specs}
        for spec in scenes.values():
            Console(stderr=True).print(f"{spec.family} with {spec.body}")
            Simulation(spec, 1, device=self.device, physics=self.physics)

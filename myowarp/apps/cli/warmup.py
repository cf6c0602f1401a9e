"""The command `myowarp warmup`: kernels compiled beforehand."""

import dataclasses
from dataclasses import dataclass
from typing import Annotated

from rich.console import Console

from myowarp.apps.cli.options import Asked, TaskIds, environment
from myowarp.definitions.task import TASKS


@dataclass
class Warmup:
    """Compile the kernels of tasks now, so that later starts take seconds."""

    asked: Annotated[Asked, environment(leave_out=("task", "horizon", "seed", "shards"))]
    tasks: TaskIds = ()

    def __call__(self) -> None:
        """Build one small simulation of every scene."""
        from myowarp.sim.simulation import Simulation
        from myowarp.tasks.setups import complete

        asked = self.asked.setup
        setups = [complete(dataclasses.replace(asked, task=task)) for task in self.tasks or TASKS]
        scenes = {(type(setup.spec), setup.spec.scene_key): setup for setup in setups}
        for setup in scenes.values():
            Console(stderr=True).print(f"{setup.spec.family} with {setup.spec.body}")
            Simulation(setup, 1)

"""The main job: run a policy in many worlds, measure, and keep what happened."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from myowarp.apps.policies.find import Policy, acting
from myowarp.apps.rollouts.episodes import Episodes, Trace
from myowarp.apps.rollouts.run import Each, Step, Watcher, run
from myowarp.disk import in_place
from myowarp.progress import progress_bar
from myowarp.sim.simulation import Simulation


@dataclass(frozen=True)
class Summary:
    """Figures of a rollout; the rates cover the steps alone, without start-up and pictures.

    Attributes:
        task: Id of the task.
        policy: Name of what acted.
        device: Warp device.
        num_worlds: Worlds stepped together.
        steps: Control steps.
        env_steps_per_s: Control steps of all worlds together [1/s].
        physics_steps_per_s: Physics steps of all worlds together [1/s].
        episodes: Episodes that ended.
        return_mean: Mean of their returns; None: none ended.
        return_std: Standard deviation of their returns.
        success_percent: Share of them that counts as a success [%].
        failed: Number of them that the task's failure ended.
        faults: Number of them that a fault ended.
    """

    task: str
    policy: str
    device: str
    num_worlds: int
    steps: int
    env_steps_per_s: float
    physics_steps_per_s: float
    episodes: int
    return_mean: float | None
    return_std: float | None
    success_percent: float | None
    failed: int
    faults: int


def roll_out(
    sim: Simulation, policy: Policy, steps: int, *watchers: Watcher, console: Console | None = None
) -> Summary:
    """Run a policy in all worlds of a simulation.

    Args:
        sim: The worlds, with autoreset in the same step or, to film the end of episodes, none.
        policy: What acts, from `find_policy`.
        steps: Control steps.
        watchers: Who looks besides.
        console: Where to draw the progress bar.

    Raises:
        ValueError: The policy returned actions of a wrong shape or value.
    """
    episodes, seconds = Episodes(sim.num_worlds), 0.0
    with progress_bar("Simulating", "steps  {task.fields[rate]:>9,.0f} env steps/s", console) as bar:
        task = bar.add_task("", total=steps, rate=0.0)

        def tell(step: Step) -> None:
            nonlocal seconds
            seconds = step.seconds
            bar.update(task, advance=1, rate=sim.num_worlds * step.number / seconds)

        run(sim, acting(policy, sim), steps, *watchers, episodes, Each(tell))
    found, rate = episodes.arrays(), sim.num_worlds * steps / seconds
    finished = len(found["world"]) > 0
    return Summary(
        task=sim.scene.spec.env_id,
        policy=policy.name,
        device=str(sim.scene.device),
        num_worlds=sim.num_worlds,
        steps=steps,
        env_steps_per_s=rate,
        physics_steps_per_s=rate * sim.scene.num_substeps,
        episodes=len(found["world"]),
        return_mean=float(found["return"].mean()) if finished else None,
        return_std=float(found["return"].std()) if finished else None,
        success_percent=100.0 * float(found["success"].mean()) if finished else None,
        failed=int(np.count_nonzero(found["failed"])),
        faults=int(np.count_nonzero(found["fault"])),
    )


def save_trace(path: Path, sim: Simulation, trace: Trace) -> None:
    """Write everything that passed between a policy and the worlds as compressed npz, in one move.

    Raises:
        OSError: The file cannot be written.
    """
    columns = [f"{c.name}[{i}]" for c in sim.columns for i in range(c.size)]
    arrays = {name: np.stack(steps) for name, steps in trace.arrays.items()}
    arrays |= {"columns": np.array(columns), "muscles": np.array(sim.scene.muscles.names)}
    arrays |= {"control_dt": np.array(sim.scene.control_dt)}
    with in_place(path) as scratch, scratch.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]

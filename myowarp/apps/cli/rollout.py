"""The command `myowarp rollout`: a policy in many worlds."""

import dataclasses
import json
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from rich.console import Console
from rich.table import Table

from myowarp.apps.cli.options import Environment, Overwrite, Policy, Steps, optional
from myowarp.definitions.registry import check_least
from myowarp.definitions.task import TaskSpec
from myowarp.kernels.episode import SUCCESS_RULE

TILE = (320, 240)  # px of one world in a video
RANDOM_ELBOW_ID = "myoElbowPose1D6MRandom-v0"
RANDOM_ELBOW = 56
"""Share of that id's episodes in which random actions succeed [%]; a yardstick for success."""


@dataclass
class Rollout:
    """Run a policy in many worlds, print statistics, and save data and video.

    Example: myowarp rollout MyoWarp/myoHandReachRandom-v1 --num-worlds 256 --video hand.mp4
    """

    asked: Environment
    num_worlds: int = 64
    """Worlds simulated together."""
    steps: Steps = None
    policy: Policy = "random"
    held: bool = False
    """Hold the part that carries all others in place, as if in a harness."""
    save: Annotated[Path | None, optional("FILE")] = None
    """Write observations, actions, rewards and endings of all steps to this .npz."""
    video: Annotated[Path | None, optional("FILE")] = None
    """Write a video of some worlds to this .mp4 or .gif."""
    video_worlds: int = 6
    """Worlds in the video."""
    signals: Annotated[Path | None, optional("FILE")] = None
    """Write muscle signals and joint angles: .parquet or .csv (tidy tables), .npz, .sto (one world)."""
    signals_every: int = 1
    """Control steps from one sample of the signals to the next."""
    overwrite: Overwrite = False
    json: bool = False
    """Print the statistics as JSON."""

    def __call__(self) -> None:
        """Run and report."""
        from myowarp.apps.policies.find import find_policy
        from myowarp.apps.rollouts.episodes import Trace
        from myowarp.apps.rollouts.fall import Fall
        from myowarp.apps.rollouts.film import VIDEOS, Film, write
        from myowarp.apps.rollouts.recording import check_recording, recording, recording_files
        from myowarp.apps.rollouts.rollout import roll_out, save_trace
        from myowarp.disk import check_output, check_overwrite
        from myowarp.sim.simulation import Simulation
        from myowarp.tasks.setups import complete
        from myowarp.view.browser.held import held_setup
        from myowarp.view.drawing.render import NoGraphicsError

        asked = self.asked.setup
        setup = held_setup(complete(asked)) if self.held else complete(asked)
        spec = setup.spec
        steps = setup.episode_steps if self.steps is None else self.steps
        self._check_numbers(steps)
        policy = find_policy(self.policy, spec)
        check_output(self.save, ".npz")
        check_output(self.video, *VIDEOS)
        check_recording(self.signals, self.num_worlds)
        check_overwrite((self.save, self.video, *recording_files(self.signals)), self.overwrite)
        console = Console(stderr=True)
        # A film ends with the last state of an episode; reset-free ones go on from there.
        autoreset = "disabled" if self.video and setup.reset != "none" else "same_step"
        sim = Simulation(setup, self.num_worlds, autoreset=autoreset)
        trace = Trace() if self.save else None
        tiles = range(min(self.video_worlds, self.num_worlds))
        film = Film(sim, tiles, TILE, legend=True) if self.video else None
        with recording(sim, self.signals, self.signals_every) if self.signals else nullcontext() as recorder:
            fall = Fall(sim)
            watchers = [watcher for watcher in (trace, recorder, film, fall) if watcher is not None]
            summary = roll_out(sim, policy, steps, *watchers, console=console)
        if isinstance(asked.task, Path):  # its poses are no task that somebody has set
            summary = dataclasses.replace(summary, return_mean=None, return_std=None, success_percent=None)
        _report(dataclasses.asdict(summary), spec, self.json)
        if text := fall.text():
            console.print(text, style="yellow", markup=False, soft_wrap=True)
        if self.save and trace is not None:
            save_trace(self.save, sim, trace)
            console.print(f"Saved {self.save}")
        for path in recording_files(self.signals):
            console.print(f"Saved {path}")
        if self.video and film is not None:
            try:
                write(self.video, [film], console)
                console.print(f"Saved {self.video}")
                if text := film.marks():
                    console.print(text)
            except NoGraphicsError as error:
                console.print(f"No video: {error}", style="yellow")
            film.close()
        sim.close()

    def _check_numbers(self, steps: int) -> None:
        """Raise ValueError if a number is out of its range."""
        check_least(1, steps=steps, video_worlds=self.video_worlds, signals_every=self.signals_every)
        if self.signals and self.signals_every > steps:
            raise ValueError(f"--signals-every must be at most --steps, {steps}, got {self.signals_every}")


def _report(figures: dict[str, object], spec: TaskSpec, as_json: bool) -> None:
    """Print the statistics of a rollout, and what success is."""
    if as_json:
        print(json.dumps(figures, indent=1))
        return
    console = Console(highlight=False)
    console.print(figures["task"], style="bold")
    table = Table(show_header=False)
    for name, value in figures.items():
        if name == "task" or value is None:
            continue
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
        if name == "policy" and value == Rollout.policy:
            text += " (default)"
        if name.endswith("_per_s"):
            text = f"{value:,.0f}"
        table.add_row(name.replace("_per_s", "/s").replace("_", " "), text)
    console.print(table)
    if figures["success_percent"] is not None:
        solved = f" A step is solved where {spec.solved_when}." if spec.solved_when else ""
        console.print(
            f"Success: {SUCCESS_RULE}.{solved} It is enough to pass through: random actions on the elbow "
            f"({RANDOM_ELBOW_ID}) succeed in about {RANDOM_ELBOW} % of the episodes.",
            markup=False,
        )

"""The command `myowarp`: list tasks, roll out policies, audit tasks, simulate cohorts, compile kernels."""

import dataclasses
import gc
import json
import sys
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
import warp as wp
from rich.console import Console
from rich.progress import track
from rich.table import Column, Table

from myowarp.apps.plot import Plot
from myowarp.apps.record import Record
from myowarp.opensim.command import Convert
from myowarp.spec.muscle import MUSCLES
from myowarp.spec.muscle_table import MuscleTable
from myowarp.spec.task import TASKS
from myowarp.tasks.variants import find_variant

TILE = (320, 240)  # px of one world in a video


@dataclass
class Tasks:
    """List the tasks with their sizes."""

    family: str | None = None
    """Only this family, such as pose or reach."""
    paper: bool = False
    """List the paper's grid of 204 tasks instead."""
    json: bool = False
    """Print JSON instead of a table."""

    def __call__(self) -> None:
        """Print the list."""
        if self.paper:
            _list_paper(self.json)
            return
        from myowarp.sim.build import oracle_model

        rows = []
        for key in track(TASKS, "Building bodies", console=Console(stderr=True), transient=True):
            spec = TASKS[key]
            if self.family not in (None, spec.family):
                continue
            model = oracle_model(spec)
            num_muscles = model.na
            rows.append(
                {
                    "id": spec.env_id,
                    "family": spec.family,
                    "body": spec.body,
                    "obs": sum(column.size for column in spec.columns(model.nq, model.nv, num_muscles)),
                    "act": model.nu,
                    "muscles": num_muscles,
                    "horizon": spec.horizon,
                    "control_dt": spec.control_dt,
                    "doc": spec.doc,
                }
            )
        if not rows:
            known = sorted({TASKS[key].family for key in TASKS})
            raise ValueError(f"family {self.family!r} unknown; available: {', '.join(known)}")
        if self.json:
            print(json.dumps(rows, indent=1))
            return
        table = Table(
            Column("id", no_wrap=True),
            "obs",
            "act",
            "horizon",
            "dt [s]",
            "task",
            title=f"{len(rows)} tasks, MyoWarp/...",
        )
        for row in rows:
            sizes = (str(row[name]) for name in ("obs", "act", "horizon"))
            table.add_row(
                row["id"].removeprefix("MyoWarp/"),
                *sizes,
                f"{row['control_dt']:.3f}",
                row["doc"].split(". ")[0],
            )
        Console().print(table)


def _list_paper(as_json: bool) -> None:
    """Print the paper's grid."""
    from myowarp.tasks.paper import grid

    rows = [dataclasses.asdict(row) for row in grid()]
    if as_json:
        print(json.dumps(rows, indent=1))
        return
    table = Table(*rows[0], title=f"{len(rows)} tasks")
    for row in rows:
        table.add_row(*row.values())
    Console().print(table)


@dataclass
class Rollout:
    """Run a policy in many worlds, print figures, and save data and video.

    Example: myowarp rollout MyoWarp/myoHandReachRandom-v0 --num-worlds 256 --video hand.mp4
    """

    task: Annotated[str | None, tyro.conf.Positional] = None
    """Task id, with or without "MyoWarp/"; `myowarp tasks` lists them."""
    model: Path | None = None
    """Instead of a task: an MJCF file, such as `myowarp convert` writes; random poses of its joints. Physics
    parity is then the file's own integrator and step."""
    num_worlds: int = 64
    """Worlds simulated together."""
    steps: int | None = None
    """Control steps; by default one episode."""
    policy: str = "random"
    """random, zero, hold, package.module:function or file.py:function (observations -> actions)."""
    seed: int = 0
    """Seed of resets and of the random policy."""
    device: str | None = None
    """Warp device, such as cpu or cuda:0; by default the GPU if there is one."""
    physics: str = "parity"
    """parity (MyoSuite's integrator and step) or fast (implicit, twice the step)."""
    muscle: Annotated[str, tyro.conf.arg(metavar="{" + ",".join(MUSCLES) + "}")] = "mujoco"
    """Muscle model."""
    muscle_parameters: Path | None = None
    """Muscle parameters in place of the model's, .csv: column `muscle`, and one for each parameter."""
    reset: str | None = None
    """What episodes start from: task, fixed, random or none; by default what the id says."""
    conditions: tuple[str, ...] = ()
    """Muscle conditions, such as sarcopenia fatigue_3ccr, besides those of the id."""
    save: Path | None = None
    """Write observations, actions, rewards and endings of all steps to this .npz."""
    video: Path | None = None
    """Write a video of some worlds to this .mp4 or .gif."""
    video_worlds: int = 6
    """Worlds in the video."""
    signals: Path | None = None
    """Write muscle signals and joint angles to this .parquet (tidy tables) or .npz."""
    signals_every: int = 1
    """Control steps from one sample of the signals to the next."""
    json: bool = False
    """Print the figures as JSON."""

    def __call__(self) -> None:
        """Run and report."""
        from myowarp.apps import rollout
        from myowarp.apps.film import VIDEOS, Film, write
        from myowarp.apps.recording import check_recording, recording
        from myowarp.bridge_gym import MyoWarpVectorEnv
        from myowarp.disk import check_output
        from myowarp.tasks.from_file import find_task
        from myowarp.view.render import NoGraphicsError

        variant = find_task(self.task, self.model)
        spec = TASKS[variant.task]
        steps = spec.horizon if self.steps is None else self.steps
        self._check_numbers(steps)
        policy = rollout.find_policy(self.policy, spec)
        check_output(self.save, ".npz")
        check_output(self.video, *VIDEOS)
        check_recording(self.signals)
        muscle = MuscleTable.read(self.muscle, self.muscle_parameters)
        console = Console(stderr=True)
        env = MyoWarpVectorEnv(
            spec.key,
            self.num_worlds,
            device=self.device,
            physics=self.physics,
            muscle=muscle,
            reset=self.reset or variant.reset,
            conditions=(*variant.conditions, *self.conditions),
            autoreset_mode="same_step",
        )
        film = None
        if self.video:
            film = Film(env.sim, range(min(self.video_worlds, self.num_worlds)), TILE)
        with (
            recording(env.sim, self.signals, self.signals_every)
            if self.signals
            else nullcontext() as recorder
        ):
            summary, kept = rollout.run(
                env,
                policy,
                steps,
                self.seed,
                record=self.save is not None,
                film=film,
                recorder=recorder,
                console=console,
            )
        _report(dataclasses.asdict(summary), self.json)
        if self.save:
            rollout.save_recording(self.save, env, kept)
            console.print(f"Saved {self.save}")
        if self.signals:
            console.print(f"Saved {self.signals}")
        if self.video and film is not None:
            try:
                write(self.video, [film], console)
                console.print(f"Saved {self.video}")
            except NoGraphicsError as error:
                console.print(f"No video: {error}", style="yellow")
        env.close()

    def _check_numbers(self, steps: int) -> None:
        """Raise ValueError if a number is out of its range."""
        numbers = {"steps": steps, "video-worlds": self.video_worlds, "signals-every": self.signals_every}
        for name, number in numbers.items():
            if number < 1:
                raise ValueError(f"--{name} must be at least 1, got {number}")
        if self.seed < 0:
            raise ValueError(f"--seed must be at least 0, got {self.seed}")


@dataclass
class Cohort:
    """Simulate a table of patients, all at once: results as tidy tables, and a plot.

    The table has one row per patient and a column for everything in which patients differ, such as strength
    (healthy: 1), fatigue_rate [1/s], load_mass [kg], exo_assistance, tendon_tear (names of muscles),
    tendon_transfer (0 or 1); a wrong name lists all. Every patient meets the same trials.

    Example: raise the forearm from hanging down, and hold it for ten seconds:
    myowarp cohort examples/elbow_cohort.csv --task myoElbowPose1D6MFixed-v0 --reset fixed --steps 500
    """

    table: Annotated[Path, tyro.conf.Positional]
    """Patients, .csv or .parquet."""
    task: str
    """Task id, with or without "MyoWarp/"; `myowarp tasks` lists them."""
    policy: str = "hold"
    """hold (pose tasks: proportional control of the joints), random, zero, package.module:function or
    file.py:function (observations -> actions)."""
    output: Path = Path("out/cohort")
    """Folder for results, summary.csv, settings.json and plot.png."""
    steps: int | None = None
    """Control steps; by default one episode of the task."""
    trials: int = 1
    """Episodes of each patient; trial k has the same start, goal and noise for all."""
    seed: int = 0
    """Seed of the first trial."""
    every: int | None = None
    """Control steps from one row of the results to the next; by default steps / 100."""
    reset: str = "task"
    """What episodes start from: task, fixed, random or none."""
    physics: str = "parity"
    """parity (MyoSuite's integrator and step) or fast (implicit, twice the step)."""
    device: str | None = None
    """Warp device, such as cpu or cuda:0; by default the GPU if there is one."""
    format: Literal["parquet", "csv"] = "parquet"
    """Format of the results."""

    def __call__(self) -> None:
        """Check, run, write."""
        from myowarp.apps.cohort import command

        settings = dataclasses.asdict(self)
        table, output, suffix = settings.pop("table"), settings.pop("output"), settings.pop("format")
        command.run(
            table, output, f".{suffix}", Console(stderr=True, highlight=False, soft_wrap=True), **settings
        )


@dataclass
class Warmup:
    """Compile the kernels of tasks now, so that later starts take seconds."""

    tasks: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Task ids; none means all."""
    device: str | None = None
    """Warp device; by default the GPU if there is one."""
    physics: str = "parity"
    """Physics preset."""

    def __call__(self) -> None:
        """Build one small simulation of every scene."""
        from myowarp.sim.simulation import Simulation

        keys = [find_variant(task).task for task in self.tasks] or list(TASKS)
        scenes = {TASKS[key].scene_key: TASKS[key] for key in keys}
        for spec in scenes.values():
            Console(stderr=True).print(f"{spec.family} with {spec.body}")
            Simulation(spec, 1, device=self.device, physics=self.physics)


@dataclass
class Audit:
    """Check whether tasks are sound: run zero, random and extreme actions, and examine targets and objects.

    Says for each id how often episodes fail at once, which share of the targets can be met, what of the
    observation and the reward never moves, whether failing early pays, how full contacts were, and whether
    objects have the inertia and friction that they should. A corrected version stands beside the one with
    MyoSuite's semantics. An id takes from seconds (elbow) to minutes (hand that touches).

    Two versions of a task: myowarp audit myoHandReachFixed-v0 myoHandReachFixed-v1

    Every registered id: myowarp audit --output out/all

    The paper's grid, each id with its reset: myowarp audit --paper
    """

    tasks: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Task ids, with or without "MyoWarp/", the paper's too; none means every registered id."""
    paper: bool = False
    """Audit the paper's grid of 204 ids."""
    num_worlds: int = 64
    """Worlds simulated together: episodes seen for each policy."""
    steps: int | None = None
    """Control steps of each policy; by default, and at least, one horizon of the task (reset-free: two)."""
    seed: int = 0
    """World i resets with seed + i."""
    device: str | None = None
    """Warp device, such as cpu or cuda:0; by default the GPU if there is one."""
    physics: str = "parity"
    """parity (MyoSuite's integrator and step) or fast (implicit, twice the step)."""
    output: Path = Path("out/audit")
    """Folder for audit.json, written after every id, and index.html with plots (needs matplotlib)."""
    json: bool = False
    """Print the JSON instead of a table."""

    def __call__(self) -> None:
        """Check everything, then audit and report."""
        from myowarp.apps.audit import command
        from myowarp.disk import check_folder
        from myowarp.sim.build import resolve_device
        from myowarp.spec.registry import check_choice
        from myowarp.spec.task import PHYSICS

        jobs = command.find_jobs(self.tasks, self.paper)
        for name, number, least in (
            ("num-worlds", self.num_worlds, 1),
            ("steps", 1 if self.steps is None else self.steps, 1),
            ("seed", self.seed, 0),
        ):
            if number < least:
                raise ValueError(f"--{name} must be at least {least}, got {number}")
        check_choice("physics", self.physics, PHYSICS)
        resolve_device(self.device)
        check_folder(self.output)
        self.output.mkdir(parents=True, exist_ok=True)
        console = Console(stderr=True, highlight=False, soft_wrap=True)
        audits = command.audit_all(
            jobs,
            self.output,
            console,
            num_worlds=self.num_worlds,
            steps=self.steps,
            seed=self.seed,
            device=self.device,
            physics=self.physics,
        )
        if self.json:
            print(command.as_json(audits))
        else:
            command.print_table(audits, Console())


def _report(figures: dict[str, object], as_json: bool) -> None:
    """Print the figures of a rollout."""
    if as_json:
        print(json.dumps(figures, indent=1))
        return
    Console().print(figures["task"], style="bold", highlight=False)
    table = Table(show_header=False)
    for name, value in figures.items():
        if name == "task" or value is None:
            continue
        text = (
            f"{value:,.0f}"
            if name.endswith("_per_s")
            else f"{value:.4g}"
            if isinstance(value, float)
            else str(value)
        )
        table.add_row(name.replace("_per_s", "/s").replace("_", " "), text)
    Console().print(table)


def command() -> None:
    """Entry point of the command, in a process of its own."""
    gc.freeze()  # half a million objects of Warp's stay to the end; not looking through them saves a second
    main()


def main() -> None:
    """Run the command; errors are one sentence and exit status 2."""
    wp.config.log_level = wp.LOG_ERROR
    command = tyro.extras.subcommand_cli_from_dict(
        {
            "tasks": Tasks,
            "rollout": Rollout,
            "cohort": Cohort,
            "audit": Audit,
            "record": Record,
            "plot": Plot,
            "convert": Convert,
            "warmup": Warmup,
        },
        prog="myowarp",
        description="Musculoskeletal motor control, simulated in thousands of worlds at once.",
    )
    try:
        command()
    except (ValueError, OSError, RuntimeError, ImportError) as error:
        Console(stderr=True, highlight=False, soft_wrap=True).print(
            f"myowarp: {error}", style="red", markup=False
        )
        sys.exit(2)


if __name__ == "__main__":
    command()

"""MyoWarp beside its rivals on the same cores, in the same run.

    make rivals
    make rivals RIVALS=--whole-bodies

For each of the nine families, or of the whole bodies: MyoSuite 3.0.0 alone and in Gymnasium's
AsyncVectorEnv, EnvPool 1.2.5, MuJoCo C without any environment, and MyoWarp with both presets. Every
contestant is a process of its own (`contestant.py`) that is up all the time; only one steps at a time, in
rounds, so that a disturbance of the machine meets all of them alike. What others use meanwhile is read from
/proc/stat; a disturbed measurement is made again. Linux only.
"""

import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.progress import Progress

from benchmarks.contestant import FULL_BODY
from benchmarks.machine import IDLE_CORES, disturbances, least_disturbed, processor
from benchmarks.rivals_report import JUDGED_SIZE, draw, print_tables, summarize

ROOT = Path(__file__).parents[1]
FAMILIES = {
    "elbow pose": "myoElbowPose1D6MRandom-v0",
    "finger pose": "myoFingerPoseRandom-v0",
    "finger reach": "myoFingerReachRandom-v0",
    "hand pose": "myoHandPoseRandom-v0",
    "hand reach": "myoHandReachRandom-v0",
    "key turn": "myoHandKeyTurnRandom-v0",
    "object hold": "myoHandObjHoldRandom-v0",
    "pen twirl": "myoHandPenTwirlRandom-v0",
    "baoding": "myoChallengeBaodingP2-v1",
}
WHOLE_BODIES = {
    "arm reach": "myoArmReachRandom-v0",
    "leg stand": "myoLegStandRandom-v0",
    "leg walk": "myoLegWalk-v0",
    "leg hills": "myoLegHillyTerrainWalk-v0",
    "torso pose": "myoTorsoPoseFixed-v0",
    "relocate": "myoChallengeRelocateP1-v0",
    "full body": FULL_BODY,
}
QUICK = ("elbow pose", "hand pose", "key turn", "arm reach", "leg walk", "full body")
AXES = {
    "EnvPool": "EnvPool 1.2.5",
    "MuJoCo C": "MuJoCo C (physics alone)",
    "MyoSuite": "the better of MyoSuite 3.0.0's two",
}
TASK_OF = FAMILIES | WHOLE_BODIES
FRESH = ("hand pose", "key turn")  # without and with contacts; each compiles for half a minute
DIFFERENCES = {
    "MyoSuite": "MyoSuite 3.0.0: the same tasks; one Python environment in one process.",
    "MyoSuite async": "The same in Gymnasium's AsyncVectorEnv, one worker process a core.",
    "EnvPool": "EnvPool 1.2.5: MyoSuite 2.11.6 in C++ on MuJoCo 3.6, with that release's models and "
    "observations; 64 environments, one thread a core. Every environment starts every episode alike.",
    "MuJoCo C, 1 thread": "mj_step of the unslimmed model of the task, float64; nothing but physics.",
    "MuJoCo C": "The same through MuJoCo's thread pool, one thread a core; whole episodes, even where a task "
    "would end early.",
    "MyoWarp": "make_vec as a user calls it; parity has MyoSuite 3.0.0's integrator and step, in float32.",
}


@dataclass
class Options:
    """Measure MyoWarp beside its rivals."""

    myosuite: Path = ROOT / ".venv-parity/bin/python"
    """Python of an environment with myosuite==3.0.0."""
    envpool: Path = ROOT / ".venv-envpool/bin/python"
    """Python of an environment with envpool==1.2.5."""
    output: Path = Path("out/rivals.json")
    """JSON file to write; the plot goes beside it."""
    families: tuple[str, ...] = tuple(FAMILIES)
    """Families to measure."""
    whole_bodies: bool = False
    """The whole bodies instead, with up to 256 worlds."""
    sizes: tuple[int, ...] = (1, 64, 256, 1024)
    """Numbers of worlds of MyoWarp."""
    rounds: int = 5
    """Rounds; the median counts."""
    seconds: float = 0.4
    """Duration of one measurement."""
    quick: bool = False
    """Three families or bodies, 64 worlds, two short rounds: does everything run?"""

    def __post_init__(self) -> None:
        """Check the names, and cut down to what is quick."""
        if self.whole_bodies:
            self.families = tuple(WHOLE_BODIES)
            self.sizes = tuple(size for size in self.sizes if size <= JUDGED_SIZE)
        unknown = sorted(set(self.families) - set(TASK_OF))
        if unknown:
            raise ValueError(f"family {unknown[0]!r} unknown; available: {', '.join(TASK_OF)}")
        if self.quick:
            self.families = tuple(name for name in self.families if name in QUICK)
            self.sizes, self.rounds, self.seconds = (64,), 2, 0.3


@dataclass
class Worker:
    """A contestant's process.

    Attributes:
        name: What tables call it.
        begin: When it was started.
        start: Seconds from there to its first step; None where others started at the same time.
        facts: What it says about itself.
        samples: What it did in each round.
    """

    name: str
    process: subprocess.Popen[str]
    begin: float
    start: float | None = None
    facts: dict[str, Any] = field(default_factory=dict)
    samples: list[dict[str, float]] = field(default_factory=list)

    def read(self) -> dict[str, Any]:
        """Return the next answer.

        Raises:
            RuntimeError: The process has ended.
        """
        line = self.process.stdout.readline()
        if not line:
            code = self.process.wait()
            raise RuntimeError(
                f"contestant {self.name!r} ended with exit code {code}; its messages are in the log"
            )
        return json.loads(line)

    def await_first_step(self, timed: bool) -> None:
        """Wait until it has stepped."""
        self.facts = self.read()["facts"]
        if timed:
            self.start = time.perf_counter() - self.begin

    def measure(self, seconds: float) -> None:
        """Let it step; takes down what it did and how many cores others kept busy."""
        sample, others = least_disturbed(lambda: self._measured(seconds))
        self.samples.append(sample | {"others": others})

    def _measured(self, seconds: float) -> tuple[dict[str, float], float]:
        """Let it step; returns what it did, and its processor time [s]."""
        begin = time.perf_counter()
        self.process.stdin.write(f"{seconds}\n")
        sample = self.read()
        wall = time.perf_counter() - begin
        return sample, sample["cpu"] * wall / sample["wall"]  # the untimed warm-up included

    def close(self) -> None:
        """End the process."""
        self.process.stdin.close()
        self.process.wait(timeout=60)


def start(
    name: str,
    python: Path,
    log: Any,
    caches: Path | None = None,
    script: str = "contestant.py",
    **options: Any,
) -> Worker:
    """Start a contestant.

    Args:
        name: What tables call it.
        python: The interpreter to run it in.
        log: File for what it prints.
        caches: Folder for compiled kernels and models; None: where they always are.
        script: File of this folder to run.
        options: Of the contestant.
    """
    environment = dict(os.environ, PYTHONPATH=str(ROOT))
    if caches is not None:
        folders = {key: str(caches / key) for key in ("WARP_CACHE_PATH", "MYOWARP_CACHE_DIR")}
        environment |= folders | {"XDG_CACHE_HOME": str(caches)}
    begin = time.perf_counter()
    process = subprocess.Popen(
        [python, ROOT / "benchmarks" / script, json.dumps(options)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=log,
        env=environment,
        text=True,
        bufsize=1,
    )
    return Worker(name, process, begin)


def line_up(task: str, options: Options, log: Any, tell: Any) -> list[Worker]:
    """Start all contestants of a family: one after the other, but for sizes that differ from the first."""
    cores, ours = len(os.sched_getaffinity(0)), Path(sys.executable)
    others: list[tuple[str, Path, dict[str, Any]]] = [
        ("MyoSuite", options.myosuite, {"kind": "myosuite"}),
        ("MyoSuite async", options.myosuite, {"kind": "myosuite_async"}),
        ("EnvPool", options.envpool, {"kind": "envpool", "num_envs": 64}),
    ]
    wanted = [
        *(others if task != FULL_BODY else []),  # they have no task with it
        ("MuJoCo C, 1 thread", ours, {"kind": "mujoco_c", "threads": 1}),
        ("MuJoCo C", ours, {"kind": "mujoco_c", "threads": cores}),
    ]
    for size in options.sizes:
        for physics in ("parity", "fast"):
            arguments = {"kind": "myowarp", "physics": physics, "num_envs": size}
            wanted.append((f"{physics} {size}", ours, arguments))
    alone = len(wanted) - 2 * (len(options.sizes) - 1)
    workers: list[Worker] = []
    for i, (name, python, arguments) in enumerate(wanted):
        tell(f"starting {name}")
        workers.append(start(name, python, log, task=task, cores=cores, **arguments))
        if i < alone:
            workers[-1].await_first_step(timed=True)
    for worker in workers[alone:]:
        worker.await_first_step(timed=False)
    return workers


def take_turns(workers: list[Worker], rounds: int, seconds: float, tell: Any) -> None:
    """Measure all contestants in rounds, odd ones backwards, and end them."""
    for turn in range(rounds):
        for worker in workers if turn % 2 == 0 else reversed(workers):
            tell(f"round {turn + 1}, {worker.name}")
            worker.measure(seconds)
    for worker in workers:
        worker.close()


def measure_family(task: str, options: Options, log: Any, tell: Any) -> dict[str, Any]:
    """Return the samples of all contestants of a family."""
    workers = line_up(task, options, log, tell)
    take_turns(workers, options.rounds, options.seconds, tell)
    return {
        worker.name: {"start": worker.start, "facts": worker.facts, "samples": worker.samples}
        for worker in workers
    }


def medians(rows: dict[str, Any]) -> list[str]:
    """Return the rate of each contestant, for people who wait."""
    rates = {name: statistics.median(s["rate"] for s in row["samples"]) for name, row in rows.items()}
    return [f"{name} {rate:,.0f}" for name, rate in rates.items()]


def first_starts(task: str, log: Any) -> dict[str, float]:
    """Return seconds to the first step with empty caches, and of the next process [s]."""
    cores, seconds = len(os.sched_getaffinity(0)), {}
    with tempfile.TemporaryDirectory() as folder:
        for turn in ("fresh", "second"):
            worker = start(
                turn, Path(sys.executable), log, Path(folder),
                kind="myowarp", task=task, cores=cores, physics="parity", num_envs=64,
            )  # fmt: skip
            worker.await_first_step(timed=True)
            seconds[turn] = round(worker.start or 0.0, 2)
            worker.close()
    return seconds


def main() -> None:
    """Measure, print tables, write JSON and plot."""
    options = tyro.cli(Options, prog="python -m benchmarks.rivals")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    begin, load = time.perf_counter(), os.getloadavg()[0]
    samples, starts = {}, {}
    log_path = options.output.with_suffix(".log")
    with log_path.open("w") as log, Progress(console=Console(stderr=True)) as progress:
        bar = progress.add_task("", total=2 * len(options.families))
        for family in options.families:
            task = TASK_OF[family]

            def tell(what: str, family: str = family) -> None:
                progress.update(bar, description=f"{family}: {what}")

            samples[family] = measure_family(task, options, log, tell)
            progress.console.print(f"{family}: {' | '.join(medians(samples[family]))}")
            progress.advance(bar)
            if family in FRESH:
                tell("compiling into an empty cache")
                starts[family] = first_starts(task, log)
            progress.advance(bar)
    others = [s["others"] for rows in samples.values() for row in rows.values() for s in row["samples"]]
    report: dict[str, Any] = {
        "processor": processor(),
        "cores": len(os.sched_getaffinity(0)),
        "python": platform.python_version(),
        "versions": {name: version(name) for name in ("mujoco", "mujoco-warp", "warp-lang", "numpy")},
        "rounds": options.rounds,
        "seconds_per_measurement": options.seconds,
        "minutes": round((time.perf_counter() - begin) / 60, 2),
        "load_before": round(load, 2),
        "cores_busy_with_others": disturbances(others),
        "differences": DIFFERENCES,
        "families": summarize(samples, TASK_OF, options.sizes),
        "start_seconds_of_myowarp": starts,
    }
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    rivals = ("MuJoCo C" if options.whole_bodies else "EnvPool"), "MyoSuite"
    draw(report, options.output.with_suffix(".png"), {name: AXES[name] for name in rivals})
    print_tables(report, Console(width=None if sys.stdout.isatty() else 160))
    if (disturbed := report["cores_busy_with_others"]["disturbed_measurements"]) > 0:
        Console(stderr=True).print(
            f"[yellow]The machine was not idle: in {disturbed} of {len(others)} measurements others kept "
            f"more than {IDLE_CORES} cores busy; do not quote these figures.[/yellow]"
        )


if __name__ == "__main__":
    main()

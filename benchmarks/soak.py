"""Random actions in every cell of the paper's grid: does anything break, and how full are the arrays?

    python -m benchmarks.soak --output out/soak.json
    python -m benchmarks.soak --others --output out/soak_others.json
    python -m benchmarks.soak --pairs --output out/soak_pairs.json
    python -m benchmarks.soak --muscles --num-worlds 256 --output out/soak_muscles.json

With --others the runs are the ids of bodies and families that the grid does not have: arm, torso, legs,
dice, objects to carry. With --pairs they are the hard task of each family with every two muscle conditions
that its body can have together; what is refused is listed with its reason. With --muscles they are pose tasks
of elbow and hand with every muscle model. Every run is 10,000 environment steps or more, split evenly over
the worlds. The file is written after each run, and runs that it already holds are skipped, so that one that
was interrupted goes on.
"""

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from rich.console import Console

from myowarp.apps.studies.audit.runs import Run
from myowarp.definitions.condition import CONDITIONS, Condition, resolve
from myowarp.definitions.muscle import MUSCLES
from myowarp.definitions.task import TASKS, TaskSpec
from myowarp.models.conditions import TendonTear
from myowarp.progress import progress_bar
from myowarp.sim.build import oracle_model
from myowarp.sim.simulation import Simulation
from myowarp.tasks.paper import FAMILIES, grid

STEPS = 10_000  # environment steps of a run
NUM_WORLDS = 48  # so that every episode gets to its end


@dataclass(frozen=True)
class Soaked:
    """A run: its name in the file, and what the simulation is made of."""

    id: str
    task: str
    conditions: tuple[str | Condition, ...]
    reset: str = "task"
    muscle: str = "mujoco"


def cells() -> Iterator[Soaked]:
    """Return the paper's grid."""
    for cell in grid():
        yield Soaked(cell.id, cell.task, cell.conditions, cell.reset)


def others() -> Iterator[Soaked]:
    """Return every id of a body or family that the paper's grid does not have."""
    covered = {(TASKS[cell.task].family, TASKS[cell.task].body) for cell in grid()}
    for key in TASKS:
        spec = TASKS[key]
        if (spec.family, spec.body) not in covered:
            yield Soaked(spec.env_id, key, ())


def pairs() -> Iterator[Soaked]:
    """Return every two conditions on the hard task of every family."""
    for _, task, _ in FAMILIES.values():
        for names in combinations(CONDITIONS, 2):
            conditions = tuple(suited(name, TASKS[task]) for name in names)
            yield Soaked(f"{TASKS[task].env_id} {' + '.join(names)}", task, conditions)


def muscles() -> Iterator[Soaked]:
    """Return every muscle model on pose tasks of elbow and hand, healthy and with two conditions."""
    conditions = {"myoElbowPose1D6MRandom-v0": ("sarcopenia", "fatigue_ma2009")}
    conditions["myoHandPoseRandom-v1"] = ("fatigue_3ccr", "tendon_transfer")
    for task, pair in conditions.items():
        for muscle in MUSCLES:
            for chosen in ((), pair):
                yield Soaked(" ".join((task, muscle, *chosen)), task, chosen, muscle=muscle)


def suited(name: str, spec: TaskSpec) -> str | Condition:
    """Return a condition for a body; where the default tendon is not there to tear, the first one tears."""
    try:
        resolve(name, spec)
    except ValueError:
        if CONDITIONS[name] is TendonTear:
            return TendonTear(oracle_model(spec).actuator(0).name)
    return name


def soak(run: Soaked, num_worlds: int) -> dict[str, object]:
    """Return what happened: faults by their meaning, what is left of contacts and rows; or the refusal."""
    spec = TASKS[run.task]
    steps = -(-STEPS // num_worlds)
    begin = time.perf_counter()
    try:
        sim = Simulation(
            spec,
            num_worlds,
            device="cpu",
            reset=run.reset,
            conditions=run.conditions,
            muscle=run.muscle,
            autoreset="same_step",
            progress=False,
        )
    except ValueError as refusal:
        return {"id": run.id, "refused": str(refusal)}
    counted = Run(sim, steps)
    counted.run("random", lambda: None, lambda share: None)
    load = counted.load()
    return {
        "id": run.id,
        "env_steps": steps * num_worlds,
        "faults": counted.faults(),
        "contacts": load.contacts,
        "contact_margin_percent": load.pool_margin,
        "rows": load.rows,
        "row_margin_percent": load.rows_margin,
        "seconds": time.perf_counter() - begin,
    }


def summary(rows: list[dict]) -> str:
    """Return one line about all runs."""
    ran = [row for row in rows if "refused" not in row]
    # Without contacts the rows have an exact bound.
    touching = [row for row in ran if row["contact_margin_percent"] is not None]
    free = [min((r[f"{what}_margin_percent"] for r in touching), default=100) for what in ("contact", "row")]
    faulty = sum(any(row["faults"].values()) for row in ran)
    return (
        f"{len(ran)} runs, {sum(row['env_steps'] for row in ran):,} environment steps, "
        f"{faulty} runs with a fault, {len(rows) - len(ran)} refused; "
        f"free at the fullest: {free[0]:.0f} % of contacts, {free[1]:.0f} % of rows"
    )


ASKED = {
    "others": (others, "ids that the grid does not have"),
    "pairs": (pairs, "pairs of muscle conditions"),
    "muscles": (muscles, "muscle models"),
}
"""Flag: runs in place of the grid, and what they are."""


def main() -> None:
    """Run, print what is worst, write the JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for asked, (_, text) in ASKED.items():
        parser.add_argument(f"--{asked}", action="store_true", help=f"{text}, not the grid")
    parser.add_argument("--output", type=Path, default=Path("out/soak.json"), help="file to write")
    parser.add_argument("--num-worlds", type=int, default=NUM_WORLDS, help="worlds stepped together")
    options = parser.parse_args()
    options.output.parent.mkdir(parents=True, exist_ok=True)
    rows = json.loads(options.output.read_text()) if options.output.exists() else []
    done = {row["id"] for row in rows}
    runs_of = next((runs for asked, (runs, _) in ASKED.items() if getattr(options, asked)), cells)
    runs = [run for run in runs_of() if run.id not in done]
    with progress_bar("Soaking", "runs", Console(stderr=True)) as bar:
        for run in bar.track(runs):
            rows.append(soak(run, options.num_worlds))
            options.output.write_text(json.dumps(rows, indent=1))
    for row in rows:
        if any(row.get("faults", {}).values()):
            print(f"{row['id']}: {row['faults']}")
    print(summary(rows))


if __name__ == "__main__":
    main()

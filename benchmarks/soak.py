"""Random actions in every cell of the paper's grid: does anything break, and how full are the arrays?

    python -m benchmarks.soak --output out/soak.json

Every id runs 10,000 environment steps or more, split evenly over the worlds. The file is written after each
id, and ids that it already holds are skipped, so that a run that was interrupted goes on.
"""

import argparse
import json
import time
from pathlib import Path

from rich.console import Console

from myowarp.audit.runs import Run
from myowarp.progress import progress_bar
from myowarp.sim import Simulation
from myowarp.spec import TASKS
from myowarp.tasks.paper import PaperTask, grid

STEPS = 10_000  # environment steps of an id
NUM_WORLDS = 48  # so that every episode gets to its end


def soak(cell: PaperTask, num_worlds: int) -> dict[str, object]:
    """Return what happened in one id: faults by their meaning, and what is left of contacts and rows."""
    spec = TASKS[cell.task]
    steps = -(-STEPS // num_worlds)
    begin = time.perf_counter()
    sim = Simulation(
        spec,
        num_worlds,
        device="cpu",
        reset=cell.reset,
        conditions=cell.conditions,
        autoreset="same_step",
        progress=False,
    )
    run = Run(sim, steps, seed=0, horizon=spec.horizon)
    run.run("random", lambda: None, lambda share: None)
    load = run.load()
    return {
        "id": cell.id,
        "env_steps": steps * num_worlds,
        "faults": run.faults(),
        "contacts": load.contacts,
        "contact_margin_percent": load.pool_margin,
        "rows": load.rows,
        "row_margin_percent": load.rows_margin,
        "seconds": time.perf_counter() - begin,
    }


def main() -> None:
    """Run the grid, print what is worst, write the JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--output", type=Path, default=Path("out/soak.json"), help="file to write")
    parser.add_argument("--num-worlds", type=int, default=NUM_WORLDS, help="worlds stepped together")
    options = parser.parse_args()
    options.output.parent.mkdir(parents=True, exist_ok=True)
    rows = json.loads(options.output.read_text()) if options.output.exists() else []
    done = {row["id"] for row in rows}
    cells = [cell for cell in grid() if cell.id not in done]
    with progress_bar("Soaking", "ids", Console(stderr=True)) as bar:
        for cell in bar.track(cells):
            rows.append(soak(cell, options.num_worlds))
            options.output.write_text(json.dumps(rows, indent=1))
    for row in rows:
        if any(row["faults"].values()):
            print(f"{row['id']}: {row['faults']}")
    touching = [
        row for row in rows if row["contact_margin_percent"] is not None
    ]  # else rows have an exact bound
    pools, margins = (min(row[f"{what}_margin_percent"] for row in touching) for what in ("contact", "row"))
    print(
        f"{len(rows)} ids, {sum(row['env_steps'] for row in rows):,} environment steps, "
        f"{sum(any(row['faults'].values()) for row in rows)} ids with a fault; "
        f"free at the fullest: {pools:.0f} % of contacts, {margins:.0f} % of rows"
    )


if __name__ == "__main__":
    main()

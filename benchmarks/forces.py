"""Forces of constraints against MuJoCo C's method in float64, in states that random actions reach.

    python -m benchmarks.forces

A physics step of ours, up to the integration, leaves the rows that it has solved: contacts, limits, friction
and equalities. A dense Newton's method (`tests/reference/constraint_newton.py`, itself compared with MuJoCo C
to 1e-9) solves them again, to the end. An error is the largest of a state's rows, as a share of the state's
greatest force.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from benchmarks.__main__ import CONTACT_TASKS
from myowarp.definitions.task import TASKS
from myowarp.engine.stages.constraint_rows import launch_contact_rows
from myowarp.sim.shard import Shard
from myowarp.sim.simulation import Simulation
from tests.reference.constraint_newton import acceleration, row_forces


@dataclass
class Options:
    """Compare forces."""

    tasks: tyro.conf.Positional[tuple[str, ...]] = (*CONTACT_TASKS, "myoLegWalk-v0")
    """Task names with version."""
    output: Path = Path("out/forces.json")
    """JSON file to write."""
    num_states: int = 300
    """States of each task, after every tenth control step."""
    num_worlds: int = 50
    """Worlds stepped together."""


def dense_rows(efc: Any, world: int, number: int, num_dofs: int) -> np.ndarray:
    """Return J of a world, shape (number, num_dofs)."""
    J = efc.J.numpy()[world].astype(float)
    if not efc.J_rownnz.shape[1]:
        return J[:number, :num_dofs]
    full = np.zeros((number, num_dofs))
    sizes, begins = efc.J_rownnz.numpy()[world], efc.J_rowadr.numpy()[world]
    columns = efc.J_colind.numpy()[world, 0]
    for row in range(number):
        places = slice(begins[row], begins[row] + sizes[row])
        full[row, columns[places]] = J[0, places]
    return full


def inertia(model: Any, data: Any, world: int) -> np.ndarray:
    """Return M of a world, shape (num_dofs, num_dofs)."""
    values, full = data.M.numpy()[world], np.zeros((model.nv, model.nv))
    sizes, begins = model.M_rownnz.numpy(), model.M_rowadr.numpy()
    columns = model.M_colind.numpy()
    for i in range(model.nv):
        places = slice(begins[i], begins[i] + sizes[i])
        full[i, columns[places]] = full[columns[places], i] = values[places]
    return full


def errors(shard: Shard) -> list[float]:
    """Return the error of each world that has rows."""
    model, data = shard.scene.model, shard.scene.data
    for place, launches in shard.physics_step.places(shard.stages).items():
        if place == "integrate":
            break
        launches()
    launch_contact_rows(model, data)  # with their Jacobian, which our solver does without
    found, efc = [], data.efc
    force, counts = efc.force.numpy(), (data.ne.numpy(), data.nf.numpy(), data.nefc.numpy())
    for world, (ne, nf, number) in enumerate(zip(*counts, strict=True)):
        if not number:
            continue
        D, aref, loss = (
            array.numpy()[world, :number].astype(float) for array in (efc.D, efc.aref, efc.frictionloss)
        )
        M, J = inertia(model, data, world), dense_rows(efc, world, number, model.nv)
        x = acceleration(M, data.qfrc_smooth.numpy()[world].astype(float), J, D, aref, loss, ne, nf)
        exact = row_forces(J @ x - aref, D, loss, ne, nf)
        greatest = np.abs(exact).max()
        if greatest > 0.0:
            found.append(float(np.abs(force[world, :number] - exact).max() / greatest))
    return found


def measure(key: str, options: Options) -> dict[str, float]:
    """Return number, median and worst of a task's errors."""
    sim = Simulation(TASKS[key], options.num_worlds, device="cpu", progress=False)
    sim.reset(seeds=np.arange(sim.num_worlds))
    rng, found = np.random.default_rng(0), list[float]()
    step = 0
    while len(found) < options.num_states:
        sim.action.assign(rng.uniform(-1, 1, sim.action.shape).astype(np.float32))
        sim.step()
        step += 1
        if step % 10 == 0:
            found += errors(sim.shards[0])
    return {"states": len(found), "median": float(np.median(found)), "worst": max(found)}


def main() -> None:
    """Compare, print a table, write the JSON."""
    options = tyro.cli(Options, prog="python -m benchmarks.forces")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    table = Table("task", "states", "median", "worst", title="error of a force / the state's greatest")
    rows = {}
    for key in options.tasks:
        rows[key] = row = measure(key, options)
        table.add_row(key, f"{row['states']}", f"{row['median']:.1e}", f"{row['worst']:.1e}")
        options.output.write_text(json.dumps(rows, indent=1) + "\n")
    Console().print(table)


if __name__ == "__main__":
    main()

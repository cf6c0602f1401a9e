"""The command `myowarp eval`; it needs no torch."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from myowarp.apps.cli.options import Asked, environment
from myowarp.apps.reports.evaluation import (
    SUCCESSES,
    evaluate_policy,
    passing,
    plan_evaluation,
    success_text,
)
from myowarp.kernels.episode import MYOSUITE
from myowarp.sim.economy import UNITS as ECONOMY
from myowarp.sim.economy import doubt, heading


@dataclass
class Eval:
    """Evaluate a trained policy: success with 95 % intervals, return, effort; of walks the metabolic rate.

    Every world runs one episode. The physics is parity (MyoSuite's integrator and step) unless you choose
    another; reset and conditions are those of the training unless you choose others.

    Example: myowarp eval runs/elbow --conditions sarcopenia
    """

    checkpoint: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]
    """Folder of a run or of a checkpoint, or a policy of the package: baselines/ID."""
    asked: Annotated[Asked, environment(flag=True)]
    episodes: int = 256
    """Episodes of each mode, and worlds simulated together."""
    mode: Literal["both", "deterministic", "sampled"] = "both"
    """Whether actions are the policy's means, or drawn as in training."""
    json: bool = False
    """Print JSON instead of a table."""

    def __call__(self) -> None:
        """Check, run and print."""
        asked = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        as_json, setup = asked.pop("json"), asked.pop("asked").setup
        job = plan_evaluation(asked.pop("checkpoint"), setup, **asked)
        head, results = evaluate_policy(job)
        if not job.ranks.leads:
            return
        if as_json:
            print(json.dumps({**head, **results}, indent=1))
        else:
            print_table(head, results)


def print_table(head: dict[str, Any], results: dict[str, dict[str, Any]]) -> None:
    """Print figures, a column for each mode."""
    console = Console(highlight=False)
    with_conditions = f", conditions {' '.join(head['conditions'])}" if head["conditions"] else ""
    console.print(
        f"[bold]{head['task']}[/bold]: {head['physics']} physics{with_conditions}, seed {head['seed']}"
    )
    table = Table("", *results)
    for name, text in (SUCCESSES | {MYOSUITE: "more than 5 solved steps, failed or not (MyoSuite)"}).items():
        table.add_row(text, *(success_text(figures, name) for figures in results.values()))
    some = next(iter(results.values()))
    if some["reachable"] and some["reachable"] < some["episodes"]:
        text = f"{SUCCESSES['success']}, {some['reachable']} reachable targets"
        table.add_row(text, *(success_text(figures, "success_reachable") for figures in results.values()))
    table.add_row("return", *(_return_text(figures) for figures in results.values()))
    walks = any(figures["speed"] is not None for figures in results.values())
    plain = {
        "length_mean": "length [steps]",
        "mean_activation": "mean activation",
        "activation_rate": "activation rate [1/s]",
        # Rates of a part of a person, such as an arm, are in the JSON alone.
        **{name: heading(name, some["body_mass"]) for name in ECONOMY if walks},
        **{name: name for name in ("episodes", "failed", "faults")},
    }
    for name, text in plain.items():
        values = (figures[name] for figures in results.values())
        cells = ("-" if value is None else f"{value:.4g}" for value in values)
        table.add_row(escape(text), *cells)  # rich would take [m/s] for a tag
    console.print(table)
    for mode, figures in results.items():
        for text in filter(None, (passing(figures["success"], figures["success_last"]), doubt(figures))):
            console.print(f"{mode}: {text}", style="yellow", markup=False, soft_wrap=True)


def _return_text(figures: dict[str, Any]) -> str:
    """Return mean and spread of the returns; of one episode there is no spread."""
    spread = "" if figures["one_episode"] else f" ± {figures['return_std']:.1f}"
    return f"{figures['return_mean']:.1f}{spread}"

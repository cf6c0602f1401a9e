"""What an experiment writes: result.json, table.csv, page.md, figure.png and figure.pdf."""

from __future__ import annotations

import csv
import inspect
import json
import math
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from myowarp.apps.policies.checkpoint import versions
from myowarp.apps.studies.reproduce.experiment import Experiment, Lab
from myowarp.apps.studies.reproduce.result import Findings, Merit
from myowarp.disk import in_place, plain

FIGURES = ("figure.png", "figure.pdf")
FILES = ("result.json", "table.csv", "page.md", *FIGURES)
WIDTH, HEIGHT, DPI = 8.0, 5.0, 110
RC: Any = {
    "font.size": 8.5,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "pdf.fonttype": 42,
}


def write(experiment: Experiment, lab: Lab, findings: Findings) -> None:
    """Write all files into the lab's folder, each whole or not at all.

    Raises:
        OSError: One cannot be written.
    """
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
        findings.draw(figure)
        for name in FIGURES:
            dates: Any = {"CreationDate": None} if name.endswith("pdf") else None
            with in_place(lab.folder / name) as scratch:
                figure.savefig(scratch, dpi=DPI, format=scratch.suffix[1:], metadata=dates)
    rows = [merit.as_dict() for merit in findings.merits]
    with in_place(lab.folder / "table.csv") as scratch, scratch.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    with in_place(lab.folder / "page.md") as scratch:
        scratch.write_text(page(experiment, lab, findings))
    with in_place(lab.folder / "result.json") as scratch:
        scratch.write_text(json.dumps(plain(as_dict(experiment, lab, findings)), indent=1) + "\n")


def as_dict(experiment: Experiment, lab: Lab, findings: Findings) -> dict[str, Any]:
    """Return all that was found as plain values."""
    return {
        "experiment": experiment.name,
        "title": experiment.title,
        "paper": experiment.paper,
        "quick": lab.quick,
        "seeds": list(lab.seeds),
        "num_worlds": lab.num_worlds,
        "policies": "retrained" if lab.retrain else "of the package",
        "interval": f"95 %, Student's t over {findings.over}",
        "versions": versions(),
        "merits": [
            merit.as_dict() | {"values": [float(v) for v in merit.values]} for merit in findings.merits
        ],
        "claims": [{"claim": c.text, "holds": bool(c.holds), "why": c.why} for c in findings.claims],
        "text": findings.text,
    }


def protocol(experiment: Experiment) -> str:
    """Return the docstring of the experiment's file."""
    return inspect.getdoc(sys.modules[experiment.run.__module__]) or ""


def page(experiment: Experiment, lab: Lab, findings: Findings) -> str:
    """Return the page: figure, table, claims, where we differ, and the protocol."""
    size = f"{len(lab.seeds)} seeds, {lab.num_worlds} worlds for each seed and condition. "
    size = size if findings.over == "seeds" and findings.in_worlds else ""
    heads = ("quantity", "condition", "paper", "ours (95 % interval)", "difference", "note")
    rows = [
        (f"{m.quantity}{f' [{m.unit}]' if m.unit else ''}", m.condition, *cells(m), m.note)
        for m in findings.merits
    ]
    lines = ["| " + " | ".join(row) + " |" for row in (heads, ("---",) * len(heads), *rows)]
    claims = [
        f"* {'Agrees' if c.holds else '**Differs**'}: {c.text}{f' {c.why}' if c.why else ''}"
        for c in findings.claims
    ]
    parts = (
        f"# {experiment.title}",
        f"`myowarp reproduce {experiment.name}{' --quick' if lab.quick else ''}`. {size}Intervals are 95 %, "
        f"Student's t over {findings.over}.",
        f"**The paper:** {experiment.paper}",
        "![Figure](figure.png)",
        "## Conclusions",
        "\n".join(claims),
        "## Figures of merit",
        "\n".join(lines),
        "## Where we differ, and why",
        findings.text.strip(),
        "## Protocol",
        protocol(experiment),
    )
    return "\n\n".join(parts) + "\n"


def number(value: float | None) -> str:
    """Return a number as a table shows it, with three digits."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def cells(merit: Merit) -> tuple[str, str, str]:
    """Return the paper's value, ours and their difference."""
    paper = number(merit.paper) + ("" if merit.spread is None else f" ± {number(merit.spread)}")
    low, high = merit.interval
    ours = number(merit.mean) + (f" ({number(low)} to {number(high)})" if math.isfinite(low) else "")
    return paper, ours, number(merit.difference)


def print_table(findings: Findings, console: Console) -> None:
    """Print figures of merit and claims."""
    table = Table("figure of merit", "condition", "paper", "ours (95 % interval)", "difference")
    for merit in findings.merits:
        unit = f" \\[{merit.unit}]" if merit.unit else ""
        table.add_row(f"{merit.quantity}{unit}", merit.condition, *cells(merit))
    console.print(table)
    for claim in findings.claims:
        style = "green" if claim.holds else "red"
        console.print(f"{'agrees' if claim.holds else 'differs'}: {claim.text}", style=style, markup=False)


def print_list(experiments: dict[str, Experiment], console: Console) -> None:
    """Print names and titles."""
    table = Table("name", "experiment")
    table.columns[0].no_wrap = True
    for name, experiment in experiments.items():
        table.add_row(name, experiment.title)
    console.print(table)


def output_folder(name: str, quick: bool, retrain: bool) -> Path:
    """Return the folder into which an experiment writes if none is named; other runs have other folders."""
    return Path("out/reproduce") / (name + "-quick" * quick + "-retrain" * retrain)

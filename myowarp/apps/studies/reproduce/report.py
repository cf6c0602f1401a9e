"""What an experiment writes: result.json, table.csv, page.md, figure.png and figure.pdf."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Column

from myowarp.apps.policies.checkpoint import versions
from myowarp.apps.reports import panel, table
from myowarp.apps.reports.result import Claim, read_claims
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.disk import in_place, plain

FIGURES = ("figure.png", "figure.pdf")
FILES = ("result.json", "table.csv", "page.md", *FIGURES)
WIDTH, HEIGHT = 8.0, 5.0
HEADS = ("condition", "paper", "ours (95 % interval)", "difference")
DIFFERENCES = "Where we differ, and why"


def write(experiment: Experiment, lab: Lab, findings: Findings) -> None:
    """Write all files into the lab's folder, each whole or not at all.

    Raises:
        OSError: One cannot be written.
    """
    with panel.style():
        figure = panel.blank(WIDTH, HEIGHT)
        findings.draw(figure)
        for name in FIGURES:
            panel.save(figure, lab.folder / name)
    table.save_csv(lab.folder / "table.csv", [merit.as_dict() for merit in findings.merits])
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
        "claims": [{"claim": c.text, "holds": c.holds, "why": c.why} for c in claims(experiment, findings)],
        "text": differences(experiment, findings),
    }


def differences(experiment: Experiment, findings: Findings) -> str:
    """Return where ours differs from the paper, and why; measured values are in it."""
    return experiment.essay[DIFFERENCES].format(**findings.measured)


def claims(experiment: Experiment, findings: Findings) -> list[Claim]:
    """Return the conclusions, and whether ours agree."""
    return read_claims(experiment.essay["Conclusions"].format(**findings.measured), findings.holds)


def page(experiment: Experiment, lab: Lab, findings: Findings) -> str:
    """Return the page: figure, table, claims, where we differ, and the protocol."""
    size = f"{len(lab.seeds)} seeds, {lab.num_worlds} worlds for each seed and condition. "
    size = size if findings.over == "seeds" and findings.in_worlds else ""
    rows = [(merit.label, merit.condition, *merit.cells(), merit.note) for merit in findings.merits]
    conclusions = [
        f"* {'Agrees' if c.holds else '**Differs**'}: {c.text}{f' {c.why}' if c.why else ''}"
        for c in claims(experiment, findings)
    ]
    parts = (
        f"# {experiment.title}",
        f"`myowarp reproduce {experiment.name}{' --quick' if lab.quick else ''}`. {size}Intervals are 95 %, "
        f"Student's t over {findings.over}.",
        f"**The paper:** {experiment.paper}",
        "![Figure](figure.png)",
        "## Conclusions",
        "\n".join(conclusions),
        "## Figures of merit",
        table.markdown(("quantity", *HEADS, "note"), rows),
        f"## {DIFFERENCES}",
        differences(experiment, findings),
        "## Protocol",
        experiment.essay["Protocol"],
    )
    return "\n\n".join(parts) + "\n"


def print_table(experiment: Experiment, findings: Findings, console: Console) -> None:
    """Print figures of merit and claims."""
    rows = [(merit.label.replace("[", "\\["), merit.condition, *merit.cells()) for merit in findings.merits]
    console.print(table.terminal(("figure of merit", *HEADS), rows))
    for claim in claims(experiment, findings):
        style = "green" if claim.holds else "red"
        console.print(f"{'agrees' if claim.holds else 'differs'}: {claim.text}", style=style, markup=False)


def print_list(experiments: dict[str, Experiment], console: Console) -> None:
    """Print names and titles."""
    rows = [(name, experiment.title) for name, experiment in experiments.items()]
    console.print(table.terminal((Column("name", no_wrap=True), "experiment"), rows))


def output_folder(name: str, quick: bool, retrain: bool) -> Path:
    """Return the folder into which an experiment writes if none is named; other runs have other folders."""
    return Path("out/reproduce") / (name + "-quick" * quick + "-retrain" * retrain)

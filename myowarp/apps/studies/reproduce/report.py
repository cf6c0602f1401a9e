"""Files of an experiment: result.json, table.csv, page.md, figure.png and figure.pdf."""

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
VERDICT, CAPTION, DIFFERENCES = "Verdict", "Figure", "Where we differ, and why"
CLAIMS = "Conclusions of the paper", "Hypotheses of our own"
"""Headings of the essays, whose texts have measured values in them."""

INTERVAL = (
    "Intervals are 95 %, over {over}: Student's t, or a bootstrap where that would leave what is possible; "
    "none where all values are the same."
)
THRESHOLDS = (
    "Agrees or differs: whether our numbers bear the paper's conclusion out; not decided: the 95 % interval "
    "of a difference has 0 in it. Where a conclusion needs a threshold, it is ours, and was not fixed before "
    "the data were seen."
)
OURS = "The paper says nothing of these. Thresholds were not fixed before the data were seen."


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
        scratch.write_text(page(experiment, lab, findings), encoding="utf-8")
    with in_place(lab.folder / "result.json") as scratch:
        scratch.write_text(json.dumps(plain(as_dict(experiment, lab, findings)), indent=1) + "\n")


def as_dict(experiment: Experiment, lab: Lab, findings: Findings) -> dict[str, Any]:
    """Return all that was found as plain values."""
    return {
        "experiment": experiment.name,
        "title": experiment.title,
        "paper": experiment.paper,
        "verdict": " ".join(text(experiment, findings, VERDICT).split()),
        "quick": lab.quick,
        **{name: value for name, value in sizes(lab).items() if name not in experiment.ignores},
        "policies": "retrained" if lab.retrain else "of the package",
        "interval": interval(findings),
        "versions": versions(),
        "caption": " ".join(text(experiment, findings, CAPTION).split()),
        "merits": [
            merit.as_dict()
            | {"values": [float(v) for v in merit.values], "within": [str(edge) for edge in merit.within]}
            for merit in findings.merits
        ],
        "claims": [
            {"claim": c.text, "own": c.own, "holds": c.holds, "verdict": c.verdict, "why": c.why}
            for c in claims(experiment, findings)
        ],
        "text": text(experiment, findings, DIFFERENCES),
    }


def interval(findings: Findings) -> str:
    """Return what the intervals are, a sentence."""
    return findings.over if findings.over.endswith(".") else INTERVAL.format(over=findings.over)


def sizes(lab: Lab) -> dict[str, Any]:
    """Return what was asked for of protocols that read it; others say their sizes themselves."""
    return {"seeds": list(lab.seeds), "num_worlds": lab.num_worlds}


def text(experiment: Experiment, findings: Findings, heading: str) -> str:
    """Return a section of the essay with measured values in it, "" if there is none."""
    return experiment.essay.get(heading, "").format(**findings.measured)


def claims(experiment: Experiment, findings: Findings) -> list[Claim]:
    """Return the paper's conclusions and hypotheses of our own, and whether ours bear them out."""
    paper, own = (text(experiment, findings, heading) for heading in CLAIMS)
    return read_claims(paper, own, findings.holds)


def page(experiment: Experiment, lab: Lab, findings: Findings) -> str:
    """Return the page: verdict, figure, claims, table, where we differ, and the protocol."""
    size = f"{len(lab.seeds)} seeds, {lab.num_worlds} worlds for each seed and condition. "
    size = size if findings.over == "seeds" and not set(sizes(lab)) & set(experiment.ignores) else ""
    rows = [(merit.label, merit.condition, *merit.cells(), merit.note) for merit in findings.merits]
    points = [
        (claim.own, f"* {claim.verdict.capitalize()}: {claim.text}{f' {claim.why}' if claim.why else ''}")
        for claim in claims(experiment, findings)
    ]
    parts = [
        f"# {experiment.title}",
        f"**{' '.join(text(experiment, findings, VERDICT).split())}**",
        f"**The paper:** {experiment.paper}",
        "![Figure](figure.png)",
        f"*{' '.join(text(experiment, findings, CAPTION).split())}*",
    ]
    for own, heading in enumerate(CLAIMS):
        if said := [point for mine, point in points if mine == bool(own)]:
            parts += [f"## {heading}", THRESHOLDS if not own else OURS, "\n".join(said)]
    parts += [
        "## Figures of merit",
        f"`myowarp reproduce {experiment.name}{' --quick' if lab.quick else ''}`. {size}{interval(findings)}",
        table.markdown(("quantity", *HEADS, "note"), rows),
        f"## {DIFFERENCES}",
        text(experiment, findings, DIFFERENCES),
        "## Protocol",
        experiment.essay["Protocol"],
    ]
    return "\n\n".join(parts) + "\n"


def print_table(experiment: Experiment, findings: Findings, console: Console) -> None:
    """Print figures of merit and claims."""
    rows = [(merit.label.replace("[", "\\["), merit.condition, *merit.cells()) for merit in findings.merits]
    console.print(table.terminal(("figure of merit", *HEADS), rows))
    for claim in claims(experiment, findings):
        style = {True: "green", False: "red", None: "yellow"}[claim.holds]
        console.print(f"{claim.verdict}: {claim.text}", style=style, markup=False)


def print_list(experiments: dict[str, Experiment], console: Console) -> None:
    """Print names and titles."""
    rows = [(name, experiment.title) for name, experiment in experiments.items()]
    console.print(table.terminal((Column("name", no_wrap=True), "experiment"), rows))


def output_folder(name: str, quick: bool, retrain: bool) -> Path:
    """Return the folder into which an experiment writes if none is named; other runs have other folders."""
    return Path("out/reproduce") / (name + "-quick" * quick + "-retrain" * retrain)

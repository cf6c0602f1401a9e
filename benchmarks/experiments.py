"""The table of docs/experiments.md, from the committed results: the paper's numbers beside ours.

myowarp reproduce exo1 --device cpu --output docs/experiments/exo1
python -m benchmarks.experiments
"""

import json
from pathlib import Path

from myowarp.apps.reports.result import Merit
from myowarp.apps.reports.table import markdown
from myowarp.apps.studies.reproduce.catalog import EXPERIMENTS

DOCS = Path(__file__).parents[1] / "docs"
PAGE, RESULTS = DOCS / "experiments.md", DOCS / "experiments"
BEGIN, END = "<!-- table: python -m benchmarks.experiments -->\n\n", "\n<!-- end of the table -->"
HEADS = ("experiment", "quantity", "condition", "paper", "ours (95 % interval)", "difference")


def merits(name: str) -> list[Merit]:
    """Return the figures of merit of a committed result."""
    rows = json.loads((RESULTS / name / "result.json").read_text())["merits"]
    return [
        Merit(
            row["quantity"],
            row["unit"],
            row["condition"],
            [float("nan") if value is None else value for value in row["values"]],
            row["paper"],
            row["paper_spread"],
        )
        for row in rows
    ]


def table() -> str:
    """Return all figures of merit that the paper has, too."""
    rows = []
    for name in EXPERIMENTS:
        if not (RESULTS / name / "result.json").exists():
            continue
        for merit in merits(name):
            if merit.paper is not None:
                rows.append((f"`{name}`", merit.label, merit.condition, *merit.cells()))
    return markdown(HEADS, rows) + "\n"


def page() -> str:
    """Return the page with its table made anew."""
    before, _, rest = PAGE.read_text().partition(BEGIN)
    return before + BEGIN + table() + END + rest.partition(END)[2]


if __name__ == "__main__":
    PAGE.write_text(page())

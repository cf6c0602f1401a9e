"""docs/experiments.md from the committed results: verdicts, figures, the paper's numbers beside ours.

myowarp reproduce exo1 --device cpu --output out/exo1
python -m benchmarks.experiments --take out/exo1    # copies the result into docs/experiments; then the page
python -m benchmarks.experiments                    # the page alone
"""

import argparse
import json
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

from myowarp.apps.reports.result import Merit
from myowarp.apps.reports.table import markdown
from myowarp.apps.studies.reproduce.catalog import EXPERIMENTS
from myowarp.disk import in_place

DOCS = Path(__file__).parents[1] / "docs"
PAGE, RESULTS = DOCS / "experiments.md", DOCS / "experiments"
FILES = ("figure.png", "page.md", "result.json", "table.csv")
BEGIN, END = "<!-- written by: python -m benchmarks.experiments -->\n\n", "\n<!-- end of what is written -->"
HEADS = ("experiment", "quantity", "condition", "paper", "ours (95 % interval)", "difference", "note")
PAPER = ("agrees", "differs", "not decided")


def results() -> dict[str, dict[str, Any]]:
    """Return the committed results by experiment."""
    paths = {name: RESULTS / name / "result.json" for name in EXPERIMENTS}
    return {name: json.loads(path.read_text()) for name, path in paths.items() if path.is_file()}


def merits(rows: list[dict[str, Any]]) -> list[Merit]:
    """Return the figures of merit of a committed result."""
    return [
        Merit(
            *(row["quantity"], row["unit"], row["condition"]),
            [float("nan") if value is None else value for value in row["values"]],
            *(row["paper"], row["paper_spread"], row["note"]),
            tuple(float(edge) for edge in row["within"]),
        )
        for row in rows
    ]


def verdicts(found: dict[str, dict[str, Any]]) -> str:
    """Return a line an experiment: how many of the paper's conclusions ours bear out, and a sentence."""
    rows = []
    for name, result in found.items():
        count = Counter(claim["verdict"] for claim in result["claims"] if not claim["own"])
        shown = [str(count[verdict]) for verdict in PAPER] if count else ["beyond the paper", "", ""]
        rows.append((f"[`{name}`](experiments/{name}/page.md)", *shown, result["verdict"]))
    return markdown(("experiment", *PAPER, "in a sentence"), rows)


def section(name: str, result: dict[str, Any]) -> str:
    """Return figure, caption and the paper's conclusions of an experiment."""
    claims = [f"* {c['verdict'].capitalize()}: {c['claim']}" for c in result["claims"] if not c["own"]]
    parts = [
        f"## {result['title']}",
        f"![{result['title']}](experiments/{name}/figure.png)",
        f"*{result['caption']}*",
        *(["The paper's conclusions:", "\n".join(claims)] if claims else []),
        f"[All numbers, hypotheses of our own, reasons and the protocol](experiments/{name}/page.md).",
    ]
    return "\n\n".join(parts)


def numbers(found: dict[str, dict[str, Any]]) -> str:
    """Return all figures of merit that the paper has, too."""
    rows = [
        (f"`{name}`", merit.label, merit.condition, *merit.cells(), merit.note)
        for name, result in found.items()
        for merit in merits(result["merits"])
        if merit.paper is not None
    ]
    return markdown(HEADS, rows)


def page() -> str:
    """Return the page, with what stands between the marks made anew."""
    found = results()
    before, _, rest = PAGE.read_text().partition(BEGIN)
    parts = (
        "## What was found",
        "How many of the paper's conclusions our numbers bear out.",
        verdicts(found),
        *(section(name, result) for name, result in found.items()),
        "## The paper's numbers and ours",
        numbers(found),
    )
    return before + BEGIN + "\n\n".join(parts) + "\n" + END + rest.partition(END)[2]


def take(folder: Path) -> None:
    """Copy a result into the docs."""
    name = json.loads((folder / "result.json").read_text())["experiment"]
    (RESULTS / name).mkdir(exist_ok=True)
    for file in FILES:
        shutil.copyfile(folder / file, RESULTS / name / file)


def main() -> None:
    """Take results, and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--take", nargs="*", type=Path, default=[], metavar="FOLDER", help="of results")
    for folder in parser.parse_args().take:
        take(folder)
    with in_place(PAGE) as scratch:
        scratch.write_text(page())


if __name__ == "__main__":
    main()

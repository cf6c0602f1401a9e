"""The columns of a cohort in docs/conditions.md, from the package's: python -m benchmarks.cohort_columns."""

from benchmarks.result_pages import ROOT, renewed
from myowarp.apps.reports.table import markdown
from myowarp.disk import in_place
from myowarp.sim.patient_columns import COLUMNS, CohortColumn

PAGE = ROOT / "docs/conditions.md"
HEADS = ("column", "meaning", "entry", "condition", "may be")


def row(name: str, column: CohortColumn) -> tuple[str, ...]:
    """Return what the table says of a column."""
    more = ", ".join(["drawn"] * column.draws + ["changing"] * column.changes)
    more += f"; empty if `{column.of}` is" * bool(column.of)
    meaning = f"{column.label} [{column.unit}]" if column.unit else column.label
    entry = column.expected().removesuffix(f" {column.unit}")
    return f"`{name}`", meaning, entry, f"`{column.condition}`", more


def page() -> str:
    """Return the page with its table made anew."""
    rows = [row(name, COLUMNS[name]) for name in COLUMNS]
    return renewed(PAGE, "benchmarks.cohort_columns", markdown(HEADS, rows) + "\n")


if __name__ == "__main__":
    with in_place(PAGE) as scratch:
        scratch.write_text(page())

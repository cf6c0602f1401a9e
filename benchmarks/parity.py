"""Compare every upstream id with MyoSuite 3.0.0, live: fresh states and seeds in each run.

    make parity

The recorders of tests/data run in MyoSuite's own environment; then the oracle tests run on what they wrote.
The table gives the worst differences per id: observation and reward in states written in, joint
configuration after one control step from the same state; of ids with a muscle condition everything after one
control step, and the compartments of its motor units. Rollouts over several contacts are left out: whether
a touch is found in float32 can decide the whole of one, so a bound on the worst of new ones would not hold.
"""

import json
import os
import secrets
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).parents[1]
RECORDERS = (
    *("record_myosuite.py", "record_legs.py", "record_contact.py", "record_fatigue.py"),
    "record_conditions.py",
)
TESTS = (
    "test_oracle.py",
    "test_oracle_walk.py",
    "test_oracle_contact.py",
    "test_oracle_contact_physics.py",
    "test_oracle_fatigue.py",
    "test_oracle_conditions.py",
)
QUANTITIES = ("observation", "reward", "qpos")
COLUMNS = (*QUANTITIES[:2], *(f"{name} {kind}" for name in QUANTITIES for kind in ("median", "worst")))
COLUMNS += ("compartments",)
MAX_SHIFT = 10_000  # of the recorders' seeds


@dataclass
class Options:
    """Compare with MyoSuite 3.0.0."""

    recorder: Path
    """Python of an environment with myosuite==3.0.0."""
    output: Path = Path("out/parity.json")
    """JSON file to write."""
    shift: int | None = None
    """Shift of all seeds; by default a random one."""


def record(python: Path, folder: Path, shift: int) -> None:
    """Run the recorders of tests/data in MyoSuite's environment."""
    for script in RECORDERS:
        command = [python, ROOT / "tests/data" / script, "--out", folder, "--shift", str(shift)]
        subprocess.run(command, check=True, cwd=folder)


def compare(folder: Path) -> tuple[dict[str, dict[str, float]], list[str]]:
    """Run the oracle tests on recorded values.

    Returns:
        For each id the worst of every column; the names of tests that failed, and of ids without any.
    """
    report = folder / "report.xml"
    tests = [str(ROOT / "tests/oracle" / name) for name in TESTS]
    command = [sys.executable, "-m", "pytest", "-q", f"--junitxml={report}", "-o", "junit_family=xunit1"]
    command += ["-k", "not rollouts", *tests]
    subprocess.run(command, cwd=ROOT, env=os.environ | {"MYOWARP_ORACLE": str(folder)}, check=False)
    worst: dict[str, dict[str, float]] = {}
    failed = []
    for case in ElementTree.parse(report).getroot().iter("testcase"):
        if any(case.find(kind) is not None for kind in ("failure", "error")):
            failed.append(case.get("name", ""))
        key = case.get("name", "").partition("[")[2].rstrip("]")
        key = (
            max(key.split("-v")[0].split("-"), key=len) + "-v" + key.split("-v")[-1][0]
            if "-v" in key
            else key
        )
        for entry in case.iter("property"):
            row, name = worst.setdefault(key, {}), entry.get("name", "")
            row[name] = max(row.get(name, 0.0), float(entry.get("value", "nan")))
    unseen = {path.stem for path in folder.glob("*.npz")} - set(worst)
    return worst, failed + sorted(unseen)


def main() -> None:
    """Record, compare, print a table, write the JSON."""
    options = tyro.cli(Options, prog="python -m benchmarks.parity")
    shift = secrets.randbelow(MAX_SHIFT) + 1 if options.shift is None else options.shift
    with tempfile.TemporaryDirectory() as scratch:
        record(options.recorder.absolute(), Path(scratch), shift)
        worst, failed = compare(Path(scratch))
    options.output.parent.mkdir(parents=True, exist_ok=True)
    result = {"myosuite": "3.0.0", "seed_shift": shift, "failed_tests": failed, "worst": worst}
    options.output.write_text(json.dumps(result, indent=1) + "\n")
    table = Table("id", *COLUMNS, title=f"worst differences, seeds shifted by {shift}")
    for key, row in sorted(worst.items()):
        table.add_row(key, *(f"{row[name]:.1e}" if name in row else "" for name in COLUMNS))
    Console().print(table)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()

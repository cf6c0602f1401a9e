"""The leaderboard of adaptation: a row for each policy in a task and its patients, all by one protocol.

    myowarp adapt ID --cohort examples/changing.csv --policies baseline my_agent.py:act --board board.csv

Protocol 1: `EPISODES` episodes as the task starts and ends them, with the seeds from `EVALUATION_SEED` on,
physics parity, MuJoCo's muscles, and the package's baseline of the task as the first policy, over which the
others gain. The figures are those of `myowarp.apps.studies.adaptation`, each with its 95 % interval; times in
seconds, all else shares.
"""

from __future__ import annotations

import csv
import hashlib
import math
from collections.abc import Sequence
from pathlib import Path

from myowarp.apps.policies.baselines import OWN
from myowarp.apps.reports.evaluation import EVALUATION_SEED
from myowarp.apps.studies.adaptation import EPISODES, Adaptation
from myowarp.definitions.condition import resolve
from myowarp.definitions.setup import Setup
from myowarp.disk import write_rows

PROTOCOL = "1"
KEY = ("protocol", "task", "patients", "policy")
FIGURES = ("before", "drop", "recovery", "after", "gain")
COLUMNS = (*KEY, "episodes", *(f"{name}{end}" for name in FIGURES for end in ("", "_low", "_high")))

Rows = list[dict[str, str]]


def check_protocol(setup: Setup, names: Sequence[str], episodes: int) -> None:
    """Raise ValueError, in one sentence, if figures would not be those of the protocol."""
    found = {
        "--episodes": (episodes, EPISODES),
        "--seed": (setup.seed, EVALUATION_SEED),
        "--physics": (setup.physics, "parity"),
        "--muscle": (setup.muscles.model, "mujoco"),
        "--horizon": (setup.episode_steps, setup.spec.horizon),
        "--reset": (setup.reset, "task"),
        "the first of --policies": (names[0], OWN),
    }
    for name, (got, wanted) in found.items():
        if got != wanted:
            raise ValueError(f"--board needs {name} to be {wanted}, got {got}")


def patients_of(setup: Setup, table: Path | None) -> str:
    """Return who changes: name and checksum of a table, else the conditions, alike from texts and objects."""
    if table is None:
        return "; ".join(map(str, resolve(setup.conditions or (), setup.spec)))
    return f"{table.name} {hashlib.sha256(table.read_bytes()).hexdigest()[:12]}"


def read_board(path: Path) -> Rows:
    """Return the rows of a leaderboard; none of a file that does not exist.

    Raises:
        ValueError: It is no leaderboard.
    """
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file)
        if tuple(reader.fieldnames or ()) != COLUMNS:
            raise ValueError(f"--board {str(path)!r} must have the columns {', '.join(COLUMNS)}")
        return list(reader)


def enter(result: Adaptation, patients: str, path: Path) -> None:
    """Put the policies of a study into a leaderboard, in place of rows of the same name.

    Raises:
        ValueError: The file is no leaderboard.
        OSError: It cannot be written.
    """
    rows = {tuple(row[name] for name in KEY): row for row in read_board(path)}
    for policy in result.policies:
        key = PROTOCOL, result.setup.spec.key, patients, policy.policy
        row = dict(zip(KEY, key, strict=True)) | {"episodes": str(policy.episodes)}
        for name in FIGURES:
            value, interval = getattr(policy, name), getattr(policy, f"{name}_interval")
            for end, number in zip(("", "_low", "_high"), (value, *(interval or ("", ""))), strict=True):
                row[f"{name}{end}"] = "" if number in (None, "") or math.isnan(number) else f"{number:.4f}"
        rows[key] = row
    ordered = [rows[key] for key in sorted(rows)]
    write_rows(path, [COLUMNS, *([row[name] for name in COLUMNS] for row in ordered)])

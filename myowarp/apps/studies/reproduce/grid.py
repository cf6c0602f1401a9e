"""Grid: success in the paper's 204 cells of tasks, resets and muscle conditions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.apps.policies.baselines import OWN, PREFIX, policy_folder
from myowarp.apps.policies.checkpoint import Checkpoint, load_checkpoint
from myowarp.apps.reports import panel
from myowarp.apps.studies.reproduce.conditions import (
    COLORS,
    LOSS,
    NO_INTERVAL,
    SEED,
    SOLVED,
    apart,
    episode_of_each_world,
    row,
)
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.apps.studies.reproduce.policies import Training, available
from myowarp.definitions.setup import Setup
from myowarp.tasks.paper import DIFFICULTIES, FAMILIES, IN_OUR_NAMES, RESETS, PaperTask, grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NONE, FIXED = "none", "fixed"
TRAINED = ("ElbowPose", "FingerPose", "FingerReach", "HandReach")
"""Families that were trained with the other resets, too, healthy."""
SAMPLES, ENDING = 3_000_000, {"stop_success": 0.995}
QUICK_FAMILY = "ElbowPose"
COLUMNS = tuple(IN_OUR_NAMES)
Shares = Mapping[PaperTask, np.ndarray]
"""Whether each world's episode succeeded by the paper's rule, by cell."""


def training(cell: PaperTask) -> Training | None:
    """Return how a policy is trained in a cell; None: it is not, the policy of the package acts there."""
    if cell.family not in TRAINED or cell.condition != NONE or cell.reset == FIXED:
        return None
    name = f"grid_{cell.family}_{cell.difficulty}_{cell.reset}"
    folder = policy_folder(OWN, cell.task) if cell.difficulty == "hard" else None
    parent = PREFIX + folder.name if folder else ""
    settings = ENDING | {"reset": cell.reset, "parent": parent}
    return Training(name, cell.task, samples=SAMPLES, settings=settings, parent=parent or None)


def of_package(cell: PaperTask) -> Checkpoint | None:
    """Return the package's policy for a cell's task or another version of it; None if there is none."""
    try:
        folder = policy_folder(OWN, cell.task)
    except ValueError:
        return None
    return load_checkpoint(folder) if folder else None


def run(lab: Lab) -> Findings:
    """Run the policies that there are in all cells, and those of a cell in their own."""
    cells = [cell for cell in grid() if not lab.quick or cell.family == QUICK_FAMILY]
    shipped = {cell: policy for cell in cells if (policy := of_package(cell)) is not None}
    own = {cell: how for cell in cells if (how := training(cell)) and (lab.retrain or available(how))}
    lab.expect(len(shipped) + len(own))
    transferred = {cell: _successes(lab, "package", cell, policy) for cell, policy in shipped.items()}
    trained = {cell: _successes(lab, "own", cell, lab.policy(how, 0)) for cell, how in own.items()}
    return findings(cells, transferred, trained)


def _successes(lab: Lab, whose: str, cell: PaperTask, policy: Checkpoint) -> np.ndarray:
    """Return whether an episode of each world succeeds in a cell, shape (num_worlds,)."""
    conditions = cell.conditions
    setup = Setup(task=cell.task, conditions=conditions, reset=cell.reset, physics="parity", seed=SEED)
    name = f"{whose}_{cell.id.rpartition('/')[2]}"
    return episode_of_each_world(lab, name, setup, policy)["success"]


def findings(cells: list[PaperTask], transferred: Shares, trained: Shares) -> Findings:
    """Return figures of merit, claims and figure.

    Args:
        cells: Of the grid.
        transferred: Successes of the package's policies.
        trained: Successes of policies that were trained in their cell.
    """
    empty = [cell for cell in cells if cell not in transferred and cell not in trained]
    rows = [row("success, the package's policy", cell.id, own) for cell, own in transferred.items()]
    rows += [row("success, trained in the cell", cell.id, own) for cell, own in trained.items()]
    other = [(_sibling(cell, transferred, reset=FIXED), cell) for cell in transferred if cell.reset != FIXED]
    resets = [(a, b) for a, b in other if a is not None]
    changed = [(a, b) for a, b in resets if apart(transferred[a], transferred[b])[1] < -LOSS]
    kept = [(a, b) for a, b in resets if apart(transferred[a], transferred[b])[0] > -LOSS]
    free = [cell for cell in transferred if cell.reset == "none" and cell.condition == NONE]
    solved_free = [cell for cell in free if 100.0 * transferred[cell].mean() >= SOLVED]
    learned = [cell for cell, own in trained.items() if 100.0 * own.mean() >= SOLVED]
    gained = [c for c in trained if c in transferred and apart(transferred[c], trained[c])[0] > 0.0]
    lost = [c for c in trained if c in transferred and apart(transferred[c], trained[c])[1] < 0.0]
    holds = {
        "resets": not changed and (len(kept) == len(resets) or None),
        "reset-free": len(solved_free) == len(free),
        "trained": len(learned) == len(trained) if trained else None,
        "own": len(gained) == len(trained) if trained else None,
    }
    measured = {
        "cells": len(cells),
        "numbers": len(cells) - len(empty),
        "empty": len(empty),
        "who": ", ".join(sorted({cell.family for cell in empty})) or "none",
        "episodes": len(next(iter(transferred.values()))),
        "half": sum(100.0 * own.mean() >= SOLVED for own in transferred.values()),
        "acted": len(transferred),
        "pairs": len(resets),
        "changed": len(changed),
        "kept": len(kept),
        "free": len(free),
        "solved_free": len(solved_free),
        "trained": len(trained),
        "learned": len(learned),
        "gained": len(gained),
        "lost": len(lost),
        "lines": "\n".join(_line(cell, transferred, trained) for cell in trained) or "* none",
    }
    over = f"One training a cell, so {NO_INTERVAL}"
    return Findings(rows, holds, lambda figure: draw(figure, cells, transferred, trained), measured, over)


def _sibling(cell: PaperTask, cells: Shares, *, reset: str) -> PaperTask | None:
    """Return the cell that differs in its reset alone, None if it has no number."""
    key = (cell.family, cell.difficulty, cell.condition, reset)
    return next((c for c in cells if (c.family, c.difficulty, c.condition, c.reset) == key), None)


def _line(cell: PaperTask, transferred: Shares, trained: Shares) -> str:
    """Return a trained cell as a line of a list."""
    before = f"{100.0 * transferred[cell].mean():.0f} %" if cell in transferred else "no policy"
    return f"* {cell.id}: the package's policy {before}, trained there {100.0 * trained[cell].mean():.0f} %"


def draw(figure: Figure, cells: list[PaperTask], transferred: Shares, trained: Shares) -> None:
    """Draw tasks by conditions and resets: the better policy's share, bold where trained there."""
    from matplotlib import colormaps

    families = [family for family in FAMILIES if any(cell.family == family for cell in cells)]
    names = [f"{family} {difficulty}" for family in families for difficulty in DIFFICULTIES]
    heads = [f"{condition}, {letter}" for condition in COLUMNS for letter in RESETS]
    figure.set_size_inches(8.0, 1.9 + 0.27 * len(names))
    axes, letters = figure.subplots(), {reset: letter for letter, reset in RESETS.items()}
    values = np.full((len(names), len(heads)), np.nan)
    for cell in cells:
        row = names.index(f"{cell.family} {cell.difficulty}")
        column = heads.index(f"{cell.condition}, {letters[cell.reset]}")
        found = [shares[cell] for shares in (transferred, trained) if cell in shares]
        if not found:
            axes.text(column, row, "no policy", ha="center", va="center", fontsize=4.0, color="0.45")
            continue
        value = values[row, column] = 100.0 * max(own.mean() for own in found)
        look: dict[str, Any] = {"fontsize": 7.0, "weight": "bold" if cell in trained else "normal"}
        look["color"] = panel.ink_on(colormaps[COLORS](value / 100.0))
        axes.text(column, row, f"{value:.0f}", ha="center", va="center", **look)
    image = axes.imshow(values, cmap=COLORS, vmin=0.0, vmax=100.0, aspect="auto")
    for edge in range(1, len(COLUMNS)):
        axes.axvline(edge * len(RESETS) - 0.5, color="white", linewidth=2.5)
    axes.set_xticks(range(len(heads)), heads, rotation=50, ha="right")
    axes.set_yticks(range(len(names)), names)
    axes.grid(False)
    figure.colorbar(image, ax=axes, label="episodes that succeed [%]", fraction=0.04)


EXPERIMENT = Experiment("grid", run, ignores=("models", "seeds"))

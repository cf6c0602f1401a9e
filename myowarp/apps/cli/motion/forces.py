"""The step `myowarp motion forces`."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.cli.motion.steps import (
    OUT,
    SHOWN,
    Contact,
    Exponent,
    Filter,
    FunctionPaths,
    Loading,
    Mode,
    Model,
    Output,
    Recorded,
    Reserve,
    Residual,
    Span,
    ToolFile,
    along,
    bones_of,
    check_results,
    needed,
    say_saved,
    setup_of,
)
from myowarp.apps.cli.options import Overwrite

if TYPE_CHECKING:
    from myowarp.motion.loads import Loads
    from myowarp.motion.muscle_forces import MuscleForces
    from myowarp.motion.storage import Tables
    from myowarp.motion.trial import Movement
    from myowarp.osim.body.skeleton import Bones

RENEWS = "moments.sto", "passive_moments.sto", "contact_forces.sto"
FILES = (
    *RENEWS,
    *("actuators.sto", "activations.sto", "forces.sto", "powers.sto", "metabolic_powers.sto"),
    *("joint_reactions.sto", "reserves.sto", "missing.sto"),
)


@dataclass
class Forces:
    """Find the forces of muscles that give a motion's moments, at the least sum of activations to a power.

    Where muscles cannot give them, a reserve of --reserve N m on every coordinate helps; what is missing is
    said.

    Example: myowarp motion forces gait.osim --motion ik.mot --loads grf.xml --filter 6 --reserve 10
    """

    model: Model
    motion: Recorded = None
    setup: ToolFile = None
    function_paths: FunctionPaths = None
    loads: Loading = None
    contact: Contact = None
    filter: Filter = None
    mode: Mode = "equilibrium"
    exponent: Exponent = None
    reserve: Reserve = None
    residual: Residual = None
    span: Span = None
    output: Output = OUT
    overwrite: Overwrite = False

    def __call__(self) -> None:
        """Check, solve, write."""
        from myowarp.motion import trial
        from myowarp.motion.setup import EXPONENT

        setup = setup_of(
            self.setup, motion=self.motion, contact=self.contact, loads=self.loads, cutoff=self.filter,
            span=self.span,
            exponent=self.exponent, reserve=self.reserve, residual=self.residual,
        )  # fmt: skip
        motion = needed(setup.motion, "forces", "motion")
        check_results(self.output, FILES, self.overwrite, RENEWS)
        bones, worst = bones_of(self.model, setup, self.function_paths), Worst()
        reserves, exponent = setup.reserves_of(bones), setup.exponent or EXPONENT

        def solve(part: Movement, tables: Tables, loads: Loads | None) -> None:
            found = trial.forces(
                bones, part, tables, loads, mode=self.mode, exponent=exponent, reserves=reserves or None
            )
            worst.add(found)

        lines = along(bones, setup, motion, self.output, solve)
        say_saved([*lines, *worst.lines(bones)], FILES, self.output)


class Worst:
    """The moments of a motion that muscles could not provide, over all its parts."""

    def __init__(self) -> None:
        """Begin with none."""
        self.frames, self.missed, self.full = 0, 0, Counter[str]()
        self.most: dict[str, np.ndarray] = {}

    def add(self, found: MuscleForces) -> None:
        """Count a part."""
        self.frames += len(found.feasible)
        self.missed += int((~found.feasible).sum())
        self.full.update(found.saturated)
        for name in ("missing", "reserve"):
            most = abs(getattr(found, name)).max(axis=0)
            self.most[name] = np.maximum(most, self.most.get(name, 0.0))

    def lines(self, bones: Bones) -> list[str]:
        """Return what muscles could not do, one line each."""
        lines = []
        if self.missed:
            lines.append(
                f"muscles cannot hold {self.missed} of {self.frames} frames; missing.sto has what is left"
            )
        for name, most in self.most.items():
            for k in most.argsort()[::-1][:SHOWN]:
                if most[k] > 1e-3:
                    unit = "N m" if bones.model.coordinates[bones.coordinates[k]].rotational else "N"
                    lines.append(f"{name} at {bones.coordinates[k]}: {most[k]:.3g} {unit} at most")
        full = self.full.most_common(SHOWN)
        return lines + [f"{muscle} is fully active in {n} of {self.frames} frames" for muscle, n in full]

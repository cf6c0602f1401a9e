"""A study of recorded motions before it runs: its table, and what each trial of it is.

One row is one trial. Paths are beside the table. Columns and entries may be missing.

    trial, model, marker_set, markers or motion, setup, loads
                                                       name and files, as `myowarp motion` takes them
    start, end, filter, fill                           [s], [s], [Hz], [s]
    max_isometric_force, tendon_slack_length, mass     factors on those of all muscles or bodies, and with
                                                       a colon and a name behind, of one alone
    max_isometric_force_spread, tendon_slack_length_spread, mass_spread, marker_weight_spread, marker_noise
                                                       how far draws spread, see `motion.draws.Uncertainty`
"""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from myowarp.definitions.parameter import say_percent
from myowarp.definitions.registry import check_least
from myowarp.disk import files_digest, number_in
from myowarp.motion.draws import Recording, Uncertainty, check_factors
from myowarp.motion.loads import Loads, read_loads
from myowarp.motion.movement import read_motion
from myowarp.motion.muscle_forces import Mode
from myowarp.motion.setup import TrialSetup
from myowarp.motion.steps import acting, kinematics
from myowarp.motion.tool_setup import read_tool_setup
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.read.element import MAX_NUMBER
from myowarp.process import warn_once
from myowarp.sim.patient_table import read_table

TRIAL = "trial"
FILES = ("model", "marker_set", "markers", "motion", "setup", "loads")
NUMBERS = ("start", "end", "filter", "fill")
FACTORS = ("max_isometric_force", "tendon_slack_length", "mass")
SPREADS = {
    one.name if one.name == "marker_noise" else f"{one.name}_spread": one.name for one in fields(Uncertainty)
}
"""Column: what spreads."""
NAME = re.compile(r"[\w][\w .+-]*")
LONGEST = 200
"""Bytes of a trial's name, which becomes a folder's."""
DRAWS = 50
"""Of a part."""
MOST = 100_000
"""Parts of a study, which are numbered with five digits."""


@dataclass(frozen=True)
class Trial:
    """A row of the table.

    Attributes:
        name: Of the trial.
        files: Paths by column.
        numbers: Of the columns `NUMBERS`.
        factors: On muscles and bodies.
        uncertain: How far draws spread.
    """

    name: str
    files: Mapping[str, Path]
    numbers: Mapping[str, float]
    factors: Mapping[str, float]
    uncertain: Uncertainty

    def setup(self) -> TrialSetup:
        """Return how it is solved: what the row states, and else what its set-up file has.

        Raises:
            ValueError: A file is not what it should be, or there are neither markers nor joint angles.
            OSError: A file cannot be read.
        """
        files, numbers = self.files, self.numbers
        said = _tool_setup(*_version(files["setup"])) if "setup" in files else TrialSetup()
        begin, end = said.span or (-float("inf"), float("inf"))
        if "markers" in files or "motion" in files:
            said = replace(said, markers=files.get("markers"), motion=files.get("motion"))
        if said.markers is None and said.motion is None:
            raise ValueError(f"{str(said.file)!r} names neither markers nor joint angles; the row needs one")
        return said.stating(
            loads=files.get("loads"),
            cutoff=numbers.get("filter"),
            fill=numbers.get("fill"),
            span=(numbers.get("start", begin), numbers.get("end", end)),
        )

    def sources(self) -> list[Path]:
        """Return the files that it is solved from: those of the row, and those that they name."""
        found = list(self.files.values())
        with suppress(ValueError, OSError):  # what cannot be read is said when the trial is solved
            setup = self.setup()
            found += [*setup.sources, *filter(None, (setup.markers, setup.motion, setup.coordinates))]
            if setup.loads is not None:
                found += [setup.loads, *filter(None, (read_loads(setup.loads)[1],))]
        return found

    def digest(self, content: Callable[[Path], str]) -> str:
        """Return a digest of the row and of its sources; `content` returns that of a file, "" for none."""
        row = self.name, sorted(self.files), sorted(self.numbers.items()), sorted(self.factors.items())
        said = repr((row, self.uncertain, [content(path) for path in self.sources()]))
        return hashlib.sha256(said.encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Piece:
    """Draws of a trial that are solved together.

    Attributes:
        number: Of the piece in its study.
        trial: The trial.
        draws: Their numbers.
        inputs: Digest of the trial.
    """

    number: int
    trial: Trial
    draws: range
    inputs: str

    @property
    def keys(self) -> dict[str, list[Any]]:
        """Columns that say what a part of the summary is."""
        count = len(self.draws)
        return {"trial": [self.trial.name] * count, "draw": list(self.draws), "inputs": [self.inputs] * count}


@dataclass(frozen=True)
class Study:
    """A table that was checked.

    Attributes:
        trials: Rows.
        draws: Of each, besides the trial as it is.
        seed: Of the draws.
        mode: What muscles can give.
        exponent: Of activations in the cost; None: as the set-up of a trial has it, or the default.
        reserve: Of every coordinate [N m] or [N]; None: as the set-up of a trial has it, or none.
    """

    trials: tuple[Trial, ...]
    draws: int = 0
    seed: int = 0
    mode: Mode = "equilibrium"
    exponent: float | None = None
    reserve: float | None = None

    def settings(self) -> dict[str, Any]:
        """Return what the results of all trials depend on."""
        names = "draws", "seed", "mode", "exponent", "reserve"
        own = {name: getattr(self, name) for name in names}
        return {"trials": [trial.name for trial in self.trials], **own}

    def pieces(self) -> list[Piece]:
        """Return all parts, those of a trial one after the other."""
        inputs = self.inputs()
        parts = [(trial, begin) for trial in self.trials for begin in range(0, self.draws + 1, DRAWS)]
        return [
            Piece(number, trial, range(begin, min(begin + DRAWS, self.draws + 1)), inputs[trial.name])
            for number, (trial, begin) in enumerate(parts)
        ]

    def inputs(self) -> dict[str, str]:
        """Return the digest of each trial; a file that several have is read once."""
        content = cache(lambda path: files_digest([path]) if path.is_file() else "")
        return {trial.name: trial.digest(content) for trial in self.trials}


def plan_study(table: Path, **settings: Any) -> Study:
    """Check a table; no file of a trial is read.

    Args:
        table: A .csv or .parquet file.
        settings: Other fields of `Study`.

    Raises:
        ValueError: A column is unknown, or an entry is wrong; the message names row and column.
        ImportError: Parquet without pandas and pyarrow.
    """
    header, rows = read_table(table, "motion")
    if not rows:
        raise ValueError(f"motion table {str(table)!r} has no rows; it needs one for every trial")
    for number, name in enumerate(header):
        kind, colon, one = name.partition(":")
        known = kind in FACTORS if colon else kind in (TRIAL, *FILES, *NUMBERS, *FACTORS, *SPREADS)
        if not known or (colon and not one):
            raise ValueError(
                f"motion column {name!r} unknown; available: "
                f"{', '.join((TRIAL, *FILES, *NUMBERS, *FACTORS, *SPREADS))}, and factors of one muscle or "
                f"body such as max_isometric_force:soleus_r"
            )
        if name in header[:number]:
            raise ValueError(f"motion column {name!r} is there twice; leave one out")
    trials = tuple(_trial(table.parent, header, row, number) for number, row in enumerate(rows, 1))
    name, often = Counter(trial.name for trial in trials).most_common(1)[0]
    if often > 1:
        raise ValueError(f"motion table {str(table)!r} has the trial {name!r} twice; names differ")
    study = Study(trials, **settings)
    TrialSetup(exponent=study.exponent, reserve=study.reserve)  # says what is out of bounds
    check_least(0, draws=study.draws, seed=study.seed)
    if (parts := len(trials) * (study.draws // DRAWS + 1)) > MOST:
        raise ValueError(
            f"a study has at most {MOST} parts of {DRAWS} draws, got {parts}, with --draws {study.draws} of "
            f"{len(trials)} trials; ask for fewer draws, or divide the table"
        )
    return study


def _trial(folder: Path, header: list[str], row: list[Any], number: int) -> Trial:
    """Return a row, checked."""
    cells = {name: str(cell).strip() for name, cell in zip(header, row, strict=True)
             if cell is not None and str(cell).strip() not in ("", "nan", "<NA>")}  # fmt: skip
    name = cells.pop(TRIAL, str(number))
    where = f"motion row {number} (trial {name!r})"
    if not NAME.fullmatch(name) or len(name.encode()) > LONGEST:
        raise ValueError(
            f"motion row {number} (trial {name[:LONGEST]!r}): a name has letters, digits, blanks and . + - _ "
            f"alone, and at most {LONGEST} bytes"
        )
    files = {kind: folder / cells.pop(kind) for kind in FILES if kind in cells}
    if "model" not in files:
        raise ValueError(f"{where}, column 'model': needs an .osim file, got nothing")
    recorded = {"markers", "motion"} & files.keys()
    if len(recorded) == 2 or (not recorded and "setup" not in files):
        raise ValueError(f"{where}: needs one of markers (.trc) and motion (.mot, .sto), or a setup with one")
    numbers = {}
    for column, cell in cells.items():
        try:
            numbers[column] = number_in(cell)
        except ValueError:
            raise ValueError(f"{where}, column {column!r}: needs a number, got {cell!r}") from None
        if not abs(numbers[column]) < MAX_NUMBER:
            raise ValueError(
                f"{where}, column {column!r}: needs a number below {MAX_NUMBER:g} in size, got {cell!r}"
            )
    spread = {what: numbers.pop(column) for column, what in SPREADS.items() if column in numbers}
    own = {column: numbers.pop(column) for column in NUMBERS if column in numbers}
    for column in ("marker_set", "fill"):
        if "motion" in files and column in {**files, **own}:
            raise ValueError(f"{where}, column {column!r}: is of markers; leave it empty beside joint angles")
    try:
        check_factors(numbers)
        for what, factor in numbers.items():
            say_percent(what, factor)
        return Trial(name, files, own, numbers, Uncertainty(**spread))
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _version(path: Path) -> tuple[Path, int]:
    """Return a file, and what tells whether it is still the one that was read."""
    return path, path.stat().st_mtime_ns


@lru_cache(maxsize=4)
def _bones(model: Path, changed: int, markers: Path | None) -> Bones:
    return Bones.read(model, markers=markers)


@lru_cache(maxsize=64)
def _tool_setup(path: Path, changed: int) -> TrialSetup:
    return read_tool_setup(path)


def recording_of(trial: Trial, study: Study) -> Recording:
    """Read a trial, and find its joint angles.

    Raises:
        ValueError: A file is not what it should be.
        NotImplementedError: The model has something that is not supported.
        OSError: A file cannot be read.
    """
    said = trial.setup().stating(mode=study.mode, exponent=study.exponent, reserve=study.reserve)
    bones, lines = said.model_of(_bones(*_version(trial.files["model"]), trial.files.get("marker_set")))
    for line in lines:
        warn_once(line)
    how: dict[str, Any] = {"setup": said, "factors": trial.factors}
    if said.motion is None:
        found = kinematics(bones, said)
        if doubt := found.fitted.doubt():
            raise ValueError(doubt)
        weights = found.targets.get("marker_weights") or {}
        own = {name: weights.get(name, 1.0) for name in found.fitted.names}
        how |= {"markers": found.recorded, "targets": {**found.targets, "marker_weights": own}}
        time = known = found.fitted.time
        values = found.fitted.values
    else:
        motion = read_motion(said.angles, bones)
        time = motion.time if said.span is None else motion.between(*said.span).time
        known, values = motion.time, motion.values
    loads = acting(bones, None if said.loads is None else Loads(said.loads), time)
    return Recording(bones, time, values, loads=loads, known=known, **how)

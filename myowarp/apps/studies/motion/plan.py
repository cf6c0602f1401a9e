"""A study of recorded motions before it runs: its table, and what each trial of it is.

One row is one trial. Paths are beside the table. Columns and entries may be missing.

    trial, model, markers or motion, setup, loads      name and files, as `myowarp motion` takes them
    start, end, filter                                 [s], [s], [Hz]
    max_isometric_force, tendon_slack_length, mass     factors on those of all muscles or bodies, and with
                                                       a colon and a name behind, of one alone
    max_isometric_force_spread, tendon_slack_length_spread, mass_spread, marker_weight_spread, marker_noise
                                                       how far draws spread, see `motion.draws.Uncertainty`
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

from myowarp.definitions.registry import check_least, number_in
from myowarp.disk import files_digest
from myowarp.motion.draws import Recording, Uncertainty
from myowarp.motion.inverse_kinematics import inverse_kinematics
from myowarp.motion.loads import loads_at
from myowarp.motion.markers import read_trc
from myowarp.motion.muscle_forces import Mode
from myowarp.motion.skeleton import Bones
from myowarp.motion.tasks import tasks_of
from myowarp.motion.trial import read_motion
from myowarp.opensim.read.document import MAX_NUMBER, parse
from myowarp.sim.patient_table import read_table

TRIAL = "trial"
FILES = ("model", "markers", "motion", "setup", "loads")
NUMBERS = ("start", "end", "filter")
FACTORS = ("max_isometric_force", "tendon_slack_length", "mass")
SPREADS = {
    one.name if one.name == "marker_noise" else f"{one.name}_spread": one.name for one in fields(Uncertainty)
}
"""Column: what spreads."""
NAME = re.compile(r"[\w][\w .+-]*")


@dataclass(frozen=True)
class Trial:
    """A row of the table.

    Attributes:
        name: Of the trial.
        files: Paths by column.
        numbers: `start`, `end`, `filter`.
        factors: On muscles and bodies.
        uncertain: How far draws spread.
    """

    name: str
    files: Mapping[str, Path]
    numbers: Mapping[str, float]
    factors: Mapping[str, float]
    uncertain: Uncertainty

    def digest(self) -> str:
        """Return a digest of the row and of the files that are there."""
        there = files_digest(path for path in self.files.values() if path.is_file())
        row = repr(
            (self.name, sorted(self.files), sorted(self.numbers.items()), sorted(self.factors.items()))
        )
        return hashlib.sha256(f"{row}{self.uncertain}{there}".encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Study:
    """A table that was checked.

    Attributes:
        trials: Rows.
        draws: Of each, besides the trial as it is.
        seed: Of the draws.
        mode: What muscles can give.
        exponent: Of activations in the cost.
        reserve: Of every coordinate [N m] or [N]; 0: none.
    """

    trials: tuple[Trial, ...]
    draws: int = 0
    seed: int = 0
    mode: Mode = "equilibrium"
    exponent: float = 2.0
    reserve: float = 0.0
    columns: tuple[str, ...] = field(default=())

    def settings(self) -> dict[str, Any]:
        """Return what the results of all trials depend on."""
        names = "draws", "seed", "mode", "exponent", "reserve"
        return {"trials": [trial.name for trial in self.trials]} | {
            name: getattr(self, name) for name in names
        }


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
    names = [trial.name for trial in trials]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"motion table {str(table)!r} has the trial {name!r} twice; names differ")
    study = Study(trials, columns=tuple(header), **settings)
    check_least(0, draws=study.draws, seed=study.seed)
    return study


def _trial(folder: Path, header: list[str], row: list[Any], number: int) -> Trial:
    """Return a row, checked.

    Raises:
        ValueError: An entry is wrong.
    """
    cells = {name: str(cell).strip() for name, cell in zip(header, row, strict=True)
             if cell is not None and str(cell).strip() not in ("", "nan", "<NA>")}  # fmt: skip
    name = cells.pop(TRIAL, str(number))
    where = f"motion row {number} (trial {name!r})"
    if not NAME.fullmatch(name):
        raise ValueError(f"{where}: a name has letters, digits, blanks and . + - _ alone")
    files = {kind: folder / cells.pop(kind) for kind in FILES if kind in cells}
    if "model" not in files:
        raise ValueError(f"{where}, column 'model': needs an .osim file, got nothing")
    if ("markers" in files) == ("motion" in files):
        raise ValueError(f"{where}: needs one of markers (.trc) and motion (.mot, .sto)")
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
    return Trial(name, files, own, numbers, Uncertainty(**spread))


@lru_cache(maxsize=4)
def _bones(model: Path, changed: int) -> Bones:
    return Bones.read(model)


def recording_of(trial: Trial, study: Study) -> Recording:
    """Read a trial, and find its joint angles.

    Raises:
        ValueError: A file is not what it should be.
        NotImplementedError: The model has something that is not supported.
        OSError: A file cannot be read.
    """
    files, numbers = trial.files, trial.numbers
    bones = _bones(files["model"], files["model"].stat().st_mtime_ns)
    span = numbers.get("start", -float("inf")), numbers.get("end", float("inf"))
    of_markers: dict[str, Any] = {}
    if "markers" in files:
        markers = read_trc(files["markers"]).between(*span)
        if "setup" in files:
            tasks = tasks_of(parse(files["setup"])[0])
            of_markers["coordinate_weights"], of_markers["coordinate_values"] = (
                tasks.coordinates,
                tasks.values,
            )
            weights = {
                name: weight for name, weight in tasks.markers.items() if name in markers.names and weight > 0
            }
        else:
            weights = {name: 1.0 for name in markers.names if name in bones.model.markers}
        fitted = inverse_kinematics(
            bones, markers, weights, of_markers.get("coordinate_weights"), of_markers.get("coordinate_values")
        )
        if doubt := fitted.doubt():
            raise ValueError(doubt)
        time, values = fitted.time, fitted.values
        of_markers |= {"markers": markers, "marker_weights": weights}
    else:
        motion = read_motion(files["motion"], bones)
        kept = (motion.time >= span[0] - 1e-9) & (motion.time <= span[1] + 1e-9)
        if not kept.any():
            raise ValueError(f"no frame between {span[0]:g} and {span[1]:g} s in {str(files['motion'])!r}")
        time, values = motion.time[kept], motion.values[kept]
    return Recording(
        bones,
        time,
        values,
        loads=loads_at(files["loads"], time) if "loads" in files else (),
        cutoff=numbers.get("filter"),
        mode=study.mode,
        exponent=study.exponent,
        reserves=dict.fromkeys(bones.coordinates, study.reserve) if study.reserve else None,
        factors=trial.factors,
        **of_markers,
    )

"""Parameters of muscles beside a compiled model: what is measured in a person, or drawn for every world.

strengths = np.random.default_rng(0).uniform(300.0, 700.0, (256, 1))
muscle = MuscleTable("mujoco", {"max_isometric_force": strengths})
muscle = MuscleTable.read("mujoco", "patient.csv")  # a row for each muscle
env = gymnasium.make_vec("MyoWarp/myoElbowPose1D6MRandom-v0", num_envs=256, muscle=muscle)
"""

from __future__ import annotations

import csv
import io
import itertools
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from myowarp.definitions.muscle import MUSCLES, muscle_index
from myowarp.definitions.registry import check_choice
from myowarp.definitions.worlds import Worlds
from myowarp.disk import csv_rows, number_in
from myowarp.kernels.write import is_finite
from myowarp.laws.muscles.hill_law import OPENSIM_LAWS, SCHUTTE_CLASS
from myowarp.laws.muscles.schutte1993 import CURVES

Knots = tuple[tuple[float, ...], tuple[float, ...]]
"""x and y of a spline."""


@dataclass(frozen=True, eq=False)
class MuscleTable:
    """A muscle model with parameters that differ from those of the compiled model.

    A tendon transfer fits the lengths of the muscle that it reroutes anew, whatever is given here.

    Attributes:
        model: Name in `MUSCLES`; "" in a body's own table of Hill parameters, for every model that takes them
            (`MuscleModel.TAKES_HILL`).
        parameters: By name in the model's `PARAMETERS`: an array, shape (1 or num_worlds, 1 or num_muscles),
            one number, or a mapping from muscle names to a number or (num_worlds,) numbers each; the side
            suffix `_r` may be left out, and a muscle that is not named keeps the compiled model's.
        curves: Splines of a body's own table, by muscle and name in `CURVES`.
    """

    model: str = "mujoco"
    parameters: Mapping[str, Any] = field(default_factory=dict)
    curves: Mapping[str, Mapping[str, Knots]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise ValueError if there is no such model, or it has no such parameter."""
        if not self.model:
            return
        known = MUSCLES[self.model].PARAMETERS
        for name in self.parameters:
            check_choice(f"parameter of muscle model {self.model!r}", name, known)

    @classmethod
    def by_muscle(cls, model: str, rows: Mapping[str, Mapping[str, Any]]) -> MuscleTable:
        """Return a table from parameters by muscle: {"BIClong": {"max_isometric_force": 400.0}}.

        Raises:
            ValueError: As for `MuscleTable`.
        """
        parameters: dict[str, dict[str, Any]] = {}
        for muscle, row in rows.items():
            for name, value in row.items():
                parameters.setdefault(name, {})[muscle] = value
        return cls(model, parameters)

    @classmethod
    def read(cls, model: str, path: str | Path | None) -> MuscleTable:
        """Return a table from a .csv: column `muscle`, and one for each parameter, empty where none is given.

        Comma, semicolon or tab separates. Without a file every parameter is the compiled model's.

        Raises:
            ValueError: The file is no such table.
            OSError: The file cannot be read.
        """
        if path is None:
            return cls(model)
        columns, *lines = csv_rows(Path(path), str(path)) or [[]]
        if "muscle" not in columns:
            raise ValueError(f"{path} must have a column 'muscle', got {', '.join(columns) or 'none'}")
        if twice := [name for name in columns if columns.count(name) > 1]:
            raise ValueError(f"{path} must have one column {twice[0]!r}, got {columns.count(twice[0])}")
        rows: dict[str, dict[str, float]] = {}
        for line in lines:
            if len(line) > len(columns):
                raise ValueError(f"{path} must have {len(columns)} cells in each row, got more")
            cells = dict(itertools.zip_longest(columns, line, fillvalue=""))
            if (muscle := cells.pop("muscle")) in rows:
                raise ValueError(f"{path} must have one row for each muscle, got two of {muscle!r}")
            rows[muscle] = {
                name: _number(f"{path}: {name} of muscle {muscle!r}", cell)
                for name, cell in cells.items()
                if cell.strip()
            }
        for name in columns:
            if name != "muscle":
                check_choice(f"parameter of muscle model {model!r}", name, MUSCLES[model].PARAMETERS)
        return cls.by_muscle(model, rows)

    @classmethod
    def converted(cls, text: str, names: Collection[str], path: Path) -> MuscleTable | None:
        """Return the Hill parameters of muscles as `myowarp convert` writes them; None: there are none.

        Args:
            text: Of a `muscles.csv`, "" for none.
            names: Of the muscles.
            path: Of the file, for what is said of it.

        Raises:
            ValueError: A number is none.
        """
        if not text:
            return None
        rows: dict[str, dict[str, float]] = {}
        curves: dict[str, dict[str, Knots]] = {}
        for line in csv.DictReader(io.StringIO(text, newline=""), restval=""):
            muscle, kind = line.pop("name"), line.pop("class")
            if muscle not in names:
                continue
            rows[muscle] = row = {
                column.partition(" [")[0]: _number(f"{path}: {column} of muscle {muscle!r}", cell)
                for column, cell in line.items()
                if " [" in column and cell not in ("", "inf", "-inf")  # curves have no unit
            }
            law: int | None = OPENSIM_LAWS.get(kind)
            if kind == SCHUTTE_CLASS:
                found = {curve: _knots(line[curve]) for curve in CURVES if line.get(curve)}
                curves[muscle] = {curve: knots for curve, knots in found.items() if knots is not None}
                law = law if curves[muscle].keys() == found.keys() else None
                row |= _of_schutte(row)
            if law is not None:
                row["law"] = float(law)
        return replace(cls.by_muscle("", rows), curves=curves)

    def bounded(self, model: str) -> tuple[MuscleTable, list[str]]:
        """Return a body's own table with values that a muscle model takes, and what was moved to a bound.

        Args:
            model: Name in `MUSCLES`.
        """
        found: dict[str, Any] = dict(self.parameters)
        moved = []
        for name in found.keys() & MUSCLES[model].PARAMETERS.keys():
            low, high = MUSCLES[model].PARAMETERS[name]
            own = {muscle: min(max(value, low), high) for muscle, value in found[name].items()}
            for muscle, value in own.items():
                if value != (was := found[name][muscle]):
                    bounds = f"must be from {low:g} to {high:g}"
                    moved.append(
                        f"{name} of muscle {muscle!r} {bounds}, got {was:g}; it is taken as {value:g}"
                    )
            found[name] = own
        return replace(self, parameters=found), sorted(moved)

    def knots(self, names: Sequence[str]) -> np.ndarray:
        """Return x and y of the splines of muscles, shape (1, num_muscles, 3, 2, most knots).

        NaN follows the last knot; a curve that is missing has none.
        """
        given = [[self.curves.get(name, {}).get(curve, ((), ())) for curve in CURVES] for name in names]
        most = max((len(x) for each in given for x, _ in each), default=0)
        table = np.full((1, len(names), len(CURVES), 2, max(most, 1)), np.nan)
        for muscle, each in enumerate(given):
            for number, (x, y) in enumerate(each):
                table[0, muscle, number, :, : len(x)] = x, y
        return table

    def of(self, names: Sequence[str], worlds: Worlds) -> dict[str, np.ndarray]:
        """Return the parameters of some worlds, shape (1 or their number, num_muscles) each.

        Args:
            names: The muscles.
            worlds: The worlds; arrays are given for all of which they are a part.

        Returns:
            Arrays by parameter, NaN where nothing is given.

        Raises:
            ValueError: A value has a wrong shape, is out of its range, or names an unknown muscle.
        """
        own = {}
        for name, value in self.parameters.items():
            array = self._array(name, value, names, worlds.everywhere)
            own[name] = array if len(array) == 1 else array[worlds.given]
        return own

    def over(self, own: MuscleTable | None, names: Sequence[str], worlds: Worlds) -> dict[str, np.ndarray]:
        """Return the parameters of some worlds as `of` does, a body's own where none are given.

        Args:
            own: Table of the body; None: it has none.
            names: The muscles.
            worlds: The worlds.

        Raises:
            ValueError: As in `of`.
        """
        given, kind = self.of(names, worlds), MUSCLES[self.model]
        if own is None or not (own.model == self.model or (kind.TAKES_HILL and not own.model)):
            return given
        known = {name: value for name, value in own.parameters.items() if name in kind.PARAMETERS}
        for name, values in MuscleTable(self.model, known).of(names, worlds).items():
            given[name] = np.where(np.isnan(given[name]), values, given[name]) if name in given else values
        return given | ({"curves": own.knots(names)} if kind.TAKES_CURVES and own.curves else {})

    def _array(self, name: str, value: Any, names: Sequence[str], total: int) -> np.ndarray:
        """Return a parameter of all worlds, shape (1 or total, num_muscles)."""
        if not isinstance(value, Mapping):
            array = self._checked(name, value)
            rows, columns = {1, total}, {1, len(names)}
            if array.ndim and not (array.ndim == 2 and array.shape[0] in rows and array.shape[1] in columns):
                raise ValueError(
                    f"{name} must be a number, an array of shape (1 or {total}, 1 or {len(names)}) or a "
                    f"mapping from muscles, got shape {array.shape}"
                )
            return np.broadcast_to(array, (len(array) if array.ndim else 1, len(names)))
        given = np.full((total, len(names)), np.nan)
        for muscle, number in value.items():
            column = self._checked(f"{name} of muscle {muscle!r}", number, name)
            if column.shape not in ((), (total,)):
                raise ValueError(
                    f"{name} of muscle {muscle!r} must be a number or one for each of {total} worlds, "
                    f"got shape {column.shape}"
                )
            given[:, muscle_index(muscle, names)] = column
        return given if any(np.ndim(number) for number in value.values()) else given[:1]

    def _checked(self, what: str, value: Any, name: str | None = None) -> np.ndarray:
        """Return a value as float64 numbers within the range of parameter `name`."""
        low, high = MUSCLES[self.model].PARAMETERS[name or what]
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.full(1, np.nan)
        outside = ~((array >= low) & (array <= high) & is_finite(array))
        if outside.any():
            got = array[outside].flat[0] if np.isfinite(array).any() else value
            raise ValueError(f"{what} must be finite and from {low:g} to {high:g}, got {got}")
        return array


def _knots(cell: str) -> Knots | None:
    """Return the knots of a spline as `myowarp convert` writes it; None: it is another function."""
    kind, *knots = json.loads(cell)
    if kind != "SimmSpline":
        return None
    x, y = (tuple(map(float, values)) for values in knots)
    return x, y


def _of_schutte(row: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters of Schutte's muscle under the names of all laws.

    Velocities are in optimal fiber lengths in a time scale; the activation rises with activation1 u +
    activation2 and falls with activation2 in a time scale.
    """
    scale = row["time_scale"]
    return {
        "fiber_damping": row["damping"],
        "max_contraction_velocity": 1.0 / scale,
        "activation_time_constant": scale / (row["activation1"] + row["activation2"]),
        "deactivation_time_constant": scale / row["activation2"],
    }


def _number(what: str, cell: str) -> float:
    """Return a cell of a table as a number."""
    try:
        return number_in(cell)
    except ValueError:
        raise ValueError(f"{what} must be a number, got {cell!r}") from None

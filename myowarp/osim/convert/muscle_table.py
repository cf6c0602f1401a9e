"""`muscles.csv`: the exact Hill parameters of all muscles, as the model states them.

One row per muscle. The header names each column and its unit, such as `max_isometric_force [N]`, under
OpenSim's property names; the numbers of a nested curve as `ForceVelocityCurve.isometric_slope [1]`. Numbers
have all their digits, switches are 0 or 1, and what a class does not have stays empty. A curve that the
file holds as a function is a JSON list of its class and its fields in order (functions.py).
"""

import csv
import dataclasses
import io
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from myowarp.disk import in_place
from myowarp.osim.body.hill_muscle import HillMuscle
from myowarp.osim.document import functions
from myowarp.osim.document.functions import Function
from myowarp.osim.document.read.element import number_of

UNITS = {
    "max_isometric_force": "N",
    "optimal_fiber_length": "m",
    "tendon_slack_length": "m",
    "default_fiber_length": "m",
    "pennation_angle_at_optimal": "rad",
    "maximum_pennation_angle": "rad",
    "max_contraction_velocity": "optimal_fiber_length/s",
    "activation_time_constant": "s",
    "deactivation_time_constant": "s",
    "time_scale": "s",
}
"""Unit of a property; every other one is a pure number, written [1]."""


def write_muscles(path: Path, muscles: Iterable[HillMuscle]) -> None:
    """Write the parameters of muscles, whole or not at all."""
    with in_place(path) as scratch:
        scratch.write_text(muscle_table(muscles), encoding="utf-8", newline="")


def muscle_table(muscles: Iterable[HillMuscle]) -> str:
    """Return the parameters of muscles as the content of a CSV file."""
    rows = list(muscles)
    values = dict.fromkeys(name for muscle in rows for name in muscle.values)
    curves = dict.fromkeys(name for muscle in rows for name in muscle.functions)
    text = io.StringIO(newline="")
    table = csv.writer(text)
    table.writerow(["name", "class", *(f"{name} [{_unit(name)}]" for name in values), *curves])
    for muscle in rows:
        numbers = [repr(float(muscle.values[name])) if name in muscle.values else "" for name in values]
        splines = [_encode(muscle.functions[name]) if name in muscle.functions else "" for name in curves]
        table.writerow([muscle.name, muscle.kind, *numbers, *splines])
    return text.getvalue()


def read_muscles(path: Path) -> list[HillMuscle]:
    """Return the muscles of a file that `write_muscles` wrote.

    Raises:
        ValueError: If a column is not what `write_muscles` writes, or a number is none.
    """
    with path.open(newline="", encoding="utf-8") as file:
        table = csv.DictReader(file)
        columns = list(table.fieldnames or ())
        if columns[:2] != ["name", "class"]:
            raise ValueError(
                f"{path} must begin with the columns name and class, got {', '.join(columns[:2])}"
            )
        muscles = []
        for row in table:
            values: dict[str, float] = {}
            curves: dict[str, Any] = {}
            for column in columns[2:]:
                name, _, unit = column.partition(" ")
                text = row[column]
                if not text:
                    continue
                if not unit:
                    curves[name] = _decode(json.loads(text))
                    continue
                if unit != f"[{_unit(name)}]":
                    raise ValueError(f"{path} gives {name} in {unit}, but its unit is [{_unit(name)}]")
                values[name] = _number(text, f"{path}, line {table.line_num}: {name}")
            muscles.append(HillMuscle(row["name"], row["class"], values, curves))
    return muscles


def _unit(name: str) -> str:
    """Return the unit of a property, which may stand in a nested object."""
    return UNITS.get(name.rpartition(".")[2], "1")


def _number(text: str, place: str) -> float:
    """Return the number that a cell holds."""
    try:
        return number_of(text)
    except ValueError as error:
        raise ValueError(f"{place} must be a number, got {text!r}") from error


def _encode(function: Function) -> str:
    """Return a function as JSON: class and fields in order, nested functions alike."""

    def nested(value: object) -> object:
        if dataclasses.is_dataclass(value):
            fields = (getattr(value, field.name) for field in dataclasses.fields(value))
            return [type(value).__name__, *(nested(field) for field in fields)]
        return value

    return json.dumps(nested(function))


def _decode(value: Any) -> Any:
    """Return the function, or the field of one, that JSON describes."""
    if not isinstance(value, list):
        return value
    if value and isinstance(value[0], str):
        kind = getattr(functions, value[0], None)
        if not (isinstance(kind, type) and dataclasses.is_dataclass(kind)):
            raise ValueError(f"a curve must be a function of an OpenSim model, got {value[0]!r}")
        return kind(*(_decode(field) for field in value[1:]))
    return tuple(_decode(item) for item in value)

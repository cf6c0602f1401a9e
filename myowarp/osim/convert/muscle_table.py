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

from myowarp.osim.body.hill_muscle import HillMuscle
from myowarp.osim.document.functions import Function

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


def _unit(name: str) -> str:
    """Return the unit of a property, which may stand in a nested object."""
    return UNITS.get(name.rpartition(".")[2], "1")


def _encode(function: Function) -> str:
    """Return a function as JSON: class and fields in order, nested functions alike."""

    def nested(value: object) -> object:
        if dataclasses.is_dataclass(value):
            fields = (getattr(value, field.name) for field in dataclasses.fields(value))
            return [type(value).__name__, *(nested(field) for field in fields)]
        return value

    return json.dumps(nested(function))

"""Muscles of public models and their forces as OpenSim 4.6 gave them; and a `muscles.csv` read back."""

import csv
import json
from pathlib import Path

import numpy as np

from myowarp.osim.body.hill_muscle import HillMuscle
from myowarp.osim.convert.compose.beside import muscle_table
from myowarp.osim.document import functions

DATA = Path(__file__).parent / "data" / "opensim"


def load(model):
    """Return the recorded arrays and the muscles of a model."""
    with np.load(DATA / f"muscles_{model}.npz") as file:
        data = dict(file)
    meta = json.loads(str(data.pop("meta")))
    rows = zip(meta["names"], meta["classes"], meta["parameters"], strict=True)
    return data, [HillMuscle(*row) for row in rows]


def write_muscles(path, muscles):
    """Write the parameters of muscles, as `myowarp convert` does."""
    path.write_text(muscle_table(muscles), encoding="utf-8", newline="")


def read_muscles(path):
    """Return the muscles of a file that `write_muscles` wrote."""
    with path.open(newline="", encoding="utf-8") as file:
        return [_muscle(row) for row in csv.DictReader(file)]


def _muscle(row):
    name, kind = row.pop("name"), row.pop("class")
    given = {column: text for column, text in row.items() if text}
    values = {column.partition(" ")[0]: float(text) for column, text in given.items() if " [" in column}
    curves = {column: _function(json.loads(text)) for column, text in given.items() if " [" not in column}
    return HillMuscle(name, kind, values, curves)


def _function(value):
    """Return the function, or the field of one, that JSON describes."""
    if not isinstance(value, list):
        return value
    if value and isinstance(value[0], str):
        return getattr(functions, value[0])(*map(_function, value[1:]))
    return tuple(map(_function, value))

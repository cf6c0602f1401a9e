"""Muscles of public models and their forces as OpenSim 4.6 gave them."""

import json
from pathlib import Path

import numpy as np

from myowarp.osim.body.hill_muscle import HillMuscle

DATA = Path(__file__).parent / "data" / "opensim"


def load(model):
    """Return the recorded arrays and the muscles of a model."""
    with np.load(DATA / f"muscles_{model}.npz") as file:
        data = dict(file)
    meta = json.loads(str(data.pop("meta")))
    rows = zip(meta["names"], meta["classes"], meta["parameters"], strict=True)
    return data, [HillMuscle(*row) for row in rows]

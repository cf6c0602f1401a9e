"""Converted models in a folder, as `myowarp convert` leaves them, with muscles or motors in their place."""

from pathlib import Path

from opensim_muscles import write_muscles

from myowarp.osim.body.hill_muscle import HillMuscle
from myowarp.osim.bundle.mjcf import mjcf
from myowarp.osim.convert.compose.convert import convert
from myowarp.osim.document.read.model import read_model
from myowarp.sim.simulation import Simulation
from myowarp.tasks.from_file import pose_task

OSIM = Path(__file__).parent / "data" / "osim"


def motorised(folder, name):
    """Write a model with a motor for each free coordinate; returns the conversion and the model's path."""
    converted = convert(read_model(OSIM / f"{name}.osim"))
    spec = converted.spec
    for element in [*spec.actuators, *spec.tendons]:
        spec.delete(element)
    for entry in converted.coordinates.coordinates:
        if entry.kind == "free":
            spec.add_actuator(name=entry.name, target=entry.joint, trntype=0, ctrlrange=(-1, 1))
    path = folder / "model.xml"
    path.write_text(mjcf(spec))
    (folder / "couplings.json").write_text(converted.couplings.as_json())
    return converted, path


def simulation(path, num_worlds, **options):
    settings = {"device": "cpu", "graph": False, "progress": False} | options
    return Simulation(pose_task(path), num_worlds, **settings)


def muscled(folder, name):
    """Write a model with its muscles, not fitted, and their Hill parameters; returns the model's path."""
    converted = convert(model := read_model(OSIM / f"{name}.osim"))
    path = folder / "model.xml"
    path.write_text(mjcf(converted.spec))
    write_muscles(folder / "muscles.csv", map(HillMuscle.of, model.muscles.values()))
    return path

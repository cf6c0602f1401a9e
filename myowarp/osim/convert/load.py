"""An OpenSim model as itself: joints, couplings, muscles and paths as its file says, nothing fitted.

What `myowarp convert` writes for plain MuJoCo - fitted tendons, quartics, a report - is not needed here:
paths are OpenSim's own on the device, joints follow exactly, and muscles take the file's parameters. The
result is kept in the cache, so that it is made once for each file and the meshes that it finds.
"""

import json
from pathlib import Path

from myowarp.disk import cache_dir, files_digest, version, writable_folder
from myowarp.osim.body.hill_muscle import HillMuscle
from myowarp.osim.convert.check.accelerations import too_fast
from myowarp.osim.convert.compose.convert import Options, convert
from myowarp.osim.convert.compose.geometry import MIN_MASS
from myowarp.osim.convert.compose.meshes import mesh_files
from myowarp.osim.convert.compose.mjcf import mjcf
from myowarp.osim.convert.muscle_table import muscle_table
from myowarp.osim.convert.run import write
from myowarp.osim.document.model import Loss
from myowarp.osim.document.read.model import read_model
from myowarp.process import warn_once

SOURCES = ("osim/**/*.py", "laws/**/*.py", "disk.py")
"""Files of the package that decide what comes out."""

TOO_FAST = "accelerations.json"
"""Beside the model: sentences on what accelerates too fast in it."""

MASSLESS = "massless"
"""Code of a model without masses, as in the report of a conversion."""


def load(path: Path) -> Path:
    """Return model.xml of an .osim file, its sidecars beside it; a line is logged for what is left out.

    Raises:
        ValueError: The file is no usable model, or contains something that is not supported.
    """
    if not path.is_file():
        raise ValueError(f"model {str(path)!r} is no file; give the path of an .osim file")
    package = Path(__file__).parents[2]
    sources = sorted(file for pattern in SOURCES for file in package.glob(pattern))
    digest = files_digest([path, *mesh_files(path), *sources])[:16]
    kept = writable_folder(cache_dir(), "MYOWARP_CACHE_DIR") / "opensim"
    folder = kept / f"{path.stem}-{digest}-mujoco-{version('mujoco')}"
    if not (folder / "model.xml").is_file():
        write(folder, _files(path))
    for line in json.loads((folder / TOO_FAST).read_text()):
        warn_once(f"{path.name}: {line}")
    codes = json.loads((folder / "left_out.json").read_text())
    if MASSLESS in codes:
        warn_once(
            f"{path.name} gives no body a mass; bodies of {MIN_MASS * 1e3:g} g stand for them, which muscles "
            "throw: use the model for paths and forces, not for motion"
        )
    if codes:
        said = ", ".join(codes)
        warn_once(
            f"{path.name}: left out, or not as in OpenSim: {said}; the report of myowarp convert says how"
        )
    return folder / "model.xml"


def _files(path: Path) -> dict[str, bytes]:
    """Return what is kept of a model, model.xml last."""
    try:
        model = read_model(path)
    except NotImplementedError as error:
        raise ValueError(str(error)) from error
    converted = convert(model, Options(tendons=False))
    converted.spec.meshdir = "meshes" if converted.meshes else ""
    left_out = {note.code for note in converted.notes if isinstance(note, Loss)}
    if not any(body.mass for body in model.bodies.values()):
        left_out.add(MASSLESS)
    return {
        **{f"meshes/{name}": content for name, content in converted.meshes.items()},
        "coordinates.json": json.dumps(converted.coordinates.as_json(), indent=1).encode(),
        "couplings.json": converted.exact.as_json().encode(),
        **({"paths.json": converted.paths.as_json().encode()} if converted.paths else {}),
        **({"forces.json": converted.forces.as_json().encode()} if converted.forces else {}),
        "muscles.csv": muscle_table(map(HillMuscle.of, model.muscles.values())).encode(),
        "left_out.json": json.dumps(sorted(left_out)).encode(),
        TOO_FAST: json.dumps(too_fast(model)).encode(),
        "model.xml": mjcf(converted.spec, comment=f"{model.name}. {model.credits}").encode(),
    }

"""An OpenSim model as itself: joints, couplings, muscles and paths as its file says, nothing fitted.

What `myowarp convert` writes for plain MuJoCo - fitted tendons, quartics, a report - is not needed here:
paths are OpenSim's own on the device, joints follow exactly, and muscles take the file's parameters. The
result is kept in the cache, so that it is made once for each file and the meshes that it finds.
"""

import json
from pathlib import Path

from myowarp.disk import cache_dir, files_digest, version, writable_folder
from myowarp.osim.bundle.bundle import MODEL
from myowarp.osim.document.read.shapes import mesh_files
from myowarp.process import warn_once

SOURCES = ("osim/**/*.py", "laws/**/*.py", "disk.py")
"""Files of the package that decide what comes out."""

LEFT_OUT = "left_out.json"
TOO_FAST = "accelerations.json"
"""Beside the model: codes of what is left out always and with MuJoCo's contact; sentences on what accelerates
too fast."""

MASSLESS = "massless"
"""Code of a model without masses, as in the report of a conversion."""


def load(path: Path, function_paths: Path | None = None, contact: str = "mujoco") -> Path:
    """Return model.xml of the bundle of an .osim file; a line is logged for what is left out.

    Args:
        path: The file.
        function_paths: A set of `FunctionBasedPath`, in place of the paths of the muscles that it names.
        contact: "opensim" where its contact forces are to act, which are then not left out; else "mujoco".

    Raises:
        ValueError: The file is no usable model, or contains something that is not supported.
    """
    if not path.is_file():
        raise ValueError(f"model {str(path)!r} is no file; give the path of an .osim file")
    package = Path(__file__).parents[2]
    sources = sorted(file for pattern in SOURCES for file in package.glob(pattern))
    beside = [] if function_paths is None else [function_paths]
    digest = files_digest([path, *beside, *mesh_files(path), *sources])[:16]
    kept = writable_folder(cache_dir(), "MYOWARP_CACHE_DIR") / "opensim"
    folder = kept / f"{path.stem}-{digest}-mujoco-{version('mujoco')}"
    if not (folder / MODEL).is_file():
        _convert(path, function_paths, folder)
    for line in json.loads((folder / TOO_FAST).read_text()):
        warn_once(f"{path.name}: {line}")
    codes, resting = json.loads((folder / LEFT_OUT).read_text())
    codes = sorted({*codes, *(resting if contact == "mujoco" else ())})
    if MASSLESS in codes:
        from myowarp.osim.convert.compose.geometry import MIN_MASS

        warn_once(
            f"{path.name} gives no body a mass; bodies of {MIN_MASS * 1e3:g} g stand for them, which muscles "
            "throw: use the model for paths and forces, not for motion"
        )
    if codes:
        warn_once(
            f"{path.name}: left out, or not as in OpenSim: {', '.join(codes)}; the report of myowarp convert "
            "says how"
        )
    return folder / MODEL


def _convert(path: Path, function_paths: Path | None, folder: Path) -> None:
    """Keep the bundle of a model, and what is said of it, in a folder."""
    from myowarp.osim.convert.check.accelerations import too_fast  # a model in the cache needs none of these
    from myowarp.osim.convert.compose.convert import Options, convert
    from myowarp.osim.document.model import Loss
    from myowarp.osim.document.read.model import read_model

    try:
        model = read_model(path, function_paths=function_paths)
    except NotImplementedError as error:
        raise ValueError(str(error)) from error
    bundle = convert(model, Options(tendons=False))
    losses = [note for note in bundle.notes if isinstance(note, Loss)]
    resting = {f"/forceset/{force.name}" for force in model.contact_forces}
    rests = sorted({note.code for note in losses if note.path in resting})
    left_out = {note.code for note in losses if note.path not in resting}
    if not any(body.mass for body in model.bodies.values()):
        left_out.add(MASSLESS)
    said = {LEFT_OUT: [sorted(left_out), rests], TOO_FAST: too_fast(model)}
    more = {name: json.dumps(lines).encode() for name, lines in said.items()}
    bundle.save(folder, f"{model.name}. {model.credits}", more)

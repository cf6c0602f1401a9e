"""The command `myowarp convert`: an .osim file -> a folder with a MuJoCo model."""

import dataclasses
import hashlib
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import mujoco
import tyro
from rich.console import Console

from myowarp.files import check_folder, in_place


@dataclass
class Convert:
    """Convert an OpenSim model to MuJoCo: bodies, joints, muscles, with a report of what is not exact.

    Writes model.xml, coordinates.json (how coordinates and joints belong together), report.json, and
    meshes where they are found. Works without OpenSim.

    Example: myowarp convert arm26.osim -o out/arm26
    """

    model: Annotated[Path, tyro.conf.Positional]
    """The model, .osim, documents 30000 to 40600."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out/model")
    """Folder for the result."""
    meshes: tuple[Path, ...] = ()
    """More folders with .vtp, .stl or .obj files; the model's own and Geometry beside it are searched."""
    json: bool = False
    """Print the report as JSON instead of a summary."""

    def __call__(self) -> None:
        """Convert, check, write."""
        report = run(self.model, self.output, self.meshes)
        if self.json:
            print(json.dumps(report, indent=1))
            return
        console = Console(highlight=False, soft_wrap=True)
        error = report["kinematics"]
        counts = report["counts"]
        console.print(f"{self.output}/model.xml: {counts['joints']} joints, {counts['muscles']} muscles")
        console.print(
            f"body origins within {error['position'] * 1e3:.2g} mm, in {error['poses']} random poses"
        )
        console.print(f"{len(report['notes'])} notes on what is not exact, in {self.output}/report.json")


def run(source: Path, output: Path, mesh_folders: tuple[Path, ...] = ()) -> dict:
    """Convert a file and write the result; the report is written last, the model before it.

    Raises:
        ValueError: The file is no usable model, or the folder cannot be written.
        NotImplementedError: The model contains something that is not supported.
        OSError: A file cannot be read or written.
    """
    from myowarp.models.opensim.convert import Options, convert
    from myowarp.models.opensim.mjcf import mjcf
    from myowarp.models.opensim.read import read_model
    from myowarp.models.opensim.validate import kinematics_error

    if not source.is_file():
        raise ValueError(f"model {str(source)!r} is no file; give the path of an .osim file")
    check_folder(output)
    begin = time.perf_counter()
    model = read_model(source)
    converted = convert(model, Options(mesh_folders))
    converted.spec.meshdir = "meshes" if converted.meshes else ""
    text = mjcf(converted.spec, comment=f"{model.name}. {model.credits}")
    compiled = mujoco.MjModel.from_xml_string(text, {**converted.meshes})
    report = {
        "source": source.name,
        "sha256": hashlib.sha256(source.read_bytes()).hexdigest(),
        "document": model.version,
        "name": model.name,
        "credits": model.credits,
        "publications": model.publications,
        "counts": {
            "bodies": len(model.bodies),
            "coordinates": len(model.coordinates),
            "joints": compiled.njnt,
            "equalities": compiled.neq,
            "muscles": len(model.muscles),
            "markers": len(model.markers),
        },
        "kinematics": dataclasses.asdict(kinematics_error(converted, compiled)),
        "notes": [dataclasses.asdict(note) for note in converted.notes],
        "seconds": round(time.perf_counter() - begin, 3),
    }
    files = {
        **{f"meshes/{name}": content for name, content in converted.meshes.items()},
        "coordinates.json": json.dumps(converted.coordinates.as_json(), indent=1).encode(),
        "model.xml": text.encode(),
        "report.json": json.dumps(report, indent=1).encode(),
    }
    write(output, files)
    return report


def write(output: Path, files: dict[str, bytes]) -> None:
    """Write files into a folder, each whole; what marks an earlier result as complete goes first."""
    for name in ("report.json", "model.xml"):
        (output / name).unlink(missing_ok=True)
    for name, content in files.items():
        path = output / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with in_place(path) as scratch:
            scratch.write_bytes(content)

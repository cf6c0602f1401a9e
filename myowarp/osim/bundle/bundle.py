"""A model of OpenSim as a scene takes it: MJCF, and what stands beside it.

In a folder these are `model.xml` with meshes, the JSON of `couplings`, `paths`, `forces`, `contacts` and
`coordinates`, and `muscles.csv`. What is not there is None or empty: the model then has MuJoCo's equalities,
tendons, springs, contact and muscles.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco

from myowarp.disk import in_place, make_folder
from myowarp.osim.bundle.contacts import DocumentContacts
from myowarp.osim.bundle.coordinate_map import CoordinateMap
from myowarp.osim.bundle.couplings import Couplings
from myowarp.osim.bundle.forces import PassiveForces
from myowarp.osim.bundle.mjcf import mjcf
from myowarp.osim.bundle.paths import DocumentPaths
from myowarp.osim.bundle.text import Sidecar
from myowarp.osim.document.contacts import TYPES
from myowarp.osim.document.model import Note

MODEL = "model.xml"
MUSCLES = "muscles.csv"
OURS = b"name,class,"
"""First bytes of a `muscles.csv` of ours."""
COORDINATES = "coordinates.json"
PARTS: tuple[type[Sidecar], ...] = (Couplings, DocumentPaths, PassiveForces, DocumentContacts)
SIDECARS = tuple(part.FILE for part in PARTS)
"""Files that not every model has, and that act where they lie beside one."""


@dataclass(frozen=True, kw_only=True)
class Bundle:
    """A model and what belongs to it.

    Attributes:
        spec: MuJoCo's model.
        couplings: How joints follow each other, and what bodies weigh; None: as the spec's equalities say.
        paths: Paths of tendons; None: as MuJoCo's.
        forces: Limits of coordinates and ligaments; None: as the spec's springs.
        contacts: Contact as OpenSim computes it; None: as MuJoCo does.
        coordinates: How coordinates and joints belong together; None: it is not known.
        muscles: Hill parameters of muscles, as `muscles.csv` has them; "": there are none.
        meshes: Files that belong into the folder `meshes`.
        notes: Everything that is not carried over exactly, reading included.
    """

    spec: mujoco.MjSpec
    couplings: Couplings | None = None
    paths: DocumentPaths | None = None
    forces: PassiveForces | None = None
    contacts: DocumentContacts | None = None
    coordinates: CoordinateMap | None = None
    muscles: str = ""
    meshes: Mapping[str, bytes] = field(default_factory=dict)
    notes: tuple[Note, ...] = ()

    @classmethod
    def load(cls, path: Path) -> "Bundle":
        """Return an MJCF file with what lies beside it; meshes stay where they are.

        Raises:
            ValueError: MuJoCo does not read the file, or one beside it is not what `save` writes.
            UnicodeDecodeError: The file is not in UTF-8.
        """
        spec = mujoco.MjSpec.from_file(str(path.absolute()))
        found: dict[str, Any] = {part.NAME: _beside(path, part) for part in PARTS}
        table = path.with_name(MUSCLES)
        if table.is_file() and (content := table.read_bytes()).startswith(OURS):
            try:
                found["muscles"] = content.decode()
            except UnicodeDecodeError as error:
                raise ForeignPartError(
                    f"file {str(table)!r} must be written in UTF-8; save it as that"
                ) from error
        return cls(spec=spec, **found)

    @property
    def parts(self) -> list[Sidecar]:
        """The parts that it has."""
        parts = self.couplings, self.paths, self.forces, self.contacts
        return [part for part in parts if part is not None]

    def touching(self, contact: str, path: Path) -> "Bundle":
        """Return it with contact as MuJoCo computes it, or as OpenSim does.

        Args:
            contact: "mujoco" or "opensim".
            path: Of the model, for the message.

        Raises:
            ForeignPartError: It is to be OpenSim's, and the model brings none.
        """
        if contact == "mujoco":
            return replace(self, contacts=None)
        if self.contacts is None:
            raise ForeignPartError(
                f"contact 'opensim' needs a {' or '.join(TYPES)} in the file; {str(path)!r} has none"
            )
        for geom in self.spec.geoms:
            geom.contype = geom.conaffinity = 0
        return self

    def into(self, spec: mujoco.MjSpec) -> mujoco.MjSpec:
        """Have the parts act in a spec, which is returned; those that it has already are replaced."""
        for part in self.parts:
            part.put_into(spec)
        return spec

    def check(self, model: mujoco.MjModel, path: Path) -> None:
        """Raise ValueError if a part names what the model has not; `path` is that of the model."""
        for part in self.parts:
            try:
                part.check(model)
            except ValueError as error:
                raise _foreign(path, type(part), error) from error

    def files(self, comment: str = "") -> dict[str, bytes]:
        """Return the files of its folder by name, the model last."""
        self.spec.meshdir = "meshes" if self.meshes else ""
        coordinates = None if self.coordinates is None else json.dumps(self.coordinates.as_json(), indent=1)
        return {
            **{f"meshes/{name}": content for name, content in self.meshes.items()},
            **({} if coordinates is None else {COORDINATES: coordinates.encode()}),
            **{part.FILE: part.text.encode() for part in self.parts},
            **({MUSCLES: self.muscles.encode()} if self.muscles else {}),
            MODEL: mjcf(self.spec, comment=comment).encode(),
        }

    def save(self, folder: Path, comment: str = "", more: Mapping[str, bytes] = {}) -> Path:
        """Write it into a folder, and more files before it; return the path of the model.

        Raises:
            OSError: A file cannot be written; those before are there as they were.
        """
        write(folder, {**more, **self.files(comment)}, instead_of=SIDECARS)
        return folder / MODEL


def _beside(path: Path, part: type[Sidecar]) -> Sidecar | None:
    """Return a part from its file beside a model, None for none."""
    file = path.with_name(part.FILE)
    if not file.is_file():
        return None
    try:
        return part.read(file.read_text())
    except ValueError as error:
        raise _foreign(path, part, error) from error


def _foreign(path: Path, part: type[Sidecar], error: ValueError) -> ValueError:
    """Return the error of a file that does not belong to a model."""
    return ForeignPartError(f"file {str(path.with_name(part.FILE))!r} must belong to {path.name}: {error}")


class ForeignPartError(ValueError):
    """A file beside a model is not the model's."""


def write(output: Path, files: Mapping[str, bytes], instead_of: Sequence[str] = ()) -> None:
    """Write files into a folder; when all are on the disk, they take their places in their order.

    Args:
        output: The folder.
        files: Contents by name.
        instead_of: Files of an earlier result, which go before.

    Raises:
        OSError: A file cannot be written; those before are there as they were.
    """
    for folder in dict.fromkeys((output / name).parent for name in files):
        make_folder(folder)
    with ExitStack() as places:
        for name in reversed(list(files)):  # the last one that is entered is the first that is moved
            places.enter_context(in_place(output / name)).write_bytes(files[name])
        for name in instead_of:
            (output / name).unlink(missing_ok=True)

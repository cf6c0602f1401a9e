"""Files of meshes that a document names, found without its being parsed."""

import re
from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import unescape

from myowarp.osim.document.read.element import decoded

MAX_PATH = 200  # characters of a file's name

FOLDERS = ("", "Geometry", "../Geometry")
"""Beside the model, where its meshes usually are."""
NAMED = re.compile("<(?:mesh_file|geometry_file|filename)>([^<]+)<")
"""Elements that name a mesh in the text of a document."""


def located(name: str, places: Sequence[Path]) -> tuple[Path, Path | None]:
    """Return a mesh file as a document names it, and where it is; None: nowhere."""
    file = Path(name.replace("\\", "/")[-MAX_PATH:])
    files = (place / part for place in places for part in (file, file.name))
    return file, next((path for path in files if path.is_file()), None)


def mesh_files(model: Path) -> list[Path]:
    """Return the mesh files of a model that are there; its document is not parsed, so that this is quick."""
    text, _ = decoded(model.read_bytes())
    names = dict.fromkeys(unescape(name.strip()) for name in NAMED.findall(text))
    places = [model.parent / folder for folder in FOLDERS]
    return [file for name in names if (file := located(name, places)[1]) is not None]

"""Groups of a model's components, such as the flexors of a hip, as the file names them."""

from pathlib import Path

from myowarp.osim.document.read.element import parse


def read_groups(path: Path) -> dict[str, tuple[str, ...]]:
    """Return the names of the members of each `ObjectGroup`, by its name.

    Raises:
        ValueError: The file is no document, with file and line.
        OSError: It cannot be read.
    """
    groups = (element for element in parse(path)[0].walk() if element.tag == "ObjectGroup")
    return {group.name: tuple(group.string("members").split()) for group in groups}

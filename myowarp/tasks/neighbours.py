"""Modules from files of the user's, each of which sees the files beside it.

Two folders may hold files of one name, such as `utils.py`. So an `import` in a file looks into the file's own
folder first, whenever it is executed, and the second `utils` of a process has another name in `sys.modules`.
Other ways to name a module, such as `pickle` or `importlib.import_module`, get the first one.
"""

from __future__ import annotations

import builtins
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import sys
import zlib
from collections.abc import Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from types import CodeType, ModuleType

from myowarp.disk import is_users

_FILES: dict[str, Path] = {}
"""Name of a module to its file, of a package to its folder."""
_NAMES: dict[Path, str] = {}
"""The latest name of each of them."""


def import_file(path: Path) -> ModuleType:
    """Run a file as a module of its own, once until it is edited; one that fails is forgotten."""
    _see(path.parent)
    name = _NAMES[path] = _name_of(path, path.read_bytes())
    return importlib.import_module(name)


def import_beside(folder: Path, name: str) -> ModuleType:
    """Import a module as a file in a folder does."""
    _see(folder)
    return importlib.import_module(_own(folder, name))


def _see(folder: Path) -> None:
    """Let what does not import by a statement find a folder, too."""
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))


@cache
def _name_of(path: Path, content: bytes = b"") -> str:
    """Return a name of its own for the module of a file: Warp clears kernels where a name comes again."""
    name = path.stem.replace(".", "_")
    if name in sys.modules or name in _FILES or name in sys.stdlib_module_names:
        name = f"{name}_{zlib.crc32(bytes(path) + content):x}"
    _FILES[name] = path
    return name


def _importing(
    folder: Path,
    name: str,
    globals: Mapping[str, object] | None = None,
    locals: Mapping[str, object] | None = None,
    fromlist: Sequence[str] | None = (),
    level: int = 0,
) -> ModuleType:
    """Import as Python does, but what lies in a folder under its own name."""
    own = _own(folder, name) if level == 0 else name
    return builtins.__import__(own, globals, locals, fromlist or (), level)


def _own(folder: Path, name: str) -> str:
    """Return the name in `sys.modules` of what a file in a folder calls `name`."""
    top, dot, rest = name.partition(".")
    return f"{_beside(folder, top) if top.isidentifier() else top}{dot}{rest}"


def _beside(folder: Path, name: str) -> str:
    """Return the name of a folder's own module or package in `sys.modules`; of another: its name."""
    if name in sys.stdlib_module_names:
        return name
    package, file = folder / name, folder / f"{name}.py"
    is_package = (package / "__init__.py").is_file()
    if is_package or not file.is_file():
        file = package
    if file in _NAMES:
        return _NAMES[file]
    if name in sys.modules and not _may_differ(name, file):
        return name
    if not is_package and not file.is_file():  # perhaps a folder without __init__.py, which Python takes last
        found = importlib.machinery.PathFinder.find_spec(name)
        if not any(file.glob("*.py")) or (found and found.origin and not is_users(Path(found.origin))):
            return name
    _NAMES[file] = _name_of(file, file.read_bytes() if file.is_file() else b"")
    return _NAMES[file]


def _may_differ(name: str, file: Path) -> bool:
    """Whether an imported module is the user's, and from another file or package."""
    if name in _FILES:
        return True
    origin = Path(getattr(sys.modules[name], "__file__", None) or "")
    return is_users(origin) and file not in (origin, origin.parent)


class _Finder(importlib.abc.MetaPathFinder):
    """Finds the modules of `_FILES`, and those inside of packages among them."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Return how a module is loaded; None: it is none of ours."""
        file = _FILES.get(fullname.partition(".")[0])
        if file is None:
            return None
        if path is not None:
            found = importlib.machinery.PathFinder.find_spec(fullname, path)
        elif file.suffix == ".py":
            found = importlib.util.spec_from_file_location(fullname, file)
        elif (file / "__init__.py").is_file():
            found = importlib.util.spec_from_file_location(fullname, file / "__init__.py")
        else:
            found = importlib.machinery.ModuleSpec(fullname, None, is_package=True)
            found.submodule_search_locations = [str(file)]
        if found is not None and isinstance(found.loader, importlib.machinery.SourceFileLoader):
            found.loader = _Loader(fullname, found.loader.path, file.parent)
        return found


class _Loader(importlib.machinery.SourceFileLoader):
    """Runs a file whose imports look into a folder first."""

    def __init__(self, fullname: str, path: str, folder: Path) -> None:
        super().__init__(fullname, path)
        self.folder = folder

    def get_code(self, fullname: str) -> CodeType:
        """Compile the file: what Python keeps of it does not tell two edits in one second apart."""
        return self.source_to_code(self.get_data(self.path), self.path)

    def exec_module(self, module: ModuleType) -> None:
        """Run the file; its functions keep the names that are built in, so that they import likewise."""
        vars(module)["__builtins__"] = vars(builtins) | {"__import__": partial(_importing, self.folder)}
        super().exec_module(module)


sys.meta_path.insert(0, _Finder())

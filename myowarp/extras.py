"""Extras of the package, and the command that installs one."""

import importlib.util

RELEASED = False
"""Whether PyPI has MyoWarp; until then it is installed from a clone. The one switch of all hints."""


def to_install(extra: str) -> str:
    """Return the command that installs an extra, as messages show it."""
    return f'`pip install "myowarp[{extra}]"`' if RELEASED else f'`pip install ".[{extra}]"` in the clone'


def check_installed(what: str, package: str, extra: str) -> None:
    """Raise ImportError if a package of an extra, which `what` needs, is not installed."""
    if importlib.util.find_spec(package) is None:
        raise ImportError(f"{what} needs {package}, which is not installed; run {to_install(extra)}")

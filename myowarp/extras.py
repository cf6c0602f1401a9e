"""Extras of the package, and the command that installs one."""

RELEASED = False
"""Whether PyPI has MyoWarp; until then it is installed from a clone. The one switch of all hints."""


def to_install(extra: str) -> str:
    """Return the command that installs an extra, as messages show it."""
    return f'`pip install "myowarp[{extra}]"`' if RELEASED else f'`pip install ".[{extra}]"` in the clone'

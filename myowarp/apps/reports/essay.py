"""Essays: texts in Markdown files beside the code, a section for each heading."""

import re
from functools import cache
from pathlib import Path


@cache
def sections(path: Path) -> dict[str, str]:
    """Return the text below each heading, in order; measured values have fields of `str.format` in it.

    Raises:
        OSError: The file cannot be read.
    """
    _, *parts = re.split(r"^#+ (.*)$", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return dict(zip(parts[::2], (text.strip() for text in parts[1::2]), strict=True))

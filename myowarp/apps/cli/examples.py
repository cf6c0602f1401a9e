"""The command `myowarp examples`: what comes with the package to be run and changed."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from myowarp.apps.cli.options import Overwrite
from myowarp.disk import check_folder, check_overwrite, in_place, make_folder, shipped

LIST = "README.md"
"""Says of each example what it shows and how it is run."""


@dataclass
class Examples:
    """List the examples that come with the package, or copy them into a folder.

    An OpenSim model, a table of patients, a study, tasks of one's own, and training with five libraries.

    Example: myowarp examples --copy
    """

    copy: bool = False
    """Copy them, to be run and changed."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("examples")
    """Folder to copy them to."""
    overwrite: Overwrite = False

    def __call__(self) -> None:
        """List or copy."""
        folder = shipped("examples")
        if not self.copy:
            for name, shows, line in examples():
                print(f"{name:24s} {shows}\n{'':24s}   {line}")
            print("\nmyowarp examples --copy   writes them into the folder examples")
            return
        files = [folder / LIST, *(folder / name for name, _, _ in examples())]
        check_folder(self.output)
        check_overwrite((self.output / file.name for file in files), self.overwrite)
        make_folder(self.output)
        for file in files:
            with in_place(self.output / file.name) as scratch:
                scratch.write_bytes(file.read_bytes())
        Console(stderr=True, highlight=False, soft_wrap=True).print(
            f"Copied {len(files)} files to {self.output}; {self.output / LIST} says how each is run"
        )


def examples() -> list[tuple[str, str, str]]:
    """Return of each example its file, what it shows, and how it is run."""
    text = (shipped("examples") / LIST).read_text(encoding="utf-8")
    return re.findall(r"^\| \[(\S+)\]\(\1\) \| (.*?) \| `(.*?)` \|$", text, re.M)

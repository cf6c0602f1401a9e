"""The documentation site: Sphinx reads the pages here, and `task_pages.py` writes one for each task id."""

import re
import shutil
import sys
from pathlib import Path

from sphinx.application import Sphinx

import myowarp
from myowarp.apps.cli.options import Said
from myowarp.apps.cli.record import Record
from myowarp.definitions.setup import Setup

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))

project, author, copyright = "MyoWarp", "MyoWarp contributors", "MyoWarp contributors, Apache-2.0"
version = release = myowarp.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "task_pages"]
exclude_patterns = ["audit/README.md"]
html_theme = "furo"
html_title = "MyoWarp"
default_role = "code"  # what stands in single backticks in a docstring
myst_heading_anchors = 3
autodoc_member_order = "bysource"


def of_repository(app: Sphinx, page: str, source: list[str]) -> None:
    """Bring CONTRIBUTING into the site; its links into the repository become text.

    Pages of experiments are reached from the one that compares them, and are not in the navigation.
    """
    if page.startswith("experiments/"):
        source[0] = "---\norphan: true\n---\n\n" + source[0]
    if page == "extending":
        text = (DOCS.parent / "CONTRIBUTING.md").read_text()
        source[0] = re.sub(r"\[([^\]]+)\]\((?!http)[^)]*\)", r"\1", text)
    source[0] = source[0].replace("](../CONTRIBUTING.md", "](extending.md")


def add_audit(app: Sphinx, error: Exception | None) -> None:
    """Put the audit's page, which needs nothing else, beside the others."""
    shutil.copy(DOCS / "audit/index.html", Path(app.outdir) / "audit.html")


def add_recording(app: Sphinx, error: Exception | None) -> None:
    """Put a hand that the reader turns beside the start page, unless it is there."""
    path = Path(app.outdir) / "hand.html"
    if error is None and not path.exists():
        task = Setup(task="myoHandKeyTurnFixed-v0", device="cpu", seed=1)
        Record(Said(task), policy="baseline", output=path, steps=80)()


def setup(app: Sphinx) -> None:
    """Register with Sphinx."""
    app.connect("source-read", of_repository)
    app.connect("build-finished", add_audit)
    app.connect("build-finished", add_recording)

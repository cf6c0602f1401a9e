"""The documentation site: Sphinx reads the pages here, and `task_pages.py` writes one for each task id."""

import html
import re
import shutil
import sys
import textwrap
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx

import myowarp

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))

project, author, copyright = "MyoWarp", "MyoWarp contributors", "MyoWarp contributors, Apache-2.0"
version = release = myowarp.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "task_pages", "recordings"]
exclude_patterns = ["audit/README.md"]
html_theme = "furo"
html_title = "MyoWarp"
html_static_path = ["static"]
html_css_files, html_js_files = ["pages.css"], ["copy.js"]
default_role = "code"  # what stands in single backticks in a docstring
myst_heading_anchors = 3
autodoc_member_order = "bysource"
LONG = 17  # rows of a table that is folded
NAME = re.compile(r"^- `([\w.]+)`(, with .*|: .*)?$", re.M)
"""A name in the list of the reference, with its members or what it is."""
DESCRIPTION = 160  # characters that search engines show


def of_repository(app: Sphinx, page: str, source: list[str]) -> None:
    """Bring CONTRIBUTING into the site; its links into the repository become text.

    Pages of experiments are reached from the one that compares them, and are not in the navigation.
    """
    if page.startswith("experiments/"):
        source[0] = "---\norphan: true\n---\n\n" + source[0]
    if page == "extending":
        text = (DOCS.parent / "CONTRIBUTING.md").read_text()
        source[0] = re.sub(r"\[([^\]]+)\]\((?!http)[^)]*\)", r"\1", text)
    if page == "reference":
        source[0] = NAME.sub(documented, source[0])
    source[0] = source[0].replace("](../CONTRIBUTING.md", "](extending.md")


def documented(item: re.Match[str]) -> str:
    """Return a name in the list of the reference as its documentation: docstring, members that are named."""
    name, more = item[1] if item[1].startswith("myowarp.") else f"myowarp.{item[1]}", item[2] or ""
    if more.startswith(":"):
        said = f".. data:: {name}\n\n   {more[2].upper()}{more[3:]}."
    else:
        kind = "autofunction" if name.rpartition(".")[2][0].islower() else "autoclass"
        members = ", ".join(re.findall(r"`(\w+)`", more))
        said = f".. {kind}:: {name}" + (f"\n   :members: {members}" if more else "")
    return f"```{{eval-rst}}\n{said}\n```\n"


def add_audit(app: Sphinx, error: Exception | None) -> None:
    """Put the audit's page, which needs nothing else, beside the others."""
    shutil.copy(DOCS / "audit/index.html", Path(app.outdir) / "audit.html")


def fold(app: Sphinx, doctree: nodes.document, page: str) -> None:
    """Fold long tables, so that figures and text are seen first; lists of tasks stay open."""
    for table in list(doctree.findall(nodes.table)):
        rows = sum(1 for body in table.findall(nodes.tbody) for _ in body.findall(nodes.row))
        if rows >= LONG and not page.startswith("tasks/"):
            begin = f"<details class='folded'><summary>Table, {rows} rows</summary>"
            around = [nodes.raw("", text, format="html") for text in (begin, "</details>")]
            table.replace_self([around[0], table.deepcopy(), around[1]])


def describe(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: nodes.document) -> None:
    """Tell search engines what a page is about: its first paragraph, unless it says so itself."""
    if (
        doctree is None
        or "html_meta" in app.env.metadata.get(page, {})
        or 'name="description"' in (context.get("metatags") or "")
    ):
        return
    paragraphs = (" ".join(node.astext().split()) for node in doctree.findall(nodes.paragraph))
    first = next((text for text in paragraphs if len(text) > 40), "")
    text = textwrap.shorten(f"MyoWarp: {context['title']}. {first}", DESCRIPTION, placeholder=" …")
    context["metatags"] = (
        f'{context.get("metatags", "")}\n<meta name="description" content="{html.escape(text)}">'
    )


def setup(app: Sphinx) -> None:
    """Register with Sphinx."""
    app.connect("source-read", of_repository)
    app.connect("build-finished", add_audit)
    app.connect("doctree-resolved", fold)
    app.connect("html-page-context", describe)

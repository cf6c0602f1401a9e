"""The command `myowarp demo`: a trained hand in the browser, with nothing to choose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from rich.console import Console

from myowarp.apps.cli.options import Said, optional
from myowarp.apps.cli.view import PORT, View
from myowarp.definitions.setup import Setup
from myowarp.disk import shipped

TASK = "myoHandKeyTurnFixed-v0"
FILM = "docs/pictures/demo.gif"


@dataclass
class Demo:
    """Open a page where a trained hand turns a key, with sliders that weaken its muscles.

    Nothing is trained and no GPU is needed. The first start compiles kernels for about a minute.

    Example: myowarp demo
    """

    port: Annotated[int | None, optional("INT")] = None
    """Port of the page on this machine; by default 8080, or a free one where that is taken."""

    def __call__(self) -> None:
        """Open the page; without what it needs, name the film."""
        from myowarp.view.modes import check_viser, has_browser

        console = Console(stderr=True, highlight=False, soft_wrap=True)
        if not has_browser():
            console.print(f"No browser opens from here. A film of the same hand: {shipped(FILM)}")
        check_viser("myowarp demo")
        View(Said(Setup(task=TASK)), policy="baseline", port=self._port(), browser=True)()

    def _port(self) -> int:
        """Return the port to use."""
        from myowarp.view.browser.server import check_port

        if self.port is not None:
            return self.port
        try:
            check_port(PORT)
        except OSError:
            return 0
        return PORT

"""Progress bars of long work, all alike, on the error stream, which leaves the output to pipe."""

import contextlib
import threading
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


def progress_bar(title: str, unit: str, console: Console | None = None) -> Progress:
    """Return a progress bar that counts units; `unit` may show fields of the bar's task."""
    return Progress(
        TextColumn(f"[bold]{title}[/bold]"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TimeRemainingColumn(elapsed_when_finished=True),
        console=console or Console(stderr=True),
    )


LISTENERS: list[Callable[[str, int, int], None]] = []
"""Told of what patient bars count: their title, how many units are done, and how many there are."""


@contextlib.contextmanager
def listening(listener: Callable[[str, int, int], None]) -> Iterator[None]:
    """Have what happens in the block told to a function, as in `LISTENERS`; a page shows it."""
    LISTENERS.append(listener)
    try:
        yield
    finally:
        LISTENERS.remove(listener)


@contextlib.contextmanager
def patient_bar(
    title: str, unit: str, total: int, *, patience: float, show: bool = True
) -> Iterator[Callable[[int], None]]:
    """Draw a progress bar once the block takes longer than `patience` [s], never if not `show`.

    Yields:
        A function that says how many more units are done.
    """
    bar = progress_bar(title, unit)
    task = bar.add_task("", total=total)

    def advance(count: int) -> None:
        bar.advance(task, count)
        for listener in LISTENERS:
            listener(title, int(bar.tasks[0].completed), total)

    def begin() -> None:
        bar.start()
        if not bar.console.is_terminal:  # there the bar is drawn at its end alone
            bar.console.print(f"{title}: {int(bar.tasks[0].completed)} of {total} {unit} so far")

    # The first unit may take long itself.
    start = threading.Timer(patience, begin)
    start.daemon = True
    if show:
        start.start()
    try:
        yield advance
    finally:
        start.cancel()
        if show and start.is_alive():
            start.join()
        if bar.live.is_started:
            bar.stop()

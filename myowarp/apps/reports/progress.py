"""Progress of a run: a live line, a row of `progress.csv`, and scalars of TensorBoard and W&B."""

from __future__ import annotations

import contextlib
import csv
import itertools
import math
import os
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.text import Text
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from myowarp.apps.reports.curve import CSV
from myowarp.apps.reports.evaluation import SUCCESSES
from myowarp.disk import NUMBER, in_place

FIRST = "samples,"
PARTS = ("simulation", "learner", "rest")
REFRESH = 0.25  # s between changes of the live line
LINE_EVERY = 10.0  # s between lines where the error stream is no terminal


class Progress:
    """Files and live line of a run; use it as a context."""

    def __init__(
        self,
        folder: Path,
        total: int,
        console: Console,
        *,
        after: int = 0,
        wandb: Mapping[str, Any] | None = None,
    ) -> None:
        """Open the files.

        Args:
            folder: Folder of the run.
            total: Samples of the whole run.
            console: Where the live line is drawn.
            after: Samples of the checkpoint that is resumed; later rows are dropped.
            wandb: Settings that Weights & Biases is told; None: it gets no scalars.

        Raises:
            OSError: The files cannot be written.
            ValueError: Those of a resumed run were changed.
        """
        self.total, self.console = total, console
        head, *kept = _rows_until(folder / CSV, after) or [""]
        # Torch writes events in a thread, whose errors nobody catches.
        name = f"events.out.tfevents.{int(time.time())}.{socket.gethostname()}.{os.getpid()}"
        self._events = RecordWriter((folder / name).open("wb"))
        self._event(file_version="brain.Event:2")
        if after:  # what comes replaces what others say
            self._event(step=after + 1, session_log=SessionLog(status=SessionLog.START))
        with in_place(folder / CSV) as scratch, scratch.open("w", newline="", encoding="utf-8") as file:
            file.writelines([head, *kept])
        self._file = (folder / CSV).open("a", newline="", encoding="utf-8")
        columns = next(csv.reader([head]), [])
        self._rows = csv.DictWriter(self._file, columns, restval="", extrasaction="ignore")
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._begin, self._after, self._shown = time.monotonic(), after, 0.0
        self._wandb: Any = None
        if wandb is not None:
            import wandb as service

            self._wandb = service.init(name=folder.name, config=dict(wandb), dir=str(folder))

    def __enter__(self) -> Progress:
        if self.console.is_terminal:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live.is_started:
            self._live.stop()
        again = () if error is None else (OSError,)  # a full disk refuses the rest of a buffer once more
        with contextlib.suppress(*again):
            self._file.close()
            self._events.close()
        if self._wandb is not None:
            self._wandb.finish()

    def add(self, row: Mapping[str, float]) -> None:
        """Write the figures of an iteration, and show them now and then.

        Args:
            row: Name to number; `samples`, `return` and the successes are shown.

        Raises:
            OSError: The files cannot be written.
        """
        if not self._rows.fieldnames:  # the first row names the columns
            self._rows.fieldnames = [*row]
            self._rows.writeheader()
        self._rows.writerow(row)
        step = int(row["samples"])
        values = [Summary.Value(tag=n, simple_value=v) for n, v in row.items() if n != "samples" and v == v]
        self._event(step=step, summary=Summary(value=values))
        if self._wandb is not None:
            self._wandb.log(dict(row), step=step)
        now, every = time.monotonic(), REFRESH if self.console.is_terminal else LINE_EVERY
        if now - self._shown < every:
            return
        self._shown = now
        self.flush()
        text = self._line(row)
        if self._live.is_started:
            self._live.update(text, refresh=True)
        else:
            self.console.print(text)

    def flush(self) -> None:
        """Hand over what was written; the rows of a checkpoint come before the checkpoint.

        Raises:
            OSError: It cannot be written.
        """
        self._file.flush()
        self._events.flush()

    def _event(self, **entries: Any) -> None:
        """Write an event for TensorBoard."""
        self._events.write(Event(wall_time=time.time(), **entries).SerializeToString())

    def _line(self, row: Mapping[str, float]) -> Text:
        """Return the live line; in a terminal the parts that fit its width, the most important ones first."""
        done, seconds = row["samples"] - self._after, time.monotonic() - self._begin
        left = int(seconds * max(self.total - row["samples"], 0) / max(done, 1))
        success, last, some = (100 * row[name] for name in SUCCESSES)
        ended = row["return"] == row["return"]
        parts = [
            f"{row['samples'] / 1e6:.2f} of {self.total / 1e6:.2f} M samples",
            f"{left // 60}:{left % 60:02d} left",
            f"success {success:.0f} %" if ended else "no episode has ended yet",
            *([f"return {row['return']:.1f}"] if ended else []),
            f"{done / max(seconds, 1e-9):,.0f} samples/s",
            *([f"solved on the last step {last:.0f} %, on any {some:.0f} %"] if ended else []),
            ", ".join(f"{part} {100 * row[f'share_{part}']:.0f} %" for part in PARTS) + " of the time",
        ]
        line, width = parts[0], self.console.width if self.console.is_terminal else math.inf
        for part in parts[1:]:
            if len(line) + 2 + len(part) > width:
                break
            line += f"  {part}"
        return Text(line)


def _rows_until(path: Path, samples: int) -> list[str]:
    """Return the lines of a CSV up to a number of samples, its first column.

    Lines that were cut, or that a disk has lost, are left out.

    Raises:
        ValueError: The names of the columns are not there.
    """
    if not samples or not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        head, *rows = [line for line in file if line.endswith("\n")] or [""]
    if head and not head.startswith(FIRST):
        raise ValueError(
            f"{str(path)!r} must begin with the names of its columns, samples first, got {head[:40]!r}; "
            "restore it, or move it away, and resume again"
        )
    firsts = [row.partition(",")[0] for row in rows]
    kept = [bool(NUMBER.fullmatch(first)) and float(first) <= samples for first in firsts]
    return [head, *itertools.compress(rows, kept)]

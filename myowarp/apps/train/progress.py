"""Progress of a run: a live line, a row of `progress.csv` and TensorBoard scalars, and the curve."""

from __future__ import annotations

import contextlib
import csv
import importlib.util
import os
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.text import Text

from myowarp.apps.reports import panel
from myowarp.apps.reports.evaluation import SUCCESSES
from myowarp.apps.reports.table import read_numbers
from myowarp.disk import in_place

CSV, CURVE = "progress.csv", "curve.png"
PARTS = ("simulation", "learner", "rest")
SELECTED = "means under parity (selection)"
REFRESH = 0.25  # s between changes of the live line
LINE_EVERY = 10.0  # s between lines where the error stream is no terminal


def check_wandb() -> None:
    """Raise ImportError if Weights & Biases is not installed."""
    if importlib.util.find_spec("wandb") is None:
        raise ImportError("--wandb needs wandb, which is not installed; run `pip install wandb`")


class _Events:
    """A file of TensorBoard's; torch writes one in a thread, whose errors nobody catches."""

    def __init__(self, folder: Path, after: int) -> None:
        """Open a file in a folder; from the step after `after` on, it replaces what others say."""
        from tensorboard.compat.proto.event_pb2 import SessionLog
        from tensorboard.summary.writer.record_writer import RecordWriter

        name = f"events.out.tfevents.{int(time.time())}.{socket.gethostname()}.{os.getpid()}"
        self._records = RecordWriter((folder / name).open("wb"))
        self._write(file_version="brain.Event:2")
        if after:
            self._write(step=after + 1, session_log=SessionLog(status=SessionLog.START))

    def add(self, row: Mapping[str, float], step: int) -> None:
        """Write the numbers of a row that are none of NaN."""
        from tensorboard.compat.proto.summary_pb2 import Summary

        values = [Summary.Value(tag=n, simple_value=v) for n, v in row.items() if n != "samples" and v == v]
        self._write(step=step, summary=Summary(value=values))

    def flush(self) -> None:
        """Hand over what was written."""
        self._records.flush()

    def close(self) -> None:
        """Hand over what was written, and close the file."""
        self._records.close()

    def _write(self, **entries: Any) -> None:
        """Write an event."""
        from tensorboard.compat.proto.event_pb2 import Event

        self._records.write(Event(wall_time=time.time(), **entries).SerializeToString())


class Progress:
    """Files and live line of a run; use it as a context."""

    def __init__(self, folder: Path, total: int, console: Console, *, after: int = 0) -> None:
        """Open the files.

        Args:
            folder: Folder of the run.
            total: Samples of the whole run.
            console: Where the live line is drawn.
            after: Samples of the checkpoint that is resumed; later rows are dropped.

        Raises:
            OSError: The files cannot be written.
        """
        self.folder, self.total, self.console = folder, total, console
        kept = _rows_until(folder / CSV, after)
        self._events = _Events(folder, after)
        columns = list(kept[0]) if kept else []
        with in_place(folder / CSV) as scratch, scratch.open("w", newline="") as file:
            rows = csv.DictWriter(file, columns)
            rows.writerows([dict(zip(columns, columns, strict=True)), *kept] if kept else [])
        self._file = (folder / CSV).open("a", newline="")
        self._rows = csv.DictWriter(self._file, columns, restval="", extrasaction="ignore") if kept else None
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._wandb: Any = None
        self._begin, self._after, self._shown = time.monotonic(), after, 0.0

    def start_wandb(self, name: str, settings: Mapping[str, Any]) -> None:
        """Send the scalars to Weights & Biases too."""
        import wandb

        self._wandb = wandb.init(name=name, config=dict(settings), dir=str(self.folder))

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
        self._write_row(row)
        step = int(row["samples"])
        self._events.add(row, step)
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

    def _write_row(self, row: Mapping[str, Any]) -> None:
        """Append a row; the first one names the columns."""
        if self._rows is None:
            self._rows = csv.DictWriter(self._file, list(row), restval="", extrasaction="ignore")
            self._rows.writeheader()
        self._rows.writerow(row)

    def _line(self, row: Mapping[str, float]) -> Text:
        """Return the live line."""
        done = row["samples"] - self._after
        seconds = time.monotonic() - self._begin
        left = seconds * (self.total - row["samples"]) / max(done, 1)
        success = "success {:.0f} % (last step {:.0f}, any step {:.0f})".format(
            *(100 * row[name] for name in SUCCESSES)
        )
        shares = " ".join(f"{part} {100 * row[f'share_{part}']:.0f}" for part in PARTS)
        return Text(
            f"{row['samples'] / 1e6:.2f} of {self.total / 1e6:.2f} M samples  return {row['return']:.1f}  "
            f"{success}  {done / max(seconds, 1e-9):,.0f}/s  {shares} %  "
            f"{int(left) // 60}:{int(left) % 60:02d} left"
        )


def _rows_until(path: Path, samples: int) -> list[dict[str, str]]:
    """Return the rows of a CSV up to a number of samples; rows that were not written whole are left out."""
    if not samples or not path.is_file():
        return []
    with path.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if None not in row.values() and row["samples"]]
    return [row for row in rows if float(row["samples"]) <= samples]


def draw_curve(folder: Path, title: str) -> Path | None:
    """Draw return and success over samples into the run's folder; None without matplotlib or episodes."""
    if importlib.util.find_spec("matplotlib") is None:
        return None
    columns = read_numbers(folder / CSV)
    if "return" not in columns:
        return None
    known = np.isfinite(columns["return"])
    samples = columns["samples"][known] / 1e6
    with panel.style(10.0):
        figure = panel.blank(8.0, 3.2)
        left, right = figure.subplots(1, 2)
        left.plot(samples, columns["return"][known])
        left.set(xlabel="samples [million]", ylabel="return")
        for name, rule in SUCCESSES.items():
            right.plot(samples, 100.0 * columns[name][known], label=rule)
        chosen = columns.get("selection_success", np.full(len(known), np.nan))[known]
        if np.isfinite(chosen).any():
            right.plot(samples, 100.0 * chosen, "k", drawstyle="steps-post", label=SELECTED)
        right.set(xlabel="samples [million]", ylabel="success [%]", ylim=(-2, 102))
        right.legend(fontsize="small")
        figure.suptitle(title, fontsize="medium")
        panel.save(figure, folder / CURVE, dpi=150)
    return folder / CURVE

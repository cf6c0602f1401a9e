"""The work of `myowarp motion study`: solve the draws of all trials in parts, and report their spread.

    out/settings.json                        what the results depend on
    out/results/part-00000.parquet           a row for each trial, draw and time
    out/summary/part-00000.parquet           a row for each trial and draw, written last
    out/failed.csv                           trials that could not be solved, and why
    out/trials/NAME/forces.sto               the trial as it is; forces_low.sto, forces_high.sto: of draws
    out/trials/NAME/forces.png

What is there is not done again, unless files or row of its trial changed.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from myowarp.apps.reports.panel import band, grid, save, style
from myowarp.apps.studies.cluster import connected, each
from myowarp.apps.studies.motion.plan import Piece, Study, plan_study, recording_of
from myowarp.apps.studies.parts import LOCK, RESULTS, SUMMARY, agree, part, remove_damaged
from myowarp.disk import check_folder, in_place, locked, make_folder, sentence, write_rows
from myowarp.extras import check_installed
from myowarp.inks import BLUE
from myowarp.motion.draws import Drawn, Recording, draw_trial
from myowarp.motion.residuals import SMALL, Residuals
from myowarp.motion.results import MISSING, RESERVES
from myowarp.motion.storage import Storage, write_storage
from myowarp.process import num_cores
from myowarp.progress import progress_bar

if TYPE_CHECKING:
    import pandas as pd

SHOWN = 3
"""The worst trials, which are named."""
STRONGEST, COLUMNS = 24, 6
"""Muscles in the picture of a trial, and how many of them side by side."""
FRAMES = 4096
"""Frames that are solved together, unless one draw has more."""
LOW, HIGH = 0.05, 0.95
"""Quantiles that intervals have as ends."""
QUANTITIES = {
    "angle": ("angles", "joint angles, rad and m"),
    "moment": ("moments", "joint moments, N m and N"),
    "activation": ("activations", "activations"),
    "force": ("forces", "forces of muscles, N"),
    "reserve": ("reserves", RESERVES),
    "missing": ("missing", MISSING),
}
"""First part of a column of the results: file, and what it is."""


@dataclass(frozen=True)
class Cluster:
    """A Ray cluster that a study is solved on.

    Attributes:
        address: Host and port of its head, or "auto"; None: one on this machine alone.
        cpus: Cores of each part.
    """

    address: str | None = None
    cpus: int = 1


def run(
    table: Path, output: Path, console: Console, cluster: Cluster | None = None, **settings: Any
) -> list[Path]:
    """Do what is missing of a study; return the folders of its trials.

    Args:
        table: Of trials.
        output: Folder.
        console: Where progress is shown.
        cluster: Where parts are solved; None: in this process. Every node must see table and output.
        settings: As in `plan_study`.

    Raises:
        ValueError: The table is wrong, or the folder holds another study; nothing was started.
        RuntimeError: Trials failed; all others are done.
        OSError: The output cannot be written.
    """
    check_folder(output)
    study, output = plan_study(table.resolve(), **settings), output.resolve()
    if cluster is not None:
        check_installed("a study over a cluster", "ray", "ray")
    for folder in (RESULTS, SUMMARY):
        make_folder(output / folder)
    with locked(output / LOCK, wait=False):
        agree(output, "motion study", study.settings())
        every = study.pieces()
        if damaged := remove_damaged(output, (piece.keys for piece in every)):
            console.print(f"{damaged} parts in {output} are damaged or of other files, and done again")
        missing = [piece for piece in every if not part(output, SUMMARY, piece.number).exists()]
        failures: dict[str, str] = {}
        with progress_bar("Solving", "parts", console) as bar:
            task = bar.add_task("", total=len(every), completed=len(every) - len(missing))
            each_part: Callable[[Study, list[Piece], Path], Iterator[tuple[int, str]]]
            each_part = _each if cluster is None else partial(_over, cluster)
            for number, why in each_part(study, missing, output):
                if why:
                    failures.setdefault(every[number].trial.name, why)
                else:
                    bar.advance(task)
        done = [trial for trial in study.trials if trial.name not in failures]
        folders = [
            spread(output, trial.name, [piece.number for piece in every if piece.trial is trial])
            for trial in done
        ]
        write_rows(output / "failed.csv", [("trial", "why"), *failures.items()])
    total = len(study.trials)
    own = [(piece.trial.name, piece.number) for piece in every if 0 in piece.draws and piece.trial in done]
    for line in doubts(output, own):
        console.print(line, markup=False)
    console.print(
        f"Saved {len(done)} of {total} trials, each with {study.draws} draws, in {output}", markup=False
    )
    if failures:
        name, why = next(iter(failures.items()))
        raise RuntimeError(
            f"{len(failures)} of {total} trials failed, such as {name!r}: {why}; the others are done, and "
            "the same command tries these again"
        )
    return folders


def _each(study: Study, missing: list[Piece], output: Path) -> Iterator[tuple[int, str]]:
    """Do parts, on all cores; yield the number of each as it ends, and why it failed, "" if it did not."""
    with ThreadPoolExecutor(num_cores()) as pool:
        waiting: dict[Future[None], int] = {}
        for _, group in groupby(missing, lambda piece: piece.trial.name):
            own = list(group)
            reading = pool.submit(recording_of, own[0].trial, study)
            waiting |= {pool.submit(solve, reading.result, study, output, one): one.number for one in own}
        try:
            for future in as_completed(waiting):
                error = future.exception()
                if error is not None and not isinstance(error, ValueError | NotImplementedError | OSError):
                    raise error
                yield waiting[future], "" if error is None else " ".join(sentence(error).split())
        finally:
            pool.shutdown(cancel_futures=True)


def _over(cluster: Cluster, study: Study, missing: list[Piece], output: Path) -> Iterator[tuple[int, str]]:
    """Do parts over a cluster; yield as `_each` does."""
    if not missing:
        return
    own = [(str(piece.number), (study, output, piece)) for piece in missing]
    with connected(cluster.address, output):
        for name, _, why in each(solve_there, own, folder=output, cpus=cluster.cpus):
            yield int(name), why


_last: dict[str, Recording] = {}
"""The trial that a worker has read last, by its digest: its parts follow each other."""


def solve_there(study: Study, output: Path, piece: Piece) -> None:
    """Solve a part of a trial and write it; on a node.

    Raises:
        As `solve`.
    """

    def reading() -> Recording:
        if piece.inputs not in _last:
            _last.clear()
            _last[piece.inputs] = recording_of(piece.trial, study)
        return _last[piece.inputs]

    if not part(output, SUMMARY, piece.number).exists():
        solve(reading, study, output, piece)


def solve(reading: Callable[[], Recording], study: Study, output: Path, piece: Piece) -> None:
    """Solve a part of a trial and write it; `reading` returns the trial, whose files are read once.

    Raises:
        ValueError: The trial is not what it should be.
        NotImplementedError: Its model has something that is not supported.
        OSError: A file cannot be read or written.
    """
    import pandas as pd

    recording, tables = reading(), []
    few = max(1, FRAMES // len(recording.time))
    for begin in range(0, len(piece.draws), few):
        draws = piece.draws[begin : begin + few]
        found = draw_trial(recording, piece.trial.uncertain, draws, study.seed)
        keys = replace(piece, draws=draws).keys
        tables.append((_results(piece.trial.name, recording, found), _summary(keys, recording, found)))
    for folder, frames in zip((RESULTS, SUMMARY), zip(*tables, strict=True), strict=True):
        with in_place(part(output, folder, piece.number)) as scratch:
            pd.concat(frames, ignore_index=True).to_parquet(scratch, index=False)


def _results(name: str, recording: Recording, found: Drawn) -> pd.DataFrame:
    """Return one row for each draw and time."""
    import pandas as pd

    count, coordinates, forces = len(found.draws), recording.bones.coordinates, found.forces
    columns: dict[str, Any] = {
        "trial": pd.Categorical([name] * count * len(recording.time)),
        "draw": np.repeat(found.draws.astype(np.int32), len(recording.time)),
        "time": np.tile(recording.time, count),
    }
    for what, names, values in (
        ("angle", coordinates, found.values),
        ("moment", coordinates, found.joint_moment),
        ("activation", found.muscles, forces.activation),
        ("force", found.muscles, forces.force),
        ("reserve", coordinates, forces.reserve),
        ("missing", coordinates, forces.missing),
    ):
        rows = values.reshape(-1, len(names)).astype(np.float32)
        columns |= {f"{what}.{one}": rows[:, k] for k, one in enumerate(names)}
    return pd.DataFrame(columns)


def _summary(keys: dict[str, list[Any]], recording: Recording, found: Drawn) -> pd.DataFrame:
    """Return one row for each draw: how well it fits, and what muscles cannot do."""
    import pandas as pd

    count, forces = len(found.draws), found.forces
    shape = count, len(recording.time), -1
    force = forces.force.reshape(shape)
    roots = [Residuals.of(recording.bones, recording.time, moments) for moments in found.joint_moment]
    columns: dict[str, Any] = {
        **keys,
        "marker_rms": found.marker_rms,
        "feasible_share": forces.feasible.reshape(count, -1).mean(axis=1),
        "most_missing": np.abs(forces.missing.reshape(shape)).max(axis=(1, 2)),
        "most_reserve": np.abs(forces.reserve.reshape(shape)).max(axis=(1, 2)),
        "root_force": [left.force[0] for left in roots],
        "root_moment": [left.moment[0] for left in roots],
        "root_force_per_weight": [left.force[0] / left.weight if left.weight else 0.0 for left in roots],
    }
    peaks = {f"peak_force.{muscle}": force[:, :, k].max(axis=1) for k, muscle in enumerate(found.muscles)}
    return pd.DataFrame(columns | peaks)


def doubts(output: Path, trials: list[tuple[str, int]]) -> list[str]:
    """Return residuals, and frames that muscles cannot hold, of the worst trials as they are.

    Args:
        output: Folder of the study.
        trials: Name of each, and number of its part that has draw 0.
    """
    from pyarrow import parquet

    columns = "root_force_per_weight", "root_force", "feasible_share"
    rows: list[tuple[float, float, float, str]] = []
    for name, number in trials:
        table = parquet.read_table(part(output, SUMMARY, number))
        if columns[0] in table.column_names:  # not in parts of before
            first = table.column("draw").to_pylist().index(0)
            share, force, held = (table.column(column)[first].as_py() for column in columns)
            rows.append((share, force, held, name))
    rows.sort(key=lambda row: (-row[0], row[2]))
    lines = []
    for share, force, held, name in rows[:SHOWN]:
        if force:
            check = ": check its loads, filter and model" if share > SMALL else ""
            lines.append(
                f"{name}: residuals at the root {force:.0f} N ({100.0 * share:.0f} % of the weight){check}"
            )
        if held < 1.0:
            lines.append(f"{name}: muscles cannot hold {100.0 * (1.0 - held):.0f} % of the frames")
    return lines


def spread(output: Path, trial: str, parts: list[int]) -> Path:
    """Write the trial as it is and the ends of its intervals, and draw its forces; return its folder."""
    from pyarrow import parquet

    folder = output / "trials" / trial
    make_folder(folder)
    files = [part(output, RESULTS, k) for k in parts]
    keys = [parquet.read_table(file, columns=["draw", "time"]) for file in files]
    draw = np.concatenate([np.asarray(table["draw"]) for table in keys])
    time = np.concatenate([np.asarray(table["time"]) for table in keys])[draw == 0]
    names = parquet.read_schema(files[0]).names
    for what, (file_name, title) in QUANTITIES.items():
        columns = [name for name in names if name.startswith(f"{what}.")]
        tables = [parquet.read_table(file, columns=columns) for file in files]
        values = np.stack([np.concatenate([np.asarray(t[name]) for t in tables]) for name in columns], axis=1)
        drawn = values[draw > 0].reshape(-1, len(time), len(columns))
        found = {"": values[draw == 0]}
        if len(drawn):
            low, high = np.quantile(drawn, (LOW, HIGH), axis=0)
            found |= {"_low": low, "_high": high}
        labels = tuple(name.partition(".")[2] for name in columns)
        for end, rows in found.items():
            write_storage(folder / f"{file_name}{end}.sto", title, Storage(labels, time, rows))
        if what == "force":
            draw_forces(folder / "forces.png", trial, labels, time, list(found.values()))
    return folder


def draw_forces(
    path: Path, trial: str, muscles: Sequence[str], time: np.ndarray, lines: Sequence[np.ndarray]
) -> None:
    """Draw the forces of the strongest muscles over time, with intervals over draws; not without matplotlib.

    Args:
        path: A .png file.
        trial: Name, for the title.
        muscles: Names.
        time: [s], shape (frames,).
        lines: Forces of the trial as it is [N], shape (frames, muscles), and both ends of intervals.

    Raises:
        OSError: The file cannot be written.
    """
    if importlib.util.find_spec("matplotlib") is None:
        return
    chosen = np.argsort(-lines[0].max(axis=0), kind="stable")[:STRONGEST]
    columns = min(COLUMNS, len(chosen))
    with style():
        figure, panels = grid(len(chosen), columns, 2.4 * columns, 1.7, 0.5, sharex=True)
        for axes, k in zip(panels, chosen, strict=True):
            middle, low, high = (lines[n if len(lines) > 1 else 0][:, k] for n in (0, 1, 2))
            band(axes, time, (low, middle, high), color=BLUE, linewidth=1.4)
            axes.set_title(muscles[k])
            axes.set_ylim(0.0, None)
        for axes in panels[(len(chosen) - 1) // columns * columns :]:
            axes.set_xlabel("Time [s]")
        for axes in panels[::columns]:
            axes.set_ylabel("Force [N]")
        note = "; band: 90 % of the draws" if len(lines) > 1 else ""
        figure.suptitle(f"{trial}: forces of the strongest muscles{note}", x=0.01, ha="left")
        save(figure, path)

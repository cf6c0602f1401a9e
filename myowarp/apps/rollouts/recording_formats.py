"""File formats of recordings: each a context manager that gives a function which writes a chunk.

A chunk has the entries of `myowarp.apps.rollouts.recording.sample_of`, stacked along a first axis of samples.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from myowarp.disk import in_place
from myowarp.motion.storage import Storage, write_storage
from myowarp.sim.signals import JOINT_UNITS, UNITS

if TYPE_CHECKING:
    import pyarrow as pa

    from myowarp.sim.signals import Signals

KEYS = ("valid", "time", "episode")
Write = Callable[[dict[str, np.ndarray]], None]


def joints_path(path: Path) -> Path:
    """Return where the joints of a recording go, the muscles' file being `path`."""
    if path.suffix.lower() == ".sto":
        return path.with_suffix(".mot")
    return path.with_name(f"{path.stem}_joints{path.suffix}")


@contextlib.contextmanager
def open_parquet(path: Path, signals: Signals) -> Iterator[Write]:
    """Write tables of muscles and joints as Parquet."""
    import pyarrow.parquet as pq

    with _open_tables(
        path, signals, lambda path, schema: pq.ParquetWriter(path, schema, compression="zstd")
    ) as write:
        yield write


@contextlib.contextmanager
def open_csv(path: Path, signals: Signals) -> Iterator[Write]:
    """Write tables of muscles and joints as text."""
    import pyarrow.csv

    with _open_tables(path, signals, pyarrow.csv.CSVWriter) as write:
        yield write


@contextlib.contextmanager
def _open_tables(path: Path, signals: Signals, writer: Callable[..., Any]) -> Iterator[Write]:
    """Write `path`, a row for every world, time and muscle, and `joints_path(path)`, one for every joint."""
    shown = dict.fromkeys(signals.info, "")
    muscles: dict[str, Sequence[str]] = {"muscle": signals.names, "group": signals.groups}
    with (
        in_place(path) as scratch,
        in_place(joints_path(path)) as joint_scratch,
        _open_table(writer, scratch, muscles, UNITS | shown) as write_muscles,
        _open_table(writer, joint_scratch, {"joint": signals.joint_names}, JOINT_UNITS) as write_joints,
    ):

        def write(chunk: dict[str, np.ndarray]) -> None:
            write_muscles(chunk)
            write_joints(chunk)

        yield write


@contextlib.contextmanager
def _open_table(
    writer: Callable[..., Any], path: Path, names: dict[str, Sequence[str]], units: dict[str, str]
) -> Iterator[Write]:
    """Write one tidy table; `names` are the categories along the last axis of the arrays named in `units`."""
    import pyarrow as pa

    fields = [("world", pa.int32()), ("episode", pa.int32()), ("time", pa.float64())]
    fields += [(name, pa.dictionary(pa.int16(), pa.string())) for name in names]
    described = [pa.field(name, pa.float32(), metadata={"unit": unit}) for name, unit in units.items()]
    schema = pa.schema([*fields, *described]).with_metadata({"units": json.dumps(units | {"time": "s"})})
    with writer(path, schema) as table:

        def write(chunk: dict[str, np.ndarray]) -> None:
            table.write_table(_tidy(chunk, names, schema))

        yield write


def _tidy(chunk: dict[str, np.ndarray], names: dict[str, Sequence[str]], schema: pa.Schema) -> pa.Table:
    """Return the rows of the valid worlds of a chunk."""
    import pyarrow as pa

    valid = chunk["valid"]
    size = len(next(iter(names.values())))
    world = np.broadcast_to(np.arange(valid.shape[1], dtype=np.int32), valid.shape)
    keys = {"world": world, "episode": chunk["episode"], "time": chunk["time"]}
    columns: dict[str, pa.Array] = {name: np.repeat(key[valid], size) for name, key in keys.items()}
    for name, entries in names.items():
        categories = list(dict.fromkeys(entries))
        codes = np.array([categories.index(entry) for entry in entries], dtype=np.int16)
        tiled = np.tile(codes, np.count_nonzero(valid))
        columns[name] = pa.DictionaryArray.from_arrays(pa.array(tiled), pa.array(categories))
    for name in schema.names[len(columns) :]:
        columns[name] = chunk[name][valid].reshape(-1).astype(np.float32)
    return pa.table(columns, schema=schema)


@contextlib.contextmanager
def open_npz(path: Path, signals: Signals) -> Iterator[Write]:
    """Write all arrays to one compressed file; until then they lie in files without a name beside it."""
    spools: dict[str, BinaryIO] = {}
    shapes: dict[str, list[int]] = {}
    dtypes: dict[str, np.dtype] = {}

    with contextlib.ExitStack() as stack:
        scratch = stack.enter_context(in_place(path))

        def write(chunk: dict[str, np.ndarray]) -> None:
            for name, values in chunk.items():
                if name not in spools:
                    spools[name] = stack.enter_context(tempfile.TemporaryFile(dir=path.parent))
                    shapes[name], dtypes[name] = [0, *values.shape[1:]], values.dtype
                if name not in KEYS:
                    values = np.where(chunk["valid"][..., None], values, np.float32(np.nan))
                shapes[name][0] += len(values)
                spools[name].write(np.ascontiguousarray(values).tobytes())

        yield write
        names = {"muscles": signals.names, "groups": signals.groups, "joints": signals.joint_names}
        extra = {name: np.array(entries) for name, entries in names.items()}
        extra["control_dt"] = np.array(signals.sim.scene.control_dt)
        with zipfile.ZipFile(scratch, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, array in extra.items():
                with archive.open(f"{name}.npy", "w") as entry:
                    np.lib.format.write_array(entry, array)
            for name, spool in spools.items():
                header = {"descr": dtypes[name].str, "fortran_order": False, "shape": tuple(shapes[name])}
                spool.seek(0)
                with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                    np.lib.format.write_array_header_2_0(entry, header)
                    shutil.copyfileobj(spool, entry)


@contextlib.contextmanager
def open_storage(path: Path, signals: Signals) -> Iterator[Write]:
    """Write the muscles of the one world to a `.sto` file, and the joint angles to the `.mot` file beside it.

    Time goes on where an episode ends, and `episode` counts them.
    """
    samples: list[dict[str, np.ndarray]] = []

    def write(chunk: dict[str, np.ndarray]) -> None:
        valid = chunk["valid"][:, 0]
        samples.append({name: values[valid, 0] for name, values in chunk.items()})

    with in_place(path) as scratch, in_place(joints_path(path)) as joint_scratch:
        yield write
        if not samples:
            raise ValueError(f"recording {str(path)!r} has no sample; add at least one before it ends")
        kept = {name: np.concatenate([sample[name] for sample in samples]) for name in samples[0]}
        time, episode = _running(kept["time"], kept["episode"]), kept["episode"][:, None]
        shown = [*UNITS, *signals.info]
        labels = [f"{muscle}.{name}" for name in shown for muscle in signals.names]
        values = np.concatenate([episode, *(kept[name] for name in shown)], axis=1)
        write_storage(scratch, path.stem, Storage(("episode", *labels), time, values))
        write_storage(joint_scratch, path.stem, Storage(signals.joint_names, time, kept["angle"]))


def _running(time: np.ndarray, episode: np.ndarray) -> np.ndarray:
    """Return times [s] that go on where an episode ends, for times that begin anew; shape (samples,)."""
    last = np.flatnonzero(np.diff(episode))
    shift = np.zeros_like(time)
    for end in last:
        shift[end + 1 :] += time[end]
    return time + shift

"""Launches that are recorded once and from then on launched together.

On CUDA this is Warp's graph. On the CPU Warp goes through its record operation by operation, looks each
kernel up by its name and packs its arguments anew: a microsecond a launch, a tenth to two thirds of what a
single world takes. What it records is noted here, too, with addresses in place of names, and a kernel goes
through the notes.
"""

import contextlib
import ctypes
import importlib
from collections.abc import Callable, Iterator
from functools import cache
from itertools import chain
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import warp as wp

from myowarp.engine.arena import Arena
from myowarp.engine.replaced import replaced
from myowarp.engine.replay import Operation, replay
from myowarp.process import warn_once, with_build_lock

Row: TypeAlias = tuple[int, ...]
Rows: TypeAlias = list[Row]

FINISH: Row = (Operation.FINISH,)


class Graph:
    """Recorded launches.

    Attributes:
        recorded: What Warp has recorded.
        arena: On CUDA, what the launches allocate; on the CPU Warp keeps it with its record.
        replay: What launches them on the CPU; None where Warp does.
    """

    @with_build_lock
    def __init__(self, launches: Callable[[], None], device: wp.Device) -> None:
        """Record what `launches` launches, without launching it.

        Args:
            launches: Launches kernels whose modules are loaded.
            device: Where they run.
        """
        warp = _warp_recording() if device.is_cpu else None
        notes = None if warp is None else _Notes(warp)
        notebook = contextlib.nullcontext() if notes is None else notes.taken(device)
        self.arena = Arena(launches, device) if device.is_cuda else None
        memory = contextlib.nullcontext() if self.arena is None else self.arena.used()
        with wp.ScopedCapture(device=device, force_module_load=False) as capture, notebook, memory:
            launches()
        self.recorded = capture.graph
        self.replay: Replay | None = None
        if notes is None:
            return
        if notes.complete(self.recorded.apic_state):
            # The notes keep what the program has addresses of, beside what the record keeps.
            self.replay = Replay(notes.program(), keep=(notes.kept, self.recorded))
        else:
            warn_once("a recording has operations that cannot be noted; Warp replays it, which is slower")

    def launch(self) -> None:
        """Launch all that was recorded."""
        if self.replay is None:
            wp.capture_launch(self.recorded)
        else:
            self.replay()


class Replay:
    """A program of `engine.replay`, ready to run; Python's other threads go on meanwhile.

    Attributes:
        rows: The program, shape (n, 4) uint64, in the memory that is run.
        row: What runs it as a part of another program.
    """

    @with_build_lock
    def __init__(self, rows: Rows, keep: object = None) -> None:
        """Load the code that runs it.

        Args:
            rows: Operations and what they are done with, of up to 4 words.
            keep: What the rows have addresses of.
        """
        words = np.array([[*row, 0, 0, 0][:4] for row in rows], dtype=np.int64).view(np.uint64)
        program = wp.array(words, dtype=wp.uint64, device="cpu")
        self._command = wp.launch(replay, dim=1, inputs=[program], device="cpu", record_cmd=True)
        self._arguments, self._kept = program.__ctype__(), (program, keep)
        self._passed = ctypes.byref(self._command.bounds), ctypes.byref(self._arguments)
        self._code = self._command.hooks.forward
        passed = (ctypes.addressof(x) for x in (self._command.bounds, self._arguments))
        self.row: Row = Operation.LAUNCH, code_address(self._code), *passed
        self.rows = program.numpy()

    def __call__(self) -> None:
        """Run it."""
        self._code(*self._passed)


def code_address(function: Any) -> int:
    """Return where the code of a function of C begins."""
    return ctypes.cast(function, ctypes.c_void_p).value or 0


class _WarpRecording(NamedTuple):
    """Private names of Warp that are needed to take notes.

    Attributes:
        runtime: Its native library, and the record that is being made.
        loop: What a conditional operation is called that is a loop.
    """

    runtime: Any
    loop: int


RECORDERS = (
    "wp_cpu_launch_kernel",
    "wp_memcpy_h2h",
    "wp_apic_begin_branch",
    "wp_apic_end_branch",
    "wp_apic_record_conditional",
    "wp_apic_get_recording_state",
    "wp_apic_get_operation_count",
)
"""Functions of Warp's native library that record, or say what was recorded."""


@cache
def _warp_recording() -> _WarpRecording | None:
    """Return what notes are taken with; None, which is logged once, where Warp has changed."""
    try:
        runtime = importlib.import_module("warp._src.context").runtime
        loop = importlib.import_module("warp._src.apic.types").APIC_OP_WHILE
        for name in RECORDERS:
            getattr(runtime.core, name)
        _ = runtime._apic_capture
        return _WarpRecording(runtime, loop)
    except (ImportError, AttributeError) as error:
        warn_once(f"launches are replayed by Warp {wp.__version__}, which has changed, and slower: {error}")
        return None


class _Notes:
    """Notes of Warp's recording on the CPU, one for each of its operations.

    It is noted where Warp hands it to its native code, by functions that are private to it: another minor
    version has to be tried out. A graph that has operations of other kinds has fewer notes than operations,
    and is left to Warp.

    Attributes:
        kept: Arguments and values whose addresses were noted.
    """

    def __init__(self, warp: _WarpRecording) -> None:
        self._warp = warp
        self.kept: list[object] = []
        self._operations: list[Rows] = []
        self._outside: list[tuple[list[Rows], int]] = []
        self._branches: list[Rows] = []
        self._has_all = not wp.config.enable_cpu_blocks  # whose errors Warp asks for after each launch

    @contextlib.contextmanager
    def taken(self, device: wp.Device) -> Iterator[None]:
        """Take notes in the block."""
        core = self._warp.runtime.core
        noted = (
            (core, "wp_cpu_launch_kernel", self._launch),
            (core, "wp_memcpy_h2h", self._copy),
            (device, "memset", self._set),
            (device, "memtile", self._tile),
            (core, "wp_apic_begin_branch", self._begin_branch),
            (core, "wp_apic_end_branch", self._end_branch),
            (core, "wp_apic_record_conditional", self._conditional),
        )
        with contextlib.ExitStack() as patches:
            for holder, name, note in noted:
                noting = self._noting(note, getattr(holder, name))
                patches.enter_context(replaced(holder, name, noting))
            yield

    def complete(self, state: ctypes.c_void_p) -> bool:
        """Whether there is a note for each operation that Warp has recorded."""
        return self._has_all and len(self._operations) == self._num_recorded(state)

    def _noting(self, note: Callable[..., None], native: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function of Warp's that takes a note, too, if it records: in this thread, not paused."""
        recording = self._warp.runtime.core.wp_apic_get_recording_state

        def noting(*args: Any) -> Any:
            if recording():
                try:
                    note(*args)
                except (AttributeError, TypeError, StopIteration, IndexError):  # Warp calls it in another way
                    self._has_all = False
            return native(*args)

        return noting

    def program(self) -> Rows:
        """Return what `replay` runs."""
        return [*chain.from_iterable(self._operations), FINISH]

    def _note(self, *rows: Row, keep: object = None) -> None:
        self._operations.append(list(rows))
        self.kept.append(keep)

    def _launch(self, code: Any, bounds: Any, arguments: Any, adjoint: Any, info: Any) -> None:
        passed = [bounds._obj, arguments and arguments._obj]  # what `ctypes.byref` points to
        addresses = [ctypes.addressof(x) if x is not None else 0 for x in passed]
        self._note((Operation.LAUNCH, code.value, *addresses), keep=passed)
        self._has_all &= adjoint is None

    def _copy(self, target: int, source: int, size: int) -> None:
        self._note((Operation.COPY, target, source, size))

    def _set(self, target: int, value: int, size: int) -> None:
        self._note((Operation.SET, target, value, size))

    def _tile(self, target: int, value: Any, size: int, times: int) -> None:
        tiles = np.frombuffer(times * ctypes.string_at(value, size), dtype=np.uint8)
        self._note((Operation.COPY, target, tiles.ctypes.data, tiles.nbytes), keep=tiles)

    def _begin_branch(self, state: ctypes.c_void_p) -> None:
        self._outside.append((self._operations, self._num_recorded(state)))
        self._operations = []

    def _end_branch(self, state: ctypes.c_void_p, start: Any) -> None:
        outside, before = self._outside.pop()
        self._has_all &= len(self._operations) == self._num_recorded(state) - before
        self._branches.append(list(chain.from_iterable(self._operations)))
        self._operations = outside

    def _conditional(self, state: Any, kind: int, region: int, offset: int, first: Any, second: Any) -> None:
        """Note a loop over the first branch, or the first if an integer is not 0, and the second if it is."""
        no = self._branches.pop() if second else []
        yes = self._branches.pop() if first else []
        again = kind == self._warp.loop and yes  # Warp ends a loop that does nothing
        skip = Operation.JUMP_IF_ZERO, self._address(region) + offset, len(yes) + 2
        self._note(skip, *yes, (Operation.JUMP, -len(yes) - 1 if again else len(no) + 1), *no)

    def _num_recorded(self, state: ctypes.c_void_p) -> int:
        """Return how many operations Warp has recorded, those of the branches that are open included."""
        return int(self._warp.runtime.core.wp_apic_get_operation_count(state))

    def _address(self, region: int) -> int:
        """Return where memory that Warp knows by a number begins."""
        known = self._warp.runtime._apic_capture._regions.values()
        return int(next(base for number, base, *_ in known if number == region))


def replay_nothing(device: wp.Device) -> None:
    """Show the compiler what replays on the CPU."""
    if device.is_cpu:
        program = wp.array([[Operation.FINISH, 0, 0, 0]], dtype=wp.uint64, device=device)
        wp.launch(replay, dim=1, inputs=[program], device=device)

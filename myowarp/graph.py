"""Launches that are recorded once and from then on launched together.

On CUDA this is Warp's graph. On the CPU Warp goes through its record operation by operation, looks each
kernel up by its name and packs its arguments anew: a microsecond a launch, a tenth to two thirds of what a
single world takes. What it records is noted here, too, with addresses in place of names, and a kernel goes
through the notes.
"""

import contextlib
import ctypes
from collections.abc import Callable, Iterator
from itertools import chain
from typing import Any, TypeAlias
from unittest import mock

import numpy as np
import warp as wp
from warp._src import context
from warp._src.apic.types import APIC_OP_WHILE

from myowarp.kernels.replay import Operation, replay

Rows: TypeAlias = list[tuple[int, ...]]

WORDS = 4  # in a row of a program


class Graph:
    """Recorded launches."""

    def __init__(self, launches: Callable[[], None], device: wp.Device) -> None:
        """Record what `launches` launches, without launching it.

        Args:
            launches: Launches kernels whose modules are loaded.
            device: Where they run.
        """
        notes = _Notes()
        beside = notes.taken(device) if device.is_cpu else contextlib.nullcontext()
        with beside, wp.ScopedCapture(device=device, force_module_load=False) as capture:
            launches()
        self._recorded, self._notes = capture.graph, notes  # keep alive what the addresses point to
        self._replay: Callable[[], None] | None = None
        if device.is_cpu and notes.complete(self._recorded.apic_state):
            self._replay = _replayed(notes.program(), device)

    def launch(self) -> None:
        """Launch all that was recorded."""
        if self._replay is None:
            wp.capture_launch(self._recorded)
        else:
            self._replay()


class _Notes:
    """What Warp records on the CPU, an entry for each of its operations.

    It is noted where Warp hands it to its native code, which is private to it. What is handed over in another
    way, as in a later Warp may be more, makes the numbers of operations differ, and is left to Warp.
    """

    def __init__(self) -> None:
        self._operations: list[Rows] = []
        self._outside: list[tuple[list[Rows], int]] = []
        self._branches: list[Rows] = []
        self._kept: list[object] = []
        self._agree = True

    @contextlib.contextmanager
    def taken(self, device: wp.Device) -> Iterator[None]:
        """Take notes in the block."""
        core = context.runtime.core
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
                both = _both(note, getattr(holder, name))
                patches.enter_context(mock.patch.object(holder, name, both))
            yield

    def complete(self, state: ctypes.c_void_p) -> bool:
        """Whether there is a note for each operation that Warp has recorded."""
        return self._agree and len(self._operations) == _num_recorded(state)

    def program(self) -> np.ndarray:
        """Return the rows that `replay` runs, shape (n, 4) uint64."""
        rows = [*chain.from_iterable(self._operations), (Operation.FINISH,)]
        words = [[*row, *[0] * (WORDS - len(row))] for row in rows]
        return np.array(words, dtype=np.int64).view(np.uint64)

    def _note(self, *rows: tuple[int, ...], keep: object = None) -> None:
        self._operations.append(list(rows))
        self._kept.append(keep)

    def _launch(self, code: Any, bounds: Any, arguments: Any, adjoint: Any, info: Any) -> None:
        held = [bounds._obj, arguments and arguments._obj]  # what `ctypes.byref` points to
        where = [ctypes.addressof(x) if x is not None else 0 for x in held]
        self._note((Operation.LAUNCH, code.value, *where), keep=held)
        self._agree &= adjoint is None

    def _copy(self, target: int, source: int, size: int) -> None:
        if size:
            self._note((Operation.COPY, target, source, size))

    def _set(self, target: int, value: int, size: int) -> None:
        if size:
            self._note((Operation.SET, target, value, size))

    def _tile(self, target: int, value: Any, size: int, times: int) -> None:
        if size and times:
            tiles = np.frombuffer(times * ctypes.string_at(value, size), dtype=np.uint8)
            self._note((Operation.COPY, target, tiles.ctypes.data, tiles.nbytes), keep=tiles)

    def _begin_branch(self, state: ctypes.c_void_p) -> None:
        self._outside.append((self._operations, _num_recorded(state)))
        self._operations = []

    def _end_branch(self, state: ctypes.c_void_p, start: Any) -> None:
        outside, before = self._outside.pop()
        self._agree &= len(self._operations) == _num_recorded(state) - before
        self._branches.append(list(chain.from_iterable(self._operations)))
        self._operations = outside

    def _conditional(self, state: Any, kind: int, region: int, offset: int, first: Any, second: Any) -> None:
        """Note a loop over the first branch, or the first if an integer is not 0, and the second if it is."""
        no = self._branches.pop() if second else []
        yes = self._branches.pop() if first else []
        over = -len(yes) - 1 if kind == APIC_OP_WHILE else len(no) + 1
        skip = Operation.JUMP_IF_ZERO, _address(region) + offset, len(yes) + 2
        self._note(skip, *yes, (Operation.JUMP, over), *no)


def _both(note: Callable[..., None], record: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that does both with its arguments."""

    def both(*args: Any) -> Any:
        note(*args)
        return record(*args)

    return both


def _num_recorded(state: ctypes.c_void_p) -> int:
    """Return how many operations Warp has recorded, in the branch that is open."""
    return int(context.runtime.core.wp_apic_get_operation_count(state))


def _address(region: int) -> int:
    """Return where memory that Warp knows by a number begins."""
    known = context.runtime._apic_capture._regions.values()
    return int(next(base for number, base, *_ in known if number == region))


def replay_command(program: wp.array, device: wp.Device) -> wp.Launch:
    """Return the launch of a program, shape (n, 4) uint64."""
    return wp.launch(replay, dim=1, inputs=[program], device=device, record_cmd=True)


def _replayed(rows: np.ndarray, device: wp.Device) -> Callable[[], None]:
    """Return a function that runs a program; Python's other threads go on meanwhile."""
    program = wp.array(rows, dtype=wp.uint64, device=device)
    command, arguments = replay_command(program, device), program.__ctype__()

    def launch() -> None:
        command.hooks.forward(ctypes.byref(command.bounds), ctypes.byref(arguments))

    return launch

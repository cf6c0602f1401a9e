"""Programs that run at the same time, each in a thread of its own.

A thread that Python wakes waits for the interpreter, and so does the one that waits for it. The threads of a
team stay in native code and wait there for each other: with Python's own locks, which are part of its stable
interface and need no interpreter. A step of 64 elbows takes a tenth less.
"""

import threading
import weakref
from collections.abc import Sequence
from ctypes import PYFUNCTYPE, c_int, c_void_p, pythonapi

import numpy as np

from myowarp.graph import Replay, code_address
from myowarp.kernels.replay import Operation

ALLOCATE = PYFUNCTYPE(c_void_p)(("PyThread_allocate_lock", pythonapi))
ACQUIRE = PYFUNCTYPE(c_int, c_void_p, c_int)(("PyThread_acquire_lock", pythonapi))
RELEASE = PYFUNCTYPE(None, c_void_p)(("PyThread_release_lock", pythonapi))
FREE = PYFUNCTYPE(None, c_void_p)(("PyThread_free_lock", pythonapi))

FINISH = (Operation.FINISH,)


class Team:
    """Threads for programs beside the caller's; they end with this object."""

    def __init__(self, size: int) -> None:
        """Start the threads.

        Args:
            size: Programs that run at the same time, the first in the caller's thread.
        """
        self._others = [_Member() for _ in range(size - 1)]
        begin = [other.asked.release for other in self._others]
        wait = [other.done.acquire for other in self._others]
        self._lead = Replay([*begin, FINISH, *wait, FINISH])
        self._tasks = [self._lead.rows[len(begin)], *(other.task for other in self._others)]
        self._programs: Sequence[Replay] = ()
        self._turn = threading.RLock()

    def run(self, programs: Sequence[Replay]) -> None:
        """Run programs, one for each member, until all have finished; Python's other threads go on."""
        with self._turn:
            if programs != self._programs:
                self._programs = ()
                for task, program in zip(self._tasks, programs, strict=True):
                    task[:] = program.row
                self._programs = programs
            self._lead()

    def end(self) -> None:
        """End the threads, for good."""
        with self._turn:
            for other in self._others:
                other.end()


class _Member:
    """A thread that runs what it is asked to, again and again.

    Attributes:
        asked: Released to let it run its task.
        done: Released by it afterwards.
        task: The row that it runs, shape (4,) uint64.
        end: Lets the thread end; called by itself when nothing refers to this object any more.
    """

    def __init__(self) -> None:
        self.asked, self.done = _Lock(), _Lock()
        again = Operation.JUMP, -3
        loop = Replay([self.asked.acquire, FINISH, self.done.release, again], keep=(self.asked, self.done))
        self.task = loop.rows[1]
        thread = threading.Thread(target=loop, name="myowarp", daemon=True)
        self.end = weakref.finalize(self, _end, thread, self.task, self.asked)
        thread.start()


class _Lock:
    """A lock that programs use; it begins locked.

    Attributes:
        address: Where it is.
        acquire: The row of a program that waits until it is released.
        release: The row that releases it.
    """

    def __init__(self) -> None:
        self.address = ALLOCATE()
        if not self.address:
            raise MemoryError("no memory is left for a lock")
        ACQUIRE(self.address, 1)
        self.acquire = Operation.CALL, code_address(ACQUIRE), self.address, 1
        self.release = Operation.CALL, code_address(RELEASE), self.address
        weakref.finalize(self, FREE, self.address).atexit = False


def _end(thread: threading.Thread, task: np.ndarray, asked: _Lock) -> None:
    """Let a thread end; wherever the garbage is collected, even in itself."""
    task[0] = Operation.FINISH
    RELEASE(asked.address)
    if thread is not threading.current_thread():
        thread.join()

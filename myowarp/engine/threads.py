"""Programs that run at the same time, each in a thread of its own.

A thread that Python wakes must first get hold of the interpreter; so must the thread that waits for its
result. The threads of a team therefore stay in native code and wait there for each other, with Python's own
locks, which are part of its stable interface and need no interpreter. No signal interrupts a team.

To be woken takes as long as a few worlds do to step. Where there is a core for each, a thread therefore looks
at its lock for a while before it sleeps; in between it yields its core, which a policy's threads may need.
"""

import os
import threading
import weakref
from collections.abc import Sequence
from ctypes import PYFUNCTYPE, c_int, c_void_p, pythonapi

import numpy as np

from myowarp.engine.graph import FINISH, Replay, Row, Rows, code_address
from myowarp.engine.replay import Operation
from myowarp.process import num_cores

ALLOCATE = PYFUNCTYPE(c_void_p)(("PyThread_allocate_lock", pythonapi))
ACQUIRE = PYFUNCTYPE(c_int, c_void_p, c_int)(("PyThread_acquire_lock", pythonapi))
RELEASE = PYFUNCTYPE(None, c_void_p)(("PyThread_release_lock", pythonapi))
FREE = PYFUNCTYPE(None, c_void_p)(("PyThread_free_lock", pythonapi))
YIELD = PYFUNCTYPE(c_int)(("sched_yield", pythonapi)) if os.name == "posix" else None


class Team:
    """Threads for programs beside the caller's; they end with this object and its programs."""

    def __init__(self, size: int) -> None:
        """Start the threads.

        Args:
            size: Programs that run at the same time, the first in the caller's thread.
        """
        looks = size <= num_cores()
        self._others = [_Member(looks) for _ in range(size - 1)]
        self._turn = _Lock(looks=False)
        RELEASE(self._turn.address)

    def together(self, programs: Sequence[Replay]) -> Replay:
        """Return a program that runs these at the same time, one for each member, until all have finished.

        Where two threads of Python run programs of a team, one waits for the other.
        """
        first, *others = programs
        tasks = [np.array(program.row, dtype=np.uint64) for program in others]
        rows = list(self._turn.acquire)
        for other, task in zip(self._others, tasks, strict=True):
            give = Operation.COPY, other.task.ctypes.data, task.ctypes.data, task.nbytes
            rows += [give, other.asked.release]
        rows.append(first.row)
        for other in self._others:
            rows += other.done.acquire
        rows += [self._turn.release, FINISH]
        return Replay(rows, keep=(self, tuple(programs), tasks))


class _Member:
    """A thread that runs what it is asked to, again and again; it ends with this object.

    Attributes:
        asked: Released to let it run its task.
        done: Released by it afterwards.
        task: The row that it runs, shape (4,) uint64.
    """

    def __init__(self, looks: bool) -> None:
        self.asked, self.done = _Lock(looks), _Lock(looks)
        rows = [*self.asked.acquire, FINISH, self.done.release]
        loop = Replay([*rows, (Operation.JUMP, -len(rows))], keep=(self.asked, self.done))
        self.task = loop.rows[len(self.asked.acquire)]
        threading.Thread(target=loop, name="myowarp", daemon=True).start()
        # Not at the end of the interpreter, which does not wait for threads in native code.
        weakref.finalize(self, _end, self.task, self.asked, os.getpid()).atexit = False


class _Lock:
    """A lock that programs use; it begins locked.

    Args:
        looks: Whether a program looks at it for a while before it sleeps.

    Attributes:
        address: Where it is.
        acquire: Rows of a program that wait until it is released, and lock it.
        release: The row that releases it.
    """

    def __init__(self, looks: bool) -> None:
        self.address = ALLOCATE()
        if not self.address:
            raise MemoryError("no memory is left for a lock")
        ACQUIRE(self.address, 1)
        self.acquire: Rows = [(Operation.CALL, code_address(ACQUIRE), self.address, 1)]
        if looks and YIELD is not None:
            look = Operation.TRY, code_address(ACQUIRE), self.address, code_address(YIELD)
            self.acquire.insert(0, look)
        self.release: Row = Operation.CALL, code_address(RELEASE), self.address
        weakref.finalize(self, _free, self.address).atexit = False


def _free(address: int) -> None:
    """Free the memory of a lock, which has to be open for that."""
    ACQUIRE(address, 0)
    RELEASE(address)
    FREE(address)


def _end(task: np.ndarray, asked: _Lock, process: int) -> None:
    """Let a thread end, without waiting for it: the garbage may be collected anywhere."""
    if process == os.getpid():  # it does not live on in a forked process
        task[0] = Operation.FINISH
        RELEASE(asked.address)

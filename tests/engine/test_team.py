"""Programs in threads of their own: at the same time, beside Python, again and again, and to an end."""

import gc
import threading
from ctypes import CFUNCTYPE, c_int, c_uint64

import numpy as np
import pytest
import warp as wp

from myowarp.engine import threads as module
from myowarp.engine.graph import FINISH, Graph, Replay, code_address
from myowarp.engine.replay import TRIES, Operation
from myowarp.engine.threads import Team

CPU = wp.get_device("cpu")
LOOKS = 30_000_000  # after which waiting for another is given up: seconds


@wp.kernel(enable_backward=False)
def look(other: wp.array[int], left: wp.array[int], met: wp.array[int]):
    left[0] -= 1
    if other[0] != 0:
        met[0] += 1
        left[0] = 0


@wp.kernel(enable_backward=False)
def add(amount: int, count: wp.array[int]):
    count[0] += amount


def array(value):
    return wp.full(1, value, dtype=int, device=CPU)


def program(launches):
    wp.load_module(device=CPU)
    return Graph(launches, CPU).replay


def meeting(mine, other, met):
    """Say that one is there, and wait for the other."""
    left = array(0)

    def launches():
        left.fill_(LOOKS)
        mine.fill_(1)
        wp.capture_while(
            left, lambda: wp.launch(look, dim=1, inputs=[other], outputs=[left, met], device=CPU)
        )

    return program(launches)


def counting(count, amount):
    return program(lambda: wp.launch(add, dim=1, inputs=[amount], outputs=[count], device=CPU))


def test_at_the_same_time():
    """Two programs that wait for each other, which one after the other would not meet."""
    here, met = [array(0) for _ in range(2)], [array(0) for _ in range(2)]
    together = Team(2).together([meeting(here[i], here[1 - i], met[i]) for i in range(2)])
    for run in range(3):
        for flag in here:
            flag.zero_()
        together()
        assert [int(m.numpy()[0]) for m in met] == [run + 1, run + 1]


@pytest.mark.parametrize("member", [0, 1])
def test_python_goes_on(member):
    """A program waits for what a thread of Python does."""
    here, told, met = array(0), array(0), array(0)
    programs = [counting(array(0), 1), counting(array(0), 1)]
    programs[member] = meeting(here, told, met)

    def tell():
        while here.numpy()[0] == 0:
            pass
        told.fill_(1)

    thread = threading.Thread(target=tell, daemon=True)
    thread.start()
    Team(2).together(programs)()
    assert met.numpy()[0] == 1
    thread.join()


@pytest.mark.parametrize("cores", [1, 64])
@pytest.mark.parametrize("size", [1, 2, 5])
def test_each_its_own_again_and_again(monkeypatch, cores, size):
    """Programs in turn with others; a run returns only when all have finished, threads look or sleep."""
    monkeypatch.setattr(module, "num_cores", lambda: cores)
    team, counts = Team(size), [array(0) for _ in range(size)]
    ones = team.together([counting(count, 1) for count in counts])
    hundreds = team.together([counting(count, 100 * (i + 1)) for i, count in enumerate(counts)])
    expected = np.zeros(size, dtype=int)
    for run in range(300):
        together, amounts = (ones, 1) if run % 3 else (hundreds, 100 * np.arange(1, size + 1))
        together()
        expected += amounts
        np.testing.assert_array_equal([int(count.numpy()[0]) for count in counts], expected)


@pytest.mark.parametrize("yes", [1, 3, TRIES, None])
def test_look_before_sleeping(yes):
    """A question is put until a yes, which skips a row, or a thousand times, with a call after each no."""
    asked, noted = [], []

    @CFUNCTYPE(c_int, c_uint64, c_uint64)
    def question(argument, constant):
        asked.append((argument, constant))
        return len(asked) == yes

    @CFUNCTYPE(c_int, c_uint64, c_uint64)
    def note(argument, _):
        noted.append(argument)
        return 1

    Replay(
        [
            (Operation.TRY, code_address(question), 7, code_address(note)),
            (Operation.CALL, code_address(note), 1),
            (Operation.CALL, code_address(note), 2),
            FINISH,
        ]
    )()
    assert asked == [(7, 0)] * (yes or TRIES)
    assert noted == ([0] * (yes - 1) + [2] if yes else [0] * TRIES + [1, 2])


def test_a_program_keeps_what_it_needs():
    """The team, and the programs that it is made of."""
    counts = [array(0) for _ in range(3)]
    together = Team(3).together([counting(count, 1) for count in counts])
    gc.collect()
    others = [counting(array(0), 1) for _ in range(100)]  # in the memory that would be free
    for _ in range(3):
        together()
    assert [int(count.numpy()[0]) for count in counts] == [3, 3, 3]
    assert len(others) == 100


@pytest.mark.parametrize("number", [1, 3])
def test_one_program_for_each(number):
    with pytest.raises(ValueError, match="zip"):
        Team(2).together([counting(array(0), 1)] * number)


def test_threads_end():
    """With the team and the last of its programs, not before."""
    gc.collect()
    before = set(threading.enumerate())
    team = Team(4)
    own = set(threading.enumerate()) - before
    assert len(own) == 3
    together = team.together([counting(array(0), 1) for _ in range(4)])
    del team
    together()
    assert all(thread.is_alive() for thread in own)
    del together
    for thread in own:
        thread.join(10.0)
    assert not any(thread.is_alive() for thread in own)

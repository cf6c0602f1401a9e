"""Recorded launches: replayed they do what NumPy does, and what Warp's own replay does."""

import gc
import threading

import numpy as np
import pytest
import warp as wp
from warp._src import context

from myowarp.engine.graph import Graph

CPU = wp.get_device("cpu")
SIZE = 5


@wp.kernel
def scale_and_add(x: wp.array[float], factor: float, offset: wp.vec2, y: wp.array[float]):
    i = wp.tid()
    y[i] = factor * x[i] + offset[0] - offset[1] + y[i]


@wp.kernel(enable_backward=False)
def number(rows: wp.array2d[int], count: wp.array[int]):
    i, j = wp.tid()
    rows[i, j] = 10 * i + j + count[0]


@wp.kernel(enable_backward=False)
def add(amount: int, count: wp.array[int]):
    count[0] += amount


def array(values, dtype=float):
    return wp.array(values, dtype=dtype, device=CPU)


def count_up(count, amount):
    wp.launch(add, dim=1, inputs=[amount], outputs=[count], device=CPU)


def graph(launches, left_to_warp=False):
    """Record launches; Warp's own replay is needed only where that is said."""
    wp.load_module(device=CPU)
    made = Graph(launches, CPU)
    assert (made.replay is None) == left_to_warp
    return made


def replays(recorded):
    """Return our replay and Warp's of the same record."""
    return recorded.launch, lambda: wp.capture_launch(recorded.recorded)


def private():
    """Return the functions of Warp that notes are taken in."""
    core = context.runtime.core
    branches = core.wp_apic_begin_branch, core.wp_apic_end_branch, core.wp_apic_record_conditional
    return [core.wp_cpu_launch_kernel, core.wp_memcpy_h2h, *branches, CPU.memset, CPU.memtile]


def test_launches_follow_what_the_arrays_hold():
    """Arguments by value and by address, of one and of two dimensions; nothing runs while it is recorded."""
    x, y, count = array(np.arange(SIZE)), array(np.ones(SIZE)), array([3], int)
    rows = wp.zeros((2, 3), dtype=int, device=CPU)

    def launches():
        wp.launch(scale_and_add, dim=SIZE, inputs=[x, 2.0, wp.vec2(0.5, 0.25)], outputs=[y], device=CPU)
        wp.launch(number, dim=rows.shape, inputs=[rows, count], device=CPU)

    recorded = graph(launches)
    np.testing.assert_array_equal(y.numpy(), np.ones(SIZE))
    recorded.launch()
    np.testing.assert_array_equal(y.numpy(), 2 * np.arange(SIZE) + 1.25)
    np.testing.assert_array_equal(rows.numpy(), 10 * np.arange(2)[:, None] + np.arange(3) + 3)
    x.fill_(10.0)
    count.fill_(-1)
    recorded.launch()
    np.testing.assert_array_equal(y.numpy(), 2 * np.arange(SIZE) + 21.5)
    assert rows.numpy()[1, 2] == 11


@pytest.mark.parametrize("dtype", [wp.int8, wp.int16, wp.float32, wp.float64, wp.vec3, wp.quat])
def test_fills_and_copies(dtype):
    """Values of every size; parts of arrays; nothing at all."""
    filled, zeroed, copied = (wp.full(SIZE, dtype(7), dtype=dtype, device=CPU) for _ in range(3))
    none = wp.zeros(0, dtype=dtype, device=CPU)

    def launches():
        filled.fill_(dtype(3))
        filled[1:3].fill_(dtype(5))
        zeroed[2:].zero_()
        wp.copy(copied, filled, dest_offset=1, src_offset=2, count=2)
        none.zero_()
        none.fill_(dtype(1))
        wp.copy(none, none)

    recorded = graph(launches)
    assert np.all(filled.numpy() == 7)
    recorded.launch()
    for got, expected in ((filled, [3, 5, 5, 3, 3]), (zeroed, [7, 7, 0, 0, 0]), (copied, [7, 5, 3, 7, 7])):
        shape = (SIZE,) + (1,) * (got.numpy().ndim - 1)
        np.testing.assert_array_equal(
            got.numpy(), np.broadcast_to(np.reshape(expected, shape), got.numpy().shape)
        )


@pytest.mark.parametrize("times", [0, 1, 4])
@pytest.mark.parametrize("branch", [0, 1, 2])
def test_loops_and_branches(times, branch):
    """A loop in which both branches, of several launches, hold a loop of their own."""
    inner, which = array([0], int), array([branch], int)
    outer = array([9, 0], int)[1:]
    counts = [array([0], int) for _ in range(4)]

    def inner_loop(count, amount):
        def body():
            count_up(count, amount)
            count_up(inner, -1)

        inner.fill_(3)
        wp.capture_while(inner, body)

    def body():
        wp.capture_if(which, lambda: inner_loop(counts[0], 1), lambda: inner_loop(counts[1], 10))
        wp.capture_if(which, lambda: count_up(counts[2], 100))
        wp.capture_if(which, on_false=lambda: count_up(counts[3], 400))
        wp.capture_if(which, lambda: None, lambda: count_up(counts[3], 600))
        count_up(outer, -1)

    def launches():
        wp.capture_while(outer, body)
        count_up(which, 1)

    recorded = graph(launches)
    taken = np.array([3, 0, 100, 0] if branch else [0, 30, 0, 1000])
    for replay in replays(recorded):
        outer.fill_(times)
        which.fill_(branch)
        for count in counts:
            count.zero_()
        replay()
        assert [int(count.numpy()[0]) for count in counts] == list(times * taken)
        assert which.numpy()[0] == branch + 1


def test_a_loop_that_does_nothing_ends():
    endless, count = array([1], int), array([0], int)

    def launches():
        wp.capture_while(endless, lambda: None)
        count_up(count, 1)

    for replay in replays(graph(launches)):
        replay()
    assert count.numpy()[0] == 2


@pytest.mark.parametrize("nested", [False, True])
def test_what_has_no_note_is_left_to_warp(nested):
    """Sums are recorded by Warp in a way of their own: Warp replays that graph, with the right result."""
    x, sums, once = array(np.arange(SIZE), int), wp.zeros(SIZE, dtype=int, device=CPU), array([1], int)

    def add_up():
        wp.utils.array_scan(x, sums, inclusive=True)
        count_up(once, -1)

    launches = (lambda: wp.capture_while(once, add_up)) if nested else add_up
    recorded = graph(launches, left_to_warp=True)
    recorded.launch()
    np.testing.assert_array_equal(sums.numpy(), np.cumsum(np.arange(SIZE)))
    assert once.numpy()[0] == 0


def test_only_what_is_recorded_is_noted():
    """Not what another thread does: it would stand in for a sum, of which there are no notes."""
    x, sums, other = array(np.arange(SIZE), int), wp.zeros(SIZE, dtype=int, device=CPU), array([5], int)

    def launches():
        wp.utils.array_scan(x, sums, inclusive=True)
        thread = threading.Thread(target=lambda: CPU.memset(other.ptr, 0, 4))
        thread.start()
        thread.join()

    recorded = graph(launches, left_to_warp=True)
    assert other.numpy()[0] == 0
    recorded.launch()
    np.testing.assert_array_equal(sums.numpy(), np.cumsum(np.arange(SIZE)))


def test_adjoints_are_left_to_warp():
    x, y = (wp.array(np.ones(SIZE), dtype=float, device=CPU, requires_grad=True) for _ in range(2))
    arguments = {"inputs": [x, 3.0, wp.vec2()], "outputs": [y]}
    adjoints = {"adj_inputs": [x.grad, 0.0, wp.vec2()], "adj_outputs": [y.grad]}
    backward = arguments | adjoints | {"adjoint": True, "device": CPU}
    recorded = graph(lambda: wp.launch(scale_and_add, dim=SIZE, **backward), left_to_warp=True)
    y.grad.fill_(1.0)
    recorded.launch()
    np.testing.assert_array_equal(x.grad.numpy(), np.full(SIZE, 3.0))


def test_a_graph_keeps_what_it_needs():
    """Arrays that nobody else holds, and those made while it was recorded."""
    total = array(np.zeros(SIZE))

    def record():
        x, zero = array(np.arange(SIZE)), wp.vec2()

        def launches():
            temporary = wp.zeros(SIZE, dtype=float, device=CPU)
            wp.launch(scale_and_add, dim=SIZE, inputs=[x, 1.0, zero], outputs=[temporary], device=CPU)
            wp.launch(scale_and_add, dim=SIZE, inputs=[temporary, 1.0, zero], outputs=[total], device=CPU)

        return graph(launches)

    recorded = record()
    gc.collect()
    others = [array(np.full(SIZE, 99.0)) for _ in range(100)]  # in the memory that would be free
    for _ in range(3):
        recorded.launch()
    np.testing.assert_array_equal(total.numpy(), 3 * np.arange(SIZE))
    assert len(others) == 100


def test_a_failure_leaves_warp_as_it_was():
    count = array([0], int)
    before = private()

    def launches():
        count_up(count, 1)
        raise OSError("no")

    with pytest.raises(OSError, match="no"):
        graph(launches)
    assert private() == before
    count_up(count, 1)
    assert count.numpy()[0] == 1
    graph(lambda: count_up(count, 1)).launch()
    assert count.numpy()[0] == 2


def test_nothing():
    graph(lambda: None).launch()

"""Threads make arrays of structs one after the other: Python 3.11.7 cannot parse two layouts at once."""

import gc
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from myowarp.kernels.structs import struct_array
from myowarp.laws.paths.path import Surface


@pytest.fixture
def other_threads_go_on_in_collections():
    """Collect at each object, and let other threads run meanwhile, as a collection that ends objects may."""
    thresholds, interval = gc.get_threshold(), sys.getswitchinterval()

    def other(phase, info):
        time.sleep(1e-5)

    gc.callbacks.append(other)
    gc.set_threshold(1)
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(interval)
    gc.set_threshold(*thresholds)
    gc.callbacks.remove(other)


@pytest.mark.usefixtures("other_threads_go_on_in_collections")
def test_threads_at_several_depths_make_arrays_of_structs():
    """`SystemError: AST constructor recursion depth mismatch` without a lock."""

    def make(depth):
        if depth:
            return make(depth - 1)
        return [len(struct_array(Surface, [])) for _ in range(300)]

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(make, (0, 7, 14, 21))) == [[0] * 300] * 4

"""What tests register, import and name goes again."""

import contextlib
import sys

import gymnasium as gym

import myowarp

REGISTRIES = (myowarp.TASKS, myowarp.BODIES, myowarp.CONDITIONS, myowarp.MUSCLES)


@contextlib.contextmanager
def as_before(folder=None):
    """Leave registries, Gymnasium's ids and the import path as they were; forget modules of a folder."""
    ids, modules, path = set(gym.registry), set(sys.modules), list(sys.path)
    try:
        with contextlib.ExitStack() as stack:
            for registry in REGISTRIES:
                stack.enter_context(registry.temporary())
            yield
    finally:
        for name in set(gym.registry) - ids:
            del gym.registry[name]
        sys.path[:] = path
        for name in set(sys.modules) - modules:
            if folder and str(folder) in str(getattr(sys.modules[name], "__file__", "")):
                del sys.modules[name]

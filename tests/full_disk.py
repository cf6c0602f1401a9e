"""A disk that fills up."""

import resource
from contextlib import contextmanager


@contextmanager
def full_disk(size):
    """Refuse to let files of this process grow beyond a size [B], as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)

"""Which cases `make test` runs of a test over many; `make test-slow` runs the others."""

import pytest


def often(cases, kept):
    """Return all cases as parameters, those that are not kept marked slow."""
    assert set(kept) <= set(cases), set(kept) - set(cases)
    return [case if case in kept else pytest.param(case, marks=pytest.mark.slow) for case in cases]

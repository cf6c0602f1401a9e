"""Which cases `make test` runs of a test over many; `make test-slow` runs the others."""

import pytest

import myowarp.tasks.variants  # noqa: F401  (registers the tasks)
from myowarp.definitions.task import TASKS


def often(cases, kept):
    """Return all cases as parameters, those that are not kept marked slow."""
    assert set(kept) <= set(cases), set(kept) - set(cases)
    return [case if case in kept else pytest.param(case, marks=pytest.mark.slow) for case in cases]


def covering(cases, facts):
    """Return few cases, the first ones, that have together what all of them have.

    Args:
        cases: All cases.
        facts: Returns a tuple of facts of a case; at each place each value is met by what is returned.
    """
    met, found = set(), []
    for case in cases:
        own = set(enumerate(facts(case)))
        if not own <= met:
            found.append(case)
            met |= own
    return found


def draws(key):
    """Return whether anything in a task differs between episodes."""
    return any(draw.varies for draw in TASKS[key].draws)


def kinds(key):
    """Return family and body of a task."""
    return TASKS[key].family, TASKS[key].body


def goals(key):
    """Return the family of a task together with whether it draws."""
    return ((TASKS[key].family, draws(key)),)


def of_each(keys, facts=kinds):
    """Return tasks as parameters, marked slow but for few that have each family and body.

    A family or body that is registered later is among them by itself. Where there is a choice they draw, and
    are not large.
    """
    return often(keys, covering(sorted(keys, key=lambda key: (TASKS[key].large, not draws(key))), facts))

"""Fixtures that tests of several commands share."""

from tiny_runs import no_simulation, tiny  # noqa: F401 (fixtures)

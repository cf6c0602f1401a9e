"""What tests of the command share, and which of them are slow."""

import gc
import re
import sys
from functools import cache

import pytest
from clusters import cluster  # noqa: F401 (a fixture)
from registries import as_before

from myowarp.apps.cli import main as cli
from myowarp.definitions.body import BODIES
from myowarp.definitions.task import TASKS


@pytest.fixture
def run(monkeypatch, capsys):
    """Run the command in this process; return exit status, output and error stream."""

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["myowarp", *map(str, arguments)])
        status = 0
        try:
            cli.main()
        except SystemExit as exit_:
            status = exit_.code
        return status, *capsys.readouterr()

    return call


@pytest.fixture
def registered():
    """What a test registers goes again."""
    with as_before():
        yield


@cache
def large():
    """Return a pattern of bodies and tasks that cost seconds a test; their oracle tests always run."""
    tasks = {TASKS[key].name.removeprefix("myo") for key in TASKS if TASKS[key].large}
    bodies = {name for name in BODIES if BODIES[name].large}
    return re.compile("|".join([*sorted(tasks), rf"\b(?:{'|'.join(sorted(bodies))})\b"]))


QUICK = "test_conditions.py"  # one or two seconds


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Look for no cycles among what stays: a third of the time of collecting."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(tryfirst=True)  # before slow ones are left out
def pytest_collection_modifyitems(items):
    """Leave large bodies to `make test-slow`, where a test is run for every body or task."""
    for item in items:
        case = item.callspec.id if hasattr(item, "callspec") else ""
        if item.path.parent.name in ("suite", "engine") and item.path.name != QUICK and large().search(case):
            item.add_marker(pytest.mark.slow)

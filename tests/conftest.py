"""What tests of the command share, and which of them are slow."""

import gc
import re
import sys
from functools import cache
from pathlib import Path

import pytest
from clusters import cluster  # noqa: F401 (a fixture)
from registries import as_before

from myowarp.apps.cli import main as cli
from myowarp.definitions.body import BODIES
from myowarp.definitions.task import TASKS
from myowarp.engine.idle import idle_kernels
from myowarp.engine.verify import choose_stages
from myowarp.sim import shard


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
    """Return a pattern of bodies and tasks that cost seconds a test; most of their oracle tests run."""
    tasks = {TASKS[key].name.removeprefix("myo") for key in TASKS if TASKS[key].large}
    bodies = {name for name in BODIES if BODIES[name].large}
    return re.compile("|".join([*sorted(tasks), rf"\b(?:{'|'.join(sorted(bodies))})\b"]))


@cache
def arms():
    """Return a pattern of the tasks of whole arms: half a minute to build, and as much to compile."""
    return re.compile(
        "|".join(TASKS[key].name.removeprefix("myo") for key in TASKS if "arm" in TASKS[key].body)
    )


def trusted(step, names, also, progress, conditions=()):
    """Return all stages that apply and all idle kernels, as where a verification finds nothing."""
    return step.stages(names), idle_kernels(step.stepped)


@pytest.hookimpl(tryfirst=True)  # before fixtures of a module are made
def pytest_runtest_setup(item):
    """Verify the physics step in tests of verification alone.

    A verification compiles the engine's own kernels for every number of degrees of freedom. Without it a
    stage that is wrong acts, where the package would leave it out: the other tests see more of it, not less.
    """
    shard.choose_stages = choose_stages if item.path.name in VERIFYING else trusted


VERIFYING = ("test_cache.py", "test_own_paths.py", "test_stages.py", "test_verify.py")
QUICK = "test_conditions.py"  # one or two seconds
ALIKE = re.compile("Exo|Baoding|PenTwirl|KeyTurn|HandPose|motorFingerPose")
"""Families of a kind, pose or object in contact, that another family shows as well."""
RARE = Path(__file__).with_name("rare.txt")
"""Long tests beside quicker ones of the same; each line is how a node id begins."""


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Look for no cycles among what stays, a third of the time of collecting; then seldom, a tenth of all."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(20_000, 10, 10)
        gc.enable()


@pytest.fixture(autouse=True, scope="module")
def swept():
    """Free what the tests of a file leave in cycles, such as simulations; look at the rest no more."""
    yield
    gc.collect()
    gc.freeze()


@pytest.hookimpl(tryfirst=True)  # before slow ones are left out
def pytest_collection_modifyitems(items):
    """Leave to `make test-slow`: large bodies, families of a kind that another one shows, and RARE."""
    shown = {function(item) for item in items if not ALIKE.search(item.name)}
    rare = tuple(RARE.read_text().splitlines())
    for item in items:
        folder, case = item.path.parent.name, item.callspec.id if hasattr(item, "callspec") else ""
        searched = {"suite": large, "engine": large, "oracle": arms}.get(folder)
        if (
            (searched and item.path.name != QUICK and searched().search(case))
            or (folder in ("suite", "engine") and ALIKE.search(case) and function(item) in shown)
            or item.nodeid.removeprefix("tests/").startswith(rare)
        ):
            item.add_marker(pytest.mark.slow)


def function(item):
    """Return the node id of a test without its case."""
    return item.nodeid.partition("[")[0]

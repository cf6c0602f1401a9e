"""Importing the package leaves out what only costs time, and nothing else."""

import json
import subprocess
import sys
from functools import cache

import pytest

SCRIPT = """
import gc, json, sys
import warp._src.context as context
from warp._src.context import Module, user_modules

if sys.argv[1] == "off":
    gc.disable()
scan = Module._find_references
import myowarp

print(json.dumps({
    "enabled": gc.isenabled(),
    "frozen": gc.get_freeze_count(),
    "restored": Module._find_references is scan,
    "references": sum(len(module.references) for module in user_modules.values()),
}))
"""


@cache
def imported(mode="on"):
    done = subprocess.run([sys.executable, "-c", SCRIPT, mode], capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow
def test_references_are_not_searched():
    """Those of functions that are defined later are: these may be defined anew."""
    found = imported()
    assert found["references"] == 0
    assert found["restored"]


@pytest.mark.slow
def test_garbage_is_collected_as_before():
    """A library does not freeze the heap of its host; the command may."""
    on, off = imported(), imported("off")
    assert on["enabled"]
    assert not off["enabled"]
    assert on["frozen"] == off["frozen"] == 0

"""What `myowarp motion` writes is whole or not there: errors, full disks and kills in the middle of it."""

import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from full_disk import full_disk
from often import often

from myowarp.disk import SCRATCH, sweep
from myowarp.motion import streams
from myowarp.motion.results import written
from myowarp.motion.setup import TrialSetup
from myowarp.motion.steps import forces, moved_in_parts
from myowarp.motion.storage import Storage, Tables, read_storage, write_storage
from myowarp.osim.body.skeleton import Bones

ROOT = Path(__file__).parents[2]
ARM, BEND = ROOT / "examples/arm.osim", ROOT / "examples/arm_bend.mot"
ENDLESS = """
import signal
import sys
from pathlib import Path
import numpy as np
from myowarp.motion.storage import Storage, Tables
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored, where the tests run in the background
with Tables(Path(sys.argv[1])) as tables:
    for k in range(10**9):
        rows = Storage(("a",), np.arange(100.0 * k, 100.0 * (k + 1)), np.ones((100, 1)))
        tables.write("moments.sto", "joint moments", rows, 10**11)
        if k == 100:
            print("begun", flush=True)
"""
"""Rows of one column, for ever."""


def long_motion(folder, rows=700, bad=None):
    """Write a motion of the arm; row number `bad` is no number."""
    time = np.arange(rows) / 100.0
    lines = [f"{t:.2f}\t{40 + 20 * np.sin(t):.6f}\t{50 + 20 * np.cos(t):.6f}" for t in time]
    if bad is not None:
        lines[bad] = f"{time[bad]:.2f}\tabc\t50"
    head = BEND.read_text().replace("nRows=61", f"nRows={rows}").splitlines()[:7]
    (folder / "long.mot").write_text("\n".join([*head, *lines]) + "\n")
    return folder / "long.mot"


def solve(motion, bones, output):
    setup = TrialSetup(motion=motion, reserve=1.0)
    for _ in written((forces(bones, setup, part) for part in moved_in_parts(bones, setup)), output):
        pass


def test_a_bad_row_at_the_end_leaves_nothing(tmp_path, monkeypatch):
    """Parts before it were written already; the old file stays, and no scratch file."""
    monkeypatch.setattr(streams, "FRAMES", 48)
    bones = Bones.read(ARM)
    (tmp_path / "out").mkdir()
    solve(long_motion(tmp_path), bones, tmp_path / "out")
    whole = read_storage(tmp_path / "out/moments.sto")
    assert "nRows=700\n" in (tmp_path / "out/moments.sto").read_text()
    assert len(whole.time) == 700
    before = (tmp_path / "out/moments.sto").read_bytes()
    names = {path.name for path in (tmp_path / "out").iterdir()}
    with pytest.raises(ValueError, match="a cell that is no number"):
        solve(long_motion(tmp_path, bad=690), bones, tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == names
    assert (tmp_path / "out/moments.sto").read_bytes() == before


def test_rows_that_a_file_announces_are_written(tmp_path):
    table = Storage(("a",), np.arange(3.0), np.ones((3, 1)))
    with pytest.raises(RuntimeError, match=r"'.*a\.sto' must have 2 rows more"), Tables(tmp_path) as tables:
        tables.write("a.sto", "a", table, 5)
    assert not any(tmp_path.iterdir())


def test_a_full_disk_says_which_file(tmp_path):
    """The second table does not fit: neither takes its place, and the message names it."""
    small, large = (Storage(("a",), np.arange(float(n)), np.ones((n, 1))) for n in (2, 900))
    write_storage(tmp_path / "b.sto", "b", small)
    before = (tmp_path / "b.sto").read_bytes()
    wanted = r"output '.*b\.sto' cannot be written \(File too large\); make room there, or choose another"

    def write():
        with full_disk(4096), Tables(tmp_path) as tables:
            for name, table in (("a.sto", small), ("b.sto", large), ("c.sto", small)):
                tables.write(name, name, table)

    with pytest.raises(OSError, match=wanted):
        write()
    assert [path.name for path in tmp_path.iterdir()] == ["b.sto"]
    assert (tmp_path / "b.sto").read_bytes() == before


def test_a_full_disk_in_the_middle_of_a_step(tmp_path, run):
    """The command says in one sentence which file, and what to do; no result of it is there."""
    step = ("motion", "forces", ARM, "--motion", BEND, "--reserve", "1", "--output")
    assert run(*step, tmp_path / "whole")[0] == 0
    with full_disk(4096):
        status, _, err = run(*step, tmp_path / "out")
    assert status == 2
    wanted = (
        r"myowarp: output '.*/out/activations\.sto' cannot be written \(File too large\); make room there"
    )
    assert re.match(wanted, err)
    assert "Errno" not in err
    assert not any((tmp_path / "out").iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("number", often([signal.SIGINT, signal.SIGKILL], [signal.SIGINT]))
def test_a_kill_leaves_the_old_table(tmp_path, number):
    """Ctrl-C cleans up; what a killed process leaves is hidden, and swept when the folder is next used."""
    write_storage(tmp_path / "moments.sto", "joint moments", Storage(("a",), np.arange(2.0), np.ones((2, 1))))
    before = (tmp_path / "moments.sto").read_bytes()
    command = [sys.executable, "-c", ENDLESS, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as writer:
        try:
            assert writer.stdout.readline() == "begun\n"
            writer.send_signal(number)
            writer.wait(timeout=60)
        finally:
            writer.kill()
    assert (tmp_path / "moments.sto").read_bytes() == before
    left = [path.name for path in tmp_path.iterdir() if path.name != "moments.sto"]
    assert len(left) == (0 if number == signal.SIGINT else 1)
    assert all(name.startswith(SCRATCH) for name in left)
    sweep(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["moments.sto"]

"""Files are written whole or not at all, whatever ends the process; what it leaves is swept."""

import errno
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from full_disk import full_disk
from often import often

from myowarp.disk import SCRATCH, check_overwrite, in_place, locked, make_folder, sweep

WRITER = """
import signal, sys, time
from pathlib import Path
from myowarp.disk import in_place
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored, where the tests run in the background
with in_place(Path(sys.argv[1])) as scratch, scratch.open("w") as file:
    file.write("half")
    file.flush()
    print("half", flush=True)
    time.sleep(600)
"""


@pytest.mark.parametrize("number", often([signal.SIGINT, signal.SIGTERM, signal.SIGKILL], [signal.SIGKILL]))
def test_a_process_that_dies_leaves_the_old_file(tmp_path, number):
    """The scratch file of a live process stays, that of a dead one is swept; datasets skip both."""
    path = tmp_path / "a.parquet"
    path.write_text("old")
    command = [sys.executable, "-c", WRITER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as writer:
        try:
            assert writer.stdout.readline() == "half\n"
            sweep(tmp_path)
            (scratch,) = (file for file in tmp_path.iterdir() if file != path)
            assert scratch.name.startswith(SCRATCH)
            assert scratch.suffix == ".parquet"
            writer.send_signal(number)
            writer.wait(timeout=60)
        finally:
            writer.kill()
    assert path.read_text() == "old"
    make_folder(tmp_path)
    assert list(tmp_path.iterdir()) == [path]


def test_a_dataset_is_read_beside_a_scratch_file(tmp_path):
    pd = pytest.importorskip("pandas")
    with in_place(tmp_path / "part-00000.parquet") as scratch:
        pd.DataFrame({"a": [1, 2]}).to_parquet(scratch)
    with in_place(tmp_path / "part-00001.parquet") as scratch:
        assert not scratch.stat().st_size
        assert len(pd.read_parquet(tmp_path)) == 2


def test_a_full_disk_names_the_file_and_leaves_the_old_one(tmp_path):
    path = tmp_path / "a.sto"
    path.write_text("old")
    with (
        pytest.raises(
            OSError, match=r"output '.*a\.sto' cannot be written \(File too large\); make room"
        ) as e,
        full_disk(100),
        in_place(path) as scratch,
    ):
        scratch.write_text("x" * 1000)
    assert "Errno" not in str(e.value)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_other_errors_of_a_block_are_its_own(tmp_path):
    with (
        pytest.raises(FileNotFoundError, match="nowhere"),
        in_place(tmp_path / "a"),
    ):
        (tmp_path / "nowhere").read_text()
    with pytest.raises(BrokenPipeError), in_place(tmp_path / "a"):
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")
    (tmp_path / "file").touch()
    with (
        pytest.raises(OSError, match=r"'.*file/a' cannot be written \(Not a directory\); its folder must"),
        in_place(tmp_path / "file/a"),
    ):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_folder_is_made(tmp_path):
    with in_place(tmp_path / "new/folder/a") as scratch:
        scratch.touch()
    assert (tmp_path / "new/folder/a").is_file()


def test_links_are_replaced_and_not_followed(tmp_path):
    """A dangling one counts as a file that exists; a folder or a device is never replaced."""
    (tmp_path / "precious").write_text("precious")
    for target in ("precious", "elsewhere"):
        link = tmp_path / f"to_{target}"
        link.symlink_to(tmp_path / target)
        with pytest.raises(ValueError, match="exists; choose another name"):
            check_overwrite([link], overwrite=False)
        with in_place(link) as scratch:
            scratch.write_text("new")
        assert link.read_text() == "new"
        assert not link.is_symlink()
    assert (tmp_path / "precious").read_text() == "precious"
    assert not (tmp_path / "elsewhere").exists()
    for path in (tmp_path, tmp_path / "null"):
        if path != tmp_path:
            path.symlink_to("/dev/null")
        with pytest.raises(OSError, match="is no file and is left alone"), in_place(path):
            pass
    assert Path("/dev/null").is_char_device()


def test_a_lock_that_is_a_link_empties_nothing(tmp_path):
    (tmp_path / "precious").write_text("precious")
    (tmp_path / ".lock").symlink_to(tmp_path / "precious")
    with (
        pytest.raises(ValueError, match=r"lock '.*\.lock' is a link"),
        locked(tmp_path / ".lock", wait=False),
    ):
        pass
    assert (tmp_path / "precious").read_text() == "precious"

"""The disk cache: what a key distinguishes, and what happens to damaged files and bad folders."""

import errno
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np
import pytest

from myowarp import disk as cache
from myowarp.disk import (
    array_bytes,
    array_from_bytes,
    cache_dir,
    cached,
    locked,
    model_bytes,
    model_from_bytes,
    writable_folder,
)

MODEL = "<mujoco><worldbody><body><joint/><geom size='{size}'/></body></worldbody></mujoco>"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    path = tmp_path / "not" / "yet" / "there"
    monkeypatch.setenv("MYOWARP_CACHE_DIR", str(path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    writable_folder.cache_clear()
    yield path
    writable_folder.cache_clear()


class Maker:
    """Makes an array and counts how often it had to."""

    def __init__(self):
        self.count = 0

    def __call__(self, *key, value=1.0):
        def make():
            self.count += 1
            return np.full(100, value)

        return cached(key, make, array_bytes, array_from_bytes)


@pytest.fixture
def make():
    return Maker()


def test_folder(folder, monkeypatch):
    assert cache_dir() == folder
    monkeypatch.delenv("MYOWARP_CACHE_DIR")
    assert cache_dir().name == "myowarp"


def test_made_once_and_equal(make, folder):
    first = make("key", 1)
    assert np.array_equal(first, make("key", 1))
    assert make.count == 1
    assert len(list(folder.iterdir())) == 1, "scratch files are left behind"


@pytest.mark.parametrize("other", [("key", 2), ("other", 1), ("key", "1"), ("key", 1, None)])
def test_another_key_is_another_entry(make, folder, other):
    make("key", 1, value=1.0)
    assert make(*other, value=2.0)[0] == 2.0
    assert make("key", 1)[0] == 1.0
    assert make.count == 2
    assert len(list(folder.iterdir())) == 2


def test_another_engine_version_is_another_entry(make, monkeypatch):
    make("key")
    monkeypatch.setattr(cache, "version", lambda package: f"{package} 99.0")
    make("key")
    assert make.count == 2


DAMAGE = {
    "empty": lambda content: b"",
    "header cut": lambda content: content[:20],
    "half": lambda content: content[: len(content) // 2],
    "garbage": lambda content: b"\x00junk" * 50,
    "one bit of the digest": lambda content: bytes([content[0] ^ 1]) + content[1:],
    "one bit of the content": lambda content: content[:200] + bytes([content[200] ^ 1]) + content[201:],
    "one more byte": lambda content: content + b"\x00",
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_entry_is_made_again(make, folder, damage, caplog):
    expected = make("key")
    entry = next(folder.iterdir())
    entry.write_bytes(DAMAGE[damage](entry.read_bytes()))
    assert np.array_equal(make("key"), expected)
    assert make.count == 2
    assert [record.getMessage() for record in caplog.records] == [
        f"cached file {entry} is made again: it was damaged or changed"
    ]
    assert np.array_equal(make("key"), expected)
    assert make.count == 2, "the new entry was not kept"


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_model_is_compiled_again(folder, damage):
    def compiled():
        return cached(
            ("model",),
            make=lambda: mujoco.MjModel.from_xml_string(MODEL.format(size=0.3)),
            save=model_bytes,
            load=model_from_bytes,
        )

    compiled()
    entry = next(folder.iterdir())
    content = entry.read_bytes()
    entry.write_bytes(DAMAGE[damage](content))
    assert compiled().geom_size[0, 0] == 0.3
    assert entry.read_bytes() == content


def test_folder_that_cannot_be_made(make, tmp_path, monkeypatch, caplog):
    """A temporary one is used, the same in the next process, and one line says so."""
    file = tmp_path / "file"
    file.write_text("in the way")
    monkeypatch.setenv("MYOWARP_CACHE_DIR", str(file / "folder"))
    for _ in range(2):
        assert make("key")[0] == 1.0
    writable_folder.cache_clear()
    assert make("key")[0] == 1.0
    assert make.count == 1
    (instead,) = tmp_path.glob("myowarp-*/myowarp_cache_dir")
    assert instead.parent.stat().st_mode & 0o777 == 0o700
    lines = [record.getMessage() for record in caplog.records]
    assert lines[0] == (
        f"cache folder {file / 'folder'} cannot be written (Not a directory), {instead} is used; "
        "set MYOWARP_CACHE_DIR to a folder that can be written"
    )
    assert lines[1:] == lines[:1]


def test_temporary_folder_of_somebody_else(make, tmp_path, monkeypatch):
    """Where others could have written nothing is read or kept."""
    monkeypatch.setenv("MYOWARP_CACHE_DIR", "/dev/null/folder")
    make("key")
    (usual,) = tmp_path.glob("myowarp-*")
    usual.chmod(0o777)
    writable_folder.cache_clear()
    make("key")
    assert make.count == 2
    assert len(list(tmp_path.glob("myowarp-*"))) == 2


def test_full_folder_that_became_read_only_is_read(make, folder, tmp_path, monkeypatch):
    """As that of an image; root may write everything, so it is feigned."""
    make("key")
    usual = os.access
    monkeypatch.setattr(os, "access", lambda path, mode, **k: Path(path) != folder and usual(path, mode, **k))
    writable_folder.cache_clear()
    make("key")
    assert make.count == 1
    make("other")
    make("other")
    assert make.count == 2
    assert len(list(folder.iterdir())) == 1


def test_folder_that_cannot_be_written(make, folder, monkeypatch):
    """A damaged entry in somebody else's folder; permissions do not bind root, so they are feigned."""
    make("key")
    entry = next(folder.iterdir())
    entry.write_bytes(b"")

    def refuse(*args, **kwargs):
        raise PermissionError("read-only")

    monkeypatch.setattr(Path, "unlink", refuse)
    monkeypatch.setattr(tempfile, "mkstemp", refuse)
    assert make("key")[0] == 1.0


def test_entry_that_cannot_be_opened(make, folder):
    """Reading fails with an OSError: here a folder bears the entry's name."""
    make("key")
    entry = next(folder.iterdir())
    entry.unlink()
    entry.mkdir()
    assert make("key")[0] == 1.0


def test_failed_write_leaves_no_scratch(folder, monkeypatch, caplog):
    def write(path, content):
        with path.open("wb") as file:
            file.write(content[:3])
        raise OSError("disk full")

    monkeypatch.setattr(Path, "write_bytes", write)
    assert cached(("key",), lambda: 5, lambda entry: b"five", lambda content: pytest.fail("loaded")) == 5
    assert not list(folder.iterdir())
    assert caplog.records[0].getMessage().endswith("made again at the next start: disk full")


def test_failure_to_make_is_not_hidden(folder):
    def make():
        raise OSError("a model file is missing")

    with pytest.raises(OSError, match="a model file is missing"):
        cached(("key",), make, array_bytes, array_from_bytes)


HOLDER = """
import sys, time
from pathlib import Path
from myowarp.disk import locked
with locked(Path(sys.argv[1]), wait=False):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.mark.slow
def test_the_lock_of_a_killed_process_is_taken_over(tmp_path):
    path = tmp_path / ".lock"
    command = [sys.executable, "-c", HOLDER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "held\n"
        with (
            pytest.raises(ValueError, match=f"is in use by process {holder.pid} on"),
            locked(path, wait=False),
        ):
            pass
        holder.kill()
    with locked(path, wait=False):
        assert path.read_text().startswith(f"process {os.getpid()} on ")


def test_a_file_system_without_locks(tmp_path, monkeypatch, caplog):
    def none(file, operation):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fcntl.flock", none)
    with locked(tmp_path / ".lock", wait=False):
        pass
    assert "cannot be locked (No locks available); start nothing else in it" in caplog.text

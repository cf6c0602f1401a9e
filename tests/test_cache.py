"""The disk cache: what a key distinguishes, and what happens to damaged files and bad folders."""

import tempfile
from pathlib import Path

import mujoco
import numpy as np
import pytest

from myowarp import disk as cache
from myowarp.disk import cache_dir, cached

MODEL = "<mujoco><worldbody><body><joint/><geom size='{size}'/></body></worldbody></mujoco>"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    path = tmp_path / "not" / "yet" / "there"
    monkeypatch.setenv("MYOWARP_CACHE_DIR", str(path))
    return path


class Maker:
    """Makes an array and counts how often it had to."""

    def __init__(self):
        self.count = 0

    def __call__(self, *key, value=1.0):
        def make():
            self.count += 1
            return np.full(100, value)

        return cached(key, ".npy", make, save=lambda entry, path: np.save(path, entry), load=np.load)


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
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_entry_is_made_again(make, folder, damage):
    expected = make("key")
    entry = next(folder.iterdir())
    entry.write_bytes(DAMAGE[damage](entry.read_bytes()))
    assert np.array_equal(make("key"), expected)
    assert make.count == 2
    assert np.array_equal(make("key"), expected)
    assert make.count == 2, "the new entry was not kept"


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_model_is_compiled_again(folder, damage):
    def compiled():
        return cached(
            ("model",),
            ".mjb",
            make=lambda: mujoco.MjModel.from_xml_string(MODEL.format(size=0.3)),
            save=mujoco.mj_saveModel,
            load=mujoco.MjModel.from_binary_path,
        )

    compiled()
    entry = next(folder.iterdir())
    content = entry.read_bytes()
    entry.write_bytes(DAMAGE[damage](content))
    assert compiled().geom_size[0, 0] == 0.3
    assert entry.read_bytes() == content


def test_folder_that_cannot_be_made(make, tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.write_text("in the way")
    monkeypatch.setenv("MYOWARP_CACHE_DIR", str(file / "folder"))
    assert make("key")[0] == 1.0
    assert make("key")[0] == 1.0
    assert make.count == 2


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


def test_failed_write_leaves_no_scratch(folder):
    def save(entry, path):
        Path(path).write_bytes(b"half of it")
        raise OSError("disk full")

    assert cached(("key",), ".npy", lambda: 5, save, lambda path: pytest.fail("loaded")) == 5
    assert not list(folder.iterdir())


def test_failure_to_make_is_not_hidden(folder):
    def make():
        raise OSError("a model file is missing")

    with pytest.raises(OSError, match="a model file is missing"):
        cached(("key",), ".npy", make, np.save, np.load)

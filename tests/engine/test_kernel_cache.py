"""Machine code on disk: what was damaged is compiled anew, and a folder that can be written is found."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import warp as wp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.cold_starts import first_starts
from myowarp import process
from myowarp.disk import writable_folder
from myowarp.engine import compile as compile_
from myowarp.engine import kernel_cache
from myowarp.engine.compile import compile_kernels, quiet
from myowarp.progress import patient_bar


@wp.kernel(enable_backward=False, module="unique")
def triple_and_one(values: wp.array[float]):
    i = wp.tid()
    values[i] = 3.0 * values[i] + 1.0


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """The folder of a module that was compiled just now."""
    wp.init()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wp.config, "kernel_cache_dir", str(tmp_path_factory.mktemp("kernels")))
        loaded()
        (found,) = Path(wp.config.kernel_cache_dir).glob("wp_triple_and_one*")
    return found


@pytest.fixture
def folder(compiled, tmp_path, monkeypatch):
    """A copy of it where Warp looks."""
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    return Path(shutil.copytree(compiled, tmp_path / compiled.name))


def loaded():
    """Compile or load the kernel as a new process would; return what it computes."""
    kernel_cache._sound.clear()
    triple_and_one.module.unload()
    values = wp.array([0.0, 2.0, -1.0], dtype=float, device="cpu")

    def launch():
        wp.launch(triple_and_one, dim=3, outputs=[values], device="cpu")

    with quiet():
        compile_kernels(launch, wp.get_device("cpu"), show=False)
        launch()
    return values.numpy().tolist()


RIGHT = [1.0, 7.0, -2.0]
SAID = "compiled kernels were damaged or changed on disk and are compiled anew: 1 modules in {}"


def damaged_files(folder):
    return sorted(file for file in folder.iterdir() if file.suffix != ".cpp")


def test_it_is_loaded_from_disk(folder, caplog):
    files = {file: file.stat().st_mtime_ns for file in folder.iterdir()}
    assert {file.suffix for file in files} == {".cpp", ".o", ".meta", ".json"}
    assert loaded() == RIGHT
    assert {file: file.stat().st_mtime_ns for file in folder.iterdir()} == files
    assert not caplog.records


@wp.kernel(enable_backward=False, module="unique")
def copied(source: wp.array[Any], target: wp.array[Any]):
    i = wp.tid()
    target[i] = source[i]


def test_kernels_of_any_type_are_compiled_once_for_all_that_is_launched(tmp_path, monkeypatch):
    """Warp would compile the module anew at the first launch with each type."""
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    pairs = [[wp.array([1, 2], dtype=kind, device="cpu") for _ in "ab"] for kind in (int, float, wp.int64)]

    def launch():
        for source, target in pairs:
            wp.launch(copied, dim=2, inputs=[source], outputs=[target], device="cpu")

    with quiet():
        compile_kernels(launch, wp.get_device("cpu"), show=False)
        modules = set(tmp_path.iterdir())
        launch()
    assert len(modules) == 1
    assert set(tmp_path.iterdir()) == modules


def test_a_pipe_is_told_before_the_first_module_is_there(capfd):
    """And nothing where all is there in a moment, or nobody wants to know."""
    with patient_bar("Compiling", "modules", 3, patience=0.01) as advance:
        time.sleep(0.2)
        said = capfd.readouterr().err
        advance(3)
    assert "Compiling: 0 of 3 modules so far" in said
    with patient_bar("Compiling", "modules", 3, patience=30.0) as advance:
        advance(3)
    with patient_bar("Compiling", "modules", 3, patience=0.01, show=False):
        time.sleep(0.1)
    assert "Compiling: 0" not in capfd.readouterr().err


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(which=st.integers(0, 2), place=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7))
def test_a_bit_flips(folder, caplog, which, place, bit):
    """In machine code, in what Warp notes beside it, or in the list itself."""
    caplog.clear()
    file = damaged_files(folder)[which]
    content = bytearray(file.read_bytes())
    content[int(place * len(content))] ^= 1 << bit
    file.write_bytes(content)
    assert loaded() == RIGHT
    assert [record.getMessage() for record in caplog.records] == [SAID.format(folder.parent)]
    caplog.clear()
    assert loaded() == RIGHT
    assert not caplog.records, "it was not healed"


@pytest.mark.parametrize("which", range(3))
@pytest.mark.parametrize("content", [b"", b"\xb6\x00garbage", None])
def test_a_file_is_cut_or_gone(folder, which, content):
    file = damaged_files(folder)[which]
    if content is None:
        file.unlink()
    else:
        file.write_bytes(content)
    assert loaded() == RIGHT
    assert len(list(folder.iterdir())) == 4


def test_what_another_program_left_is_taken_over(folder, caplog):
    (folder / kernel_cache.SUMS).unlink()
    before = {file: file.stat().st_mtime_ns for file in folder.iterdir()}
    assert loaded() == RIGHT
    assert (folder / kernel_cache.SUMS).exists()
    assert {file: file.stat().st_mtime_ns for file in before} == before
    assert not caplog.records


def test_a_killed_compilation_is_swept_after_a_day(tmp_path, monkeypatch):
    """What another process may still compile, here or on another machine, stays; so do modules."""
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    days = {"wp_one_0a_p17_t140": 2.0, "wp_two_0b_p17_t140": 0.5, "wp_three_0c": 90.0}
    for name, age in days.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "wp_module.cpp").write_text("")
        os.utime(tmp_path / name, (time.time() - 86_400.0 * age,) * 2)
    assert loaded() == RIGHT
    assert {path.name for path in tmp_path.glob("wp_t*_0*")} == {"wp_two_0b_p17_t140", "wp_three_0c"}
    assert not (tmp_path / "wp_one_0a_p17_t140").exists()


def test_what_cannot_be_removed_is_an_error(folder, monkeypatch):
    (folder / kernel_cache.SUMS).write_text("{}")

    def refuse(*args, **kwargs):
        raise PermissionError("read-only")

    monkeypatch.setattr(Path, "rename", refuse)
    with pytest.raises(
        RuntimeError, match=r"are damaged and cannot be removed \(read-only\); remove them or "
    ):
        loaded()


@pytest.mark.slow
def test_read_only_folder_is_read_and_a_temporary_one_written(folder, tmp_path_factory, monkeypatch, caplog):
    """As that of an image; root may write everything, so it is feigned."""
    full, usual = folder.parent, os.access
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    monkeypatch.setattr(kernel_cache.tempfile, "tempdir", str(elsewhere))
    monkeypatch.setattr(os, "access", lambda path, mode, **k: Path(path) != full and usual(path, mode, **k))
    writable_folder.cache_clear()
    process.start_warp.__wrapped__.cache_clear()
    before = {file: file.stat().st_mtime_ns for file in full.rglob("*")}
    process.start_warp()
    assert Path(wp.config.kernel_cache_dir).is_relative_to(elsewhere)
    assert "set WARP_CACHE_PATH to a folder that can be written" in caplog.records[0].getMessage()
    caplog.clear()
    assert loaded() == RIGHT
    assert {file: file.stat().st_mtime_ns for file in full.rglob("*")} == before, "compiled anew, or written"
    (link,) = Path(wp.config.kernel_cache_dir).glob("wp_triple*")
    next(folder.glob("*.o")).write_bytes(b"")
    assert loaded() == RIGHT
    assert not link.is_symlink()
    assert len(caplog.records) == 1
    writable_folder.cache_clear()
    process.start_warp.__wrapped__.cache_clear()


START = """
import logging
from myowarp.sim.build import resolve_device
resolve_device(None)
import warp as wp, sys
print(wp.config.kernel_cache_dir)
try:
    resolve_device("cuda:0")
except ValueError as error:
    print(error)
"""


def start(**environment):
    """Start Warp in a process of its own; return its output and error stream by lines."""
    variables = os.environ | environment
    done = subprocess.run(
        [sys.executable, "-c", START], capture_output=True, text=True, env=variables, check=True
    )
    return done.stdout.splitlines(), done.stderr.splitlines()


@pytest.mark.slow
def test_home_that_cannot_be_written(tmp_path):
    """Warp itself ends with an OSError there."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    out, err = start(WARP_CACHE_PATH="/dev/null/cache", TMPDIR=str(temporary))
    folder = next(line for line in out if line.startswith(str(temporary)))
    assert Path(folder).is_dir()
    (line,) = [line for line in err if "cache" in line]
    assert line.endswith("is used; set WARP_CACHE_PATH to a folder that can be written")


@pytest.mark.slow
@pytest.mark.skipif(wp.is_cuda_available(), reason="for machines without a GPU")
def test_machine_without_gpu():
    """Nothing is said about CUDA until somebody asks for it."""
    out, err = start()
    assert "CUDA" not in "".join(err)
    assert out[-1] == f"device 'cuda:0' is not available; available: cpu ({process.NO_DRIVER})"


def test_each_process_begins_with_other_modules(monkeypatch):
    """So that processes which start at once take from disk what another has compiled."""
    began = []
    monkeypatch.setattr(compile_, "load_module", lambda module, *_: began.append(module))
    monkeypatch.setattr(os, "cpu_count", lambda: 1)  # one after the other

    def kernel(number):
        @wp.kernel(enable_backward=False, module=f"{__name__}.{number}")
        def nothing(values: wp.array[float]):
            values[wp.tid()] = 0.0

        return nothing

    kernels = [kernel(number) for number in range(12)]

    def launch():
        for each in kernels:
            wp.launch(each, dim=3, outputs=[wp.zeros(3, dtype=float, device="cpu")], device="cpu")

    orders = set()
    for _ in range(4):
        began.clear()
        assert compile_kernels(launch, wp.get_device("cpu")) == tuple(each.module for each in kernels)
        assert sorted(module.name for module in began) == sorted(each.module.name for each in kernels)
        orders.add(tuple(began))
    assert len(orders) == 4


@pytest.mark.scale
def test_first_starts_at_once_share_the_work():
    """Three on an empty cache, one of them killed; processor times say it on busy cores, too."""
    alone = first_starts("myoElbowPose1D6MRandom-v0", 1, None)
    together = first_starts("myoElbowPose1D6MRandom-v0", 3, min(8.0, alone["seconds"][0] / 2))
    assert len(together["seconds"]) == 2
    assert max(together["seconds"]) <= 2 * alone["seconds"][0]
    assert max(together["cpu_seconds"]) <= 0.85 * alone["cpu_seconds"][0]

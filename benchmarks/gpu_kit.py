"""All that a machine with a GPU needs to measure without internet or compiler, in parts of at most 50 MB.

    python -m benchmarks.gpu_kit out/gpu_kit

A kit holds this commit, the packages it needs for Python 3.12 (torch and a driver are there), machine code
of what is launched, caches of models and verdicts, and what the CPU makes of the tasks. `gpu_run.sh` unpacks
it and measures.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import tyro
import warp as wp
from rich.console import Console

from myowarp.process import start_warp

PYTHON = "3.12"
PART = "50MB"  # as `split` reads it
PACKAGES = (
    *("warp-lang", "mujoco", "mujoco-core", "mujoco-warp", "myo-sim", "absl-py", "etils", "fsspec", "zipp"),
    *("numpy", "gymnasium", "farama-notifications", "cloudpickle", "typing-extensions", "safetensors"),
    *("tyro", "typeguard", "docstring-parser", "platformdirs", "rich", "markdown-it-py", "mdurl", "pygments"),
)
"""Imports of `benchmarks.gpu`, and their requirements; at the versions of this environment."""

PLATFORMS = tuple(f"manylinux{tag}_x86_64" for tag in ("_2_34", "_2_31", "_2_28", "_2_27", "_2_17", "2014"))
UNREAD = ("warp/tests", "warp/examples", "mujoco_warp/test_data", "numpy/*/tests")
"""Files of packages that no measurement reads."""
SOURCES = ("myowarp", "benchmarks", "pyproject.toml", "LICENSE")


@dataclass(frozen=True)
class Options:
    """Pack all that a machine with a GPU needs to measure."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder for the parts, replaced."""
    tasks: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-t"])] = ()
    """Task names with version; all that are measured by default."""
    cubins: Path = Path("out/cubins")
    """Folder that keeps machine code from one kit to the next: it takes minutes."""


def run(*command: object, kit: Path | None = None) -> None:
    """Run a command; in a kit, with its sources and caches."""
    environment = dict(os.environ)
    if kit is not None:
        kernels = Path(wp.config.kernel_cache_dir).parent  # those of this CPU are of no use elsewhere
        folders = {"PYTHONPATH": kit, "XDG_CACHE_HOME": kit / "cache", "WARP_CACHE_PATH": kernels}
        environment |= {name: str(folder) for name, folder in folders.items()}
    subprocess.run([str(part) for part in command], check=True, cwd=kit, env=environment)


def install(site: Path) -> None:
    """Install the packages into a folder, for the other machine's Python."""
    wanted = [f"{name}=={version(name)}" for name in PACKAGES]
    platforms = [f"--platform={name}" for name in PLATFORMS]
    options = ("-qq", "--no-deps", "--no-compile", "--only-binary=:all:", f"--python-version={PYTHON}")
    run(sys.executable, "-m", "pip", "install", *options, *platforms, f"--target={site}", *wanted)
    for pattern in UNREAD:
        for folder in site.glob(pattern):
            shutil.rmtree(folder)


def fill(kit: Path, options: Options) -> None:
    """Write what the kit holds."""
    tasks = ["--tasks", *options.tasks] if options.tasks else []
    archive = subprocess.run(["git", "archive", "HEAD", *SOURCES], check=True, capture_output=True).stdout
    subprocess.run(["tar", "x", "-C", kit], input=archive, check=True)
    install(kit / "site")
    references = kit / "references.npz"
    run(sys.executable, "-m", "benchmarks.gpu", *tasks, "--record", references, kit=kit)
    folder = (options.cubins / wp.__version__).resolve()
    run(sys.executable, "-m", "benchmarks.cuda_step", *tasks, "--complete", "--compile", folder, kit=kit)
    shutil.copytree(folder, kit / "warp" / wp.__version__, ignore=shutil.ignore_patterns("*.cu", "lto"))


def pack(kit: Path, folder: Path, size: str = PART) -> None:
    """Compress the kit, and split it into parts of a size."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    shutil.copy(Path(__file__).with_name("gpu_run.sh"), folder / "run.sh")
    command = f"tar c -C {kit} . | xz -T0 | split -d -b {size} - {folder}/part"
    run("bash", "-o", "pipefail", "-c", command)


def main() -> None:
    """Pack, and say how large the parts are."""
    options = tyro.cli(Options, prog="python -m benchmarks.gpu_kit")
    start_warp()
    with tempfile.TemporaryDirectory() as folder:
        fill(Path(folder), options)
        pack(Path(folder), options.folder)
    sizes = {part.name: part.stat().st_size / 1e6 for part in sorted(options.folder.glob("part*"))}
    Console().print(
        f"{options.folder}: " + ", ".join(f"{name} {size:.1f} MB" for name, size in sizes.items())
    )


if __name__ == "__main__":
    main()

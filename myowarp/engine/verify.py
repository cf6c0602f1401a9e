"""What the engine's step can be relieved of in a scene, found out once per machine.

To verify pruning and fusions the stock step has to be compiled and run beside ours, which is most of the time
of a first start. The verdict is kept on disk, under a key that names everything it depends on.
"""

import json
import platform
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

from myowarp.disk import cached, files_digest, model_digest, version
from myowarp.engine.compile import compile_kernels
from myowarp.engine.idle import idle_kernels, verified_idle
from myowarp.engine.stages import Fusion, applicable_fusions, installed, verified_fusions
from myowarp.spec.scene import Scene

SOURCES = (
    "engine/**/*.py",
    "engine/**/*.cpp",
    "sim/*.py",
    "kernels/*.py",
    "kernels/*.cpp",
    "models/muscles/*.py",
    "models/muscles/*.cpp",
)
"""Files of the package that decide a verdict."""


class Verdict(NamedTuple):
    """What was verified.

    Attributes:
        idle: Kernels of the engine to leave out.
        fusions: Classes of the fusions to use.
    """

    idle: frozenset[str]
    fusions: frozenset[str]


def cached_verdict(scene: Scene, candidates: Iterable[Fusion], verify: Callable[[], Verdict]) -> Verdict:
    """Return what `verify` found for this scene and these candidates, now or in an earlier process."""
    package = Path(__file__).parents[1]
    files = sorted(file for pattern in SOURCES for file in package.glob(pattern))
    digests = (model_digest(scene.oracle), files_digest(files))
    names = sorted(type(fusion).__name__ for fusion in candidates)
    where = (scene.device.alias, scene.device.name, scene.device.arch, platform.machine())
    key = ("verdict", *digests, names, where, version("mujoco-warp"), version("warp-lang"))

    def load(path: str) -> Verdict:
        entry = json.loads(Path(path).read_text())
        known = {"idle": idle_kernels(scene.oracle), "fusions": frozenset(names)}
        if not isinstance(entry, dict) or any(not isinstance(entry.get(part), list) for part in known):
            raise ValueError(f"{path} holds no verdict")
        parts = {part: frozenset(map(str, entry[part])) for part in known}
        if not all(parts[part] <= known[part] for part in known):
            raise ValueError(f"{path} names kernels that are not there")
        return Verdict(**parts)

    def save(verdict: Verdict, path: str) -> None:
        Path(path).write_text(json.dumps({part: sorted(names) for part, names in verdict._asdict().items()}))

    return cached(key, ".json", make=verify, save=save, load=load)


def choose_kernels(
    scene: Scene,
    names: Iterable[str],
    launch_all: Callable[[], None],
    launch_physics: Callable[[], None],
    progress: bool,
) -> tuple[frozenset[str], tuple[Fusion, ...]]:
    """Return which kernels of the engine to leave out, and which fusions to use.

    Args:
        scene: The task; its state is overwritten.
        names: Fusions to use where they apply, names in `FUSIONS`.
        launch_all: Launches everything, the physics stock.
        launch_physics: Launches a stock physics step.
        progress: Whether to show progress bars.
    """
    candidates = applicable_fusions(scene, names)

    def launch_both() -> None:
        launch_all()
        with installed(candidates):
            launch_physics()

    def verify() -> Verdict:
        compile_kernels(launch_both, scene.device, show=progress)
        trusted = verified_fusions(scene, candidates, launch_physics)
        idle = verified_idle(scene, launch_physics)
        return Verdict(idle, frozenset(type(fusion).__name__ for fusion in trusted))

    verdict = cached_verdict(scene, candidates, verify)
    return verdict.idle, tuple(fusion for fusion in candidates if type(fusion).__name__ in verdict.fusions)

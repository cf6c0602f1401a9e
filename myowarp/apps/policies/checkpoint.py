"""A checkpoint: a folder with `manifest.json` and tensors, written whole or not at all, read without torch.

    runs/x/checkpoints/000000614400/
        manifest.json          what it is: task contract, settings, versions, checksums
        policy.safetensors     what acts: weights and normaliser
        state.safetensors      what a resumed run needs besides
    runs/x/best/000000307200/  manifest.json and policy.safetensors of the best policy, which plays

It is written under a temporary name, flushed to the disk and renamed; only then the one before is deleted. So
the last good one survives a kill at any moment and a full disk. Reading runs no code: JSON and plain arrays,
whose checksums are in the manifest.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shlex
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from myowarp.apps.policies.form import check_manifest, check_policy
from myowarp.definitions.condition import Condition
from myowarp.definitions.muscle import muscle_names
from myowarp.definitions.option import flag
from myowarp.definitions.senses import PARAMETERS, SENSES, Told
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TaskSpec
from myowarp.disk import version
from myowarp.kernels.action import CENTER, STEEPNESS
from myowarp.process import warn_once
from myowarp.sim.build import oracle_model
from myowarp.sim.simulation import Simulation
from myowarp.tasks.setups import variant_of

FORMAT = 1
MANIFEST, POLICY, STATE = "manifest.json", "policy.safetensors", "state.safetensors"
FOLDER, BEST, TEMPORARY = "checkpoints", "best", ".part"
LEARNER = 2  # of which kind the arrays of a resumed run are; 1, without a number: those of skrl's agents
ACTING = ("family", "body", "columns", "actuators", "action")  # entries of a contract that a policy needs
PACKAGES = ("myowarp", "mujoco", "mujoco-warp", "warp-lang", "myo-sim", "numpy", "torch")


class CheckpointError(ValueError):
    """A checkpoint that cannot be used."""


@dataclass(frozen=True)
class Checkpoint:
    """A trained policy as a folder holds it.

    Attributes:
        folder: Where it is.
        manifest: What it is.
        policy: Arrays of the policy by name.
    """

    folder: Path
    manifest: dict[str, Any]
    policy: dict[str, np.ndarray]

    @property
    def task(self) -> str:
        """Key of the task it was trained in."""
        return str(self.manifest["contract"]["task"])

    def state(self) -> dict[str, np.ndarray]:
        """Return what a resumed run needs besides the policy.

        Raises:
            CheckpointError: It is damaged.
        """
        return _read_arrays(self.folder, STATE, self.manifest)


def is_file(asked: Setup) -> bool:
    """Whether a task is from a file, which a checkpoint does not open by itself."""
    return isinstance(asked.task, Path) or ":" in str(asked.task)


def eval_command(asked: Setup, folder: Path | str) -> str:
    """Return what a shell is told to evaluate a policy, of which its checkpoint says the task."""
    flag = "--model" if isinstance(asked.task, Path) else "--task"
    file = [flag, str(asked.task)] if is_file(asked) else []
    return f"myowarp {shlex.join(['eval', str(folder), *file])}"


def resume_command(asked: Setup, folder: Path, ranks: int) -> str:
    """Return what a shell is told to go on with a run, which its checkpoint says."""
    start = f"torchrun --nproc-per-node {ranks} -m myowarp" if ranks > 1 else "myowarp"
    model = ["--model"] if isinstance(asked.task, Path) else []
    file = [*model, str(asked.task)] if is_file(asked) else []
    return f"{start} {shlex.join(['train', *file, '--resume', str(folder)])}"


def trained_setup(manifest: Mapping[str, Any]) -> Setup:
    """Return what a checkpoint's policy was trained in, as its user said it."""
    task = Path(manifest["task"]) if manifest["model"] else manifest["task"]
    return Setup(task=task).over(Setup.from_plain(manifest["settings"]))


def setup_entries(asked: Setup, setup: Setup) -> dict[str, Any]:
    """Return what a checkpoint says of its environment besides its settings; `trained_setup` reads it.

    Args:
        asked: What the user said.
        setup: What that stands for.
    """
    # A model's file was read at the start, and may be gone by now.
    task, from_file = asked.task, isinstance(asked.task, Path)
    variant = variant_of(replace(asked, task=setup.spec.key if from_file else task))
    objects = [condition.name for condition in asked.conditions or () if isinstance(condition, Condition)]
    return {
        "task": task.key if isinstance(task, TaskSpec) else str(task),  # what it changes is in the contract
        "model": from_file,
        "reset": variant.reset,
        "conditions": [*variant.conditions, *objects],
    }


def task_contract(sim: Simulation) -> dict[str, Any]:
    """Return what a policy is tied to: observation, action mapping and reward of a task."""
    scene = sim.scene
    spec: TaskSpec = scene.spec
    names = [scene.oracle.actuator(i).name for i in range(scene.num_actions)]
    return {
        "task": spec.key,
        "family": spec.family,
        "body": spec.body,
        "columns": [[column.name, column.size, column.unit] for column in sim.columns],
        "actuators": names,
        "action": f"clip(a, -1, 1); muscles 1 / (1 + exp(-{STEEPNESS} (a - {CENTER}))), motors linear",
        "reward": [[term.name, term.weight] for term in sim.terms],
        "control_dt": scene.control_dt,
        "success": "more than 5 solved steps",
    }


def check_task(checkpoint: Checkpoint, spec: TaskSpec) -> None:
    """Raise CheckpointError if a policy cannot act in a task whatever the conditions; nothing is compiled.

    Conditions may append columns, and change sizes of the task's: `check_contract` sees those.
    """
    recorded, model = checkpoint.manifest["contract"], oracle_model(spec)
    columns = spec.columns(model.nq, model.nv, len(muscle_names(model)))
    own = [[column.name, column.size, column.unit] for column in columns]
    present = {"family": spec.family, "body": spec.body, "columns": [column for column in own if column[1]]}
    there, here = ([(name, unit) for name, _, unit in of["columns"]] for of in (recorded, present))
    differs = {key: recorded[key] != present[key] for key in ("family", "body")}
    differs["columns"] = there[: len(here)] != here
    for key in filter(differs.get, differs):
        raise _refusal(checkpoint, "act", spec.key, _difference(key, recorded[key], present[key]))


def _refusal(checkpoint: Checkpoint, does: str, key: str, why: str) -> CheckpointError:
    """Return the error of a policy that cannot act or learn in a task."""
    return CheckpointError(
        f"checkpoint {str(checkpoint.folder)!r} was trained in {checkpoint.task!r} and cannot {does} in "
        f"{key!r}: {why}"
    )


def check_contract(checkpoint: Checkpoint, sim: Simulation, *, learning: bool = False) -> None:
    """Raise CheckpointError if a policy cannot act in a simulation, or not go on to learn in it.

    A policy may act on other muscles than those that it was trained with, which is said once.
    """
    present = json.loads(json.dumps(task_contract(sim)))
    recorded = checkpoint.manifest["contract"]
    if not learning:
        present["columns"] = _visible(recorded["columns"], sim)
    for key in present if learning else ACTING:
        if recorded.get(key) != present[key]:
            why = _difference(key, recorded.get(key), present[key])
            senses = trained_setup(checkpoint.manifest).observe or ()
            if key == "columns" and senses != (sim.setup.observe or ()):
                why += f"; it was trained with {flag('observe')} {' '.join(senses)}".rstrip()
            raise _refusal(checkpoint, "learn" if learning else "act", present["task"], why)
    trained, runs = checkpoint.manifest["settings"].get("muscle") or "mujoco", sim.setup.muscles.model
    if trained != runs:
        warn_once(f"policy {str(checkpoint.folder)!r} was trained with {trained} muscles and acts on {runs}")


def _visible(recorded: list[Any], sim: Simulation) -> list[Any]:
    """Return the columns that a policy can have here: those of the task, and of the senses its own."""
    here = {column.name: [column.name, column.size, column.unit] for column in sim.columns}
    senses = {name: here.pop(name) for name in SENSES if name in here}
    if PARAMETERS not in senses and sim.shards[0].scene.parameters:  # which whoever needs them is told
        told = Told(sim.shards[0].scene, sim.shards[0].clock).column
        senses[PARAMETERS] = [told.name, told.size, told.unit]
    return [*here.values(), *(senses[name] for name, *_ in recorded if name in senses)]


def _difference(key: str, recorded: Any, present: Any) -> str:
    """Return how an entry of two contracts differs, in a few words."""
    if not isinstance(recorded, list):
        return f"{key} is {recorded!r} there and {present!r} here"
    there, here = ([x[0] if isinstance(x, list) else x for x in own] for own in (recorded, present))
    alone = {"there": [x for x in there if x not in here], "here": [x for x in here if x not in there]}
    only = "".join(f"; only {where}: {', '.join(own)}" for where, own in alone.items() if own)
    pairs = [(a, b) for a, b in zip(recorded, present, strict=False) if a != b]
    if pairs and not only:
        return f"{key} have {pairs[0][0]} there and {pairs[0][1]} here"
    return f"{key} have {len(recorded)} entries there and {len(present)} here{only}"


def versions() -> dict[str, str]:
    """Return versions of Python and of the packages that numbers depend on."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def save_checkpoint(
    run: Path,
    samples: int,
    manifest: Mapping[str, Any],
    policy: Mapping[str, np.ndarray],
    state: Mapping[str, np.ndarray] | None = None,
    *,
    root: str = FOLDER,
) -> Path:
    """Write a checkpoint of a run, and delete the ones before; returns its folder.

    Args:
        run: Folder of the run.
        samples: Samples so far; the folder's name.
        manifest: What it is; format and checksums are added.
        policy: Arrays of the policy.
        state: Arrays that a resumed run needs besides; None: it holds a policy alone.
        root: Folder of the run in which it is, `FOLDER` or `BEST`.

    Raises:
        OSError: It cannot be written; the one before is still there.
    """
    above = run / root
    above.mkdir(parents=True, exist_ok=True)
    final, part = above / f"{samples:012d}", above / f"{samples:012d}{TEMPORARY}"
    if final.exists():  # a resumed run that ends before its first step
        return final
    shutil.rmtree(part, ignore_errors=True)
    try:
        part.mkdir()
        files = {POLICY: policy} | ({} if state is None else {STATE: state})
        for name, content in _contents(manifest, files).items():
            _write(part / name, content)
        _flush_folder(part)
        part.rename(final)
        _flush_folder(above)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    for other in above.iterdir():  # what else lies there is the user's
        if other != final and other.name.removesuffix(TEMPORARY).isdecimal():
            shutil.rmtree(other, ignore_errors=True)
    return final


def save_policy(folder: Path, checkpoint: Checkpoint) -> None:
    """Write what acts of a checkpoint: manifest and policy; such a run cannot be resumed.

    Raises:
        OSError: It cannot be written.
    """
    manifest = {name: entry for name, entry in checkpoint.manifest.items() if name not in ("format", "files")}
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in _contents(manifest, {POLICY: checkpoint.policy}).items():
        _write(folder / name, content)


def _contents(manifest: Mapping[str, Any], files: Mapping[str, Mapping[str, np.ndarray]]) -> dict[str, bytes]:
    """Return the contents of a checkpoint's files: arrays, and the manifest with their checksums."""
    contents = {name: _packed(arrays) for name, arrays in files.items()}
    entries = {name: file_entry(content) for name, content in contents.items()}
    whole = {"format": FORMAT, **manifest, "files": entries}
    contents[MANIFEST] = json.dumps(whole | {"digest": manifest_digest(whole)}, indent=1).encode()
    return contents


def find_folder(path: Path, *, learning: bool = False) -> Path:
    """Return the folder of a checkpoint; of a run's folder that of the best policy, else the last one.

    Args:
        path: The folder.
        learning: Whether the run is to go on: then its last checkpoint.

    Raises:
        CheckpointError: There is none.
    """
    if (path / MANIFEST).is_file():
        return path
    for root in (path / FOLDER,) if learning else (path / BEST, path / FOLDER):
        folders = root.iterdir() if root.is_dir() else ()
        found = [folder for folder in folders if folder.name.isdecimal() and (folder / MANIFEST).is_file()]
        if found:
            return max(found, key=lambda folder: folder.name)
    absent = "" if path.exists() else ", and this one does not exist"
    raise CheckpointError(
        f"{str(path)!r} holds no checkpoint; a run's folder has {FOLDER}/<samples>/{MANIFEST}{absent}; the "
        "package's policies are baselines/ID"
    )


def last_saved(folder: Path) -> Path | None:
    """Return the last checkpoint in the folder of a run; None if there is none."""
    try:
        return find_folder(folder, learning=True)
    except CheckpointError:
        return None


def load_checkpoint(path: Path, *, learning: bool = False) -> Checkpoint:
    """Read a checkpoint, or of a run's folder the best policy or, where it is to go on, the last checkpoint.

    Raises:
        CheckpointError: There is none, it is damaged, or another version wrote it.
    """
    folder = find_folder(path, learning=learning)
    try:
        manifest = read_manifest(folder)
        policy = _read_arrays(folder, POLICY, manifest)
        _agreed(folder, check_policy, manifest, policy)
    except CheckpointError:
        if find_folder(path, learning=learning) == folder:
            raise
        return load_checkpoint(path, learning=learning)  # the run goes on, and has replaced it meanwhile
    return Checkpoint(folder, manifest, policy)


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest, checked against its own digest, and in its form."""
    try:
        manifest = json.loads((folder / MANIFEST).read_bytes())
        digest = manifest.pop("digest", None) if isinstance(manifest, dict) else None
        wanted = manifest_digest(manifest)
    except (OSError, ValueError, RecursionError) as error:
        raise CheckpointError(f"checkpoint {str(folder)!r} has no readable {MANIFEST} ({error})") from error
    if not isinstance(manifest, dict):
        raise CheckpointError(f"checkpoint {str(folder)!r} has a {MANIFEST} that is no entries by name")
    if manifest.get("format") != FORMAT:
        raise CheckpointError(
            f"checkpoint {str(folder)!r} has format {manifest.get('format')!r}; this version reads {FORMAT}"
        )
    if digest != wanted:
        raise CheckpointError(f"checkpoint {str(folder)!r} was changed: {MANIFEST} does not have its digest")
    _agreed(folder, check_manifest, manifest)
    return dict(manifest)


def _agreed(folder: Path, check: Callable[..., None], *parts: Any) -> None:
    """Raise CheckpointError with the reason that a check of `myowarp.apps.policies.form` gives."""
    try:
        check(*parts)
    except ValueError as error:
        raise CheckpointError(f"checkpoint {str(folder)!r} {error}") from error


def _read_arrays(folder: Path, name: str, manifest: dict[str, Any]) -> dict[str, np.ndarray]:
    """Return the arrays of a file that has the checksum of the manifest."""
    if (wanted := manifest["files"].get(name)) is None:
        raise CheckpointError(
            f"checkpoint {str(folder)!r} lacks {name}, of which its {MANIFEST} says nothing"
        )
    try:
        content = (folder / name).read_bytes()
    except OSError as error:
        raise CheckpointError(f"checkpoint {str(folder)!r} lacks {name} ({error.strerror})") from error
    if len(content) != wanted["bytes"]:
        raise CheckpointError(
            f"checkpoint {str(folder)!r} is damaged: {name} has {len(content)} bytes, its manifest says "
            f"{wanted['bytes']}"
        )
    if file_entry(content) != wanted:
        raise CheckpointError(f"checkpoint {str(folder)!r} was changed: {name} does not have its checksum")
    try:
        return dict(load(content))
    except SafetensorError as error:
        raise CheckpointError(f"checkpoint {str(folder)!r} has {name} that is no safetensors file") from error
    except KeyError as error:  # a type that NumPy does not have
        raise CheckpointError(
            f"checkpoint {str(folder)!r} has {name} with numbers of type {error.args[0]}, which no run writes"
        ) from error


def _packed(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Return arrays as the content of a safetensors file."""
    return bytes(save({name: np.ascontiguousarray(array) for name, array in arrays.items()}))


def file_entry(content: bytes) -> dict[str, Any]:
    """Return what the manifest says of a file."""
    return {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}


def manifest_digest(manifest: Mapping[str, Any]) -> str:
    """Return the digest of a manifest."""
    return hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()


def _write(path: Path, content: bytes) -> None:
    """Write a file and wait until it is on the disk."""
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _flush_folder(folder: Path) -> None:
    """Wait until the names in a folder are on the disk; Windows opens no folder."""
    if os.name == "nt":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)

"""Runs of `myowarp train` whose files were damaged, edited or copied: what is refused, and what goes on."""

import csv
import io
import json
import os
import pickle
import re
import shutil

import numpy as np
import pytest
from rich.console import Console
from tiny_runs import ELBOW, TINY, said

from myowarp.apps.policies import checkpoint as checkpoints
from myowarp.apps.policies.learned import LearnedPolicy, read_policy
from myowarp.apps.reports.progress import Progress
from myowarp.definitions.task import TASKS


@pytest.fixture
def copy(tiny, tmp_path):
    """Return the folder of a checkpoint that may be damaged."""
    source, target = checkpoints.find_folder(tiny), tmp_path / "damaged"
    target.mkdir()
    for file in source.iterdir():
        (target / file.name).write_bytes(file.read_bytes())
    return target


def truncate(path):
    path.write_bytes(path.read_bytes()[:-1])


def flip(path):
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)


def edit(path):
    path.write_text(path.read_text().replace('"samples": 128', '"samples": 129'))


def unpickled(path):
    class Code:
        def __reduce__(self):
            return os.mkdir, (str(path) + ".ran",)

    path.write_bytes(pickle.dumps(Code()))


@pytest.mark.parametrize(
    ("damage", "file", "words"),
    [
        (truncate, "policy.safetensors", "is damaged: policy.safetensors has"),
        (flip, "policy.safetensors", "was changed: policy.safetensors does not have its checksum"),
        (unpickled, "policy.safetensors", "is damaged: policy.safetensors has"),
        (os.unlink, "policy.safetensors", "lacks policy.safetensors"),
        (truncate, "manifest.json", "has no readable manifest.json"),
        (unpickled, "manifest.json", "has no readable manifest.json"),
        (edit, "manifest.json", "was changed: manifest.json does not have its digest"),
        (os.unlink, "manifest.json", "holds no checkpoint"),
    ],
)
def test_damaged_checkpoints_are_refused(damage, file, words, copy, run, no_simulation):
    damage(copy / file)
    for arguments in (("eval", copy), ("rollout", ELBOW, "--policy", copy), ("train", "--resume", copy)):
        assert words in said(run(*arguments))
    assert not (copy / f"{file}.ran").exists()


def test_a_run_of_the_trainer_before_plays_and_does_not_go_on(copy, run, tmp_path):
    """A baseline has no number of its trainer, and arrays that nothing here understands."""
    rewrite(copy, lambda manifest: manifest.pop("learner"))
    root = tmp_path / "old" / checkpoints.FOLDER
    root.mkdir(parents=True)
    copy.rename(root / "000000000128")
    assert said(run("train", "--resume", tmp_path / "old")) == (
        f"run {str(tmp_path / 'old')!r} is one of the trainer before this one, and cannot go on; its policy "
        f"plays, and a new run can start from it with --parent {tmp_path / 'old'}"
    )
    options = ("--num-worlds", 2, "--steps", 2, "--device", "cpu")
    status, _, err = run("rollout", ELBOW, "--policy", tmp_path / "old", *options)
    assert status == 0, err
    options = ("--output", tmp_path / "new", *TINY, "--samples", 64, "--parent", tmp_path / "old")
    status, _, err = run("train", ELBOW, *options)
    assert status == 0, err


def test_the_best_policy_alone_does_not_go_on(tiny, run, tmp_path):
    whole = checkpoints.load_checkpoint(tiny)
    content = {k: v for k, v in whole.manifest.items() if k != "files"}, whole.policy
    best = checkpoints.save_checkpoint(tmp_path, 64, *content, root=checkpoints.BEST)
    assert said(run("train", "--resume", best)) == (
        f"checkpoint {str(best)!r} holds a policy alone and cannot be resumed"
    )
    assert said(run("train", "--resume", tmp_path)).startswith(
        f"{str(tmp_path)!r} holds no checkpoint; a run"
    )


def test_a_damaged_state_is_refused_when_a_run_goes_on(copy, run):
    flip(copy / "state.safetensors")
    assert "state.safetensors does not have its checksum" in said(run("train", "--resume", copy))


@pytest.mark.parametrize("lost", ["\0\0\0\0\n", "x6,2,nan\n", "\n", "\xff,1\n", "12"])
def test_a_run_goes_on_where_lines_of_its_progress_were_lost(lost, tiny, run, tmp_path):
    """As a disk leaves them that lost its power; the checkpoint, which was flushed, is whole."""
    folder = tmp_path / "lost"
    shutil.copytree(tiny, folder)
    lines = (folder / "progress.csv").read_text().splitlines(keepends=True)
    (folder / "progress.csv").write_bytes("".join([*lines, lost]).encode("latin-1"))
    status, _, err = run("train", "--resume", folder, "--samples", 192)
    assert status == 0, err
    now = (folder / "progress.csv").read_text().splitlines(keepends=True)
    assert now[:-1] == lines
    assert [row["samples"] for row in csv.DictReader(now)] == ["64", "128", "192"]


def test_a_progress_without_names_is_left_alone(tiny, run, tmp_path):
    folder = tmp_path / "other"
    shutil.copytree(tiny, folder)
    resaved = (folder / "progress.csv").read_text().replace(",", ";")
    (folder / "progress.csv").write_text(resaved)
    assert said(run("train", "--resume", folder, "--samples", 192)) == (
        f"{str(folder / 'progress.csv')!r} must begin with the names of its columns, samples first, got "
        "'samples;updates;seconds;return;length;su'; restore it, or move it away, and resume again"
    )
    assert (folder / "progress.csv").read_text() == resaved


def test_copies_of_a_checkpoint_are_the_users(tiny, run, tmp_path):
    """Neither resumed, though their names are the last ones, nor deleted with the checkpoints before."""
    folder = tmp_path / "kept"
    shutil.copytree(tiny, folder)
    last = checkpoints.find_folder(folder, learning=True)
    copies = [last.with_name(name) for name in (f"{last.name} (copy)", "my_best")]
    for copied in copies:
        shutil.copytree(last, copied)
        (copied / "policy.safetensors").write_bytes(b"")
    (last.parent / f"{2 * 128:012d}{checkpoints.TEMPORARY}").mkdir()
    status, _, err = run("train", "--resume", folder, "--samples", 192)
    assert status == 0, err
    assert {path.name for path in last.parent.iterdir()} == {f"{192:012d}", *(path.name for path in copies)}


def wide(policy, name, array):
    policy[name] = np.asarray(array, np.float32)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: p["net.2.bias"].fill(np.nan), "has net.2.bias that is not finite"),
        (lambda p: wide(p, "net.0.weight", np.ones((16, 4))), "own contract: net.0.weight has shape (16, 4)"),
        (lambda p: wide(p, "net.2.weight", np.ones((6, 8))), "net.2.weight has shape (6, 8), (6, 16) is"),
        (lambda p: p.pop("net.2.weight"), "net.2.weight has shape none, (6, 16) is needed"),
        (lambda p: p.pop("observation_variance"), "observation_variance has shape none, (9,) is needed"),
        (lambda p: wide(p, "net.x.weight", np.ones(1)), "net.x.weight has shape (1,), none is needed"),
        (lambda p: p.update({"log_std": np.zeros(6, int)}), "has log_std of type int64; floating-point"),
        (lambda p: wide(p, "observation_variance", -np.ones(9)), "observation_variance that is no variance"),
        (lambda p: p.update({"observation_mean": np.full(9, 1e300)}), "observation_mean that is not finite"),
        (lambda p: p["net.2.weight"].fill(3e38), "has weights so large that actions are not finite"),
    ],
)
def test_weights_that_cannot_act_are_refused(change, words, tiny, tmp_path):
    whole = checkpoints.load_checkpoint(tiny)
    policy = {name: array.copy() for name, array in whole.policy.items()}
    change(policy)
    checkpoints.save_checkpoint(
        tmp_path, 1, {k: v for k, v in whole.manifest.items() if k != "files"}, policy, {}
    )
    with pytest.raises(checkpoints.CheckpointError, match=re.escape(words)):
        checkpoints.load_checkpoint(tmp_path)


@pytest.mark.parametrize("kind", ["BF16", "F8_E4M3"])
def test_numbers_that_no_run_writes_are_refused(kind, copy, monkeypatch):
    header = json.dumps({"a": {"dtype": kind, "shape": [4], "data_offsets": [0, 8 if kind == "BF16" else 4]}})
    content = len(header).to_bytes(8, "little") + header.encode() + bytes(8 if kind == "BF16" else 4)
    (copy / checkpoints.POLICY).write_bytes(content)
    rewrite(
        copy, lambda manifest: manifest["files"].update({checkpoints.POLICY: checkpoints.file_entry(content)})
    )
    with pytest.raises(
        checkpoints.CheckpointError, match=f"with numbers of type {kind}, which no run writes"
    ):
        checkpoints.load_checkpoint(copy)


def rewrite(folder, change):
    """Change a manifest, with the digest of what it then says."""
    path = folder / checkpoints.MANIFEST
    manifest = json.loads(path.read_text())
    del manifest["digest"]
    change(manifest)
    path.write_text(json.dumps(manifest | {"digest": checkpoints.manifest_digest(manifest)}))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("[]", "has a manifest.json that is no entries by name"),
        ("[" * 100_000, "has no readable manifest.json (maximum recursion depth exceeded"),
    ],
)
def test_what_is_no_manifest_is_refused(content, words, copy, run, no_simulation):
    (copy / checkpoints.MANIFEST).write_text(content)
    assert words in said(run("eval", copy))


@pytest.mark.parametrize("value", [None, 5, -1, 1e308, float("nan"), "x", [], {}, True, [[["a"]]], [None]])
def test_no_entry_of_a_manifest_is_trusted(value, copy):
    """Whatever stands in the place of an entry, all that is raised is a sentence about the checkpoint."""
    original = (copy / checkpoints.MANIFEST).read_text()
    whole, refused = json.loads(original), 0
    places = [(key,) for key in whole if key != "digest"]
    places += [(key, inner) for key in whole if isinstance(whole[key], dict) for inner in whole[key]]

    def put(manifest, *keys):
        for key in keys[:-1]:
            manifest = manifest[key]
        manifest[keys[-1]] = value

    for place in places:
        (copy / checkpoints.MANIFEST).write_text(original)
        rewrite(copy, lambda manifest, place=place: put(manifest, *place))
        try:
            LearnedPolicy(read_policy("x", copy, TASKS[ELBOW]))(np.zeros((2, 9), np.float32))
        except checkpoints.CheckpointError:
            refused += 1
    assert refused > 20


def test_a_manifest_without_an_entry_is_refused(copy):
    original = (copy / checkpoints.MANIFEST).read_text()
    for name in ("contract", "policy", "files", "settings", "clock"):
        (copy / checkpoints.MANIFEST).write_text(original)
        rewrite(copy, lambda manifest: manifest.pop(name))  # noqa: B023
        with pytest.raises(checkpoints.CheckpointError, match=f"is not what a run writes: it has no {name}"):
            checkpoints.load_checkpoint(copy)
    (copy / checkpoints.MANIFEST).write_text(original)
    rewrite(copy, lambda manifest: manifest["contract"]["columns"].append(["more", -1, "1"]))
    with pytest.raises(checkpoints.CheckpointError, match=r"contract.columns\[4\]\[1\] must be a count"):
        checkpoints.load_checkpoint(copy)


@pytest.mark.parametrize(
    ("width", "last"),
    [(50, "success 95 %"), (80, "12,500 samples/s"), (250, "% of the time"), (None, "time")],
)
def test_the_live_line_has_the_parts_that_fit(width, last, tmp_path, monkeypatch):
    """Whole parts, the most important first; a log, which has no width, has them all."""
    now = iter((0.0, *[80.0] * 9))
    monkeypatch.setattr("myowarp.apps.reports.progress.time.monotonic", lambda: next(now))
    shown = io.StringIO()
    console = Console(file=shown, force_terminal=width is not None, width=width, soft_wrap=True)
    row = {"samples": 1e6, "return": 1234.5, "success": 0.95, "success_last": 0.9, "success_any": 0.99}
    row |= {"share_simulation": 0.7, "share_learner": 0.2, "share_rest": 0.1}
    with Progress(tmp_path, 3_000_000, console) as progress:
        progress.add(row)
    plain = re.sub(r"\x1b\[[?\d;]*[a-zA-Z]", "", shown.getvalue())
    (line,) = {*filter(None, map(str.strip, plain.splitlines()))}
    assert line.startswith("1.00 of 3.00 M samples  2:40 left")
    assert line.endswith(last)
    assert width is None or len(line) <= width

"""What a visitor tries first: the demo, the examples, and PPO from top to bottom."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from myowarp.apps.cli import main as cli
from myowarp.apps.cli.examples import LIST, examples
from myowarp.disk import shipped

ROOT = Path(__file__).parents[2]
KEPT = {file.name for file in (ROOT / "examples").iterdir() if file.is_file()} - {LIST, "opensim.log"}
SAMPLES = 60_000
UNTRAINED, TRAINED = 20.0, 8.0  # deg: error at the end of an episode, beyond and below
MOST_FILM = 3e6  # bytes


def test_every_example_is_listed_and_copied(run, tmp_path, monkeypatch):
    assert {name for name, *_ in examples()} == KEPT
    status, out, _ = run("examples")
    assert status == 0
    assert all(name in out for name in KEPT)
    monkeypatch.chdir(tmp_path)
    assert run("examples", "--copy")[0] == 0
    assert {file.name for file in (tmp_path / "examples").iterdir()} == KEPT | {LIST}
    for file in (ROOT / "examples").glob("*.*"):
        if file.name in KEPT:
            assert (tmp_path / "examples" / file.name).read_bytes() == file.read_bytes()


def test_copying_replaces_nothing_unasked(run, tmp_path):
    (tmp_path / "own_task.py").write_text("mine")
    status, _, err = run("examples", "--copy", "--output", tmp_path)
    assert status == 2
    assert "exists; choose another name, or replace it with --overwrite" in err
    assert (tmp_path / "own_task.py").read_text() == "mine"
    assert not (tmp_path / "arm.osim").exists()
    assert run("examples", "--copy", "--output", tmp_path, "--overwrite")[0] == 0
    assert (tmp_path / "own_task.py").read_text() != "mine"


def test_examples_are_not_copied_through_links(run, tmp_path):
    """A link that points nowhere counts as a file; it is replaced, and nothing is made where it points."""
    (tmp_path / "out").mkdir()
    link = tmp_path / "out/arm.osim"
    link.symlink_to(tmp_path / "elsewhere")
    status, _, err = run("examples", "--copy", "--output", tmp_path / "out")
    assert (status, "arm.osim' exists" in err) == (2, True)
    assert run("examples", "--copy", "--output", tmp_path / "out", "--overwrite")[0] == 0
    assert link.is_file()
    assert not link.is_symlink()
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.parametrize("line", [line for *_, line in examples() if line.startswith("myowarp ")])
def test_the_line_of_an_example_is_understood(line, monkeypatch):
    called = []
    words = line.split()
    monkeypatch.setattr(cli.COMMANDS[words[1]], "__call__", lambda self: called.append(self))
    monkeypatch.setattr("sys.argv", words)
    monkeypatch.chdir(ROOT)
    cli.main()
    assert len(called) == 1
    assert all(Path(word.partition(":")[0]).exists() for word in words if word.startswith("examples/"))


@pytest.mark.slow
def test_plain_ppo_learns_the_elbow():
    command = [sys.executable, ROOT / "examples/train_plain.py", str(SAMPLES)]
    pytest.importorskip("torch")
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    before, after = (float(error) for error in re.findall(r"([\d.]+) deg off", out))
    assert before > UNTRAINED
    assert after < TRAINED


def test_our_arm_converts(run, tmp_path):
    """All gates hold but those of the long triceps' moment arm: its path leaves the cylinder at once."""
    pytest.importorskip("scipy")
    status, out, err = run("convert", shipped("examples/arm.osim"), "--output", tmp_path, "--json")
    assert status == 0, err
    report = json.loads(out)
    assert report["counts"]["muscles"] == 8
    assert report["left_out"] == []
    missed = {gate["where"].partition(",")[0] for gate in report["gates"] if not gate["passed"]}
    assert missed == {"TRIlong"}


def test_the_film_is_small():
    film = shipped("docs/pictures/demo.gif").read_bytes()
    assert film.startswith(b"GIF89a")
    assert len(film) <= MOST_FILM

"""What README and documentation show: every command is understood, every snippet runs, every link leads."""

import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import pytest

import myowarp
from myowarp.apps import cli
from myowarp.tasks.outside import find_task

ROOT = Path(__file__).parents[1]
WRITTEN = ROOT / "docs/tasks"  # by docs/task_pages.py
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
PAGES += [page for page in sorted((ROOT / "docs").rglob("*.md")) if page.parent != WRITTEN]
MOST_LINES = 110  # of README


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), re.DOTALL)


def commands():
    """Return the command lines of `myowarp` in all pages, with the page of each."""
    lines = [(page, line) for page in PAGES for block in blocks(page, "sh") for line in block.splitlines()]
    return [(page.name, line) for page, line in lines if line.startswith("myowarp ")]


COMMANDS = commands()
SNIPPETS = {
    page: [block for block in blocks(page, "python") if "import" in block or page.stem == "environments"]
    for page in PAGES
    if page.name != "CONTRIBUTING.md"  # its snippets are what tests/outside holds, in pieces
}


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= MOST_LINES
    assert len(COMMANDS) > 10


@pytest.mark.parametrize(("page", "line"), COMMANDS, ids=[line for _, line in COMMANDS])
def test_every_command_is_understood(page, line, monkeypatch):
    """Its options exist, its task is registered, its files are here; what it does, its own tests say."""
    arguments = shlex.split(line, comments=True)[1:]
    called = []
    kind = cli.COMMANDS[arguments[0]]
    monkeypatch.setattr(kind, "__call__", lambda self: called.append(self))
    monkeypatch.setattr("sys.argv", ["myowarp", *arguments])
    monkeypatch.chdir(ROOT)
    cli.main()
    (command,) = called
    task = getattr(command, "task", None)
    if task is not None and ".py:" not in task:
        find_task(task)
    for word in arguments:
        if word.startswith(("examples/", "tests/")):
            assert Path(word).exists(), word


@pytest.mark.parametrize("page", [page for page in SNIPPETS if SNIPPETS[page]], ids=lambda page: page.stem)
def test_every_snippet_runs(page, tmp_path, monkeypatch, run):
    """One after the other in a fresh folder, with few worlds; what they register goes again."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(myowarp.TASKS, "_entries", dict(myowarp.TASKS._entries))
    ids = set(gym.registry)
    names = {}
    for number, snippet in enumerate(SNIPPETS[page]):
        if "run.parquet" in snippet:
            pytest.importorskip("pyarrow")
            pytest.importorskip("matplotlib").use("agg")
            steps = ("--steps", 3, "--num-worlds", 4)
            assert run("rollout", "myoElbowPose1D6MRandom-v0", *steps, "--signals", "run.parquet")[0] == 0
        if "Sb3VecEnv" in snippet:
            pytest.importorskip("stable_baselines3")
            pytest.importorskip("rsl_rl")
        file = tmp_path / f"snippet_{number}.py"
        file.write_text(re.sub(r"(num_envs=|, )(256|64)\b", r"\g<1>8", snippet))
        names |= runpy.run_path(str(file), names)
        if "actions" not in names and hasattr(names["env"], "action_space"):
            names["actions"] = names["env"].action_space.sample()
    for name in set(gym.registry) - ids:
        del gym.registry[name]


def test_reference_lists_what_is_public():
    named = re.findall(
        r"^\.\. (?:autoclass|autofunction|data):: (\w+)$", (ROOT / "docs/reference.md").read_text(), re.M
    )
    assert sorted(named) == sorted(set(myowarp.__all__) - {"__version__"})


def test_version_changelog_and_citation_agree():
    cited = re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.M).group(1)
    latest = re.search(r"^## \[(.*?)\]", (ROOT / "CHANGELOG.md").read_text(), re.M).group(1)
    assert cited == myowarp.__version__
    assert latest in ("Unreleased", myowarp.__version__)


def test_the_site_is_built_without_a_warning(tmp_path):
    """Every page is in the navigation, every link inside of the site leads, every task has a page."""
    build = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-d", str(tmp_path / "doctrees")]
    done = subprocess.run([*build, "docs", str(tmp_path / "site")], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for key in myowarp.TASKS:
        page = (tmp_path / f"site/tasks/{key}.html").read_text()
        assert "Observation:" in page
        assert f"../audit.html#{key}" in page
    anchors = (tmp_path / "site/audit.html").read_text()
    assert all(f'id="{key}"' in anchors for key in myowarp.TASKS)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads(page):
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text()):
        if not target.startswith("http") and (page.parent / target).resolve().parent != WRITTEN:
            assert (page.parent / target).exists(), target

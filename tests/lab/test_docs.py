"""What README and documentation show: every command and every snippet runs, every link leads.

A command runs smaller than it is written: fewer worlds, steps and samples.
"""

import importlib
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import threading
import tomllib
from pathlib import Path

import gymnasium
import pytest
import recordings
from socket_client import Client, until

import myowarp
from benchmarks import cohort_columns, readme, result_pages
from myowarp import extras, motion
from myowarp.apps.cli import main as cli
from myowarp.apps.reports import motion as motion_page
from myowarp.apps.studies.audit import tasks as audit_command
from myowarp.definitions.body import BODIES
from myowarp.tasks.outside import find_task
from myowarp.view.browser.live import Live
from myowarp.view.browser.trial_page import TrialPage

ROOT = Path(__file__).parents[2]
WRITTEN = ROOT / "docs/tasks"  # by docs/task_pages.py
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
PAGES += [page for page in sorted((ROOT / "docs").rglob("*.md")) if page.parent != WRITTEN]
IDS = tuple(myowarp.TASKS)  # before tests add some
MOST_LINES = 110  # of README
MOST_WORDS = 1200  # of a page, rows of tables left out
MOST_WORDS_BY_HAND = 13_100  # of README and docs together, code and tables too; they had 21,890 before 0.1.0
GENERATED = {"baselines.md", "experiments.md", "page.md"}  # by programs, from texts of their own
BANNED = (
    (r"^(?-i:What|Who|Whoever|Whatever) [^?]*$", "a relative clause is the subject"),
    (r"^(?-i:Those|That) (that|which|who) ", "a relative clause is the subject"),
    (r", which is (said|told|counted|named|shown|reported)\b", "say who says it: 'a message says so'"),
    (r"\bwhat (is|was|are|were) (asked|aimed|wanted|meant|left|known)\b", "name it"),
    (r"\b(is|are|be) asked (for|of)\b", "say who asks, or name the quantity"),
    (r"\bbut for\b", "'except'"),
    (r"\bof one's own\b", "'of your own'"),
    (r"\b(anew|thereof|wherein|whereof|nought)\b", "a word of today"),
    (r"\bdo(es)? (neither|not) [^,.]* neither\b", "one negation"),
    (r"\bnobody has\b", "'there is no'"),
)
"""Forms of sentences that readers had to read twice, and what to write in their place."""


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), re.DOTALL)


def commands(block):
    """Return the command lines of `myowarp` in a block, without what starts it on several ranks."""
    found = (re.fullmatch(r"(?:torchrun .* -m )?(myowarp .*)", line) for line in block.splitlines())
    return [line[1] for line in found if line]


BLOCKS = [
    (f"{page.relative_to(ROOT)}:{number}", page, commands(block))
    for page in PAGES
    for number, block in enumerate(blocks(page, "sh"))
    if commands(block)
]
COMMANDS = [(page.name, line) for _, page, lines in BLOCKS for line in lines]
SMALL = {
    "rollout": {"--num-worlds": "2", "--steps": "3", "--video-worlds": "1"},
    "record": {"--worlds": "1", "--steps": "2"},
    "view": {"--port": "0"},
    "demo": {"--port": "0"},
    "cohort": {"--steps": "5"},
    "audit": {"--num-worlds": "2"},
    "train": {
        **{"--num-worlds": "8", "--rollout-steps": "8", "--minibatches": "2", "--samples": "64"},
        "--selections": "0",
    },
    "improve": {
        **{"--num-worlds": "8", "--copies": "4", "--rollout-steps": "8", "--samples": "64"},
        **{"--gradient-steps": "2", "--selections": "0"},
    },
    "gait": {"--population": "4", "--generations": "1", "--horizon": "5"},
    "eval": {"--episodes": "2"},
    "score": {"--num-worlds": "1"},
    "adapt": {"--episodes": "4"},
    "reproduce": {"--seeds": "1", "--num-worlds": "2"},
}
"""Options that make a command small, and take the place of its own."""
PATIENTS = 41  # lines of the table of a cohort
MARKS = {
    "myowarp train myoHandReachFixed-v1 --output runs/filmed": "slow",  # films whole episodes
    "myowarp improve baselines": "slow",  # two starts of a key
    "myowarp train myoHandKeyTurnRandom-v0 --parent": "slow",  # from what that has found
    "myowarp score": "slow",  # a whole episode of legs
    "myowarp export runs/filmed": "slow",  # what that has trained
    "myowarp audit --output": "slow",  # steps every registered id
    "myowarp audit --paper": "slow",
    "myowarp baselines run": "slow",  # trains an elbow to the end
    "myowarp reproduce exo1": "slow",  # trains, and measures for minutes
    "myowarp sweep examples/study.yaml --dry-run": "",  # only says what it would do
    "myowarp sweep examples/study.yaml": "scale",  # starts a cluster
    "myowarp cohort examples/elbow_cohort.csv --task myoElbowPose1D6MFixed-v0 --ray": "scale",
}
"""Commands, by how they begin, that `make test` leaves to others."""
SNIPPETS = {
    page: [block for block in blocks(page, "python") if "import" in block or page.stem == "environments"]
    for page in PAGES
    if page.name != "CONTRIBUTING.md"  # its snippets are what tests/outside holds, in pieces
}


def test_readmes_results_are_those_of_the_measurements():
    assert readme.README.read_text() == readme.page()


@pytest.mark.parametrize("name", result_pages.FIELDS)
def test_pages_of_results_are_those_of_the_measurements(name):
    assert (result_pages.PAGES / f"{name}.md").read_text() == result_pages.page(name)


def test_conditions_lists_the_columns_of_cohorts():
    """With what each takes, as the columns themselves say it."""
    assert cohort_columns.PAGE.read_text() == cohort_columns.page()
    strength = next(line for line in cohort_columns.page().splitlines() if line.startswith("| `strength` "))
    assert re.search(r"share from 0 to 4, .*drawn, changing", strength)


def test_numbers_of_results_are_read_as_they_are_written():
    """Two or three significant digits, no exponent where a reader expects none."""
    shown = [result_pages.number(value) for value in (0.0, 1.34, 99.6, 130.4, 2_934.0, 2.5e-6)]
    assert shown == ["0", "1.3", "100", "130", "2,900", "2.5e-06"]
    assert result_pages.number(104_542.2, 3) == "105,000"


@pytest.mark.slow
def test_readmes_set_up_leaves_the_system_alone(tmp_path):
    """README's venv line, as a stranger types it: no package of ours or the user's is seen."""
    venv, install = blocks(ROOT / "README.md", "sh")[0].splitlines()
    assert install.startswith("pip install ")
    home = {"HOME": str(tmp_path), "PATH": f"{Path(sys.base_exec_prefix, 'bin')}:/usr/bin:/bin"}
    line = f"{venv} && python -c 'import sys; print(sys.prefix)' && pip --version && pip list"
    done = subprocess.run(["bash", "-c", line], cwd=tmp_path, env=home, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    prefix, version, *packages = done.stdout.splitlines()
    assert prefix == str(tmp_path / ".venv")
    assert str(tmp_path) in version
    assert not any(package.startswith(("myowarp", "warp")) for package in packages)


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= MOST_LINES
    assert len(COMMANDS) > 10


def paragraphs(page):
    """Return the running text of a page: without code, tables, headings and links' targets."""
    text = re.sub(r"^(---\n.*?\n---|```.*?\n```)$", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"\]\([^)]*\)", "]", re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL))
    lines = [line for line in text.splitlines() if not line.startswith(("|", "#", "    "))]
    blocks = re.split(r"\n\s*\n|\n(?=[-*] |\d\. )", "\n".join(lines))
    return [" ".join(block.split()) for block in blocks]


PROSE = [page for page in PAGES if page.name not in GENERATED]


@pytest.mark.parametrize("page", PROSE, ids=lambda page: str(page.relative_to(ROOT)))
def test_sentences_are_read_once(page):
    for paragraph in paragraphs(page):
        for sentence in re.split(r"(?<=[.!?:;])\s+", paragraph.lstrip("-*0123456789. ")):
            for form, advice in BANNED:
                assert not re.search(form, sentence.lstrip("*"), re.I), f"{sentence!r}: {advice}"


@pytest.mark.parametrize("page", PROSE, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_are_short(page):
    if page.name != "CONTRIBUTING.md":
        assert sum(len(paragraph.split()) for paragraph in paragraphs(page)) <= MOST_WORDS


def by_hand(page):
    """Return the text of a page that no program writes."""
    if page.name in ("baselines.md", "page.md") or page.parent.name == "results":
        return ""
    return re.sub(r"<!-- written by.*?<!-- end of what is written -->", "", page.read_text(), flags=re.DOTALL)


def test_pages_are_short_together():
    pages = [page for page in PAGES if page.name != "CONTRIBUTING.md"]
    assert 10_000 < sum(len(by_hand(page).split()) for page in pages) <= MOST_WORDS_BY_HAND


def test_banned_forms_are_found(tmp_path):
    """In sentences that newcomers named."""
    page = tmp_path / "page.md"
    page.write_text(
        "Rows are sorted, which is said.\n\n- What is asked for before anything is built is the least.\n"
        "- What a newton metre saves is read between patients.\n\nWhat does not work? See below.\n"
    )
    with pytest.raises(AssertionError, match="which is said"):
        test_sentences_are_read_once(page)
    found = [
        sentence
        for sentence in paragraphs(page)
        if any(re.search(form, sentence.lstrip("- "), re.I) for form, _ in BANNED)
    ]
    assert len(found) == 3


@pytest.mark.parametrize(("page", "line"), COMMANDS, ids=[line for _, line in COMMANDS])
def test_every_command_is_understood(page, line, monkeypatch):
    """As it is written: its options exist, its task is registered, its files are here."""
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


def test_no_page_writes_where_another_did():
    """A reader who goes from README to a tutorial and on is never told that an output exists."""
    taken = {}
    for block, _, lines in BLOCKS:
        for words in (shlex.split(line, comments=True) for line in lines):
            named = {"--output", "-o", "--video", "--signals"} & {*words}
            outputs = [words[words.index(option) + 1] for option in named]
            for output in outputs or ["out/plot.png"] * ("plot" in words):
                assert taken.setdefault(output, block) == block, f"{output}: {taken[output]} and {block}"


def kind_of(line):
    """Return which command a line is, with its step where it has steps."""
    words = line.split()[1:3]
    return tuple(words if words[0] in ("motion", "baselines") else words[:1])


def runs():
    """Return what runs for each block and mark: the lines without a mark, and those that have it.

    A block without a command that none before it has is slow.
    """
    shown = set()
    for name, page, lines in BLOCKS:
        marks = [
            next((mark for begin, mark in MARKS.items() if line.startswith(begin)), "") for line in lines
        ]
        for mark in dict.fromkeys(marks):
            chosen = [line for line, own in zip(lines, marks, strict=True) if own in ("", mark)]
            known = shown >= set(map(kind_of, chosen))
            marked = mark or ("slow" if known else "")
            if not marked:
                shown |= set(map(kind_of, chosen))
            yield pytest.param(
                page, chosen, id=f"{name}{mark}", marks=[getattr(pytest.mark, marked)] if marked else []
            )


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """Return the folder of a converted model, which some pages go on with."""
    pytest.importorskip("scipy")
    folder = tmp_path_factory.mktemp("converted")
    cli.COMMANDS["convert"](ROOT / "tests/data/osim/arm26.osim", folder / "arm26")()
    return folder / "arm26"


@pytest.fixture(scope="module")
def found():
    """Return the folders of muscle forces by the command that found them; several pages begin with it."""
    return {}


def save_agent(folder):
    """Save what a user has trained with Stable-Baselines3; here it has not learned yet."""
    trainer = pytest.importorskip("stable_baselines3")
    env = gymnasium.make_vec("MyoWarp/myoElbowPose1D6MRandom-v0", 2, autoreset_mode="SameStep")
    trainer.PPO("MlpPolicy", myowarp.Sb3VecEnv(env), device="cpu").save(folder / "agent")


def prepare(folder, page, lines):
    """Put into a folder what the commands of a block name; study and cohort are made small."""
    (folder / "tests").mkdir()
    (folder / "tests/data").symlink_to(ROOT / "tests/data")
    shutil.copytree(ROOT / "examples", folder / "examples")
    study = folder / "examples/study.yaml"
    study.write_text(re.sub(r"(seeds|episodes): .*", r"\1: 2", study.read_text().replace("300_000", "2048")))
    patients = folder / "examples/elbow_cohort.csv"
    patients.write_text("".join(patients.read_text().splitlines(keepends=True)[:PATIENTS]))
    shutil.copy(ROOT / "tests/data/osim/arm26.osim", folder)
    (folder / "my_tasks.py").write_text("".join(blocks(page, "python")))
    if any("my_agent.py" in line for line in lines):
        save_agent(folder)
        (own,) = (block for block in blocks(page, "python") if "def act(obs)" in block)
        (folder / "my_agent.py").write_text(own)
    if any("gait.osim" in line for line in lines):
        recordings.write_gait(folder)
    if any("walk.c3d" in line for line in lines):
        labels = [*recordings.MARKERS]
        recordings.write(folder / "walk.c3d", POINT={"LABELS": labels, "ANGLES": ["none"]})


def smaller(line):
    """Return the words of a command, made small."""
    words = shlex.split(line, comments=True)[1:]
    for option, value in SMALL.get(words[0], {}).items():
        if option == "--minibatches" and "dagger" in words:
            continue  # it has none
        if option in words:
            at = words.index(option)
            words[at + 1] = min(words[at + 1], value, key=int)
        elif "--list" not in words:
            words += [option, value]
    return words + ["--quick"] * (words[0] == "reproduce" and not {"--quick", "--list"} & {*words})


def quickest(job):
    """Return what the quickest of the jobs has less of: muscles of its body, steps of an episode."""
    return job.setup.spec.large, len(BODIES[job.setup.spec.body].groups), job.setup.episode_steps


run_page = {kind: kind.run for kind in (Live, TrialPage)}


def visited(live):
    """Serve until a browser has seen the body move, a file's model once it is played."""
    seen = []

    def visit():
        try:
            page = Client(f"ws://127.0.0.1:{live.server.get_port()}")
            seen.append(until(lambda: live.play() or page.frames > 2))
            page.leave()
        finally:
            live.stop()

    visitor = threading.Thread(target=visit)
    visitor.start()
    run_page[type(live)](live)
    visitor.join()
    assert seen


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize(("page", "lines"), list(runs()))
def test_every_command_runs(page, lines, found, tmp_path, monkeypatch, run, request):
    """Those of a block one after the other, in a folder of their own."""
    prepare(tmp_path, page, lines)
    if any("out/arm26" in line for line in lines) and not any("convert" in line for line in lines):
        shutil.copytree(request.getfixturevalue("arm"), tmp_path / "out/arm26")
    monkeypatch.chdir(tmp_path)
    for kind in run_page:
        monkeypatch.setattr(kind, "run", visited)
    monkeypatch.setattr(motion_page, "DRAWN", 2)  # panels of a table; ten take a second to draw
    every = audit_command.find_jobs
    monkeypatch.setattr(audit_command, "find_jobs", lambda *which: [min(every(*which), key=quickest)])
    for line in lines:
        command, _, output = line.partition(" -o ")
        if output and command in found:
            shutil.copytree(found[command], output)
            continue
        status, _, err = run(*smaller(line))
        if status and "drawing needs OpenGL" in err:
            pytest.skip(err)
        assert status == 0, f"{line}: {err}"
        if command.startswith("myowarp motion forces"):
            found[command] = tmp_path / output


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize("page", [page for page in SNIPPETS if SNIPPETS[page]], ids=lambda page: page.stem)
def test_every_snippet_runs(page, tmp_path, monkeypatch, run):
    """One after the other in a fresh folder, with few worlds; what they register goes again."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests/data").symlink_to(ROOT / "tests/data")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
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
        if "PPO.load" in snippet:
            save_agent(tmp_path)
        file = tmp_path / f"snippet_{number}.py"
        file.write_text(re.sub(r"(num_envs=|, )(256|64)\b", r"\g<1>8", snippet))
        names |= runpy.run_path(str(file), names)
        if "actions" not in names and hasattr(names.get("env"), "action_space"):
            names["actions"] = names["env"].action_space.sample()


def test_reference_lists_what_is_public():
    text = (ROOT / "docs/reference.md").read_text()
    named = re.findall(r"^- `(\w+)`", text, re.M)
    assert sorted(named) == sorted(set(myowarp.__all__) - {"__version__"})
    found = re.findall(r"^- `myowarp\.motion\.(\w+)`", text, re.M)
    assert sorted(found) == sorted(motion.__all__)


def test_install_names_every_extra():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = re.findall(r"^\| `(\w+)` \|", (ROOT / "docs/install.md").read_text(), re.M)
    assert sorted(named) == sorted(set(extras) - {"dev", "docs", "test"})


@pytest.mark.parametrize(
    ("released", "shown"),
    [(False, '`pip install ".[view]"` in the clone'), (True, '`pip install "myowarp[view]"`')],
)
def test_a_hint_is_that_of_clone_or_release(released, shown, monkeypatch):
    monkeypatch.setattr(extras, "RELEASED", released)
    assert extras.to_install("view") == shown


def test_one_constant_decides_how_extras_are_installed():
    """In pages, README included, and in messages: nothing else of the package names its own extras."""
    name = "myowarp" if extras.RELEASED else "."
    known = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
    for page in PAGES:
        for line in (line for block in blocks(page, "sh") for line in block.splitlines()):
            if (found := re.match(r"(?:pip install|uvx --from) [\"'](.*?)\[", line)) and "dist/" not in line:
                assert found[1] == name, f"{page.name}: {line}"
        text = page.read_text()
        for asked in re.findall(r'(?:pip install|--from) "[^"]*\[([^]]*)\]"', text):
            assert set(asked.split(",")) <= known, f"{page.name}: {asked}"
        assert set(re.findall(r"dist/myowarp-(.*?)-py3", text)) <= {myowarp.__version__}, page.name
    for notebook in (ROOT / "examples").glob("*.ipynb"):
        assert re.findall(r'pip install \\"(.*?)\[', notebook.read_text()) == [name], notebook
    for path in (ROOT / "myowarp").rglob("*.py"):
        assert path.name == "extras.py" or "myowarp[" not in path.read_text(), path


def test_ci_runs_what_readme_promises():
    """One command; and what the workflows make, the Makefile has."""
    script = (ROOT / ".ci/run").read_text()
    assert script.splitlines()[-1] == "make test"
    assert any("make test " in block for block in blocks(ROOT / "README.md", "sh"))
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M)
    files = [ROOT / ".ci/run", *(ROOT / ".github").rglob("*.yml")]
    made = {name for file in files for name in re.findall(r"\bmake ([a-z-]+)", file.read_text())}
    assert {"test", "fast", "lint", "docs", "dist"} <= made <= set(targets)
    for page in PAGES:
        assert set(re.findall(r"(?:^|`)make ([a-z-]+)", page.read_text(), re.M)) <= set(targets), page.name


def test_lock_is_of_these_requirements():
    """`uv lock` was run after the last change; every file comes from PyPI."""
    lock = tomllib.loads((ROOT / "uv.lock").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    asked = {("", *requirement(text)) for text in project["dependencies"]}
    asked |= {(extra, *requirement(text)) for extra in extras for text in with_ours(extra, extras)}
    (ours,) = (package for package in lock["package"] if package["name"] == "myowarp")
    assert {
        (
            re.sub(r"extra == '(.*)'", r"\1", item.get("marker", "")),
            item["name"],
            set_of(item.get("specifier", "")),
        )
        for item in ours["metadata"]["requires-dist"]
    } == asked
    assert lock["requires-python"] == project["requires-python"]
    hosts = {url.split("/")[2] for url in re.findall(r"https?://[^\"]+", (ROOT / "uv.lock").read_text())}
    assert hosts == {"pypi.org", "files.pythonhosted.org"}
    assert "file://" not in (ROOT / "uv.lock").read_text()


def set_of(specifier):
    """Return the parts of a version specifier, in no order."""
    return frozenset(part.strip() for part in specifier.split(",") if part.strip())


def requirement(text):
    """Return name and specifier of a requirement without an extra."""
    name, specifier = re.fullmatch(r"([\w.-]+)(?:\[[^]]*\])?(.*)", text).groups()
    return name, set_of(specifier)


def with_ours(extra, extras):
    """Yield the requirements of an extra, those of the package's own extras resolved."""
    for text in extras[extra]:
        if found := re.fullmatch(r"myowarp\[(.*)\]", text):
            for other in found[1].split(","):
                yield from with_ours(other, extras)
        else:
            yield text


def test_version_changelog_and_citation_agree():
    cited = re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.M).group(1)
    latest = re.search(r"^## \[(.*?)\]", (ROOT / "CHANGELOG.md").read_text(), re.M).group(1)
    assert cited == myowarp.__version__
    assert latest in ("Unreleased", myowarp.__version__)


@pytest.mark.slow  # `make docs` builds it, too, beside the tests
def test_the_site_is_built_without_a_warning(tmp_path):
    """Every page is in the navigation, every link inside of the site leads, every task has a page."""
    build = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-D", "recordings=0"]
    build += ["-d", str(tmp_path / "doctrees")]
    done = subprocess.run([*build, "docs", str(tmp_path / "site")], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for key in IDS:
        assert (WRITTEN / f"{key}.md").read_text().startswith(f"# {key}\n")
        page = (tmp_path / f"site/tasks/{key}.html").read_text()
        assert "Observation:" in page
        assert f"../audit.html#{key}" in page
    anchors = (tmp_path / "site/audit.html").read_text()
    assert all(f'id="{key}"' in anchors for key in IDS)


@pytest.mark.slow
def test_the_site_has_a_page_of_each_family_and_names_every_page(monkeypatch):
    """What the built site is made of: pages that are written, and a navigation that lists the others."""
    pytest.importorskip("sphinx")
    monkeypatch.syspath_prepend(ROOT / "docs")
    written = importlib.import_module("task_pages")
    for key in {myowarp.TASKS[key].family: key for key in reversed(IDS)}.values():
        page = written.page(key, None)
        assert page.startswith(f"# {key}\n")
        assert "Observation:" in page
    pages = [page for page in (ROOT / "docs").rglob("*.md") if page.parent != WRITTEN]
    trees = "\n".join(tree for page in pages for tree in blocks(page, "{toctree}"))
    listed = set(re.findall(r"[\w/-]+", trees))
    outside = {"index", "audit/README"}
    names = {str(page.relative_to(ROOT / "docs").with_suffix("")) for page in pages}
    assert {name for name in names - outside if not name.startswith("experiments/")} <= listed


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads(page):
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text()):
        if target.startswith(("http", "../../actions/")):  # of the site that the repository is on
            continue
        if (page.parent / target).resolve().parent != WRITTEN:
            assert (page.parent / target).exists(), target

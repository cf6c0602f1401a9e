"""The command `myowarp audit`: which ids, what it says, what it writes, and how it says no."""

import itertools
import json
import re
from dataclasses import replace
from functools import partial

import pytest
from rich.console import Console

from myowarp.apps.studies.audit import audit, runs
from myowarp.apps.studies.audit import tasks as command
from myowarp.apps.studies.audit.figures import FIGURES, changes, findings
from myowarp.apps.studies.audit.page import COLORS, Page, draw
from myowarp.definitions.task import TASKS
from myowarp.extras import to_install
from myowarp.sim.simulation import Simulation

ELBOW, REACH = "myoElbowPose1D6MRandom-v0", "myoHandReachFixed-v0"
MAX_ID_BYTES = 50_000  # of the page for each id, so that 60 ids make 3 MB


@pytest.fixture(scope="module", autouse=True)
def few_probes():
    """Random starts take long to find, so no audit here looks for them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("myowarp.apps.studies.audit.measure.PROBED_RESETS", ("task",))
        yield


@pytest.fixture(scope="module")
def reach():
    return audit(TASKS[REACH], 1, device="cpu")


@pytest.mark.slow
def test_findings_and_changes(reach):
    """A corrected version beside upstream's: what is shown otherwise, and only that."""
    better = replace(
        reach,
        id="MyoWarp/myoHandReachFixed-v1",
        version=1,
        scores=reach.scores | {"zero": replace(reach.scores["zero"], failed=0.25)},
        constant_columns=tuple(f"qpos[{i}]" for i in range(10)),
    )
    assert (reach.corrected, better.corrected) == (False, True)
    shown = {figure.head: (there, here) for figure, there, here in changes(better, reach)}
    assert shown == {"failed zero, %": ("100", "25"), "constant columns": ("0", "10")}
    rows = json.loads(command.as_json([reach, better]))["audits"]
    assert [row["corrected"] for row in rows] == [False, True]
    assert [row["changed"] for row in rows] == [{}, {head: list(pair) for head, pair in shown.items()}]
    page = Page()
    page.add(reach)
    page.add(better)
    assert '<td class="changed">25<small>100</small></td>' in page.html()
    assert list(changes(reach, reach)) == list(changes(better, None)) == []
    columns = ", ".join(f"qpos[{i}]" for i in range(8))
    assert findings(better) == [f"Observation columns that never change: {columns} and 2 more."]


@pytest.mark.parametrize("figure", FIGURES, ids=lambda figure: figure.head)
def test_a_finding_has_a_sentence(figure):
    assert figure.meaning.endswith(".")
    if any(figure.bad(value) for value in (-1e9, 1e9)):
        assert "77" in figure.finding("77")
        assert figure.finding("77").endswith(".")
    else:
        with pytest.raises(IndexError):
            figure.finding("77")


def test_jobs_are_every_id_with_versions_together():
    jobs = command.find_jobs((), paper=False)
    assert sorted(job.setup.spec.key for job in jobs) == sorted(TASKS)
    names = [job.setup.spec.name for job in jobs]
    assert sum(a != b for a, b in itertools.pairwise(names)) == len(set(names)) - 1
    for one, other in itertools.pairwise(jobs):
        assert (
            one.setup.spec.name != other.setup.spec.name or one.setup.spec.version < other.setup.spec.version
        )


def test_paper_jobs_are_the_grid():
    jobs = command.find_jobs((), paper=True)
    assert len(jobs) == 204
    assert {job.setup.reset for job in jobs} == {"fixed", "random", "none"}
    (one,) = command.find_jobs(("MyoWarp/paperElbowPoseHardNSarc-v0",), paper=False)
    assert (one.setup.spec.key, one.setup.reset, one.setup.conditions) == (ELBOW, "none", ("sarcopenia",))


@pytest.fixture
def run(run):
    """Run `myowarp audit`; see `run` in conftest."""
    return partial(run, "audit")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["myoElbowPose"], "task 'myoElbowPose' unknown; did you mean "),
        ([ELBOW, "nonsense"], "task 'nonsense' unknown; there are "),
        (["--paper", ELBOW], f"--paper audits the whole grid; leave it or '{ELBOW}' away"),
        (["--num-worlds", 0], "--num-worlds must be at least 1, got 0"),
        (["--steps", 0], "--steps must be at least 1, got 0"),
        (["--seed", -1], "--seed must be at least 0, got -1"),
        (["--physics", "slow"], "physics 'slow' unknown; available: parity, fast"),
        (["--device", "cuda:77"], "device 'cuda:77' is not available; available: "),
        (["--output", "{file}/deeper"], "output '{file}/deeper' cannot be written; it must be a folder, "),
    ],
)
def test_bad_input_is_refused_before_anything_runs(run, monkeypatch, tmp_path, arguments, sentence):
    def refuse(*args, **options):
        pytest.fail("a simulation was built")

    monkeypatch.setattr(Simulation, "__init__", refuse)
    (tmp_path / "file").touch()
    fill = {"file": tmp_path / "file"}
    here = ["--output", tmp_path / "out"] if "--output" not in arguments else []
    status, out, err = run(*(str(argument).format(**fill) for argument in arguments), *here)
    assert (status, out) == (2, "")
    assert err.startswith(f"myowarp: {sentence.format(**fill)}")
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"steps": 0}, "--steps must be at least 1, got 0"),
        ({"seed": -1}, "--seed must be at least 0, got -1"),
        ({"num_worlds": 0}, "num_worlds must be a positive integer, got 0"),
        ({"reset": "maybe"}, "reset 'maybe' unknown; available: task, fixed, random, none"),
    ],
)
def test_audit_refuses_bad_arguments(options, sentence):
    with pytest.raises(ValueError, match=f"^{re.escape(sentence)}$"):
        audit(TASKS[ELBOW], **options)


@pytest.mark.slow
def test_command_writes_json_and_page(run, tmp_path):
    names = [f"MyoWarp/{ELBOW}", "paperElbowPoseHardN-v0"]
    options = ("--num-worlds", 2, "--device", "cpu", "--output", tmp_path / "new" / "folder")
    status, out, err = run(*names, "--json", *options)
    assert status == 0, err
    saved = (tmp_path / "new" / "folder" / "audit.json").read_text()
    assert json.loads(out) == json.loads(saved)
    first, second = json.loads(saved)["audits"]
    assert (first["id"], second["id"]) == (names[0], f"MyoWarp/{names[1]}")
    assert (first["reset"], second["reset"], second["steps"]) == ("task", "none", 200)
    assert first["findings"] == ["Reward terms that never leave 0: penalty."]
    assert first["targets"]["solvable"] == 1.0
    returns = first["scores"]["random"]["returns"]
    assert list(returns) == ["0", "5", "25", "50", "75", "95", "100"]
    mean = (returns["0"] + returns["100"]) / 2  # of two worlds
    assert mean == pytest.approx(first["scores"]["random"]["return_mean"])
    assert list(first["columns"]) == ["qpos", "qvel", "pose_err", "act"]
    assert len(first["columns"]["act"]["high"]) == 6
    assert len(saved.splitlines()) == 4
    page = (tmp_path / "new" / "folder" / "index.html").read_text()
    assert page.count("data:image/svg+xml;base64,") == page.count("<img") == 2
    assert f'<h3 id="{ELBOW}">' in page
    assert len(page) < 2 * MAX_ID_BYTES
    assert "Saved audit.json and index.html in" in err


def test_without_matplotlib_json_and_table_come(run, monkeypatch, tmp_path):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    status, out, err = run(ELBOW, "--num-worlds", 1, "--device", "cpu", "--output", tmp_path)
    assert status == 0, err
    assert f"No page: it needs matplotlib; run {to_install('plot')}\n" in err
    assert [path.name for path in tmp_path.iterdir()] == ["audit.json"]
    assert out.count(ELBOW) > 1  # the table comes in parts


def test_interruption_loses_nothing(tmp_path, reach):
    def measure(setup, tick, **options):
        if setup.spec.key == ELBOW:
            raise KeyboardInterrupt
        tick(0.5, "half")
        return reach

    jobs = command.find_jobs((REACH, ELBOW), paper=False)
    with pytest.raises(KeyboardInterrupt):
        command.audit_all(jobs, tmp_path, Console(quiet=True), measure=measure)
    (row,) = json.loads((tmp_path / "audit.json").read_text())["audits"]
    assert row["id"] == reach.id
    assert sorted(path.name for path in tmp_path.iterdir()) == ["audit.json", "index.html"]


def test_numbers_that_are_not_finite_become_null(reach):
    endless = replace(reach, failing=replace(reach.failing, living_reward=float("nan")))
    (row,) = json.loads(command.as_json([endless]))["audits"]
    assert row["failing"]["living_reward"] is None
    assert row["failing"]["failing_reward"] == reach.failing.failing_reward


def test_picture_shows_every_policy(reach):
    picture = draw(reach, "svg").decode()
    for policy in runs.POLICIES:
        assert COLORS[policy] in picture
    for block in ("qpos", "tip_pos", "penalty", "not failed yet"):
        assert block in picture

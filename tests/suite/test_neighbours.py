"""Files of the user's in two folders, with helpers of one name: each sees the files beside it."""

import importlib
import sys

import numpy as np
import pytest
import warp as wp
from registries import as_before

from myowarp.definitions.task import TASKS
from myowarp.disk import code_digest
from myowarp.tasks.outside import find_task, load

FILES = {
    "task.py": """
import myowarp, utils
t = myowarp.extend("myoElbowPose1D6MRandom-v0", "beside{x}-v0", rewards={{"act_reg": utils.W}})
""",
    "pol.py": """
import numpy as np, utils
def act(obs):
    return np.full((len(obs), 6), utils.W, np.float32)
def late():
    import deep
    return deep.later()
""",
    "utils.py": "W = {w}\nSEEN = []\nclass Law:\n    gain = W\n",
    "deep.py": """
import utils
def later():
    import late_helper
    from late_helper import W
    return utils.W, late_helper.W, W
""",
    "late_helper.py": "W = 10 * {w}\n",
    "lib/__init__.py": "from . import first\n",
    "lib/first.py": "import utils\nW = utils.W\n",
    "lib/second.py": """
from lib.first import W
import lib.first as f
import lib.inner.third
V = lib.inner.third.W
""",
    "lib/inner/__init__.py": "",
    "lib/inner/third.py": "from ..first import W\n",
    "plain/part.py": "import utils\nW = utils.W\n",
    "packages.py": """
import lib.second
from plain import part
found = lib.second.W, lib.second.f.W, lib.second.V, part.W
""",
    "kernels.py": """
import warp as wp
W = wp.constant({w})
@wp.func
def law(x: float) -> float:
    return W * x
@wp.kernel
def work(out: wp.array[float]):
    out[wp.tid()] = law(2.0)
""",
    "works.py": "from kernels import work\n",
    "uses.py": "import myowarp, utils\nclass Mine(utils.Law):\n    pass\n",
    "again.py": "import task\n",
    "bad.py": "import broken\n",
    "broken.py": "x = 1\ny = 1 / 0\n",
    "calendar.py": "W = {w}\n",
    "dates.py": "import calendar\nimport utils\n",
}
WEIGHTS = {"a": -3.0, "b": -4.0}


@pytest.fixture(autouse=True)
def folders(tmp_path):
    """Two folders of the same files, which differ in a number; what they register goes again."""
    for x, w in WEIGHTS.items():
        for name, text in FILES.items():
            path = tmp_path / x / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text.format(x=x, w=w))
    with as_before(tmp_path):
        yield tmp_path


def both(folders, file, order="ab"):
    """Return the modules of a file in both folders, loaded one after the other."""
    return {x: load(f"{folders}/{x}/{file}") for x in order}


@pytest.mark.parametrize("order", ["ab", "ba"])
def test_tasks(folders, order):
    for x in order:
        spec = TASKS[find_task(f"{folders}/{x}/task.py:t").task]
        assert {term.name: term.weight for term in spec.reward_terms()}["act_reg"] == WEIGHTS[x]


def test_policy_beside_a_task_of_another_folder(folders, run):
    """On the command line: the policy's own number comes out of the policy."""
    data = folders / "data.npz"
    command = ("rollout", folders / "a/task.py:t", "--policy", f"{folders}/b/pol.py:act", "--save", data)
    status, _, err = run(*command, "--num-worlds", 1, "--steps", 2, "--device", "cpu")
    assert status == 0, err
    with np.load(data) as saved:
        assert (saved["action"] == WEIGHTS["b"]).all()


def test_imports_in_functions(folders):
    """They are executed after files of the other folder were loaded."""
    modules = both(folders, "pol.py")
    for x in "aba":
        assert modules[x].late() == (WEIGHTS[x], 10 * WEIGHTS[x], 10 * WEIGHTS[x])


def test_packages(folders):
    """Modules in packages, with absolute and relative imports, and in folders without __init__.py."""
    for x, module in both(folders, "packages.py").items():
        assert module.found == (WEIGHTS[x],) * 4
        assert module.lib.second.__file__ == str(folders / x / "lib/second.py")


def test_kernels(folders):
    """Warp's modules are known by their names; those of the first folder still run after the second."""
    modules = both(folders, "works.py")
    for x in "ab":
        out = wp.zeros(1, dtype=float, device="cpu")
        wp.launch(modules[x].work, dim=1, outputs=[out], device="cpu")
        assert out.numpy()[0] == 2 * WEIGHTS[x]


def test_digests(folders):
    """An edited helper renews what depends on it, and nothing else."""
    modules = both(folders, "uses.py")
    assert [modules[x].Mine.gain for x in "ab"] == [WEIGHTS[x] for x in "ab"]
    before = {x: code_digest(modules[x].Mine) for x in "ab"}
    (folders / "b/utils.py").write_text("W = -5.0\n")
    assert code_digest(modules["a"].Mine) == before["a"]
    assert code_digest(modules["b"].Mine) != before["b"]


def test_an_edited_file(folders):
    """It is run again, within a second too, and what was made before keeps its module."""
    path = folders / "a/utils.py"
    old = load(str(path))
    path.write_text(path.read_text().replace("-3.0", "-7.0"))
    assert [old.W, load(str(path)).W, load(str(path)) is load(str(path))] == [-3.0, -7.0, True]
    assert load(str(folders / "a/late_helper.py")).W == -30.0


def test_a_file_is_run_once(folders, monkeypatch):
    """By its path, by its name, and imported by another, whichever comes first."""
    module = load(f"{folders}/a/task.py")
    assert load(f"{folders}/a/again.py").task is module
    imported = load(f"{folders}/b/again.py").task
    assert load(f"{folders}/b/task.py") is imported is not module
    monkeypatch.chdir(folders / "b")
    assert load("task") is imported
    monkeypatch.setattr(sys, "path", [str(folders / "a"), *sys.path])
    monkeypatch.delitem(sys.modules, "late_helper", raising=False)
    by_python = importlib.import_module("late_helper")
    assert load(f"{folders}/a/deep.py").later()[1] == by_python.W


def test_names_of_python_stay(folders):
    """A file that is called as a module of Python's hides it from nobody."""
    assert load(f"{folders}/a/calendar.py").W == -3.0
    assert hasattr(importlib.import_module("calendar"), "monthrange")
    assert hasattr(load(f"{folders}/a/dates.py").calendar, "monthrange")
    assert load(f"{folders}/a/dates.py").utils.W == -3.0


def test_a_helper_that_fails(folders):
    for _ in range(2):  # it is forgotten
        with pytest.raises(ValueError, match=r"bad\.py cannot be imported: line 2: ZeroDivisionError: div"):
            load(f"{folders}/a/bad.py")
    (folders / "a/broken.py").write_text("y = 1\n")
    assert load(f"{folders}/a/bad.py").broken.y == 1

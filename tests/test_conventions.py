"""Rules of the code base that no linter knows, checked on the syntax trees of the package."""

import ast
import re
from functools import lru_cache
from pathlib import Path

import pytest

from myowarp.definitions.setup import OPTIONS

PACKAGE = Path(__file__).parents[1] / "myowarp"
FILES = {str(path.relative_to(PACKAGE)): path for path in sorted(PACKAGE.rglob("*.py"))}

MAX_PARAMETERS = 12

GROUPS = ("# Model:", "# Params:", "# Data in:", "# In:", "# Data out:", "# Out:")
SUFFIXES = {"# Data in:": "_in", "# Data out:": "_out"}

ALIASES: dict[str, set[str]] = {}
"""Parameter name: other names that an argument may have; empty as long as the code can do without."""

ROOMS = (
    "__main__",
    "__init__",
    "apps",
    "bridge_gym",
    "tasks",
    "view",
    "motion",
    "opensim",
    "sim",
    "coordinates",
    "engine",
    "muscle",
    "models",
    "definitions",
    "kernels",
    "disk",
    "progress",
)
"""The house from the top floor down; what a room imports, for types too, lies below it."""

FOLDERS = {
    "apps": ("cli", "studies", "train", "reports", "rollouts", "policies", "adapters"),
    "opensim": ("load", "convert", "report", "check", "compose", "tendon", "wrap", "muscle", "read", "model"),
    "view": ("pictures", "window", "modes", "browser", "drawing"),
}
"""Folders and files of large rooms, likewise; the faces of packages (`__init__.py`) may import anything."""


@lru_cache
def tree(name):
    """Return the syntax tree of a file."""
    return ast.parse(FILES[name].read_text())


def is_warp(node, attribute):
    """Whether `node` is `wp.<attribute>` or a call of it."""
    node = node.func if isinstance(node, ast.Call) else node
    return (
        isinstance(node, ast.Attribute)
        and node.attr == attribute
        and isinstance(node.value, ast.Name)
        and node.value.id == "wp"
    )


def _collect():
    """Return kernels by name, launches as (file, call), and the first arguments of other `launch` calls."""
    kernels, launches, named = {}, [], set()
    for name in FILES:
        for node in ast.walk(tree(name)):
            if isinstance(node, ast.FunctionDef):
                if any(is_warp(decorator, "kernel") for decorator in node.decorator_list):
                    assert node.name not in kernels, f"two kernels are called {node.name}"
                    kernels[node.name] = (name, node)
            elif isinstance(node, ast.Call) and name != "kernels/launch.py":
                if is_warp(node, "launch") or is_warp(node, "launch_tiled"):
                    launches.append((name, node))
                elif getattr(node.func, "id", getattr(node.func, "attr", "")) == "launch" and node.args:
                    named |= {node.args[0].id} if isinstance(node.args[0], ast.Name) else set()
    return kernels, launches, named


KERNELS, LAUNCHES, NAMED = _collect()
LAUNCH_IDS = [f"{name}:{call.args[0].id if call.args else call.lineno}" for name, call in LAUNCHES]


def parameters(kernel):
    """Return the parameter names of a kernel."""
    return [argument.arg for argument in KERNELS[kernel][1].args.args]


def group_of_parameters(kernel):
    """Return the comment group of every parameter, None where there is none."""
    name, node = KERNELS[kernel]
    lines = FILES[name].read_text().splitlines()
    groups, current = [], None
    next_line = node.lineno
    for argument in node.args.args:
        for line in lines[next_line : argument.lineno]:
            current = line.strip() if line.strip() in GROUPS else current
        next_line = argument.lineno
        groups.append(current)
    return groups


def names_of(argument):
    """Return the names that an argument expression has: its own, and joined with its owner's."""
    if isinstance(argument, ast.Name):
        return {argument.id}
    if isinstance(argument, ast.Attribute):
        owner = argument.value
        last = owner.attr if isinstance(owner, ast.Attribute) else getattr(owner, "id", "")
        return {argument.attr, f"{last}_{argument.attr}"}
    return set()


def test_there_is_something_to_check():
    assert len(FILES) > 20
    assert len(KERNELS) >= 10
    assert set(KERNELS) <= {call.args[0].id for _, call in LAUNCHES} | NAMED, "a kernel nobody launches"


@pytest.mark.parametrize(("name", "call"), LAUNCHES, ids=LAUNCH_IDS)
def test_launch_arguments_match_parameters(name, call):
    """`wp.launch` checks dtype and rank only: swapped arrays of one kind would go unseen."""
    where = f"{name}:{call.lineno}"
    assert len(call.args) == 1, f"{where}: all but the kernel by keyword"
    keywords = {keyword.arg: keyword.value for keyword in call.keywords}
    assert "dim" in keywords, where
    arguments = []
    for side in ("inputs", "outputs"):
        values = keywords.get(side, ast.List(elts=[]))
        assert isinstance(values, ast.List), f"{where}: {side} is no literal list"
        arguments += values.elts
    kernel = call.args[0].id
    expected = parameters(kernel)
    assert len(arguments) == len(expected), f"{where}: {kernel} takes {expected}"
    for argument, parameter in zip(arguments, expected, strict=True):
        names = names_of(argument)
        base = parameter.removesuffix("_in").removesuffix("_out")
        allowed = {parameter, base} | ALIASES.get(parameter, set())
        assert not names or names & allowed, f"{where}: {ast.unparse(argument)} for {parameter}"


@pytest.mark.parametrize(("name", "call"), LAUNCHES, ids=LAUNCH_IDS)
def test_outputs_are_the_written_parameters(name, call):
    """What stands under `# Data out:` and `# Out:` is passed as outputs, all else as inputs."""
    keywords = {keyword.arg: keyword.value for keyword in call.keywords}
    kernel = call.args[0].id
    outputs = len(keywords["outputs"].elts) if "outputs" in keywords else 0
    groups = group_of_parameters(kernel)
    written = [group in ("# Data out:", "# Out:") for group in groups]
    assert written == [False] * (len(groups) - outputs) + [True] * outputs, f"{name}:{call.lineno}"


@pytest.mark.parametrize("kernel", KERNELS)
def test_kernel_signature(kernel):
    _, node = KERNELS[kernel]
    assert ast.get_docstring(node), "a kernel's docstring is its formula"
    assert len(node.args.args) <= MAX_PARAMETERS
    assert all(argument.annotation is not None for argument in node.args.args)
    groups = group_of_parameters(kernel)
    assert None not in groups, f"parameters without a group comment; the groups are {GROUPS}"
    order = [GROUPS.index(group) for group in groups]
    assert order == sorted(order), f"groups out of order: {groups}"
    for parameter, group in zip(parameters(kernel), groups, strict=True):
        suffix = SUFFIXES.get(group, "")
        if suffix:
            assert parameter.endswith(suffix), f"{parameter} stands under {group}"
        else:
            assert not parameter.endswith(("_in", "_out")), f"{parameter} stands under {group}"


@pytest.mark.parametrize("kernel", KERNELS)
def test_kernel_begins_with_its_indices(kernel):
    _, node = KERNELS[kernel]
    first = node.body[1]
    assert isinstance(first, ast.Assign)
    assert is_warp(first.value, "tid")


GUARDS = {"view/browser/controls.py": 1}
"""How often a file may catch whatever comes: a page lives, whatever one of its browsers asks for."""


@pytest.mark.parametrize("name", FILES)
def test_no_catch_all(name):
    guards = GUARDS.get(name, 0)
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.ExceptHandler):
            caught = {sub.id for sub in ast.walk(node.type or node) if isinstance(sub, ast.Name)}
            where = f"{name}:{node.lineno}"
            assert node.type is not None, f"{where}: bare except"
            last = node.body[-1]
            tidies_up = isinstance(last, ast.Raise) and (
                last.exc is None or ast.unparse(last.cause or last) == node.name  # or says it in our words
            )
            everything = not tidies_up and bool(caught & {"Exception", "BaseException"})
            guards -= everything
            assert guards >= 0, where
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("suppress"):
            assert not {"Exception", "BaseException"} & set(map(ast.unparse, node.args)), (
                f"{name}:{node.lineno}"
            )


def imports(name):
    """Return (line, dotted module) of every import, those for type checkers and in functions included."""
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}:{node.lineno}: relative import"
            yield node.lineno, node.module
            yield from ((node.lineno, f"{node.module}.{alias.name}") for alias in node.names)


@pytest.mark.parametrize("name", FILES)
def test_gymnasium_only_in_the_bridge(name):
    if name != "bridge_gym.py":
        found = [module for _, module in imports(name) if module.split(".")[0] == "gymnasium"]
        assert not found


@pytest.mark.parametrize("name", [name for name in FILES if name.startswith("engine/")])
def test_the_engine_knows_no_task(name):
    """It steps models and worlds, whatever they are for."""
    assert {module.removeprefix("myowarp.definitions.") for _, module in imports(name)}.isdisjoint(
        {"scene", "task", "program", "registry"}
    )


def room_of(name):
    """Return the room of a file (`sim/build.py`) or of a module (`sim.build`)."""
    return re.split(r"[./]", name.removesuffix(".py"))[0]


def test_every_file_is_in_a_room():
    assert {room_of(name) for name in FILES} == set(ROOMS)


@pytest.mark.parametrize("name", FILES)
def test_imports_go_down(name):
    floor = ROOMS.index(room_of(name))
    for line, module in imports(name):
        package, _, inside = module.partition(".")
        if package == "myowarp" and inside:
            assert ROOMS.index(room_of(inside)) >= floor, f"{name}:{line} imports {module}"


def place_of(name):
    """Return room and folder of a file (`apps/cli/view.py`) or a module (`apps.cli.view`); None: neither."""
    room, *inside = re.split(r"[./]", name.removesuffix(".py"))
    return (room, inside[0]) if room in FOLDERS and inside and inside[0] != "__init__" else None


NOT_OPTIONS = {
    # In these files the words are torch's and torchrun's.
    "apps/train/loop.py": {"device"},
    "apps/train/networks.py": {"device"},
    "apps/train/replay.py": {"device"},
    "apps/train/tally.py": {"device"},
    "apps/rollouts/ranks.py": {"device", "rank"},
    "apps/adapters/rsl_rl.py": {"seed"},
    # A recorded motion has no environment.
    "apps/cli/motion/study.py": {"seed"},
    "apps/studies/motion/plan.py": {"seed"},
    # Here they are what a result says of how it was made, or where it is kept.
    "apps/policies/baselines.py": {"task", "seed"},
    "apps/studies/sweep/study.py": {"task", "seed"},
    "apps/rollouts/rollout.py": {"task", "device"},
    "apps/studies/audit/measure.py": {"task", "reset", "conditions", "physics", "device", "horizon", "seed"},
}
"""Words of `Setup` that mean something else; file: words."""


PROTOCOLS = {"task", "muscle", "conditions", "seed"}
"""In the paper's experiments: what a protocol itself sets, one muscle's name, the seed of a repetition."""


@pytest.mark.parametrize("name", [name for name in FILES if name.startswith("apps/")])
def test_an_option_of_an_environment_is_declared_once(name):
    """No field or parameter of the apps bears the name of a field of `Setup`; they take it whole."""
    found = set()
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            arguments = node.args
            every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
            found |= {argument.arg for argument in every}
        elif isinstance(node, ast.ClassDef):
            found |= {part.target.id for part in node.body if isinstance(part, ast.AnnAssign)}
    meant = PROTOCOLS if name.startswith("apps/studies/reproduce/") else NOT_OPTIONS.get(name, set())
    assert found & OPTIONS.keys() <= meant


OTHER_STEPS = re.compile(r"(optimizer|optimizers\[.*\]|axes|\bworlds)$")
"""Optimisers and plots have steps of their own; a learner's worlds step the environment, in one place."""


def test_worlds_are_stepped_in_one_loop():
    """The trainer's worlds and other libraries' adapters have theirs."""
    loops = set()
    for name in (name for name in FILES if name.startswith("apps/")):
        for node in ast.walk(tree(name)):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr == "step"
            ):
                if not OTHER_STEPS.search(ast.unparse(node.func.value)):
                    loops.add(name)
    own = {name for name in loops if name.startswith("apps/adapters/")}
    assert loops == own | {"apps/rollouts/run.py", "apps/train/worlds.py"}


def test_every_folder_has_its_place():
    for room, folders in FOLDERS.items():
        assert {place[1] for place in map(place_of, FILES) if place and place[0] == room} == set(folders)


@pytest.mark.parametrize("name", [name for name in FILES if place_of(name) and "__init__" not in name])
def test_imports_go_down_inside_of_rooms(name):
    room, folder = place_of(name)
    for line, module in imports(name):
        there = place_of(module.removeprefix("myowarp.")) if module.startswith("myowarp.") else None
        if there and there[0] == room:
            order = FOLDERS[room]
            assert order.index(there[1]) >= order.index(folder), f"{name}:{line} imports {module}"


BUILDS = {
    "engine/graph.py: Graph.__init__",
    "engine/graph.py: Replay.__init__",
    "engine/kernel_cache.py: start_warp",
    "sim/build.py: _cached_model",
    "sim/build.py: resolve_device",
    "sim/interop.py: _cloned",
    "sim/shard.py: Shard.__init__",
    "sim/shard.py: Shard.attach",
    "sim/signals.py: Signals.__init__",
    "sim/simulation.py: Simulation.__init__",
    "sim/starts.py: find_starts",
}
"""What changes the whole process and so waits for its turn; a decorator that slides off is missed here."""


def decorated(node, decorator, above=""):
    """Yield the names of the functions in a tree that have a decorator."""
    for part in ast.iter_child_nodes(node):
        named = isinstance(part, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        name = f"{above}.{part.name}".lstrip(".") if named else above
        if named and decorator in map(ast.unparse, part.decorator_list):
            yield name
        yield from decorated(part, decorator, name)


def test_constructions_take_turns():
    files = [file for file, path in FILES.items() if "@with_build_lock" in path.read_text()]
    found = {f"{file}: {name}" for file in files for name in decorated(tree(file), "with_build_lock")}
    assert found == BUILDS


def modules_of(name):
    """Return the files of ours that a file imports."""
    for _, module in imports(name):
        path = module.removeprefix("myowarp.").replace(".", "/")
        if module.startswith("myowarp.") and f"{path}.py" in FILES:
            yield f"{path}.py"


def test_no_file_imports_itself_by_way_of_others():
    """Imports form no circle, those for types and inside of functions included."""
    done, path = set(), []

    def visit(name):
        assert name not in path, " -> ".join([*path[path.index(name) :], name])
        if name not in done:
            path.append(name)
            for other in modules_of(name):
                visit(other)
            done.add(path.pop())

    for name in FILES:
        visit(name)


LIBRARIES = ("warp", "mujoco_warp", "mujoco", "stable_baselines3", "viser", "websockets")
GUARDED = {
    "engine/": "Warp and mujoco-warp",
    "kernels/world_function.py": "text that becomes a kernel",
    "view/browser/origins.py": "websockets",
    "view/browser/updates.py": "viser",
    "apps/adapters/stable_baselines3.py": "what Stable-Baselines3 has for those who write environments",
}
"""Where private names of a library may stand, and what replaces its functions. Of MuJoCo we use none."""
UNGUARDED = [name for name in FILES if not name.startswith(tuple(GUARDED))]
SURGERY = re.compile(r"\b_src\b|\bmock\b|\bexec\(|\breload\(")
"""What replaces functions of others, and text that is run."""
OF_TUPLES = {"_asdict", "_fields", "_make", "_replace"}
BY_NAME = {"getattr", "setattr", "hasattr", "delattr"}


def is_private(name):
    """Whether a name is meant for its owner alone, unlike `__names__` and `_names_` of protocols."""
    return name.startswith("_") and not name.startswith("__") and not name.endswith("_")


def bound(module):
    """Return the top package of each name that a file imports."""
    found = {}
    for node in ast.walk(module):
        if isinstance(node, ast.Import):
            found |= {(n.asname or n.name).split(".")[0]: n.name.split(".")[0] for n in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {n.asname or n.name: node.module.split(".")[0] for n in node.names}
    return found


def own_names(module):
    """Return the private names that a file defines; those set in a class of a library may be its own."""
    packages, found = bound(module), set()
    for node in ast.walk(module):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
        if isinstance(node, ast.ClassDef):
            bases = {root_of(base) for base in node.bases}
            if not any(packages.get(base) in LIBRARIES for base in bases):
                found |= {
                    sub.attr
                    for sub in ast.walk(node)
                    if isinstance(sub, ast.Attribute)
                    and isinstance(sub.ctx, ast.Store)
                    and root_of(sub) == "self"
                }
    return {name for name in found if is_private(name)}


def root_of(node):
    """Return the name at the beginning of `a.b.c`, "" for none."""
    while isinstance(node, ast.Attribute | ast.Subscript):
        node = node.value
    return node.id if isinstance(node, ast.Name) else ""


def uses_of_others(text, own):
    """Return what a file uses that others keep to themselves."""
    module, found = ast.parse(text), SURGERY.findall(text)
    packages = bound(module)
    for node in ast.walk(module):
        used = []
        if isinstance(node, ast.Import):
            used = [part for name in node.names for part in name.name.split(".")]
        elif isinstance(node, ast.ImportFrom) and not node.module.startswith("myowarp"):
            used = [*node.module.split("."), *(name.name for name in node.names)]
        elif isinstance(node, ast.Attribute):
            used = [node.attr]
            whole = ast.unparse(node)
            replaces = isinstance(node.ctx, ast.Store) and packages.get(root_of(node)) in LIBRARIES
            found += [whole] if replaces and ".config." not in whole else []
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in BY_NAME:
            used = [arg.value for arg in node.args[1:2] if isinstance(arg, ast.Constant)]
        found += [name for name in used if is_private(name) and name not in own | OF_TUPLES]
    return found


OWN = set().union(*(own_names(tree(name)) for name in UNGUARDED))


@pytest.mark.parametrize("name", UNGUARDED)
def test_what_others_keep_private_stays_in_one_file(name):
    """Private names of a library, and what replaces its functions, are in the file that `GUARDED` names."""
    assert uses_of_others(FILES[name].read_text(), OWN) == []


@pytest.mark.parametrize(
    "planted",
    [
        "from viser._messages import GuiUpdateMessage",
        "from warp._src import context",
        "import mujoco_warp._src.solver",
        "def f(agent): return agent._entropy_coefficient",
        "def f(renderer): return getattr(renderer, '_mjr_context')",
        "from stable_baselines3 import SAC\nclass A(SAC):\n    def f(self): self._last_obs = 1",
        "class A:\n    def f(self): super()._parallel_variance()",
        "import websockets.asyncio.server\nwebsockets.asyncio.server.serve = print",
        "import warp as wp\nwp.launch = print",
        "from unittest import mock",
        "import importlib, mujoco\nimportlib.reload(mujoco)",
        "exec('pass')",
    ],
)
def test_planted_private_names_are_found(planted):
    assert uses_of_others(planted, OWN)


def test_own_private_names_are_not_those_of_others():
    text = "import warp as wp\nwp.config.quiet = True\ndef f(seen, self): return seen._replace(self._mine)"
    assert uses_of_others(text, {"_mine"}) == []


WRITES = {
    *("write_text", "write_bytes", "tofile", "savetxt", "savez", "savez_compressed", "savefig"),
    *("to_csv", "to_parquet", "to_json", "copyfile", "copy2", "copytree", "mkstemp", "mkdtemp"),
    *("NamedTemporaryFile", "write_frames", "ParquetWriter", "CSVWriter", "RecordWriter"),
}
"""Calls that write a file, by the end of their name."""
ALLOWED_WRITERS = {
    "apps/train/progress.py:_Events.__init__": "grows while a training runs; readers skip a cut end",
    "apps/train/progress.py:Progress.__init__": "likewise; the rows before are written whole",
    "apps/policies/checkpoint.py:_write": "into a folder that is moved when it is whole, and summed",
    "apps/reports/panel.py:picture": "into memory",
    "apps/rollouts/recording_formats.py:open_parquet": "the scratch files of `_open_tables`",
    "view/drawing/video.py:_encode": "the scratch file of `_write`",
    "engine/kernel_cache.py:_remove": "an empty folder, for what is deleted",
}
"""Functions that write without `in_place`, and why."""


def opens_for_writing(call):
    """Whether a call writes a file: by its name, or by the mode that it is given."""
    name = getattr(call.func, "attr", getattr(call.func, "id", ""))
    if name == "save":
        return ast.unparse(call.func).endswith(("np.save", "jit.save"))
    modes = constants(call) if name in ("open", "ZipFile") else []
    return name in WRITES or any(re.fullmatch(r"[rbt]*[wax+][bt+]*", mode) for mode in modes)


def constants(call):
    """Return the texts among the arguments of a call."""
    every = [*call.args, *(keyword.value for keyword in call.keywords)]
    return [one.value for one in every if isinstance(one, ast.Constant) and isinstance(one.value, str)]


def writers(module):
    """Yield the functions that write a file without `in_place`, by qualified name."""

    def visit(node, names):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                if isinstance(child, ast.ClassDef) or not holds(child):
                    yield from visit(child, [*names, child.name])
                continue
            if isinstance(child, ast.Call) and opens_for_writing(child):
                yield ".".join(names)
            yield from visit(child, names)

    def holds(function):
        calls = (node.func for node in ast.walk(function) if isinstance(node, ast.Call))
        return any(isinstance(called, ast.Name) and called.id == "in_place" for called in calls)

    yield from visit(module, [])


@pytest.mark.parametrize("name", [name for name in FILES if name != "disk.py"])
def test_files_are_written_whole(name):
    """What opens a file for writing stands in a function with `in_place`, or in `ALLOWED_WRITERS`."""
    assert {f"{name}:{function}" for function in writers(tree(name))} <= ALLOWED_WRITERS.keys()


@pytest.mark.parametrize(
    "planted",
    [
        "def f(path): path.write_text('a')",
        "def f(path):\n    with path.open('w') as file: file.write('a')",
        "def f(path): open(path, mode='ab')",
        "def f(path): open(path, 'r+b')",
        "def f(table, path): table.to_parquet(path, index=False)",
        "import shutil\ndef f(a, b): shutil.copyfile(a, b)",
        "import numpy as np\nnp.savez('a.npz', a=1)",
        "import zipfile\nclass A:\n    def f(self, path): zipfile.ZipFile(path, 'w')",
    ],
)
def test_planted_writers_are_found(planted):
    assert list(writers(ast.parse(planted)))


def test_a_writer_with_in_place_is_none():
    assert not list(writers(ast.parse("def f(p):\n    with in_place(p) as s: s.write_text('a')")))
    assert not list(writers(ast.parse("def f(p):\n    with p.open() as s: return s.read()")))

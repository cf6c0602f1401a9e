"""Rules of the code base that no linter knows, checked on the syntax trees of the package."""

import ast
import gc
import re
from functools import cache
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
    "sim",
    "coordinates",
    "engine",
    "muscle",
    "models",
    "definitions",
    "motion",
    "osim",
    "laws",
    "kernels",
    "process",
    "disk",
    "extras",
    "inks",
    "progress",
)
"""The house from the top floor down; what a room imports, for types too, lies below it."""

FOLDERS = {
    "apps": ("cli", "studies", "train", "reports", "rollouts", "policies", "adapters"),
    "osim": ("convert", "body", "bundle", "document"),
    "view": ("pictures", "window", "modes", "browser", "drawing"),
}
"""Folders and files of large rooms, likewise; the faces of packages (`__init__.py`) may import anything."""


@cache
def tree(name):
    """Return the syntax tree of a file."""
    return ast.parse(FILES[name].read_text())


@cache
def nodes(name):
    """Return all nodes of a file's syntax tree."""
    return list(ast.walk(tree(name)))


@pytest.fixture(scope="module", autouse=True)
def memory():
    """Hold the trees while rules are checked, and look for no cycles among a million nodes meanwhile."""
    gc.disable()
    yield
    for kept in (tree, nodes, imports, kernels, launches, all_own_names):
        kept.cache_clear()
    gc.enable()


def refuse(faults):
    """Fail with all places at which a rule is broken, one a line."""
    found = list(faults)
    assert not found, "\n".join(["", *found])


def is_warp(node, attribute):
    """Whether `node` is `wp.<attribute>` or a call of it."""
    node = node.func if isinstance(node, ast.Call) else node
    return (
        isinstance(node, ast.Attribute)
        and node.attr == attribute
        and isinstance(node.value, ast.Name)
        and node.value.id == "wp"
    )


def is_native(node):
    """Whether a function is the signature of a kernel that is C++, see `kernels/lanes.py`."""
    calls = [decorator.func for decorator in node.decorator_list if isinstance(decorator, ast.Call)]
    return any(isinstance(call, ast.Name) and call.id == "native_kernel" for call in calls)


@cache
def kernels():
    """Return file and function of each kernel, by name."""
    found = {}
    for name in FILES:
        for node in nodes(name):
            if isinstance(node, ast.FunctionDef):
                if is_native(node) or any(is_warp(decorator, "kernel") for decorator in node.decorator_list):
                    assert node.name not in found, f"two kernels are called {node.name}"
                    found[node.name] = (name, node)
    return found


@cache
def launches():
    """Return launches of Warp as (file, call), and the first arguments of other `launch` calls."""
    found, named = [], set()
    for name in FILES.keys() - {"kernels/launch.py"}:
        for node in nodes(name):
            if isinstance(node, ast.Call):
                if is_warp(node, "launch") or is_warp(node, "launch_tiled"):
                    found.append((name, node))
                elif getattr(node.func, "id", getattr(node.func, "attr", "")) == "launch" and node.args:
                    named |= {node.args[0].id} if isinstance(node.args[0], ast.Name) else set()
    return found, named


def parameters(kernel):
    """Return the parameter names of a kernel."""
    return [argument.arg for argument in kernels()[kernel][1].args.args]


def group_of_parameters(kernel):
    """Return the comment group of every parameter, None where there is none."""
    name, node = kernels()[kernel]
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
    calls, named = launches()
    assert len(FILES) > 20
    assert len(kernels()) >= 10
    assert kernels().keys() <= {launched(call) for _, call in calls} | named, "a kernel nobody launches"


def launched(call):
    """Return the name of the kernel that is launched; on CUDA it may be a twin of it."""
    kernel = call.args[0]
    return kernel.body.id if isinstance(kernel, ast.IfExp) else kernel.id


def wrong_arguments(name, call):
    """Yield what is wrong with the arguments of a launch, and with what it passes as outputs."""
    where = f"{name}:{call.lineno}"
    keywords = {keyword.arg: keyword.value for keyword in call.keywords}
    sides = [keywords.get(side, ast.List(elts=[])) for side in ("inputs", "outputs")]
    if len(call.args) != 1 or "dim" not in keywords or not all(isinstance(side, ast.List) for side in sides):
        yield f"{where}: all but the kernel by keyword, dim among them, inputs and outputs as literal lists"
        return
    kernel = launched(call)
    arguments, expected = [*sides[0].elts, *sides[1].elts], parameters(kernel)
    if len(arguments) != len(expected):
        yield f"{where}: {kernel} takes {expected}"
        return
    for argument, parameter in zip(arguments, expected, strict=True):
        names = names_of(argument)
        base = parameter.removesuffix("_in").removesuffix("_out")
        if names and not names & ({parameter, base} | ALIASES.get(parameter, set())):
            yield f"{where}: {ast.unparse(argument)} for {parameter}"
    written = [group in ("# Data out:", "# Out:") for group in group_of_parameters(kernel)]
    if written != [False] * len(sides[0].elts) + [True] * len(sides[1].elts):
        yield f"{where}: outputs are what stands under `# Data out:` and `# Out:`, inputs all else"


def test_launch_arguments_match_parameters():
    """`wp.launch` checks dtype and rank only: swapped arrays of one kind would go unseen."""
    refuse(fault for name, call in launches()[0] for fault in wrong_arguments(name, call))


@pytest.mark.parametrize(
    ("planted", "fault"),
    [
        ("wp.launch(scale, 3, inputs=[a_in], outputs=[b_out])", "all but the kernel by keyword"),
        ("wp.launch(scale, dim=3, inputs=[a_in])", "scale takes"),
        ("wp.launch(scale, dim=3, inputs=[b_out], outputs=[a_in])", "b_out for a_in"),
        ("wp.launch(scale, dim=3, inputs=[a_in, b_out])", "outputs are what stands under"),
    ],
)
def test_planted_launches_are_found(planted, fault, tmp_path, monkeypatch):
    kernel = "def scale(\n    # In:\n    a_in: int,\n    # Out:\n    b_out: int,\n):\n    pass\n"
    file = tmp_path / "scale.py"
    file.write_text(kernel)
    monkeypatch.setitem(FILES, "scale.py", file)
    monkeypatch.setitem(kernels(), "scale", ("scale.py", ast.parse(kernel).body[0]))
    assert any(fault in found for found in wrong_arguments("scale.py", ast.parse(planted).body[0].value))


def wrong_signature(kernel):
    """Yield what is wrong with a kernel's signature, docstring and first line."""
    name, node = kernels()[kernel]
    where, groups = f"{name}:{node.lineno}: {kernel}", group_of_parameters(kernel)
    if not ast.get_docstring(node):
        yield f"{where}: a kernel's docstring is its formula"
    if len(node.args.args) > MAX_PARAMETERS:
        yield f"{where}: {len(node.args.args)} parameters; at most {MAX_PARAMETERS}"
    if any(argument.annotation is None for argument in node.args.args):
        yield f"{where}: parameters without a type"
    if None in groups:
        yield f"{where}: parameters without a group comment; the groups are {GROUPS}"
        return
    if groups != sorted(groups, key=GROUPS.index):
        yield f"{where}: groups out of order: {groups}"
    for parameter, group in zip(parameters(kernel), groups, strict=True):
        ending = tuple(end for end in SUFFIXES.values() if parameter.endswith(end))
        if ending != tuple(filter(None, [SUFFIXES.get(group)])):
            yield f"{where}: {parameter} stands under {group}"
    first = node.body[1] if len(node.body) > 1 else None
    if not (is_native(node) or (isinstance(first, ast.Assign) and is_warp(first.value, "tid"))):
        yield f"{where}: a kernel begins with its indices"


def test_kernel_signatures():
    refuse(fault for kernel in kernels() for fault in wrong_signature(kernel))


GUARDS = {"view/browser/controls.py": 1}
"""How often a file may catch whatever comes: a page lives, whatever one of its browsers asks for."""


def catches_all(node):
    """Whether a syntax node catches whatever comes, unless it tidies up or says it in our words."""
    if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("suppress"):
        return bool({"Exception", "BaseException"} & set(map(ast.unparse, node.args)))
    if not isinstance(node, ast.ExceptHandler):
        return False
    last = node.body[-1]
    again = isinstance(last, ast.Raise) and (last.exc is None or ast.unparse(last.cause or last) == node.name)
    caught = {sub.id for sub in ast.walk(node.type or node) if isinstance(sub, ast.Name)}
    return node.type is None or (not again and bool(caught & {"Exception", "BaseException"}))


def test_no_catch_all():
    found = {name: [node.lineno for node in nodes(name) if catches_all(node)] for name in FILES}
    refuse(f"{name}: lines {at}" for name, at in found.items() if len(at) > GUARDS.get(name, 0))


@cache
def imports(name):
    """Return (line, dotted module) of every import, those for type checkers and in functions included."""
    found = []
    for node in nodes(name):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}:{node.lineno}: relative import"
            found += [(node.lineno, node.module)]
            found += [(node.lineno, f"{node.module}.{alias.name}") for alias in node.names]
    return found


def wrong_imports(wrong, files=FILES):
    """Yield the imports for which `wrong(file, module)` is true."""
    for name in files:
        yield from (
            f"{name}:{line} imports {module}" for line, module in imports(name) if wrong(name, module)
        )


def test_gymnasium_only_in_the_bridge():
    others = FILES.keys() - {"bridge_gym.py"}
    refuse(wrong_imports(lambda _, module: module.split(".")[0] == "gymnasium", others))


def test_the_engine_knows_no_task():
    """It steps models and worlds, whatever they are for."""
    above = {f"myowarp.definitions.{name}" for name in ("scene", "task", "program", "registry")}
    engine = [name for name in FILES if name.startswith("engine/")]
    refuse(wrong_imports(lambda _, module: module in above, engine))


def room_of(name):
    """Return the room of a file (`sim/build.py`) or of a module (`sim.build`)."""
    return re.split(r"[./]", name.removesuffix(".py"))[0]


def test_every_file_is_in_a_room():
    assert {room_of(name) for name in FILES} == set(ROOMS)


def goes_up(name, module):
    """Whether a file imports from a room above its own."""
    package, _, inside = module.partition(".")
    return package == "myowarp" and inside and ROOMS.index(room_of(inside)) < ROOMS.index(room_of(name))


def test_imports_go_down():
    refuse(wrong_imports(goes_up))


def test_a_reader_climbs_few_floors():
    """A room stands one floor above the highest that it imports from."""
    below = {room: set() for room in ROOMS}
    for name in FILES:
        for _, module in imports(name):
            package, _, inside = module.partition(".")
            if package == "myowarp" and inside:
                below[room_of(name)].add(room_of(inside))
    floors = {}
    for room in reversed(ROOMS):
        floors[room] = 1 + max((floors[other] for other in below[room] - {room}), default=0)
    assert floors["osim"] <= 4
    assert floors["motion"] <= 5
    assert max(floors.values()) <= 10


def place_of(name):
    """Return room and folder of a file (`apps/cli/view.py`) or a module (`apps.cli.view`); None: neither."""
    room, *inside = re.split(r"[./]", name.removesuffix(".py"))
    return (room, inside[0]) if room in FOLDERS and inside and inside[0] != "__init__" else None


NOT_OPTIONS = {
    "apps/cli/motion/options.py": {"contact"},
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


PROTOCOLS = {"task", "muscle", "conditions", "reset", "seed"}
"""In the paper's experiments: what a protocol itself sets, one muscle's name, the seed of a repetition."""


def fields_and_parameters(name):
    """Return the names of all parameters and of all fields of classes in a file."""
    found = set()
    for node in nodes(name):
        if isinstance(node, ast.arg):
            found.add(node.arg)
        elif isinstance(node, ast.ClassDef):
            found |= {part.target.id for part in node.body if isinstance(part, ast.AnnAssign)}
    return found


def test_an_option_of_an_environment_is_declared_once():
    """No field or parameter of the apps bears the name of a field of `Setup`; they take it whole."""
    meant = {name: NOT_OPTIONS.get(name, set()) for name in FILES if name.startswith("apps/")}
    meant |= {name: PROTOCOLS for name in FILES if name.startswith("apps/studies/reproduce/")}
    found = {name: fields_and_parameters(name) & OPTIONS.keys() - words for name, words in meant.items()}
    refuse(f"{name}: {sorted(words)}" for name, words in found.items() if words)


OTHER_STEPS = re.compile(r"(optimizer|optimizers\[.*\]|axes|\bworlds)$")
"""Optimisers and plots have steps of their own; a learner's worlds step the environment, in one place."""


def test_worlds_are_stepped_in_one_loop():
    """The trainer's worlds and other libraries' adapters have theirs."""
    loops = set()
    for name in (name for name in FILES if name.startswith("apps/")):
        for node in nodes(name):
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


def goes_up_inside(name, module):
    """Whether a file imports from a folder above its own in a large room."""
    here, there = place_of(name), place_of(module.removeprefix("myowarp."))
    if (
        not here
        or "__init__" in name
        or not there
        or not module.startswith("myowarp.")
        or here[0] != there[0]
    ):
        return False
    order = FOLDERS[here[0]]
    return order.index(there[1]) < order.index(here[1])


def test_imports_go_down_inside_of_rooms():
    refuse(wrong_imports(goes_up_inside))


BUILDS = {
    "engine/graph.py: Graph.__init__",
    "engine/graph.py: Replay.__init__",
    "process.py: start_warp",
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


def bound(every):
    """Return the top package of each name that a file imports, of all of its nodes."""
    found = {}
    for node in every:
        if isinstance(node, ast.Import):
            found |= {(n.asname or n.name).split(".")[0]: n.name.split(".")[0] for n in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {n.asname or n.name: node.module.split(".")[0] for n in node.names}
    return found


def own_names(every):
    """Return the private names that a file defines; those set in a class of a library may be its own."""
    packages, found = bound(every), set()
    for node in every:
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


def uses_of_others(text, own, every=None):
    """Return what a file uses that others keep to themselves; without its nodes they are found."""
    every, found = every or list(ast.walk(ast.parse(text))), SURGERY.findall(text)
    packages = bound(every)
    for node in every:
        used = []
        if isinstance(node, ast.Import):
            used = [part for name in node.names for part in name.name.split(".")]
        elif isinstance(node, ast.ImportFrom) and not node.module.startswith("myowarp"):
            used = [*node.module.split("."), *(name.name for name in node.names)]
        elif isinstance(node, ast.Attribute):
            used = [node.attr]
            replaces = isinstance(node.ctx, ast.Store) and packages.get(root_of(node)) in LIBRARIES
            found += [ast.unparse(node)] if replaces and ".config." not in ast.unparse(node) else []
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in BY_NAME:
            used = [arg.value for arg in node.args[1:2] if isinstance(arg, ast.Constant)]
        found += [name for name in used if is_private(name) and name not in own | OF_TUPLES]
    return found


@cache
def all_own_names():
    """Return the private names that our files define, but for those that may use a library's."""
    return set().union(*(own_names(nodes(name)) for name in UNGUARDED))


def test_what_others_keep_private_stays_in_one_file():
    """Private names of a library, and what replaces its functions, are in the file that `GUARDED` names."""
    own, texts = all_own_names(), {name: FILES[name].read_text() for name in UNGUARDED}
    found = {name: uses_of_others(text, own, nodes(name)) for name, text in texts.items()}
    refuse(f"{name}: {uses}" for name, uses in found.items() if uses)


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
    assert uses_of_others(planted, all_own_names())


def test_own_private_names_are_not_those_of_others():
    text = "import warp as wp\nwp.config.quiet = True\ndef f(seen, self): return seen._replace(self._mine)"
    assert uses_of_others(text, {"_mine"}) == []


TESTS = Path(__file__).parent
KNOW_THE_INSIDE = ("engine", "data")
"""Folders of tests that may: of the engine's kernels, and what runs within MyoSuite or OpenSim to record."""


def looks_inside(text):
    """Yield line and name of each private attribute or import of others, in programs within a text, too."""
    for node in ast.walk(ast.parse(text)):
        used = []
        if isinstance(node, ast.Attribute):
            used = [] if getattr(node.value, "id", "") in ("self", "cls", "os") else [node.attr]
        elif isinstance(node, ast.ImportFrom):
            used = [name.name for name in node.names]
        elif isinstance(node, ast.Call):
            named = getattr(node.func, "attr", getattr(node.func, "id", ""))
            used = [value.split(".")[-1] for value in constants(node)] if named in BY_NAME else []
        elif isinstance(node, ast.Constant) and re.search(r"\n *import ", str(node.value)):
            used = re.findall(r"(?<!self)(?<!cls)(?<!os)\.(_\w+)", node.value)
        yield from ((node.lineno, name) for name in used if is_private(name) and name not in OF_TUPLES)


def test_tests_know_what_is_public():
    """A private name may change without a word; what a test needs of it deserves a public one."""
    files = {str(path.relative_to(TESTS)): path for path in sorted(TESTS.rglob("*.py"))}
    refuse(
        f"{name}:{line}: {inside}"
        for name, path in files.items()
        if not name.startswith(KNOW_THE_INSIDE)
        for line, inside in looks_inside(path.read_text())
    )


def test_tests_that_are_left_to_the_slow_ones_are_there():
    """A renamed test would come back to `make test` unseen."""
    tests = Path(__file__).parent
    for line in (tests / "rare.txt").read_text().splitlines():
        file, *_, name = line.split("::")
        assert re.search(rf"def {name.partition('[')[0]}\(", (tests / file).read_text()), line


@pytest.mark.parametrize(
    "planted",
    [
        "assert live._panel",
        "from myowarp.apps.train.improve import _choice",
        "monkeypatch.setattr(selection.Selection, '_build', None)",
        r'PROGRAM = "\nimport myowarp\nprint(env._pictures)"',
    ],
)
def test_planted_looks_inside_are_found(planted):
    assert list(looks_inside(planted))
    assert not list(looks_inside(planted.replace("_", "")))


WRITES = {
    *("write_text", "write_bytes", "tofile", "savetxt", "savez", "savez_compressed", "savefig"),
    *("to_csv", "to_parquet", "to_json", "copyfile", "copy2", "copytree", "mkstemp", "mkdtemp"),
    *("NamedTemporaryFile", "write_frames", "ParquetWriter", "CSVWriter", "RecordWriter"),
}
"""Calls that write a file, by the end of their name."""
ALLOWED_WRITERS = {
    "apps/reports/progress.py:Progress.__init__": "grows while a training runs; readers skip a cut end",
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


def test_files_are_written_whole():
    """What opens a file for writing stands in a function with `in_place`, or in `ALLOWED_WRITERS`."""
    calls = {name: (node for node in nodes(name) if isinstance(node, ast.Call)) for name in FILES}
    files = {name for name in FILES.keys() - {"disk.py"} if any(map(opens_for_writing, calls[name]))}
    refuse(
        {f"{name}:{function}" for name in files for function in writers(tree(name))} - ALLOWED_WRITERS.keys()
    )


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


CLAUSES = re.compile(r"(What|Where|Who|Whoever|Whose|Which|Those|That|How) ")


def docstrings(every):
    """Yield the docstrings of a module, the texts under its constants included, of all of its nodes."""
    for node in every:
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
            for child in node.body:
                text = child.value if isinstance(child, ast.Expr) else None
                if isinstance(text, ast.Constant) and isinstance(text.value, str):
                    yield text.value


def test_docstrings_begin_with_a_noun_or_a_verb():
    """A relative clause in place of the thing has to be read twice."""
    modules = {name: nodes(name) for name in FILES}
    for path in PACKAGE.parent.glob("benchmarks/*.py"):
        modules[path.name] = ast.walk(ast.parse(path.read_text()))
    assert not [
        f"{name}: {text.splitlines()[0]}"
        for name, module in modules.items()
        for text in docstrings(module)
        if CLAUSES.match(text.strip())
    ]


def test_a_docstring_that_is_a_clause_is_found():
    module = ast.parse('"""What a body is."""\nA = 1\n"""Where it is."""\ndef f():\n    """Return it."""')
    assert [bool(CLAUSES.match(text)) for text in docstrings(ast.walk(module))] == [True, True, False]


def test_colours_are_those_of_one_file():
    """Greys, whose parts differ little, may stand anywhere."""

    def parts(color):
        return [int(color[k : k + 2], 16) for k in (0, 2, 4)]

    refuse(
        f"{name}:{node.lineno}: #{color} is none of inks.py"
        for name in FILES.keys() - {"inks.py"}
        for node in nodes(name)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        for color in re.findall(r"#([0-9a-fA-F]{6})\b", node.value)
        if max(parts(color)) - min(parts(color)) > 24
    )

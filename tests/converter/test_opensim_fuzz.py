"""Mutated models end in a result with a report or in one sentence that names the file; none hangs."""

import json
import re
import signal
from pathlib import Path

import mujoco
import numpy as np
import pytest

pytest.importorskip("scipy")
if not hasattr(signal, "setitimer"):
    pytest.skip("needs a timer of processor time", allow_module_level=True)

from myowarp.osim.convert import run as command
from myowarp.osim.convert.tendon import fits as muscle_fit
from myowarp.sim.converted_step import OurStep

OSIM = Path(__file__).parents[1] / "data" / "osim"
SMALL = ("Tug_of_War", "joints", "old", "arm26")
ALL = (*SMALL, "ellipsoids", "leg6dof9musc", "gait10dof18musc")
LIMIT = 60
"""s of processor time of one case; the slowest takes about a tenth."""
NUMBERS = ("nan", "inf", "-inf", "0", "-1", "1e300", "-1e300", "1e-300", "", "x", "1 2", "0x10", "1e999")
ELEMENT = re.compile(r"<(\w+)([^<>]*)>([^<>]*)</\1>")
NUMBER = re.compile(r"-?\d+(\.\d+)?(e-?\d+)?")
LEAST_RESULTS = 0.15
"""Share of cases that should still be converted; else the mutations test the parser only."""


def mutate(text, random):
    """Return a model's text with one to three things wrong."""
    for _ in range(random.integers(1, 4)):
        leaves = list(ELEMENT.finditer(text))
        leaf = leaves[random.integers(len(leaves))]
        other = leaves[random.integers(len(leaves))]
        tag, attributes, content = leaf.groups()
        kind = random.integers(12)
        if kind == 0:
            new = ""
        elif kind == 1:
            new = leaf.group() * 2
        elif kind == 2:
            new = f"<{tag}{attributes}>{NUMBERS[random.integers(len(NUMBERS))]}</{tag}>"
        elif kind == 3:
            parts = content.split() or [""]
            parts[random.integers(len(parts))] = NUMBERS[random.integers(len(NUMBERS))]
            new = f"<{tag}{attributes}>{' '.join(parts)}</{tag}>"
        elif kind == 4:
            alike = [leaf for leaf in leaves if leaf.group(1) == tag]
            new = f"<{tag}{attributes}>{alike[random.integers(len(alike))].group(3)}</{tag}>"
        elif kind == 5:
            new = other.group()
        elif kind == 6:
            new = f"<Unheard{attributes}>{content}</Unheard>"
        elif kind > 7:
            scale = random.choice([-1.0, 0.0, 1e-3, 0.5, 2.0, 30.0])
            words = [
                repr(scale * float(word)) if NUMBER.fullmatch(word) else word for word in content.split()
            ]
            new = f"<{tag}{attributes}>{' '.join(words)}</{tag}>"
        else:
            names = re.findall(r'name="(\w+)"', text)
            old, name = (names[random.integers(len(names))] for _ in range(2))
            text = text.replace(f'name="{old}"', f'name="{name}"', 1)
            continue
        text = text[: leaf.start()] + new + text[leaf.end() :]
    if random.random() < 0.05:
        text = text[: random.integers(len(text))]
    return text


def late(*_):
    raise TimeoutError(f"no result within {LIMIT} s of processor time")


def outcome(source, output):
    """Return whether a file was converted; else its error must be a sentence."""
    signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, LIMIT)
    said = None
    try:
        report = command.run(source, output, OurStep, workers=1)
    except (ValueError, NotImplementedError) as error:
        said = str(error)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    if said is not None:
        assert source.name in said
        assert "\n" not in said
        assert not (output / "report.json").exists()
        return False
    assert json.loads((output / "report.json").read_text())["gates"] == report["gates"]
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_path(str(output / "model.xml")))
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    assert np.isfinite(data.ten_length).all()
    return True


@pytest.mark.parametrize(("names", "count"), [(SMALL, 16), pytest.param(ALL, 200, marks=pytest.mark.slow)])
def test_mutated_models_end_well(names, count, tmp_path, monkeypatch):
    monkeypatch.setattr(muscle_fit, "POSES", 24)
    monkeypatch.setattr(muscle_fit, "CHECK_POSES", 8)
    monkeypatch.setattr(command, "PATIENCE", LIMIT)
    monkeypatch.setenv("MYOWARP_CACHE_DIR", str(tmp_path / "cache"))
    texts = [(OSIM / f"{name}.osim").read_text() for name in names]
    results = []
    for number in range(count):
        random = np.random.default_rng(number)
        source = tmp_path / f"case{number}.osim"
        source.write_text(mutate(texts[number % len(texts)], random))
        results.append(outcome(source, tmp_path / str(number)))
    assert np.mean(results) > LEAST_RESULTS
    assert not all(results)

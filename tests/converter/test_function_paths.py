"""Lengths that are functions of coordinates: sets in files, fits, refusals, and the step.

What OpenSim makes of such paths is in `test_opensim_forces.py` and `tests/motion/test_model_forces.py`.
"""

from pathlib import Path

import numpy as np
import pytest
import warp as wp

from myowarp.kernels.launch import launch
from myowarp.laws.paths.path import MOST_VARIABLES, follow_paths
from myowarp.laws.paths.tables import OsimPath, OsimPaths, PathMemory, Polynomial, Via
from myowarp.osim.body.muscle_paths import PathsOfMuscles, muscle_paths
from myowarp.osim.body.scale_document import scale_document
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.convert.function_paths import (
    ARM,
    JUMP,
    LENGTH,
    fit_function_paths,
    write_function_paths,
)
from myowarp.osim.document.read.element import parse
from myowarp.osim.document.read.functions import exponents
from myowarp.osim.document.read.model import Document, read_model

OSIM = Path(__file__).parents[1] / "data/osim"
LEG = OSIM / "leg6dof9musc.osim"
DEVICES = OSIM / "devices.osim"

SET = """<OpenSimDocument Version="40600"><Set_FunctionBasedPath_><objects>
<FunctionBasedPath name="/forceset/{name}"><coordinate_paths>{coordinates}</coordinate_paths>
<length_function>{function}</length_function>{more}</FunctionBasedPath></objects></Set_FunctionBasedPath_>
</OpenSimDocument>"""
SQUARE = """<MultivariatePolynomialFunction><coefficients>{}</coefficients><dimension>1</dimension>
<order>2</order></MultivariatePolynomialFunction>"""


def bones_with(folder, name="cable", coordinates="/jointset/knee/knee_angle", function="", more=""):
    """Return the devices with a path of a set in place of one of theirs."""
    file = folder / "paths.xml"
    function = function or SQUARE.format("0.4 0.05 0.01")
    file.write_text(SET.format(name=name, coordinates=coordinates, function=function, more=more))
    return Bones.read(DEVICES, function_paths=file)


def test_terms_are_in_the_order_of_opensim():
    """OpenSim 4.6: 1, 2, ... 6 of order 2 at (10, 100) is 35841."""
    terms = [10.0**p * 100.0**q for p, q in exponents(2, 2)]
    assert np.dot(range(1, 7), terms) == 35841.0
    assert len(exponents(3, 5)) == 56
    assert len(exponents(6, 5)) == 462


def test_a_set_takes_the_place_of_paths(tmp_path):
    bones = bones_with(tmp_path)
    knee, hip = (bones.coordinates.index(name) for name in ("knee_angle", "hip_flexion"))
    values = np.random.default_rng(0).uniform(-1.0, 1.0, size=(37, len(bones.coordinates)))
    speeds = np.random.default_rng(1).normal(size=values.shape)
    lanes = muscle_paths(bones, values, speeds, ["cable", "belt"])
    kernels = PathsOfMuscles(bones, 37, ["cable", "belt"]).along(values, speeds)
    for found in (lanes, kernels):
        q = values[:, knee]
        np.testing.assert_allclose(found.length[:, 0], 0.4 + 0.05 * q + 0.01 * q**2, rtol=1e-14)
        np.testing.assert_allclose(found.moment_arm[:, 0, knee], -0.05 - 0.02 * q, rtol=1e-14)
        np.testing.assert_allclose(found.velocity[:, 0], (0.05 + 0.02 * q) * speeds[:, knee], rtol=1e-12)
        assert not found.moment_arm[:, 0, hip].any()
        assert found.moment_arm[:, 1].any()
    before = muscle_paths(Bones.read(DEVICES), values, speeds, ["cable"])
    assert np.abs(before.length - lanes.length[:, :1]).max() > 0.01


@pytest.mark.parametrize("worlds", [1, 19])
def test_polynomials_in_lanes_and_in_the_kernel_are_sums_of_powers(worlds):
    """Some of few terms, in any order, beside a path of points, which keeps its place."""
    random, values = np.random.default_rng(5), 8
    paths: dict[str, OsimPath] = {"line": OsimPath((Via("a", (0, 0, 0)), Via("a", (0, 3, 4))))}
    for number in range(1, MOST_VARIABLES + 1):
        powers = {tuple(random.integers(0, 5, number).tolist()) for _ in range(9)}
        chosen = tuple(random.permutation(values)[:number].tolist())
        terms = Polynomial(chosen, tuple(random.normal(size=len(powers))), tuple(powers))
        paths[f"polynomial {number}"] = OsimPath((), (), terms)
    with wp.ScopedDevice("cpu"):
        memory = PathMemory(OsimPaths(paths, {}), worlds, values)
        x = random.uniform(-1.5, 1.5, (worlds, values))
        memory.frames.value.assign(x)
        memory.frames.rotation.assign(np.tile(np.eye(3), (worlds, 1, 1, 1)))
        found = []
        for by_kernel in (False, True):
            memory.pulls.length.fill_(np.nan)
            memory.pulls.by_variable.fill_(np.nan)
            if by_kernel:
                numbers = wp.array(np.arange(len(paths)), dtype=int)
                launch(follow_paths, (worlds, len(paths)), memory, numbers=numbers)
            else:
                memory.launch()
            found.append((memory.pulls.length.numpy().copy(), memory.pulls.by_variable.numpy().copy()))
    place = 0
    for number, path in enumerate(paths.values()):
        if path.polynomial is None:
            wanted, slopes = np.full(worlds, 5.0), []
        else:
            own, power = x[:, path.polynomial.values], np.array(path.polynomial.powers)
            c = np.array(path.polynomial.coefficients)
            wanted = (c * (own[:, None, :] ** power).prod(axis=2)).sum(axis=1)
            slopes = []
            for k in range(own.shape[1]):
                less = power - (np.arange(own.shape[1]) == k)
                each = power[:, k] * (own[:, None, :] ** np.maximum(less, 0)).prod(axis=2)
                slopes.append((c * each).sum(axis=1))
        for length, by_variable in found:
            np.testing.assert_allclose(length[:, number], wanted, rtol=1e-12, atol=1e-12)
            for k, slope in enumerate(slopes):
                np.testing.assert_allclose(by_variable[:, place + k], slope, rtol=1e-11, atol=1e-11)
        place += len(slopes)


WRONG = [
    ({"name": "nobody"}, ValueError, "names a force that the model does not have, or that has no path"),
    ({"coordinates": "/jointset/x/elsewhere"}, ValueError, "refers to coordinate '/jointset/x/elsewhere'"),
    ({"coordinates": ""}, ValueError, "must have coordinates, each once, got none"),
    ({"function": SQUARE.format("1 2")}, ValueError, "3"),
    ({"function": "<Nothing/>"}, NotImplementedError, "Nothing"),
    (
        {"coordinates": "knee_angle hip_flexion", "function": SQUARE.format("1 2 3")},
        ValueError,
        "as many dimensions as coordinates, 2, got 1",
    ),
    (
        {"more": f"<moment_arm_functions>{SQUARE.format('0.05 0.02 0')}</moment_arm_functions>"},
        NotImplementedError,
        "states moment arms or speeds up to 0.1",
    ),
]


@pytest.mark.parametrize(("parts", "error", "reason"), WRONG)
def test_what_is_wrong_is_said(parts, error, reason, tmp_path):
    with pytest.raises(error, match=reason) as raised:
        bones_with(tmp_path, **parts)
    assert "\n" not in str(raised.value)


def test_other_kinds_of_path_are_named(tmp_path):
    text = DEVICES.read_text().replace("FunctionBasedPath", "Scholz2015GeometryPath")
    path = tmp_path / "scholz.osim"
    path.write_text(text)
    with pytest.raises(
        NotImplementedError, match="<Scholz2015GeometryPath name='path'> is no supported kind"
    ):
        read_model(path)


def test_no_factor_scales_a_function():
    document = Document(DEVICES, parse(DEVICES)[0])
    with pytest.raises(ValueError, match="4 paths, such as that of 'tether', are functions of coordinates"):
        scale_document(document, {"thigh": np.full(3, 1.1)}, None, False)


def test_fits_are_as_near_as_they_say(tmp_path):
    """Of nine muscles over wraps and moving points; read back, they are what was fitted."""
    bones = Bones.read(LEG)
    fitted, without = fit_function_paths(bones)
    assert not without
    assert len(fitted) == len(bones.model.muscles)
    file = tmp_path / "paths.xml"
    write_function_paths(file, bones.model, fitted)
    functions = Bones(read_model(LEG, function_paths=file))
    low, high = np.array([bones.model.coordinates[name].sampling_range for name in bones.coordinates]).T
    values = np.random.default_rng(7).uniform(low, high, size=(500, len(low)))
    still = np.zeros_like(values)
    theirs, found = muscle_paths(bones, values, still), muscle_paths(functions, values, still)
    assert theirs.muscles == found.muscles
    off = np.abs(found.length - theirs.length).max(axis=0)
    arm = np.abs(found.moment_arm - theirs.moment_arm).max(axis=(0, 2))
    good = np.array([one.good for one in fitted])
    assert good.sum() >= 5
    # What is beyond the bounds jumps by itself, and nothing else does.
    assert all((one.jump > JUMP) != one.good for one in fitted)
    psoas, hip = found.muscles.index("psoas_r"), bones.coordinates.index("hip_flexion_r")
    line = np.zeros((4001, len(low)))
    line[:, hip] = np.linspace(low[hip], high[hip], len(line))
    steps = np.abs(np.diff(muscle_paths(bones, line, 0 * line, ["psoas_r"]).length[:, 0]))
    np.testing.assert_allclose(fitted[psoas].jump, steps.max(), atol=1e-4)
    assert fitted[psoas].jump > 100 * np.median(steps)
    assert off[good].max() <= 1.3 * LENGTH
    assert arm[good].max() <= 1.3 * ARM
    assert max(one.length_worst for one in fitted) > 10 * LENGTH
    assert {len(one.function.coordinates) for one in fitted} == {1, 2}

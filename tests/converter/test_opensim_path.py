"""Muscle paths against OpenSim 4.6: recorded lengths and both moment arms; live where it is installed."""

from pathlib import Path

import numpy as np
import pytest
from reference.osim_paths.cylinder import MANDATORY, wrap_cylinder
from reference.osim_paths.ellipsoid import wrap_ellipsoid
from reference.osim_paths.sphere import wrap_sphere, wrap_torus

from myowarp.osim.body.described import quadrant
from myowarp.osim.body.moment_arm import PRESENT, crossed, own_reference, poses_of
from myowarp.osim.body.path_solution import activity, solve
from myowarp.osim.document.elements import ConditionalPathPoint
from myowarp.osim.document.elements import Path as MusclePath
from myowarp.osim.document.kinematics import complete, forward
from myowarp.osim.document.read.model import read_model

DATA = Path(__file__).parents[1] / "data"
MODELS = ("arm26", "gait10dof18musc", "leg6dof9musc")

LENGTH_TOLERANCE = 1e-9
"""m. Only rounding differs, also in OpenSim's iterations; its lengths have 1e-16, adjusted spirals 1e-12."""

MOMENT_ARM_TOLERANCE = 2e-9
"""m. Differences with a step of 1e-5 of lengths that agree to 1e-15."""

TORUS_TOLERANCE = 5e-4
"""m. OpenSim's search for the nearest point on a torus stops at 1e-4; most lines agree to rounding."""

WRAPS = {
    "cylinder": lambda a, b: wrap_cylinder(a, b, 0.3, 1.0, 0, 0, False),
    "cylinder_x": lambda a, b: wrap_cylinder(a, b, 0.3, 1.0, 0, 1, False),
    "cylinder_-y": lambda a, b: wrap_cylinder(a, b, 0.3, 0.5, 1, -1, False),
    "cylinder_x_double": lambda a, b: wrap_cylinder(a, b, 0.3, 1.0, 0, 1, True),
    "sphere": lambda a, b: wrap_sphere(a, b, 0.3, 0, 0),
    "sphere_y": lambda a, b: wrap_sphere(a, b, 0.3, 1, 1),
    "ellipsoid": lambda a, b: wrap_ellipsoid(a, b, (0.3, 0.2, 0.25), 0, 0, "hybrid"),
    "ellipsoid_y": lambda a, b: wrap_ellipsoid(a, b, (0.03, 0.02, 0.025), 1, 1, "hybrid"),
    "ellipsoid_-z_midpoint": lambda a, b: wrap_ellipsoid(a, b, (0.3, 0.2, 0.25), 2, -1, "midpoint"),
    "ellipsoid_-x_axial": lambda a, b: wrap_ellipsoid(a, b, (0.3, 0.2, 0.25), 0, -1, "axial"),
    "torus": lambda a, b: wrap_torus(a, b, 0.1, 0.3, 0, 0, False),
    "torus_x": lambda a, b: wrap_torus(a, b, 0.1, 0.3, 0, 1, False),
}


def recorded(model):
    """Return a model, the recorded arrays, and the recorded coordinates by name."""
    arrays = np.load(DATA / "opensim" / f"paths_{model}.npz")
    values = dict(zip(arrays["coordinates"].tolist(), arrays["values"].T, strict=True))
    return read_model(DATA / "osim" / f"{model}.osim"), arrays, values


@pytest.mark.parametrize("case", WRAPS)
def test_single_wraps(case):
    arrays = np.load(DATA / "opensim" / "paths_wraps.npz")
    start, end, length, size = (arrays[f"{case}_{name}"] for name in ("start", "end", "length", "size"))
    wrap = WRAPS[case](start, end)
    on = wrap.status > 0
    straight = np.linalg.norm(start - end, axis=1)
    over = np.linalg.norm(start - wrap.first, axis=1) + wrap.length + np.linalg.norm(end - wrap.last, axis=1)
    assert 10 < (size == 4).sum() < len(size) - 10
    known = np.isfinite(length)
    assert known.mean() > 0.9
    assert (on == (size == 4))[known].all()
    error = np.abs(np.where(on, over, straight) - length)[known]
    assert (error < LENGTH_TOLERANCE).mean() > (0.95 if case.startswith("torus") else 0.999)
    assert error.max() < (TORUS_TOLERANCE if case.startswith("torus") else LENGTH_TOLERANCE)
    # What a wrap adds is far above the tolerance.
    assert np.nanmean((length - straight)[size == 4]) > 1e-3


@pytest.mark.parametrize("name", MODELS)
def test_lengths(name):
    model, arrays, values = recorded(name)
    coordinates = complete(
        model, {k: v for k, v in values.items() if k not in model.couplers}, len(arrays["length"])
    )
    frames = forward(model, coordinates)
    for column, muscle in enumerate(arrays["muscles"].tolist()):
        solution = solve(model, model.muscles[muscle].path, frames, coordinates)
        assert np.abs(solution.length - arrays["length"][:, column]).max() < LENGTH_TOLERANCE, muscle
        assert ((solution.order >= 0).sum(axis=1) == arrays["size"][:, column]).all(), muscle
        assert np.ptp(arrays["length"][:, column]) > 100 * LENGTH_TOLERANCE


@pytest.mark.parametrize("name", MODELS)
def test_both_moment_arms(name):
    model, arrays, values = recorded(name)
    poses = poses_of(model, values, arrays["free"].tolist())
    wanted = {
        (arrays["muscles"][muscle], arrays["free"][free]): column
        for column, (muscle, free) in enumerate(arrays["pairs"])
    }
    for muscle in arrays["muscles"].tolist():
        path = model.muscles[muscle].path
        along = crossed(model, path)
        reference = own_reference(model, path, poses, along)
        for coordinate in along:
            column = wanted.pop((muscle, coordinate), None)
            if column is None:
                assert np.abs(reference.slope[coordinate]).max() < PRESENT
                continue
            arm, slope = reference.moment_arm[coordinate], reference.slope[coordinate]
            assert np.abs(arm - arrays["moment_arm"][:, column]).max() < MOMENT_ARM_TOLERANCE, muscle
            assert np.abs(slope - arrays["slope"][:, column]).max() < MOMENT_ARM_TOLERANCE, muscle
    assert not wanted, f"{wanted} depend on coordinates that we do not see"


def test_inconsistent_samples_are_counted():
    """OpenSim forgets to move wrap points in its cache: its two senses of a moment arm then differ."""
    model, arrays, values = recorded("arm26")
    poses = poses_of(model, values, arrays["free"].tolist())
    reference = own_reference(model, model.muscles["TRIlong"].path, poses, ["r_shoulder_elev"])
    muscle, free = list(arrays["muscles"]).index("TRIlong"), list(arrays["free"]).index("r_shoulder_elev")
    column = arrays["pairs"].tolist().index([muscle, free])
    apart = np.abs(arrays["moment_arm"][:, column] - arrays["slope"][:, column]) > 1e-4
    assert (reference.consistent("r_shoulder_elev") == ~apart).all()
    assert 0.1 < apart.mean() < 0.9


@pytest.mark.parametrize(
    ("name", "expected"), [("all", (0, 0)), ("+x", (0, 1)), ("-y", (1, -1)), ("Z", (2, 1)), ("-X", (0, -1))]
)
def test_quadrants(name, expected):
    assert quadrant(name) == expected


@pytest.mark.slow
def test_lengths_live():
    """The same against an installed OpenSim, in poses that nobody chose."""
    opensim = pytest.importorskip("opensim")
    opensim.Logger.setLevelString("Off")
    from tests.data.record_opensim_paths import record_model

    seed = int(np.random.default_rng().integers(1 << 30))
    for name in MODELS:
        file = DATA / "osim" / f"{name}.osim"
        arrays, model = record_model(file, 10, seed), read_model(file)
        values = dict(zip(arrays["coordinates"], np.array(arrays["values"]).T, strict=True))
        frames = forward(model, values)
        for column, muscle in enumerate(arrays["muscles"]):
            length = solve(model, model.muscles[muscle].path, frames, values).length
            error = np.abs(length - np.array(arrays["length"])[:, column]).max()
            assert error < LENGTH_TOLERANCE, (seed, muscle)


LEVEL_END = (
    # second end [m]; first and last point on the cylinder [m], arc [m], of OpenSim 4.6
    (
        (-0.1038540183, -0.1168474991, 0.0),
        ((-0.014593668, 0.010536834, 0.00971485), (-0.014741328, 0.010329242, 0.006540673), 0.003184384),
    ),
    (
        (-0.0869728553, -0.129405243, 0.0),
        ((-0.014593668, 0.010536834, 0.007486617), (-0.015998631, 0.008248867, 0.005473719), 0.003357659),
    ),
)


@pytest.mark.parametrize(("end", "expected"), LEVEL_END)
def test_second_end_in_the_middle_of_a_cylinder(end, expected):
    """Without a height of its second end OpenSim slides only one of the tangent points along the axis."""
    start = np.array([[0.05, 0.1, 0.02]])
    wrap = wrap_cylinder(start, np.array([end]), radius=0.018, length=0.1, axis=0, sign=0, adjust=True)
    first, last, arc = expected
    assert wrap.status == [MANDATORY]
    np.testing.assert_allclose(wrap.first[0], first, atol=1e-8)
    np.testing.assert_allclose(wrap.last[0], last, atol=1e-8)
    np.testing.assert_allclose(wrap.length, arc, atol=1e-8)
    raised = wrap_cylinder(start, np.array([(*end[:2], 1e-6)]), 0.018, 0.1, axis=0, sign=0, adjust=True)
    assert abs(raised.length[0] - arc) > 1e-4


@pytest.mark.parametrize(("beyond", "active"), [(0.9e-5, True), (1.1e-5, False)])
def test_conditional_points_just_beyond_their_range(beyond, active):
    """OpenSim 4.6 counts them to 1e-5: FPL of a wrist at 0.9e-5 rad beyond, gracilis at 0.07e-5."""
    point = ConditionalPathPoint("p", "b", np.zeros(3), "q", (0.1, 0.2))
    for value in (0.1 - beyond, 0.2 + beyond):
        found = activity(MusclePath((point,), ()), {"q": np.array([value])}, 1)
        assert found[0, 0] == active

"""Lines over OpenSim's wrap objects, in a kernel: against OpenSim 4.6, recorded, and the float64 NumPy."""

from pathlib import Path

import numpy as np
import pytest
import warp as wp
from reference.osim_paths import cylinder, ellipsoid, sphere

from myowarp.laws.paths.cylinder import wrap_cylinder
from myowarp.laws.paths.ellipsoid import AXIAL, HYBRID, MIDPOINT, wrap_ellipsoid
from myowarp.laws.paths.sphere import wrap_sphere
from myowarp.laws.paths.torus import wrap_torus
from myowarp.laws.paths.wrap import Wrap, real

# Kernels of tests are compiled once and launched for a moment.
wp.set_module_options({"enable_backward": False, "optimization_level": 0})

RECORDED = Path(__file__).parents[1] / "data" / "opensim" / "paths_wraps.npz"

LENGTH_TOLERANCE = 1e-9
"""m. Both in float64; OpenSim's lengths have 1e-16, adjusted spirals 1e-12."""

TORUS_TOLERANCE = 2e-5
"""m. Of a few lines: OpenSim's search along them stops at 1e-4. NumPy differs by the same 7e-6, the kernel
from NumPy by 1e-15."""

CYLINDERS = {
    "cylinder": (0.3, 1.0, 0, 0, False),
    "cylinder_x": (0.3, 1.0, 0, 1, False),
    "cylinder_-y": (0.3, 0.5, 1, -1, False),
    "cylinder_x_double": (0.3, 1.0, 0, 1, True),
}
SPHERES = {"sphere": (0.3, 0, 0), "sphere_y": (0.3, 1, 1)}
TORI = {"torus": (0.1, 0.3, 0, 0, False), "torus_x": (0.1, 0.3, 0, 1, False)}
ELLIPSOIDS = {
    "ellipsoid": ((0.3, 0.2, 0.25), 0, 0, "hybrid"),
    "ellipsoid_y": ((0.03, 0.02, 0.025), 1, 1, "hybrid"),
    "ellipsoid_-z_midpoint": ((0.3, 0.2, 0.25), 2, -1, "midpoint"),
    "ellipsoid_-x_axial": ((0.3, 0.2, 0.25), 0, -1, "axial"),
}
METHODS = {"hybrid": int(HYBRID), "midpoint": int(MIDPOINT), "axial": int(AXIAL)}
CASES = [*CYLINDERS, *SPHERES, *ELLIPSOIDS, *TORI]


@wp.kernel(enable_backward=False)
def over_ellipsoids(
    start: wp.array[wp.vec3d],
    end: wp.array[wp.vec3d],
    radii: wp.vec3d,
    axis: int,
    sign: int,
    method: int,
    found: wp.array[Wrap],
):
    line = wp.tid()
    found[line] = wrap_ellipsoid(start[line], end[line], radii, axis, sign, method)


@wp.kernel(enable_backward=False)
def over_cylinders(
    start: wp.array[wp.vec3d],
    end: wp.array[wp.vec3d],
    radius: wp.float64,
    length: wp.float64,
    axis: int,
    sign: int,
    adjust: bool,
    found: wp.array[Wrap],
):
    line = wp.tid()
    found[line] = wrap_cylinder(start[line], end[line], radius, length, axis, sign, adjust)


@wp.kernel(enable_backward=False)
def over_spheres(
    start: wp.array[wp.vec3d],
    end: wp.array[wp.vec3d],
    radius: wp.float64,
    axis: int,
    sign: int,
    found: wp.array[Wrap],
):
    line = wp.tid()
    found[line] = wrap_sphere(start[line], end[line], radius, axis, sign)


@wp.kernel(enable_backward=False)
def over_tori(
    start: wp.array[wp.vec3d],
    end: wp.array[wp.vec3d],
    tube: wp.float64,
    ring: wp.float64,
    axis: int,
    sign: int,
    adjust: bool,
    found: wp.array[Wrap],
):
    line = wp.tid()
    found[line] = wrap_torus(start[line], end[line], tube, ring, axis, sign, adjust)


def wrapped(kernel, start, end, *parameters):
    """Return what a kernel says of lines, as a structured array."""
    found = wp.zeros(len(start), dtype=Wrap, device="cpu")
    lines = [wp.array(points, dtype=wp.vec3d, device="cpu") for points in (start, end)]
    wp.launch(kernel, len(start), inputs=[*lines, *parameters, found], device="cpu")
    return found.numpy()


def of_case(case, start, end):
    """Return kernel and NumPy over the object of a recorded case."""
    if case in SPHERES:
        radius, *others = SPHERES[case]
        found = wrapped(over_spheres, start, end, real(radius), *others)
        return found, sphere.wrap_sphere(start, end, radius, *others)
    if case in ELLIPSOIDS:
        radii, axis, sign, method = ELLIPSOIDS[case]
        found = wrapped(over_ellipsoids, start, end, wp.vec3d(*radii), axis, sign, METHODS[method])
        return found, ellipsoid.wrap_ellipsoid(start, end, radii, axis, sign, method)
    if case in TORI:
        tube, ring, *others = TORI[case]
        found = wrapped(over_tori, start, end, real(tube), real(ring), *others)
        return found, sphere.wrap_torus(start, end, tube, ring, *others)
    radius, length, *others = CYLINDERS[case]
    found = wrapped(over_cylinders, start, end, real(radius), real(length), *others)
    return found, cylinder.wrap_cylinder(start, end, radius, length, *others)


def path_length(start, end, status, first, last, arc):
    """Return the length of a line over an object, straight where it does not wrap [m]."""
    over = np.linalg.norm(start - first, axis=1) + arc + np.linalg.norm(end - last, axis=1)
    return np.where(status > 0, over, np.linalg.norm(start - end, axis=1))


@pytest.mark.parametrize("case", CASES)
def test_recorded_wraps(case):
    arrays = np.load(RECORDED)
    start, end, length, size = (arrays[f"{case}_{name}"] for name in ("start", "end", "length", "size"))
    found, _ = of_case(case, start, end)
    known = np.isfinite(length)
    assert known.mean() > 0.9
    assert ((found["status"] > 0) == (size == 4))[known].all()
    own = path_length(start, end, *(found[name] for name in ("status", "first", "last", "length")))
    error = np.abs(own - length)[known]
    assert (error < LENGTH_TOLERANCE).mean() > (0.95 if case in TORI else 0.999)
    assert error.max() < (TORUS_TOLERANCE if case in TORI else LENGTH_TOLERANCE)
    # What a wrap adds is far above the tolerance.
    assert np.nanmean((length - np.linalg.norm(start - end, axis=1))[size == 4]) > 1e-3


@pytest.mark.parametrize("case", [case for case in CASES if not case.endswith("axial")])
def test_random_lines_go_as_in_numpy(case):
    """Status of every line, and points and arcs of those that wrap, at a number that is no multiple of 32.

    OpenSim's search for tangent points diverges on some such lines under `axial`; see the recorded ones.
    """
    random = np.random.default_rng(3)
    reach = 0.08 if case == "ellipsoid_y" else 0.8  # m
    start, end = random.uniform(-reach, reach, (2, 4001, 3))
    end[::7, 2] = 0.0  # OpenSim slides these otherwise
    found, expected = of_case(case, start, end)
    np.testing.assert_array_equal(found["status"], expected.status)
    on = expected.status > 0
    assert 200 < on.sum() < 3800
    sane = on & (np.abs(expected.first) < 10).all(axis=1)  # spirals that OpenSim's adjustment drives away
    for name in ("first", "last", "length"):
        assert np.abs(found[name] - getattr(expected, name))[sane].max() < LENGTH_TOLERANCE, name


def test_an_end_on_the_axis_or_no_line_at_all_is_a_number_or_no_wrap():
    start = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.5, 0, 0], [0.3, 0, 0], [0.5, 0.1, 0.2]])
    end = np.array([[0.5, 0, 0], [0.5, 0, 0], [-0.5, 0, 0], [-0.3, 0, 0], [0.5, 0.1, -0.2]])
    for case in (*CYLINDERS, *SPHERES, *TORI):
        with np.errstate(divide="ignore", invalid="ignore"):  # NumPy's search over a torus divides by zero
            found, expected = of_case(case, start, end)
        np.testing.assert_array_equal(found["status"], expected.status)
        on = found["status"] > 0
        assert np.isfinite(found["length"][on]).all(), case

"""Scaling of models against OpenSim 4.6, as recorded, and what is refused."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from myowarp.apps.cli.motion.kinematics import Kinematics
from myowarp.apps.cli.motion.scale import FILES, Scale
from myowarp.motion.markers import Markers, write_trc
from myowarp.motion.scaling import read_setup, scale, window
from myowarp.osim.body.muscle_paths import muscle_paths
from myowarp.osim.body.scale_document import scale_document, scaled_inertia
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.kinematics import complete, forward
from myowarp.osim.document.read.element import parse, write
from myowarp.osim.document.read.model import Document, read_model, set_markers

DATA = Path(__file__).parents[1] / "data"
MODELS = ("arm26", "ellipsoids", "gait10dof18musc", "joints", "leg6dof9musc", "old")
SETUP = DATA / "osim/leg6dof9musc_scale.xml"
MASS = 50.0


@pytest.fixture(scope="module")
def recorded():
    """Return what OpenSim gave, by `<model>/<what>`."""
    with np.load(DATA / "opensim/scaling.npz") as arrays:
        return dict(arrays)


def document(name):
    path = DATA / f"osim/{name}.osim"
    return Document(path, parse(path)[0])


@pytest.fixture
def person(tmp_path, recorded):
    """Return the recording of a person who stands still."""
    markers = tuple(recorded["leg6dof9musc/markers"])
    still = Markers(markers, recorded["leg6dof9musc/time"], recorded["leg6dof9musc/seen"])
    write_trc(tmp_path / "static.trc", still)
    return tmp_path / "static.trc"


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("share", ["keep", "volume"])
def test_unequal_factors(recorded, tmp_path, name, share):
    """Masses, frames, moves, points, wrap surfaces and muscles are OpenSim's, also after writing."""
    there = {key.split("/", 1)[1]: value for key, value in recorded.items() if key.startswith(f"{name}/")}
    factors = dict(zip(there["bodies"], there["factors"], strict=True))
    write(tmp_path / "scaled.osim", scale_document(document(name), factors, MASS, share == "keep").root)
    model = read_model(tmp_path / "scaled.osim")
    bodies = [model.bodies[body] for body in there["bodies"]]
    ours = np.array([[body.mass, *body.mass_center, *body.inertia] for body in bodies])
    np.testing.assert_allclose(ours, there[f"{share}/inertia"], rtol=1e-9, atol=1e-12)
    free = tuple(there["free"])
    pose = complete(model, dict(zip(free, there["values"], strict=True)), 1)
    frames = forward(model, pose)
    np.testing.assert_allclose(
        [frames[body][1][0] for body in there["bodies"]], there["origins"], atol=1e-9, rtol=0
    )
    if len(there["muscles"]):
        bones = Bones(model, "cpu")
        assert bones.coordinates == free
        paths = muscle_paths(bones, there["values"][None], np.zeros((1, len(free))))
        found = [
            (model.muscles[m].optimal_fiber_length, model.muscles[m].tendon_slack_length, length)
            for m, length in zip(paths.muscles, paths.length[0], strict=True)
        ]
        np.testing.assert_allclose(found, there["lengths"][: len(found)], rtol=1e-6)
        assert list(paths.muscles) == list(there["muscles"])


def test_a_cylinder_that_grows():
    """Closed form: m r^2 / 2 about the axis, m (l^2 / 12 + r^2 / 4) across; a ball by the square."""
    m, r, length, s = 3.0, 0.05, 0.4, np.array([1.1, 1.3, 0.9])
    across = m * (length**2 / 12 + r**2 / 4)
    tensor = np.array([across, m * r**2 / 2, across, 0.0, 0.0, 0.0])
    radius = r**2 * s[0] * s[2]
    wanted = 2 * m * np.array([(length * s[1]) ** 2 / 12 + radius / 4, radius / 2])
    np.testing.assert_allclose(scaled_inertia(tensor, m, 2 * m, s)[:2], wanted, rtol=1e-12)
    np.testing.assert_allclose(scaled_inertia(tensor, m, m, np.full(3, 1.2)), 1.44 * tensor, rtol=1e-12)


def test_as_the_scale_tool(recorded, person):
    """Factors of a person, masses, and markers before and after they are placed."""
    there = {key.split("/", 1)[1]: v for key, v in recorded.items() if key.startswith("leg6dof9musc/")}
    setup = read_setup(SETUP)
    found = scale(setup.model, setup, person)
    model, names = found.document.model, there["markers"]
    assert found.unknown == ("wing_r",)
    factors = np.array([found.factors[body] for body in there["bodies"]])
    np.testing.assert_allclose(factors, there["tool/factors"], atol=6e-6)
    np.testing.assert_allclose(
        [model.bodies[body].mass for body in there["bodies"]], there["tool/mass"], rtol=1e-8
    )
    generic = read_model(setup.model)
    scaled = [generic.markers[m].location * found.factors[generic.markers[m].body] for m in names]
    np.testing.assert_allclose(scaled, there["tool/scaled"], atol=1e-9)
    placed = np.array([model.markers[m].location for m in names])
    assert np.linalg.norm(placed - there["exact/placed"], axis=1).max() < 1e-7
    assert np.linalg.norm(placed - there["tool/placed"], axis=1).max() < 2.5e-3, "ScaleTool stops early"
    assert np.linalg.norm(placed - scaled, axis=1).max() > 0.02
    fixed = parse(setup.model)[0]
    next(e for e in fixed.walk() if e.tag == "Marker" and e.name == "R.Heel").put("fixed", "true")
    write(person.with_name("fixed.osim"), fixed)
    again = scale(person.with_name("fixed.osim"), setup, person)
    heel = list(names).index("R.Heel")
    assert "R.Heel" not in again.moved
    np.testing.assert_allclose(again.document.model.markers["R.Heel"].location, scaled[heel], atol=1e-12)


def test_the_command(person, capsys):
    out = person.parent / "out"
    model = DATA / "osim/leg6dof9musc.osim"
    Scale(model, setup=SETUP, markers=person, output=out)()
    assert {path.name for path in out.iterdir()} == set(FILES)
    said = capsys.readouterr().err
    assert "not in the model, and left out: wing_r" in said
    assert "31.5 kg in 7 bodies" in said
    tasks = re.search("<IKTaskSet>.*</IKTaskSet>", SETUP.read_text(), re.DOTALL)
    (out / "tasks.xml").write_text(tasks[0])
    Kinematics(out / "scaled.osim", setup=out / "tasks.xml", markers=person, output=out / "ik")()
    assert "pelvis_tilt" in (out / "ik/ik.mot").read_text()
    with pytest.raises(ValueError, match="motion scale needs --setup FILE"):
        Scale(model, markers=person, output=out / "again")()


def test_markers_of_a_set(tmp_path):
    """One is replaced, one is added, also in a document of OpenSim 3; one on no body is refused."""
    text = "<MarkerSet><objects>{}</objects></MarkerSet>"
    marker = '<Marker name="{}"><body>{}</body><location>0.1 0.2 0.3</location></Marker>'
    path = tmp_path / "set.xml"
    for name in ("leg6dof9musc", "old"):
        before = document(name)
        body = next(iter(before.model.bodies))
        path.write_text(text.format(marker.format("R.Heel", body) + marker.format("NEW", "ground")))
        after = set_markers(before, parse(path)[0])
        write(tmp_path / "with.osim", after.root)
        markers = read_model(tmp_path / "with.osim").markers
        assert (markers["R.Heel"].body, markers["NEW"].body) == (body, "ground")
        np.testing.assert_array_equal(markers["R.Heel"].location, [0.1, 0.2, 0.3])
        assert set(markers) == set(before.model.markers) | {"R.Heel", "NEW"}
    path.write_text(text.format(marker.format("A", "nose")))
    with pytest.raises(ValueError, match="is on the body 'nose', which the model does not have"):
        set_markers(document("old"), parse(path)[0])


def test_frames_around_a_span():
    """From the last one not after the start to the first one not before the end, as OpenSim takes them."""
    markers = Markers(("A",), np.arange(5) / 10, np.zeros((5, 1, 3)))
    np.testing.assert_allclose(window(markers, (0.1, 0.15)).time, [0.1, 0.2])
    np.testing.assert_allclose(window(markers, (0.15, 9.0)).time, [0.1, 0.2, 0.3, 0.4])
    assert len(window(markers, (-np.inf, np.inf)).time) == 5
    with pytest.raises(ValueError, match="no frame between 7 and 8 s"):
        window(markers, (7.0, 8.0))
    with pytest.raises(ValueError, match="no frame between -5 and -2 s"):
        window(markers, (-5.0, -2.0))
    np.testing.assert_allclose(window(markers, (-1.0, -1.0)).time, [0.0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("<markers>R.ASIS L.ASIS", "<markers>R.ASIS NOSE"), "needs the marker 'NOSE', which the model"),
        (("<markers>R.ASIS L.ASIS", "<markers>R.ASIS"), "must name two markers, got 'R.ASIS'"),
        (("<markers>R.ASIS L.ASIS", "<markers>R.ASIS R.ASIS"), "must be apart in the model"),
        (("<axes>Y<", "<axes>Q<"), "must have axes of X Y Z, got 'Q'"),
        (("1.05 1.02 0.98", "1.05 -1 0.98"), "must have factors above 0"),
        (("measurements manual", "measurement manual"), "or manualScale, got 'measurement'"),
        (("ScaleTool", "OtherTool"), "holds no <ScaleTool>"),
        (("IKMarkerTask", "Task"), "has no <IKMarkerTask>"),
    ],
)  # fmt: skip
def test_bad_set_up_files_are_refused(person, change, message):
    text = SETUP.read_text()
    assert change[0] in text
    path = person.with_name("setup.xml")
    path.write_text(text.replace(*change))
    with pytest.raises(ValueError, match=message) as caught:
        scale(DATA / "osim/leg6dof9musc.osim", read_setup(path), person)
    assert "\n" not in str(caught.value)


def test_a_recording_in_another_unit_is_refused(person):
    """Its millimetres are called metres."""
    path = person.with_name("metres.trc")
    path.write_text(person.read_text().replace("\tmm\t", "\tm\t"))
    with pytest.raises(
        ValueError, match=r"'\w+' makes bodies .*e\+03 times as large, which must be 0\.1 to 10"
    ):
        scale(DATA / "osim/leg6dof9musc.osim", read_setup(SETUP), path)


def test_a_mass_in_grams_is_refused(person):
    setup = replace(read_setup(SETUP), mass=72600.0)
    message = r"^<mass> must be 0\.01 to 100 times the model's [0-9.]+ kg, got 72600 kg; write it in kg$"
    with pytest.raises(ValueError, match=message):
        scale(DATA / "osim/leg6dof9musc.osim", setup, person)


def test_a_recording_is_needed(person):
    path = person.with_name("setup.xml")
    path.write_text(SETUP.read_text().replace("<marker_file>static.trc</marker_file>", ""))
    with pytest.raises(ValueError, match="give --markers FILE"):
        scale(DATA / "osim/leg6dof9musc.osim", read_setup(path))


def test_markers_that_nothing_needs_are_refused(tmp_path, person):
    """Of a set-up that neither measures nor poses."""
    setup = tmp_path / "none.xml"
    setup.write_text("<ScaleTool><MarkerPlacer><apply>false</apply></MarkerPlacer></ScaleTool>")
    with pytest.raises(
        ValueError, match=r"--markers measure or pose a person; '.*none\.xml' has neither, so"
    ):
        Scale(DATA / "osim/arm26.osim", setup=setup, markers=person, output=tmp_path / "out")()

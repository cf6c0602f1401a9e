"""What studies report with: intervals, tables, claims, essays and figures."""

import string

import numpy as np
import pytest

from myowarp.apps.reports import panel, table
from myowarp.apps.reports.essay import sections
from myowarp.apps.reports.intervals import mean_interval, newcombe, student, wilson
from myowarp.apps.reports.result import POSITIVE, Merit, both, merits, read_claims, rises, stays
from myowarp.apps.studies.audit import figures
from myowarp.apps.studies.reproduce.catalog import EXPERIMENTS
from myowarp.apps.studies.reproduce.report import CLAIMS
from myowarp.inks import BLUE, INKS

# t that Student's distribution stays below with probability 0.975, from any printed table.
STUDENT = {1: 12.706, 2: 4.303, 4: 2.776, 9: 2.262, 30: 2.042}


@pytest.mark.parametrize(("degrees", "quantile"), STUDENT.items())
def test_students_interval_is_that_of_the_tables(degrees, quantile):
    values = np.random.default_rng(degrees).normal(size=(degrees + 1, 3))
    low, high = student(values)
    error = values.std(axis=0, ddof=1) / np.sqrt(degrees + 1)
    np.testing.assert_allclose((high - values.mean(axis=0)) / error, quantile, atol=5e-4)
    np.testing.assert_allclose(0.5 * (low + high), values.mean(axis=0), atol=1e-12)


def test_one_value_has_no_interval_and_equal_ones_have_an_empty_one():
    assert np.isnan(student([3.0])).all()
    assert student([3.0, 3.0]) == (3.0, 3.0)


def test_wilsons_interval_is_the_published_one():
    # Newcombe 1998, Statistics in Medicine 17:857, table I, method 3.
    np.testing.assert_allclose(wilson(81, 263), (0.2553, 0.3662), atol=5e-5)
    np.testing.assert_allclose(wilson(15, 148), (0.0624, 0.1605), atol=5e-5)
    np.testing.assert_allclose(wilson(0, 20), (0.0, 0.1611), atol=5e-5)
    np.testing.assert_allclose(wilson(1, 29), (0.0061, 0.1718), atol=5e-5)
    stats = pytest.importorskip("scipy.stats")
    for successes in (0, 7, 50):
        known = stats.binomtest(successes, 50).proportion_ci(method="wilson")
        np.testing.assert_allclose(wilson(successes, 50), known, atol=1e-12)


def test_newcombes_interval_is_the_published_one():
    # Newcombe 1998, Statistics in Medicine 17:873, table II, method 10; second minus first here.
    np.testing.assert_allclose(newcombe(48, 80, 56, 70), (0.0524, 0.3339), atol=5e-5)
    np.testing.assert_allclose(newcombe(3, 10, 9, 10), (0.1705, 0.8090), atol=5e-5)
    np.testing.assert_allclose(newcombe(0, 10, 10, 10), (0.6075, 1.0), atol=5e-5)


def test_merits_stand_beside_the_papers():
    numbers = (1.0, 2.5, 2.0, 4.0, np.nan)
    merit = Merit("x", "mm", "y", numbers, paper=2.0, spread=0.5)
    half = 3.182 * np.std(numbers[:4], ddof=1) / 2  # of a printed table, 3 degrees of freedom
    assert merit.interval == pytest.approx((2.375 - half, 2.375 + half), rel=1e-3)
    assert (merit.n, merit.difference, merit.label) == (4, pytest.approx(0.375), "x [mm]")
    assert merit.cells() == ("2 ± 0.5", "2.38 (0.386 to 4.36)", "0.375")
    assert Merit("x", "", "y", (1.0,)).cells() == ("-", "1", "-")
    rows = merits(("a", "b"), ("x", "", np.array([[1.0], [2.0]])), ("z", "°", np.array([[3.0], [4.0]])))
    assert [(m.condition, m.label, m.mean) for m in rows] == [
        ("a", "x", 1.0),
        ("a", "z [°]", 3.0),
        ("b", "x", 2.0),
        ("b", "z [°]", 4.0),
    ]


def test_a_mean_of_shares_has_an_interval_within_what_is_possible():
    """Student's where it stays there; else BCa, whose coverage of a skewed mean is near 95 %."""
    spread = (40.0, 50.0, 60.0)
    assert mean_interval(spread, 0.0, 100.0) == pytest.approx([float(end) for end in student(spread)])
    near = (100.0, 100.0, 99.0, 96.0, 100.0)
    assert student(near)[1] > 100.0
    low, high = mean_interval(near, 0.0, 100.0)
    assert min(near) <= low < np.mean(near) < high <= 100.0
    assert np.isnan(mean_interval((100.0, 100.0, 100.0), 0.0, 100.0)).all()
    assert np.isnan(mean_interval((3.0,))).all()
    stats = pytest.importorskip("scipy.stats")
    rng = np.random.default_rng(0)
    draws = stats.lognorm(1.0).rvs((60, 30), random_state=rng)
    ends = np.array([mean_interval(row, *POSITIVE) for row in draws])
    inside = (ends[:, 0] < np.exp(0.5)) & (np.exp(0.5) < ends[:, 1])
    assert 0.8 < inside.mean() <= 1.0


def test_a_difference_is_decided_by_its_interval():
    t = 2.776 / np.sqrt(5.0)  # of a printed table, 4 degrees of freedom, times the standard deviation
    values = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    half = t * values.std(ddof=1)
    assert rises(values + 1.01 * half) is True
    assert rises(values + 0.99 * half) is None
    assert rises(values - 1.01 * half) is False
    assert rises(np.full(4, 0.1)) is True
    assert rises(np.zeros(4)) is False
    assert rises([1.0]) is None
    assert stays(values, 1.01 * half) is True
    assert stays(values, 0.99 * half) is None
    assert stays(values + 5.0, 5.0 - 1.01 * half) is False
    assert (both(True, True), both(True, None), both(None, False)) == (True, None, False)


def test_claims_have_the_keys_of_their_essay():
    paper, own = "* a: First: it holds.\n  For a reason.\n* b, c: Second.", "* d: Third.\n* e: Fourth."
    found = read_claims(paper, own, {"b, c": np.bool_(False), "a": True, "d": None, "e": False})
    assert [claim.text for claim in found] == ["First: it holds.", "Second.", "Third.", "Fourth."]
    assert [claim.why for claim in found] == ["For a reason.", "", "", ""]
    assert [claim.own for claim in found] == [False, False, True, True]
    assert [claim.verdict for claim in found] == ["agrees", "differs", "not decided", "does not hold"]
    with pytest.raises(
        ValueError, match=r"must have the keys of the essay, \['a', 'b, c', 'd', 'e'\], got \['a'\]"
    ):
        read_claims(paper, own, {"a": True})


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_an_essay_has_all_sections(name):
    essay = EXPERIMENTS[name].essay
    title, *rest = essay
    assert (EXPERIMENTS[name].title, essay[title]) == (title, "")
    known = ["The paper", "Verdict", "Figure", *CLAIMS, "Where we differ, and why", "Protocol"]
    assert rest == [heading for heading in known if heading in essay]
    assert set(known) - set(rest) < set(CLAIMS)  # one of the two lists may be missing
    assert all(essay[heading] for heading in rest)
    assert "\n\n" not in essay["Verdict"]  # it becomes one line, in which a list could not be read
    for heading in ("The paper", "Protocol"):  # nothing is filled in there
        assert not [field for _, field, _, _ in string.Formatter().parse(essay[heading]) if field]


def test_the_audits_texts_are_those_of_its_columns():
    _, *heads = sections(figures.TEXTS)
    assert heads == [figure.head for figure in figures.FIGURES]


def test_a_table_is_written_and_read(tmp_path):
    table.save_csv(tmp_path / "table.csv", [{"x": 1.5, "who": "a"}, {"x": float("nan"), "more": 2}])
    assert (tmp_path / "table.csv").read_bytes() == b"x,who,more\n1.5,a,\nnan,,2\n"
    columns = table.read_numbers(tmp_path / "table.csv")
    assert list(columns) == ["x", "more"]
    np.testing.assert_array_equal(columns["x"], (1.5, np.nan))
    np.testing.assert_array_equal(columns["more"], (np.nan, 2.0))
    (tmp_path / "empty.csv").touch()
    assert table.read_numbers(tmp_path / "empty.csv") == {}
    assert table.markdown(("a", "b"), [("1", "2")]) == "| a | b |\n| --- | --- |\n| 1 | 2 |"


def test_marks_show_seeds_and_figures_have_no_date(tmp_path):
    pytest.importorskip("matplotlib")
    values = np.array([[1.0, 4.0], [3.0, 8.0], [2.0, 3.0]])  # (seeds, places)
    np.testing.assert_array_equal(panel.extent(values), ((1.0, 3.0), (2.0, 5.0), (3.0, 8.0)))
    np.testing.assert_array_equal(panel.quarters(values), ((1.5, 3.5), (2.0, 4.0), (2.5, 6.0)))
    with panel.style():
        figure = panel.blank(3.0, 2.0)
        axes = figure.subplots()
        panel.band(axes, (0.0, 1.0), panel.extent(values), color=BLUE)
        panel.bars(axes, np.arange(2), values, 0.5)
        line, dots = axes.lines
        np.testing.assert_array_equal(line.get_ydata(), (2.0, 5.0))
        np.testing.assert_array_equal(dots.get_ydata(), values.ravel())
        np.testing.assert_array_equal(dots.get_xdata(), (0.0, 1.0) * 3)
        assert [bar.get_height() for bar in axes.patches] == [2.0, 5.0]
        (edges,) = (path.vertices for path in axes.collections[0].get_paths())
        assert (edges[:, 1].min(), edges[:, 1].max()) == (1.0, 8.0)
        for form in ("pdf", "svg"):
            panel.save(figure, tmp_path / f"a.{form}")
            picture = (tmp_path / f"a.{form}").read_bytes()
            assert picture.startswith(b"%PDF" if form == "pdf" else b"<?xml")
            assert b"dc:date" not in picture
            assert b"CreationDate" not in picture


def test_inks_differ_for_eyes_without_a_kind_of_cones():
    """Red, green or blue ones: in CIELAB, where 2.3 is noticed, after Machado et al. 2009, full severity.

    doi:10.1109/TVCG.2009.113
    """
    red = [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    green = [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]]
    blue = [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]]
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    shown = np.array([[int(color[k : k + 2], 16) / 255 for k in (1, 3, 5)] for color in INKS])
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    for seen in (np.eye(3), np.array(red), np.array(green), np.array(blue)):
        xyz = np.clip(linear @ seen.T, 0.0, 1.0) @ np.array(to_xyz).T / (0.95047, 1.0, 1.08883)
        x, y, z = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116).T
        lab = np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)
        apart = np.linalg.norm(lab[:, None] - lab, axis=2)[np.triu_indices(len(INKS), 1)]
        assert apart.min() > 15.0

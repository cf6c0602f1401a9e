"""The page of a recorded motion: what is worst comes first, and is what the tables say."""

import re
from pathlib import Path

import numpy as np
import pytest

from myowarp.apps.cli.motion.dynamics import Dynamics
from myowarp.apps.cli.motion.report import Report
from myowarp.apps.cli.motion.steps import RENEWED
from myowarp.apps.reports import panel
from myowarp.apps.reports.motion import DRAWN, draw, floating, page
from myowarp.apps.reports.motion import PARTS as LIST
from myowarp.motion.storage import Storage, read_storage, write_storage
from myowarp.osim.document.read.model import read_model

OSIM = Path(__file__).parents[1] / "data/osim"
LEG, ARM = (OSIM / f"{name}.osim" for name in ("leg6dof9musc", "arm26"))
TIME = np.linspace(0.0, 1.0, 11)


def table(folder, file, **columns):
    values = np.stack([np.broadcast_to(column, TIME.shape) for column in columns.values()], axis=1)
    write_storage(folder / file, file, Storage(tuple(columns), TIME, values))


def named(text, title):
    """Return the names in the table of a section, in order."""
    return re.findall(r"<tr[^>]*><td>([\w.]+)</td>", text.split(f"<h2>{title}</h2>")[1].split("</table>")[0])


def test_the_worst_comes_first(tmp_path):
    """Bad markers, moments that nobody gives, and full muscles are found; the rest is below."""
    error = np.full(11, 0.010)
    error[3] = np.nan
    table(tmp_path, "marker_errors.sto", GOOD=error, BAD=0.025, WORST=0.050 + 0.001 * TIME)
    table(
        tmp_path,
        "missing.sto",
        knee_angle_r_moment=np.where(TIME > 0.75, -7.0, 0.0),
        hip_flexion_r_moment=0.0,
        pelvis_ty_force=287.0,  # a residual, which no muscle could hold
    )
    table(tmp_path, "activations.sto", soleus=np.where(TIME < 0.35, 1.0, 0.1), gastroc=0.2)
    table(tmp_path, "moments.sto", pelvis_ty_force=0.0 * TIME, knee_angle_r_moment=30 * TIME)
    text = page(tmp_path, read_model(LEG))
    assert "Muscles cannot hold 3 of 11 frames: knee_angle_r_moment lacks 7 N m at 0.8 s." in text
    assert "Fully active, in frames of 11: soleus (4)." in text
    assert "the worst is WORST: 50.5 mm, 51 mm at most." in text
    assert named(text, "Marker errors") == ["WORST", "BAD", "GOOD"]
    assert text.count("<tr class=bad>") == 2
    assert named(text, "What muscles cannot hold") == ["knee_angle_r_moment"]
    assert "<td>10</td><td>10</td><td>mm</td><td>0</td>" in text, "what was not seen does not count"
    heads = re.findall("<h2>(.*?)</h2>", text)
    assert heads[:2] == ["What muscles cannot hold", "Marker errors"]
    assert "http" not in text


def test_joint_reactions_are_in_the_report(tmp_path):
    """The size of each joint's force; weights are those of the model's masses."""
    leg = read_model(LEG)
    weight = 9.80665 * sum(body.mass for body in leg.bodies.values())
    force = {
        f"knee_r_on_tibia_r_in_ground_f{axis}": k * weight for axis, k in zip("xyz", (2, -3, 6), strict=True)
    }
    table(tmp_path, "joint_reactions.sto", **force, knee_r_on_tibia_r_in_ground_mx=1e6)
    text = page(tmp_path, leg)
    assert re.search(
        r"The greatest joint reaction is knee_r: \d+ N at 0 s, 7 times the weight of the model", text
    )
    assert named(text, "Joint reactions") == ["knee_r"]


def test_left_is_beside_right(tmp_path):
    """One panel for both, the limb of the worst first."""
    sides = Storage(("knee_angle_r", "hip_l", "knee_angle_l"), TIME, np.outer(np.ones(11), (1.0, 2.0, 3.0)))
    picture = draw(LIST[0], sides, "svg").decode()
    titles = re.findall(r">(knee_angle|hip|right|left|knee_angle_[rl])</text>", picture)
    assert sorted(titles) == ["hip", "knee_angle", "left", "right"]


def test_a_good_trial_is_not_red(tmp_path):
    table(tmp_path, "marker_errors.sto", A=0.005, B=0.004)
    table(tmp_path, "missing.sto", knee_angle_r_moment=1e-9)
    text = page(tmp_path, read_model(LEG))
    assert "Muscles and reserves hold all 11 frames." in text
    assert "class=bad" not in text
    assert "What muscles cannot hold" not in text


def test_residuals_are_those_of_a_floating_root(tmp_path):
    """A pelvis floats, a shoulder does not."""
    leg = read_model(LEG)
    root = floating(leg)
    assert root
    assert not floating(read_model(ARM))
    moments = {f"{name}_{'moment' if leg.coordinates[name].rotational else 'force'}": 1.0 for name in root}
    first = next(iter(moments))
    moments |= {first: 100.0 * TIME, "knee_angle_r_moment": 500.0}
    table(tmp_path, "moments.sto", **moments)
    text = page(tmp_path, leg)
    assert f"The greatest residual at the root is {first}: 100" in text
    assert named(text, "Residuals at the root")[0] == first
    assert named(text, "Joint moments") == ["knee_angle_r_moment"]


@pytest.mark.slow
def test_a_panel_for_each_column(tmp_path):
    """Pictures grow by rows up to the most that are drawn, and show what changes."""
    few, most = (
        Storage(tuple(f"c{k}" for k in range(n)), TIME, np.outer(TIME, np.arange(1, n + 1)))
        for n in (3, DRAWN + 9)
    )
    part = LIST[0]
    pictures = [draw(part, one, "svg").decode() for one in (few, most)]
    assert [len(re.findall(r">c\d+</text>", picture)) for picture in pictures] == [3, DRAWN]
    assert (
        pictures[0]
        != draw(part, Storage(few.labels, TIME, few.values + np.sin(9 * TIME)[:, None]), "svg").decode()
    )


def test_a_page_that_takes_long_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("myowarp.apps.reports.motion.PATIENCE", 0.0)
    table(tmp_path, "activations.sto", soleus=TIME, gastroc=0.2)
    table(tmp_path, "moments.sto", knee_angle_r_moment=30 * TIME)
    page(tmp_path, read_model(LEG))
    said = capsys.readouterr().err
    assert "Drawing: 0 of 2 tables so far" in said
    assert "2/2 tables" in said


def test_the_command(tmp_path):
    arm, motion = (Path(__file__).parents[2] / "examples" / name for name in ("arm.osim", "arm_bend.mot"))
    Dynamics(arm, motion=motion, filter=6.0, output=tmp_path / "out")()
    Report(arm, motion=motion, output=tmp_path / "out")()
    text = (tmp_path / "out/report.html").read_text()
    assert "<h2>Joint angles</h2>" in text
    assert "Residuals" not in text
    assert text.startswith(RENEWED["report.html"]), "so that a later step may write it again"
    peak = np.abs(read_storage(tmp_path / "out/moments.sto").values).max()
    assert f"<td>{peak:.3g}</td>" in text or f"<td>-{peak:.3g}</td>" in text
    (tmp_path / "out/report.html").write_text("mine")
    with pytest.raises(ValueError, match="exists; choose another folder"):
        Report(arm, output=tmp_path / "out")()
    with pytest.raises(ValueError, match="has no table of a motion; write one with"):
        Report(arm, output=tmp_path)()


def test_names_are_no_formulas(tmp_path):
    r"""A muscle called $\input{x}$ ended the page; a power of ten on an axis is one still."""
    table(tmp_path, "activations.sto", **{r"$\input{x}$": 0.5, "a $ b": 0.4, "time": 0.3, "a,b": 0.2})
    assert r"<td>$\input{x}$</td>" in page(tmp_path, read_model(LEG))
    assert read_storage(tmp_path / "activations.sto").labels[2] == "time"
    figure = panel.blank(3.0, 2.0)
    axes = figure.subplots()
    axes.set(title=r"$\input{x}$", yscale="log", ylim=(1.0, 1e4))
    panel.picture(figure, "svg")
    assert not axes.title.get_parse_math()
    assert axes.get_yticklabels()[1].get_parse_math()


def test_angles_of_another_file_are_in_degrees(tmp_path):
    """Joint angles in radians, as OpenSim's states are, were shown as degrees."""
    model = read_model(ARM)
    labels = tuple(f"/jointset/{model.coordinates[name].joint}/{name}/value" for name in model.coordinates)
    values = np.radians([[30.0, 60.0]] * len(TIME))
    write_storage(tmp_path / "states.sto", "states", Storage(labels, TIME, values))
    text = page(tmp_path, model, tmp_path / "states.sto")
    assert named(text, "Joint angles") == list(model.coordinates)[::-1]
    assert "<td>60</td><td>60</td><td>\u00b0</td>" in text

"""Inverse kinematics against MuJoCo's forward kinematics, brute force, another optimiser, closed forms."""

import mujoco
import mujoco.minimize
import numpy as np
import pytest
from often import often
from solve_reach_targets import reachable_targets

from myowarp.definitions.body import BODIES
from myowarp.models.reachability import reachable
from myowarp.tasks.reach_ids import HAND_CENTER, HAND_HIGH, HAND_LOW

FOUND = 1e-3  # m; a thousandth of the miss of a wrong chain, ten times what the iterations leave
EXCESS = 2e-3  # m above the true minimum after the default iterations, worst of the targets here
FINGER_BOX = (np.array([0.1, -0.1, 0.1]), np.array([0.27, 0.1, 0.3]))  # m; MyoSuite 2's random targets

TWO_LINKS = """
<mujoco><compiler angle="radian"/><worldbody><body pos=".1 .2 .3" euler="0 0 1"><body pos="0 .1 0">
  <joint name="first" axis="0 0 1" pos=".05 0 0" range="-1 1" ref=".25" limited="true"/>
  <joint name="second" axis="0 1 0" pos=".05 0 0" range="-.5 .5" ref="-.25"/>
  <geom size=".01"/>
  <body pos=".35 0 0" euler=".5 0 0"><site name="tip" pos="0 0 0"/></body></body></body>
</worldbody>{tied}</mujoco>
"""  # 0.3 m from the axes to the tip, both joints in one body, the tip on a welded one


TIED = '<equality><joint joint1="first" joint2="second"/></equality>'
KINDS = {
    "hinge without range": '<joint axis="0 0 1" pos="0 .02 0"/>',
    "slide": '<joint type="slide" axis="1 1 0" range="-.2 .1" ref=".05" limited="true"/>',
    "slide without range": '<joint type="slide" axis="0 1 1"/>',
    "ball": '<joint type="ball" pos="0 .02 0"/>',
    "ball in a cone": '<joint type="ball" range="0 1" limited="true"/>',
    "free": "<freejoint/>",
}
ARM = """
<mujoco><compiler angle="radian"/><worldbody><body pos=".1 .2 .3" euler="0 0 1">{joint}
  <geom size=".01"/><site name="near" pos="0 .1 .05"/><body pos=".15 0 0" euler=".5 0 0">
  <joint axis="0 1 0" range="-1 1" limited="true"/><geom size=".01"/><site name="far" pos=".2 0 .05"/>
</body></body></worldbody></mujoco>
"""


def full_model(body):
    return BODIES[body].build().compile(), BODIES[body].tips


def two_links(tied=""):
    return mujoco.MjModel.from_xml_string(TWO_LINKS.format(tied=tied))


def tips_of(model, tips, qpos):
    """Written anew, through mj_forward: the module under test is not its own witness."""
    data = mujoco.MjData(model)
    rows = []
    for row in qpos:
        data.qpos = row
        mujoco.mj_forward(model, data)
        rows.append(np.concatenate([data.site(tip).xpos for tip in tips]))
    return np.array(rows)


def bounded_minimum(model, tips, target, start):
    """Residual norm after MuJoCo's own box-constrained least squares from a start."""
    low, high = model.jnt_range.T

    def error(columns):
        return (tips_of(model, tips, columns.T) - target).T

    best, _ = mujoco.minimize.least_squares(start, error, bounds=(low, high), verbose=0)
    return np.linalg.norm(error(best[:, None]))


@pytest.mark.parametrize("body", ["finger", "hand"])
def test_finds_what_forward_kinematics_reaches(body):
    model, tips = full_model(body)
    low, high = model.jnt_range.T
    truth = np.random.default_rng(5).uniform(low, high, (200, model.nq))
    targets = tips_of(model, tips, truth)
    residual, qpos = reachable(model, tips, targets)
    assert np.mean(residual < FOUND) >= 0.99
    assert ((qpos >= low) & (qpos <= high)).all()
    attained = np.linalg.norm(tips_of(model, tips, qpos) - targets, axis=1)
    np.testing.assert_allclose(residual, attained, atol=1e-12)
    spread = np.linalg.norm(targets - tips_of(model, tips, [(low + high) / 2]), axis=1)
    assert np.median(spread) > 10 * FOUND  # the start alone would not pass


def test_residual_of_the_finger_is_the_distance_to_its_workspace():
    model, tips = full_model("finger")
    rng = np.random.default_rng(6)
    targets = rng.uniform(*FINGER_BOX, (40, 3))
    residual, _ = reachable(model, tips, targets)
    poses = rng.uniform(*model.jnt_range.T, (30_000, model.nq))
    cloud = tips_of(model, tips, poses)
    for target, found in zip(targets, residual, strict=True):
        distance = np.linalg.norm(cloud - target, axis=1)
        nearest = distance.argmin()
        assert found < distance[nearest] + 1e-6
        truth = bounded_minimum(model, tips, target, poses[nearest])
        assert found == pytest.approx(truth, abs=1e-4)
    assert np.mean(residual > 10 * 1e-4) > 0.3  # many of them are out of reach


@pytest.mark.slow
def test_residual_of_the_hand_is_the_bounded_minimum():
    model, tips = full_model("hand")
    low, high = model.jnt_range.T
    center = np.asarray(HAND_CENTER)
    targets = center + np.random.default_rng(7).uniform(HAND_LOW, HAND_HIGH, (12, 15))
    residual, qpos = reachable(model, tips, targets)
    for target, found, pose in zip(targets, residual, qpos, strict=True):
        for start in (pose, (low + high) / 2):
            assert found < bounded_minimum(model, tips, target, start) + EXCESS
    assert np.median(residual) > 5 * EXCESS


def test_offset_joints_of_one_body_have_a_closed_form():
    model = two_links()
    axes = tips_of(model, ("tip",), [model.qpos0])[0] - 0.3 * np.array([np.cos(1), np.sin(1), 0])
    angle = 1 - 0.25 - 0.8  # the body's turn, ref, and a joint angle within the range
    targets = [axes + length * np.array([np.cos(angle), np.sin(angle), 0]) for length in (0.3, 0.5, 0.1)]
    # The second joint's ref leaves it within [-0.5, 0.5] at -0.25: straight.
    residual, qpos = reachable(model, ("tip",), np.array(targets))
    np.testing.assert_allclose(residual, [0.0, 0.2, 0.2], atol=1e-6)
    np.testing.assert_allclose(qpos, [[-0.8, -0.25]] * 3, atol=1e-3)
    beyond = axes + 0.3 * np.array([np.cos(1.75 + 0.5), np.sin(1.75 + 0.5), 0])
    residual, qpos = reachable(model, ("tip",), beyond[None])  # half a radian past the range
    np.testing.assert_allclose(residual, 2 * 0.3 * np.sin(0.25), atol=1e-6)
    np.testing.assert_allclose(qpos[0, 0], 1.0)


@pytest.mark.parametrize("kind", often([*KINDS], ["slide", "slide without range", "ball in a cone"]))
def test_every_kind_of_joint_is_solved_for(kind):
    """Poses are found again that MuJoCo makes of random velocities, which know each kind of joint."""
    model, tips = mujoco.MjModel.from_xml_string(ARM.format(joint=KINDS[kind])), ("near", "far")
    rng = np.random.default_rng(9)
    truth = np.tile(model.qpos0, (50, 1))
    for row in truth:
        size = 0.15 if kind.startswith("slide") else 0.45  # within cone and ranges, after all
        mujoco.mj_integratePos(model, row, rng.uniform(-size, size, model.nv), 1.0)
    limited = np.flatnonzero(model.jnt_limited & (model.jnt_type >= mujoco.mjtJoint.mjJNT_SLIDE.value))
    columns, (low, high) = model.jnt_qposadr[limited], model.jnt_range[limited].T
    truth[:, columns] = truth[:, columns].clip(low, high)
    targets = tips_of(model, tips, truth)
    residual, qpos = reachable(model, tips, targets)
    assert residual.max() < FOUND
    np.testing.assert_allclose(
        residual, np.linalg.norm(tips_of(model, tips, qpos) - targets, axis=1), atol=1e-9
    )
    assert ((qpos[:, columns] >= low) & (qpos[:, columns] <= high)).all()
    assert np.median(np.linalg.norm(targets - tips_of(model, tips, [model.qpos0]), axis=1)) > 10 * FOUND


@pytest.mark.slow
def test_ranges_of_slides_and_cones_of_balls_hold():
    """Targets half a metre past a slide's end, half a radian past a cone's edge, wider than a body."""
    world = '<mujoco><compiler angle="radian"/><worldbody>{}</worldbody></mujoco>'
    body = world.format('<body>{}<geom size=".01"/>{}</body>')
    tip = '<site name="tip" pos=".3 0 0"/>'
    slide = body.format('<joint type="slide" axis="1 0 0" range="-.2 .1" limited="true"/>', tip)
    ball = body.format('<joint type="ball" range="0 1" limited="true"/>', tip)
    turned = 0.3 * np.array((np.cos(1.5), np.sin(1.5), 0.0))
    free = body.format("<freejoint/>", tip + '<site name="other" pos="-.3 0 0"/>')
    both = body.format(
        '<joint type="slide" axis="1 0 0" range="-.1 .1" limited="true"/><joint axis="0 0 1"/>', tip
    )
    for text, tips, target, expected in (
        (both, ("tip",), (0.6, 0.2, 0.0), np.hypot(0.5, 0.2) - 0.3),  # the hinge turns towards the target
        (slide, ("tip",), (0.9, 0.0, 0.0), 0.5),
        (ball, ("tip",), turned, 2 * 0.3 * np.sin(0.25)),
        (free, ("tip", "other"), (3.0, 1.0, 0.0, 3.0, 2.0, 0.0), 0.4 / np.sqrt(2.0)),
    ):
        model = mujoco.MjModel.from_xml_string(text)
        residual, _ = reachable(model, tips, np.array([target]))
        np.testing.assert_allclose(residual, expected, atol=1e-5)


def test_answers_do_not_depend_on_the_batch():
    model, tips = full_model("finger")
    targets = np.random.default_rng(8).uniform(*FINGER_BOX, (600, 3))
    together, _ = reachable(model, tips, targets)
    alone, _ = reachable(model, tips, targets[[0, 599]])
    np.testing.assert_array_equal(together[[0, 599]], alone)


@pytest.mark.slow
def test_drawn_targets_are_reachable_and_fill_the_box():
    model, tips = full_model("finger")
    center, zero = np.array([0.185, 0.0, 0.2]), np.zeros(3)
    low, high = FINGER_BOX[0] - center, FINGER_BOX[1] - center
    targets = reachable_targets(model, tips, center, low, high, 1e-3, 300)
    assert ((targets >= FINGER_BOX[0]) & (targets <= FINGER_BOX[1])).all()
    assert (reachable(model, tips, targets)[0] <= 1e-3).all()
    plain = np.random.default_rng((0, 0)).uniform(low, high, (300, 3)) + center
    kept = (targets == plain).all(axis=1)
    rejected = reachable(model, tips, plain[~kept])[0] > 1e-3
    assert 0.3 < kept.mean() < 0.5  # 41 % of the box is within reach
    assert rejected.mean() > 0.98
    fewer = reachable_targets(model, tips, center, low, high, 1e-3, 40)
    np.testing.assert_array_equal(fewer, targets[:40])
    with pytest.raises(ValueError, match="3 of 3 targets met no point"):
        reachable_targets(model, tips, center + 1.0, zero, zero, 1e-3, 3)


@pytest.mark.parametrize(
    ("model", "tip", "targets", "error", "message"),
    [
        (two_links(), "top", np.zeros((1, 3)), ValueError, "site 'top' unknown"),
        (two_links(), "tip", np.zeros((1, 6)), ValueError, r"shape \(num_targets, 3\)"),
        (two_links(), "tip", np.full((1, 3), np.nan), ValueError, "finite"),
        (two_links(tied=TIED), "tip", np.zeros((1, 3)), NotImplementedError, "constraint couples joints"),
    ],
)
def test_refusals_say_why(model, tip, targets, error, message):
    with pytest.raises(error, match=message):
        reachable(model, (tip,), targets)

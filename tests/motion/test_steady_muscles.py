"""Muscles held steady on the device against the NumPy laws, which are OpenSim's to 1e-8."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import opensim_muscles
import pytest

from myowarp.motion.metabolic_power import metabolic_power
from myowarp.motion.muscle_forces import muscle_forces, rigid_capacity
from myowarp.motion.storage import read_storage
from myowarp.osim.body.hill_curves import SPLINES
from myowarp.osim.body.hill_muscle import HillMuscle, known
from myowarp.osim.body.muscle_paths import muscle_paths
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.body.steady_muscles import SteadyMuscles
from myowarp.osim.document.read.model import read_model
from myowarp.osim.document.read.muscle_defaults import DEFAULTS

DATA = Path(__file__).parents[1] / "data"
TABLES = 5e-6
"""Share of the maximum isometric force: Millard's curves are tables on the device."""


@pytest.mark.parametrize("name", ["variants", "arm26"])
def test_the_same_as_in_numpy(name):
    """Elastic and rigid tendons, slack ones, and fibers at their shortest; each frame has its own factor."""
    muscles = opensim_muscles.load(name)[1]
    splines = "Delp1990Muscle_Deprecated"
    muscles.append(replace(muscles[0], name="splines", kind=splines, functions=SPLINES[splines]))
    steady, random = SteadyMuscles(muscles), np.random.default_rng(1)
    values = [muscle.values for muscle in steady.muscles]
    optimal, slack = (
        np.array([v[n] for v in values]) for n in ("optimal_fiber_length", "tendon_slack_length")
    )
    shape = (33, len(values))
    length = slack + optimal * random.uniform(0.2, 1.5, shape)
    velocity = optimal * random.uniform(-6.0, 6.0, shape)
    activation, factor = random.uniform(0.0, 1.0, shape), random.uniform(0.95, 1.05, shape)
    force, along, _ = steady.at(activation, length, velocity, factor)
    bare, *_ = steady.at(activation, length, velocity)
    for k, muscle in enumerate(steady.muscles):
        own = factor[:, k] * slack[k]
        z, wanted = muscle.steady(activation[:, k], length[:, k], velocity[:, k], own)
        most = muscle.values["max_isometric_force"]
        np.testing.assert_allclose(force[:, k] / most, wanted, atol=TABLES, err_msg=muscle.name)
        np.testing.assert_allclose(along[:, k], z, atol=1e-5 * optimal[k], err_msg=muscle.name)
    strength = np.array([v["max_isometric_force"] for v in values])
    assert (np.abs(force - bare) / strength).max() > 100 * TABLES, "the slack length matters"


@pytest.mark.parametrize("mode", ["equilibrium", "opensim"])
def test_metabolic_power(mode):
    """Against Bhargava's equations in NumPy, at fibers that the equilibrium itself is solved for here."""
    model = read_model(DATA / "osim/arm26.osim")
    coordinates, random = tuple(model.coordinates), np.random.default_rng(4)
    values = 0.8 + random.uniform(-0.5, 0.5, (9, 2))
    paths = muscle_paths(Bones(model, "cpu"), values, 2.0 * random.normal(size=(9, 2)))
    found = muscle_forces(model, coordinates, paths, 6.0 * random.normal(size=(9, 2)), mode=mode)
    power = metabolic_power(model, found, paths)
    for k, name in enumerate(found.muscles):
        muscle = HillMuscle.of(model.muscles[name])
        v, a, path = muscle.values, found.activation[:, k], paths.velocity[:, k]
        z = np.maximum(paths.length[:, k] - v["tendon_slack_length"], muscle.shortest_fiber)
        if mode == "equilibrium":
            slack = np.full(9, v["tendon_slack_length"])
            z, _ = muscle.steady(a, paths.length[:, k], path, slack)
        length = np.hypot(z, muscle.fiber_width)
        velocity, norm = path * z / length, length / v["optimal_fiber_length"]
        active = v["max_isometric_force"] * a * muscle.curves.active_force_length(norm)[0]
        active *= muscle.curves.force_velocity(
            velocity / muscle.velocity_scale, np.where(mode == "opensim", 1, a)
        )[0]
        active = np.maximum(active, 0.0)
        total = active
        if mode == "equilibrium":
            total = active + v["max_isometric_force"] * muscle.curves.passive_force(norm)[0]
        mass = v["max_isometric_force"] / 0.25e6 * 1059.7 * v["optimal_fiber_length"]
        slow, fast = 0.5 * np.sin(np.pi / 2 * a), 0.5 * (1.0 - np.cos(np.pi / 2 * a))
        share = np.interp(norm, [0.5, 1.0, 1.5], [0.5, 1.0, 0.0])
        heat = mass * (40 * slow + 133 * fast + share * (74 * slow + 111 * fast))
        heat = heat + 0.25 * total * np.maximum(-velocity, 0.0)
        work = -active * velocity
        heat = np.maximum(heat - np.minimum(heat + work, 0.0), mass)
        held = z > muscle.shortest_fiber
        np.testing.assert_allclose(power[held, k], (heat + work)[held], rtol=0.02, atol=0.02, err_msg=name)
    assert power.max() > 5.0, "W"


def test_forces_are_those_of_their_activations():
    """By the NumPy law, where muscles shorten so fast that they have no force up to an activation above 0."""
    model = read_model(DATA / "osim/arm26.osim")
    coordinates, random = tuple(model.coordinates), np.random.default_rng(5)
    values, speeds = 0.8 + random.uniform(-0.5, 0.5, (40, 2)), random.uniform(-9.0, -3.0, (40, 2))
    paths = muscle_paths(Bones(model, "cpu"), values, speeds)
    moment = random.uniform(-1.0, -0.2, (40, 2))
    found = muscle_forces(model, coordinates, paths, moment, reserves=dict.fromkeys(coordinates, 1.0))
    for k, name in enumerate(found.muscles):
        muscle = HillMuscle.of(model.muscles[name])
        slack = np.full(40, muscle.values["tendon_slack_length"])
        _, wanted = muscle.steady(found.activation[:, k], paths.length[:, k], paths.velocity[:, k], slack)
        share = found.force[:, k] / muscle.values["max_isometric_force"]
        np.testing.assert_allclose(share, wanted, atol=1e-3, err_msg=name)
    assert found.force.max() > 100.0, "N"


def test_reserves_do_not_take_the_place_of_muscles_that_shorten(run, tmp_path):
    """The triceps of the example hold the arm on its way back."""
    examples = DATA.parents[1] / "examples"
    motion = ("--motion", examples / "arm_bend.mot", "--filter", 6, "--reserve", 1)
    status, _, said = run("motion", "forces", examples / "arm.osim", *motion, "-o", tmp_path)
    assert status == 0, said
    moments, reserves = (read_storage(tmp_path / f"{name}.sto") for name in ("moments", "reserves"))
    assert np.abs(reserves.values).max() < 0.01 * np.abs(moments.values).max()


RIGID = {
    "Thelen2003Muscle": 877.5825618903726,
    "Millard2012EquilibriumMuscle": 998.8500946234824,
    "Millard2012AccelerationMuscle": 877.5825618903723,
    "DeGrooteFregly2016Muscle": 999.9999999999998,
}
"""What OpenSim 4.6's `calcInextensibleTendonActiveFiberForce` says of 1000 N, optimal length 0.1 m, pennation
0.5 rad, at optimal length, activation 1 and no speed [N]: some classes count the cosine of the pennation."""
TOP = 2e-3
"""Share by which OpenSim lowers the top of Millard's curve, when it sets its least value to 0."""


@pytest.mark.parametrize("kind", RIGID)
def test_rigid_capacity_is_that_of_opensims_class(kind):
    stated = {
        **{"max_isometric_force": 1000.0, "optimal_fiber_length": 0.1, "tendon_slack_length": 0.2},
        **{"pennation_angle_at_optimal": 0.5, "max_contraction_velocity": 10.0},
        **{"ignore_tendon_compliance": 0.0, "ignore_activation_dynamics": 0.0},
    }
    muscle = HillMuscle("m", kind, {**DEFAULTS[kind], **stated}, SPLINES.get(kind, {}))
    found = rigid_capacity(known(muscle)[0], np.array([0.2 + 0.1 * np.cos(0.5)]), np.zeros(1))
    np.testing.assert_allclose(found, RIGID[kind], rtol=TOP)

"""Record muscles of OpenSim: parameters, lengths, static tendon forces, fiber velocities.

    python tests/data/record_opensim_muscles.py MODEL.osim... -o tests/data/opensim

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. Every model gives
`muscles_<model>.npz`; `muscles_variants.npz` holds single muscles of every class with unusual parameters.
Poses are random and independent per coordinate, over the full ranges. See README.md for the arrays.
"""

import argparse
import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import opensim

ACTIVATIONS = (0.01, 0.05, 0.25, 0.5, 0.75, 1.0)
NUM_STATIC = 12
NUM_LENGTHS = 200
WIDE = 20.0  # rad or m: nobody set such a range


def parameters(muscle):
    """Return every number of a muscle, with all digits; switches are 0 or 1. Curves are left out."""
    values = {}

    def walk(element, prefix):
        for child in element:
            if child.tag in ("GeometryPath", "components", "appliesForce"):
                continue
            text = (child.text or "").strip()
            if len(child):
                walk(child, f"{prefix}{child.tag}.")
            elif text in ("true", "false"):
                values[prefix + child.tag] = float(text == "true")
            elif text and text not in ("explicit", "implicit") and len(text.split()) == 1:
                values[prefix + child.tag] = float(text)

    walk(ElementTree.fromstring(muscle.dump()), "")
    return values


def poses(model, state, count, seed=0):
    """Set one random pose after the other."""
    rng = np.random.default_rng(seed)
    coordinates, constraints = model.getCoordinateSet(), model.getConstraintSet()
    free = [c for c in map(coordinates.get, range(coordinates.getSize())) if not c.isConstrained(state)]
    couplers = [
        coupler
        for i in range(constraints.getSize())
        if (coupler := opensim.CoordinateCouplerConstraint.safeDownCast(constraints.get(i))) is not None
    ]
    for _ in range(count):
        for coordinate in free:
            low, high = coordinate.getRangeMin(), coordinate.getRangeMax()
            low, high = (low, high) if high - low < WIDE else (-1.0, 1.0)
            coordinate.setValue(state, rng.uniform(low, high), False)
        for coupler in couplers:
            source = coordinates.get(coupler.getIndependentCoordinateNames().get(0))
            value = coupler.getFunction().calcValue(opensim.Vector(1, source.getValue(state)))
            coordinates.get(coupler.getDependentCoordinateName()).setValue(state, value, False)
        model.realizeVelocity(state)
        yield


def static(model, state, muscles):
    """Return forces of tendons, and velocities of fibers over the greatest: 0 but where OpenSim gives up.

    Both are (activations, muscles), NaN where OpenSim says that it finds no equilibrium.
    """
    force, velocity = np.full((2, len(ACTIVATIONS), len(muscles)), np.nan)
    for i, activation in enumerate(ACTIVATIONS):
        for muscle in muscles:
            muscle.setActivation(state, activation)
        model.realizeVelocity(state)
        found = []
        for j, muscle in enumerate(muscles):
            try:
                muscle.computeEquilibrium(state)
                found.append(j)
            except RuntimeError:
                continue
        model.realizeDynamics(state)
        force[i, found] = [muscles[j].getTendonForce(state) for j in found]
        velocity[i, found] = [muscles[j].getNormalizedFiberVelocity(state) for j in found]
    return force, velocity


def record(model, path, name):
    """Record the muscles of a model in random poses."""
    state = model.initSystem()
    muscles = [model.getMuscles().get(i) for i in range(model.getMuscles().getSize())]
    lengths, forces = [], []
    for i, _ in enumerate(poses(model, state, NUM_LENGTHS)):
        lengths.append([muscle.getLength(state) for muscle in muscles])
        if i < NUM_STATIC:
            forces.append(static(model, state, muscles)[0])
    meta = {
        "model": name,
        "credits": model.get_credits(),
        "publications": model.get_publications(),
        "opensim": opensim.GetVersion(),
        "names": [muscle.getName() for muscle in muscles],
        "classes": [muscle.getConcreteClassName() for muscle in muscles],
        "parameters": [parameters(muscle) for muscle in muscles],
    }
    np.savez_compressed(
        path,
        meta=json.dumps(meta),
        length=np.array(lengths[:NUM_STATIC]),
        activation=np.array(ACTIVATIONS),
        tendon_force=np.array(forces),
        pose_length=np.array(lengths, np.float32),
    )


def variants():
    """Yield single muscles with parameters that models rarely have."""

    def thelen(**values):
        return opensim.Thelen2003Muscle(), values

    def millard(**values):
        return opensim.Millard2012EquilibriumMuscle(), values

    def de_groote(**values):
        return opensim.DeGrooteFregly2016Muscle(), values

    yield thelen(pennation_angle_at_optimal=0.5, FmaxTendonStrain=0.08)
    yield thelen(Af=0.35, Flen=1.7, KshapeActive=0.6, KshapePassive=3.0, FmaxMuscleStrain=0.8)
    yield millard(pennation_angle_at_optimal=0.3)
    yield millard(fiber_damping=0.0, pennation_angle_at_optimal=0.3)
    yield millard(ignore_tendon_compliance=True, pennation_angle_at_optimal=0.2)
    muscle, values = millard()
    muscle.upd_FiberForceLengthCurve().setOptionalProperties(0.3, 4.0, 0.6)
    muscle.upd_FiberForceLengthCurve().set_strain_at_zero_force(-0.3)
    muscle.upd_TendonForceLengthCurve().setOptionalProperties(40.0, 0.5, 0.7)
    yield muscle, values
    yield de_groote()
    yield de_groote(
        pennation_angle_at_optimal=0.4, active_force_width_scale=1.3, tendon_strain_at_one_norm_force=0.08
    )
    yield de_groote(ignore_tendon_compliance=True, passive_fiber_strain_at_one_norm_force=0.5)


def variant_model():
    """Return a model in which every variant pulls a block along one slide."""
    model = opensim.Model()
    block = opensim.Body("block", 1.0, opensim.Vec3(0), opensim.Inertia(1))
    model.addBody(block)
    joint = opensim.SliderJoint("slide", model.getGround(), block)
    joint.updCoordinate().setRangeMin(0.15)
    joint.updCoordinate().setRangeMax(0.4)
    model.addJoint(joint)
    for i, (muscle, values) in enumerate(variants()):
        for name, value in values.items():
            getattr(muscle, f"set_{name}")(value)
        muscle.setName(f"variant{i}")
        muscle.addNewPathPoint("origin", model.getGround(), opensim.Vec3(0))
        muscle.addNewPathPoint("insertion", block, opensim.Vec3(0))
        model.addForce(muscle)
    model.finalizeConnections()
    return model


def moving(model, path):
    """Record velocities of the fibers of elastic muscles at random lengths, strains and activations."""
    state = model.initSystem()
    coordinate = model.getCoordinateSet().get(0)
    muscles = [model.getMuscles().get(i) for i in range(model.getMuscles().getSize())]
    rows = []
    rng = np.random.default_rng(1)
    for index, muscle in enumerate(muscles):
        if muscle.get_ignore_tendon_compliance():
            continue
        for _ in range(60):
            activation, strain, norm_length = rng.uniform((0.05, 0.005, 0.7), (1.0, 0.045, 1.4))
            fiber = norm_length * muscle.getOptimalFiberLength()
            width = muscle.getOptimalFiberLength() * np.sin(muscle.get_pennation_angle_at_optimal())
            along = np.sqrt(fiber**2 - width**2)
            length = along + muscle.getTendonSlackLength() * (1.0 + strain)
            coordinate.setValue(state, length)
            muscle.setActivation(state, activation)
            degroote = opensim.DeGrooteFregly2016Muscle.safeDownCast(muscle)
            if degroote is not None:
                k = np.log(1.2 / 0.2) / degroote.get_tendon_strain_at_one_norm_force()
                degroote.setNormalizedTendonForce(state, 0.2 * (np.exp(k * strain) - 1.0))
            else:
                muscle.setStateVariableValue(state, muscle.getStateVariableNames().get(1), fiber)
            model.realizeDynamics(state)
            rows.append(
                [
                    index,
                    activation,
                    muscle.getLength(state),
                    muscle.getFiberLength(state),
                    muscle.getFiberVelocity(state),
                    muscle.getActiveForceLengthMultiplier(state),
                    muscle.getPassiveForceMultiplier(state),
                    muscle.getForceVelocityMultiplier(state),
                    muscle.getTendonForce(state),
                ]
            )
    np.savez_compressed(path, state=np.array(rows))


def main():
    """Record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", nargs="+", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    opensim.Logger.setLevelString("Off")
    for source in arguments.models:
        record(opensim.Model(str(source)), arguments.output / f"muscles_{source.stem}.npz", source.stem)
    record(variant_model(), arguments.output / "muscles_variants.npz", "variants")
    moving(variant_model(), arguments.output / "muscles_moving.npz")


if __name__ == "__main__":
    main()

"""Record a mass that hangs from one muscle, as OpenSim 4.6 integrates it to 1e-6.

    python tests/data/record_opensim_bench.py -o tests/data/opensim/bench.npz

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. The scene is that of
OpenSim's own testMuscles.cpp, hung up so that the muscle stays within its working range: a mass of 5 kg on a
slider along x, gravity 9.81 m/s^2 along x, a muscle of 100 N, 0.1 m fibers and 0.2 m tendon from the origin
to the mass. It starts with activation 0.6, where the muscle carries the mass or at 0.33 m; the excitation is
0.6, from 0.05 s on 0.9, from 0.2 s on 0.4.

`ball` and `sine` are the bench of testMuscles.cpp: nothing but the muscle acts on a ball of 10 kg, which
begins at rest at 0.28 m and is watched until fibers are slack, or the path is 0.31 m - 0.03 m cos(2 pi t);
the activation begins at 0.2 and the excitation is 0.5. There the time constant of deactivation is 0.4 s, here
0.04, since OpenSim's De Groote muscles all have the time constants of the first one in a process.
"""

import argparse
from itertools import product
from pathlib import Path

import numpy as np
import opensim

CLASSES = {
    "thelen2003": opensim.Thelen2003Muscle,
    "millard2012": opensim.Millard2012EquilibriumMuscle,
    "degroote_fregly2016": opensim.DeGrooteFregly2016Muscle,
}
PENNATIONS = (0.0, np.pi / 4)
MASS, FORCE, FIBER, TENDON, START = 5.0, 100.0, 0.1, 0.2, 0.6
RISE, FALL = 0.01, 0.04
CONTROL = ((0.0, 0.6), (0.05, 0.9), (0.2, 0.4))
END, EVERY = 0.5, 0.01
BALL, AT, SWING, ACTIVATION, EXCITATION, SLACK = 10.0, 0.28, 0.03, 0.2, 0.5, 0.2


def built(kind, pennation, rigid, scene="hanging"):
    """Return the model, its muscle and its coordinate."""
    hangs = scene == "hanging"
    model = opensim.Model()
    model.setGravity(opensim.Vec3(9.81 if hangs else 0, 0, 0))
    body = opensim.Body("mass", MASS if hangs else BALL, opensim.Vec3(0), opensim.Inertia(1))
    joint = opensim.SliderJoint("slider", model.getGround(), body)
    coordinate = joint.updCoordinate()
    coordinate.setName("x")
    if scene == "sine":
        coordinate.setPrescribedFunction(opensim.Sine(SWING, 2 * np.pi, -np.pi / 2, AT + SWING))
        coordinate.setDefaultIsPrescribed(True)
    model.addBody(body)
    model.addJoint(joint)
    muscle = CLASSES[kind]()
    muscle.setName("muscle")
    muscle.set_max_isometric_force(FORCE)
    muscle.set_optimal_fiber_length(FIBER)
    muscle.set_tendon_slack_length(TENDON)
    muscle.set_pennation_angle_at_optimal(pennation)
    muscle.set_ignore_tendon_compliance(rigid)
    muscle.set_activation_time_constant(RISE)
    muscle.set_deactivation_time_constant(FALL)
    muscle.addNewPathPoint("origin", model.getGround(), opensim.Vec3(0))
    muscle.addNewPathPoint("insertion", body, opensim.Vec3(0))
    model.addForce(muscle)
    control = opensim.PrescribedController()
    control.addActuator(muscle)
    function = opensim.PiecewiseConstantFunction()
    for time, value in CONTROL if hangs else ((0.0, EXCITATION),):
        function.addPoint(time, value)
    control.prescribeControlForActuator("muscle", function)
    model.addController(control)
    return model, muscle, joint.updCoordinate()


def balance(model, muscle, coordinate, state):
    """Put the mass where the muscle carries it at rest."""
    muscle.setActivation(state, START)
    low, high = TENDON + 0.3 * FIBER, TENDON + 1.3 * FIBER
    for _ in range(60):
        middle = 0.5 * (low + high)
        coordinate.setValue(state, middle)
        coordinate.setSpeedValue(state, 0.0)
        model.equilibrateMuscles(state)
        model.realizeDynamics(state)
        low, high = (middle, high) if muscle.getTendonForce(state) < MASS * 9.81 else (low, middle)


def recorded(kind, pennation, rigid, scene):
    """Return positions, velocities and tendon forces over time."""
    model, muscle, coordinate = built(kind, pennation, rigid, scene)
    state = model.initSystem()
    if scene == "hanging":
        balance(model, muscle, coordinate, state)
    else:
        muscle.setActivation(state, ACTIVATION)
        if scene == "ball":
            coordinate.setValue(state, AT)
        model.realizeVelocity(state)
        model.equilibrateMuscles(state)
    manager = opensim.Manager(model)
    manager.setIntegratorAccuracy(1e-6)
    manager.setIntegratorMaximumStepSize(1e-3)
    manager.initialize(state)
    rows = []
    for k in range(round((SLACK if scene == "ball" else END) / EVERY) + 1):
        if k:
            state = manager.integrate(k * EVERY)
        model.realizeDynamics(state)
        row = coordinate.getValue(state), coordinate.getSpeedValue(state), muscle.getTendonForce(state)
        rows.append(row)
    return np.array(rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    opensim.Logger.setLevelString("Off")
    arrays = {}
    cases = product(("hanging", "ball", "sine"), CLASSES, enumerate(PENNATIONS), (False, True))
    for scene, kind, (i, pennation), rigid in cases:
        name = f"{scene} {kind}{'_rigid' if rigid else ''} {i}"
        try:
            arrays[name] = recorded(kind, pennation, rigid, scene)
        except RuntimeError as error:  # OpenSim's own failure is a fact to be seen
            print(name, str(error)[:200])
            continue
        x = arrays[name][:, 0]
        print(name, x[0], x.min(), x.max(), arrays[name][:, 2].max())
    np.savez_compressed(parser.parse_args().output, **arrays)

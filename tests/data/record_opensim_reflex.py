"""Record how arm26 swings in OpenSim with and without a stretch reflex, ToyReflexController.

    python tests/data/record_opensim_reflex.py -o tests/data/opensim/reflex.npz

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. The arm begins at
`START` with `SPEED`, all muscles excited by `EXCITATION` and in equilibrium; every 10 ms over 0.3 s: `values`
of both coordinates [rad] and `excitation` of all muscles, shape (gains, samples, ...), one row for each of
`gains`; `fibers` are the lengths of fibers at the start [m].
"""

import argparse
from pathlib import Path

import numpy as np
import opensim

ARM = Path(__file__).parent / "osim/arm26.osim"
COORDINATES = ("r_shoulder_elev", "r_elbow_flex")
START, SPEED = (0.2, 1.0), (2.0, -9.0)  # rad, rad/s
EXCITATION = 0.05
GAINS = (0.0, 0.8)
EVERY, SAMPLES = 0.01, 31


def arm(gain):
    """Return the arm with a reflex of a gain: the model, its muscles, a manager, the state."""
    model = opensim.Model(str(ARM))
    muscles = [model.getMuscles().get(k) for k in range(model.getMuscles().getSize())]
    controller = opensim.PrescribedController()
    for muscle in muscles:
        controller.addActuator(muscle)
        controller.prescribeControlForActuator(muscle.getName(), opensim.Constant(EXCITATION))
    model.addController(controller)
    if gain:
        reflex = opensim.ToyReflexController(gain)
        for muscle in muscles:
            reflex.addActuator(muscle)
        model.addController(reflex)
    state = model.initSystem()
    for name, value, speed in zip(COORDINATES, START, SPEED, strict=True):
        model.getCoordinateSet().get(name).setValue(state, value, False)
        model.getCoordinateSet().get(name).setSpeedValue(state, speed)
    for muscle in muscles:
        muscle.setActivation(state, EXCITATION)
    model.equilibrateMuscles(state)
    manager = opensim.Manager(model)
    manager.setIntegratorAccuracy(1e-7)
    manager.initialize(state)
    return model, muscles, manager, state


def swing(gain):
    """Return coordinates and excitations over time."""
    model, _muscles, manager, state = arm(gain)
    values, controls = [], []
    for k in range(SAMPLES):
        if k:
            state = manager.integrate(k * EVERY)
        model.realizeVelocity(state)
        values.append([model.getCoordinateSet().get(name).getValue(state) for name in COORDINATES])
        controls.append(model.getControls(state).to_numpy())
    return values, controls


def main():
    """Record all motions."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    output = parser.parse_args().output
    opensim.Logger.setLevelString("Off")
    values, controls = zip(*map(swing, GAINS), strict=True)
    model, muscles, manager, state = arm(0.0)  # kept while its muscles are asked
    np.savez_compressed(
        output,
        gains=GAINS,
        values=values,
        excitation=controls,
        muscles=[muscle.getName() for muscle in muscles],
        fibers=[muscle.getFiberLength(state) for muscle in muscles],
        version=opensim.GetVersion(),
    )
    del model, manager


if __name__ == "__main__":
    main()

"""Record metabolic rates that OpenSim's probes give for a Millard muscle in random states.

Run in an environment of its own:
    pip install opensim==4.6
    python tests/data/record_metabolics.py
"""

from pathlib import Path

import numpy as np
import opensim

OUTPUT = Path(__file__).parent / "opensim" / "metabolics.npz"
STATES = 400
FORCE, OPTIMAL, SLACK, PENNATION, SPEED, SLOW = 3127.0, 0.055, 0.25, 0.4, 8.0, 0.8  # soleus
PROBES = {
    "bhargava2004": (opensim.Bhargava2004MuscleMetabolicsProbe, {}),
    "bhargava2004_of_force": (
        opensim.Bhargava2004MuscleMetabolicsProbe,
        {"use_force_dependent_shortening_prop_constant": True},
    ),
    "umberger2010": (opensim.Umberger2010MuscleMetabolicsProbe, {}),
    "umberger2010_positive": (
        opensim.Umberger2010MuscleMetabolicsProbe,
        {"include_negative_mechanical_work": False},
    ),
}


def main() -> None:
    """Step through the states, a muscle between ground and a block on a slider."""
    model = opensim.Model()
    block = opensim.Body("block", 1.0, opensim.Vec3(0), opensim.Inertia(1))
    model.addBody(block)
    model.addJoint(opensim.SliderJoint("slider", model.getGround(), block))
    muscle = opensim.Millard2012EquilibriumMuscle("muscle", FORCE, OPTIMAL, SLACK, PENNATION)
    muscle.set_ignore_tendon_compliance(True)
    muscle.set_max_contraction_velocity(SPEED)
    muscle.addNewPathPoint("origin", model.getGround(), opensim.Vec3(0))
    muscle.addNewPathPoint("insertion", block, opensim.Vec3(0))
    model.addForce(muscle)
    probes = {}
    for name, (kind, properties) in PROBES.items():
        probe = kind()
        probe.setName(name)
        probe.set_report_total_metabolics_only(False)
        probe.set_basal_rate_on(False)
        for prop, value in properties.items():
            getattr(probe, f"set_{prop}")(value)
        constants = (40.0, 133.0, 74.0, 111.0) if "bhargava" in name else ()
        probe.addMuscle("muscle", SLOW, *constants)
        model.addProbe(probe)
        probes[name] = probe
    state = model.initSystem()
    coordinate = model.getCoordinateSet().get(0)
    rng = np.random.default_rng(0)
    rows: dict[str, list[float]] = {}
    for _ in range(STATES):
        coordinate.setValue(state, SLACK + OPTIMAL * rng.uniform(0.5, 1.5))
        coordinate.setSpeedValue(state, OPTIMAL * SPEED * rng.uniform(-1.0, 0.6))
        muscle.setActivation(state, rng.uniform(0.01, 1.0))
        model.setControls(state, opensim.Vector(1, rng.uniform(0.0, 1.0)))
        model.realizeReport(state)
        row = {
            "excitation": muscle.getControl(state),
            "activation": muscle.getActivation(state),
            "norm_fiber_length": muscle.getNormalizedFiberLength(state),
            "active_force_length_multiplier": muscle.getActiveForceLengthMultiplier(state),
            "fiber_velocity": muscle.getFiberVelocity(state),
            "active_fiber_force": muscle.getActiveFiberForce(state),
            "fiber_force": muscle.getFiberForce(state),
        }
        row |= {name: probe.computeProbeInputs(state).get(2) for name, probe in probes.items()}
        for name, value in row.items():
            rows.setdefault(name, []).append(value)
    constants = {"max_isometric_force": FORCE, "optimal_fiber_length": OPTIMAL, "slow_twitch_ratio": SLOW}
    constants |= {
        "max_contraction_velocity": SPEED,
        "muscle_mass": probes["umberger2010"].getMuscleMass("muscle"),
    }
    OUTPUT.parent.mkdir(exist_ok=True)
    np.savez_compressed(OUTPUT, **{name: np.array(values) for name, values in (rows | constants).items()})


if __name__ == "__main__":
    main()

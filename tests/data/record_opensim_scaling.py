"""Record what OpenSim's scaling makes of models, and its ScaleTool of a person who stands still.

    python tests/data/record_opensim_scaling.py -o tests/data/opensim

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. Gives `scaling.npz`,
with names `<model>/<what>`, for every model in `osim`: each body is scaled by random factors with the same
seed always, every second one by the same in all axes; masses keep their shares (`keep`) or take volumes
(`volume`), and add up to 50 kg. Float64, SI and rad:

    bodies (b,), factors (b, 3), free (c,), values (c,)     factors, and a pose off the default
    keep/inertia, volume/inertia (b, 10)                    mass, mass centre, xx yy zz xy xz yz
    origins (b, 3)                                          of bodies in that pose
    muscles (m,), lengths (m, 3)                            optimal fiber, tendon, path in that pose

`leg6dof9musc/` has also, of the set-up file `leg6dof9musc_scale.xml` and a standing person:

    markers (k,), time (n,), seen (n, k, 3)                 the recording
    tool/factors (b, 3), tool/mass (b,)                     ScaleTool; factors have six digits
    tool/scaled (k, 3), tool/placed (k, 3)                  markers before and after they are placed
    exact/placed (k, 3)                                     placed after inverse kinematics to 1e-9
"""

import argparse
import os
import shutil
import tempfile
from pathlib import Path

import numpy as np
import opensim
from record_opensim_motion import RATE, trc

HERE = Path(__file__).parent
MODELS = ("arm26", "ellipsoids", "gait10dof18musc", "joints", "leg6dof9musc", "old")
FRAMES, NOISE = 12, 1e-3


def vector(v):
    """Return an OpenSim vector as an array."""
    return np.array([v.get(i) for i in range(v.size())])


def bodies_of(model):
    """Return the bodies."""
    return [model.getBodySet().get(i) for i in range(model.getBodySet().getSize())]


def inertia(model):
    """Return mass, mass centre and inertia of all bodies."""
    return np.array(
        [[b.getMass(), *vector(b.getMassCenter()), *vector(b.get_inertia())] for b in bodies_of(model)]
    )


def scaled(source, names, factors, keep):
    """Return a scaled model."""
    model = opensim.Model(str(source))
    state = model.initSystem()
    scales = opensim.ScaleSet()
    for name, row in zip(names, factors, strict=True):
        scale = opensim.Scale()
        scale.setSegmentName(name)
        scale.setScaleFactors(opensim.Vec3(*row))
        scale.setApply(True)
        scales.cloneAndAppend(scale)
    model.scale(state, scales, keep, 50.0)
    return model


def record(source):
    """Return the arrays of one model."""
    random = np.random.default_rng(0)
    model = opensim.Model(str(source))
    state = model.initSystem()
    names = [b.getName() for b in bodies_of(model)]
    factors = np.array(
        [
            random.uniform(0.8, 1.2, 3) if k % 2 else np.full(3, random.uniform(0.8, 1.2))
            for k in range(len(names))
        ]
    )
    out = {"bodies": names, "factors": factors}
    for keep, name in ((True, "keep"), (False, "volume")):
        model = scaled(source, names, factors, keep)
        out[f"{name}/inertia"] = inertia(model)
    model.set_assembly_accuracy(1e-12)
    state = model.initSystem()
    coordinates = [model.getCoordinateSet().get(i) for i in range(model.getCoordinateSet().getSize())]
    free = [c for c in coordinates if not c.isConstrained(state)]
    out["free"] = [c.getName() for c in free]
    for coordinate in free:
        coordinate.setValue(state, coordinate.getDefaultValue() + 0.1, False)
    model.assemble(state)  # moves also those that lead
    model.realizePosition(state)
    out["values"] = np.array([c.getValue(state) for c in free])
    out["origins"] = np.array([vector(b.getPositionInGround(state)) for b in bodies_of(model)])
    muscles = [model.getMuscles().get(i) for i in range(model.getMuscles().getSize())]
    out["muscles"] = [m.getName() for m in muscles]
    out["lengths"] = np.array(
        [[m.getOptimalFiberLength(), m.getTendonSlackLength(), m.getLength(state)] for m in muscles]
    ).reshape(-1, 3)
    return out


def places(model):
    """Return names and places of markers in their bodies."""
    markers = [model.getMarkerSet().get(i) for i in range(model.getMarkerSet().getSize())]
    return [m.getName() for m in markers], np.array([vector(m.get_location()) for m in markers])


def tool(source, setup):
    """Return what ScaleTool makes of a person; the working folder is where files may be written."""
    random = np.random.default_rng(1)
    shutil.copy(source, ".")
    shutil.copy(setup, ".")
    person = opensim.Model(str(source))
    names = [b.getName() for b in bodies_of(person)]
    person = scaled(source, names, np.tile(random.uniform(1.02, 1.12, 3), (len(names), 1)), True)
    state = person.initSystem()
    for i in range(person.getCoordinateSet().getSize()):
        coordinate = person.getCoordinateSet().get(i)
        if not coordinate.isConstrained(state):
            coordinate.setValue(state, coordinate.getDefaultValue() + random.uniform(-0.08, 0.08), False)
    person.assemble(state)
    person.realizePosition(state)
    markers = [person.getMarkerSet().get(i) for i in range(person.getMarkerSet().getSize())]
    still = np.array([vector(m.getLocationInGround(state)) for m in markers])
    still += 0.01 * random.normal(size=still.shape)
    seen = still + NOISE * random.normal(size=(FRAMES, *still.shape))
    labels, time = [m.getName() for m in markers], np.arange(FRAMES) / RATE
    out = {"markers": labels, "time": time, "seen": seen}
    trc(Path("static.trc"), labels, time, seen)
    opensim.ScaleTool(setup.name).run()
    result = opensim.Model("placed.osim")
    out["tool/mass"] = inertia(result)[:, 0]
    factors = opensim.ScaleSet("factors.xml")
    by_name = {
        factors.get(i).getSegmentName(): vector(factors.get(i).getScaleFactors())
        for i in range(factors.getSize())
    }
    out["tool/factors"] = np.array([by_name[name] for name in names])
    _, out["tool/scaled"] = places(opensim.Model("scaled.osim"))
    after, out["tool/placed"] = places(result)
    assert after == labels
    # The same pose by inverse kinematics to an accuracy that ScaleTool does not reach.
    span = (time >= 0.05 - 1e-9) & (time <= 0.15 + 1e-9)
    mean = seen[span].mean(axis=0)
    trc(Path("mean.trc"), labels, time[:2], np.array([mean, mean]))
    scale = opensim.ScaleTool(setup.name)
    kinematics = opensim.InverseKinematicsTool()
    kinematics.set_model_file("scaled.osim")
    kinematics.set_marker_file("mean.trc")
    tasks = scale.getMarkerPlacer().getIKTaskSet()
    for i in range(tasks.getSize()):
        kinematics.upd_IKTaskSet().cloneAndAppend(tasks.get(i))
    kinematics.setStartTime(time[0])
    kinematics.setEndTime(time[1])
    kinematics.set_accuracy(1e-9)
    kinematics.set_output_motion_file("exact.mot")
    kinematics.run()
    model = opensim.Model("scaled.osim")
    state = model.initSystem()
    lines = Path("exact.mot").read_text().splitlines()
    end = lines.index("endheader")
    columns, row = lines[end + 1].split("\t"), [float(x) for x in lines[end + 2].split()]
    for i in range(model.getCoordinateSet().getSize()):
        coordinate = model.getCoordinateSet().get(i)
        value = row[columns.index(coordinate.getName())]
        coordinate.setValue(state, np.radians(value) if coordinate.getMotionType() == 1 else value, False)
    model.assemble(state)
    model.realizePosition(state)
    ground = model.getGround()
    out["exact/placed"] = np.array(
        [
            vector(ground.findStationLocationInAnotherFrame(state, opensim.Vec3(*point), m.getParentFrame()))
            for point, m in zip(mean, [model.getMarkerSet().get(i) for i in range(len(labels))], strict=True)
        ]
    )
    return out


def main():
    """Record all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    output = parser.parse_args().output.resolve()
    opensim.Logger.setLevelString("Error")
    arrays, home = {}, Path.cwd()
    for name in MODELS:
        source = HERE.resolve() / "osim" / f"{name}.osim"
        found = record(source)
        setup = source.with_name(f"{name}_scale.xml")
        if setup.exists():
            with tempfile.TemporaryDirectory() as folder:
                os.chdir(folder)
                found |= tool(source, setup)
                os.chdir(home)
        arrays |= {f"{name}/{what}": np.array(value) for what, value in found.items()}
    np.savez_compressed(output / "scaling.npz", version=opensim.GetVersion(), **arrays)


if __name__ == "__main__":
    main()

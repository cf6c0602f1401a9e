"""Record what OpenSim reads of headers, and of recordings with something wrong.

    python tests/data/record_opensim_readers.py -o tests/data/opensim

needs an interpreter with `opensim` (4.6); of ours, `tests/reader_cases.py` alone is imported. Gives
`readers.json`:

    opensim       version
    headers       of each of `reader_cases.HEADERS`, as .mot and as .sto: whether angles are in degrees
    right         by name, of each of `reader_cases.RIGHT`: what OpenSim reads, as below
    recordings    by name, of what `reader_cases.recordings` yields: what OpenSim reads, null where it fails
                  or ends. Of tables its `Storage`: [in degrees, labels, rows]; of markers its
                  `TimeSeriesTableVec3`, in the file's unit: [labels, rows], null where a marker was not seen.
                  A reading that is that of the right file is its name instead.
    setups        by name, of what `reader_cases.setups` yields: what the tool says

Each case is read in a process of its own, as OpenSim ends the process at some of them.
"""

import argparse
import json
import math
import os
import signal
import sys
import tempfile
from pathlib import Path

import opensim

sys.path.insert(0, str(Path(__file__).parents[1]))
import reader_cases as cases

PATIENCE = 5  # s
opensim.Logger.setLevelString("off")


def storage(path):
    """Return what OpenSim's `Storage` makes of a file."""
    found = opensim.Storage(path)
    labels = found.getColumnLabels()
    rows = []
    for k in range(found.getSize()):
        vector = found.getStateVector(k)
        data = vector.getData()
        rows.append([vector.getTime(), *(data.get(i) for i in range(data.getSize()))])
    return [found.isInDegrees(), [labels.get(i) for i in range(labels.getSize())], rows]


def markers(path):
    """Return what OpenSim's `TimeSeriesTableVec3` makes of a file."""
    table = opensim.TimeSeriesTableVec3(path)
    time, rows = table.getIndependentColumn(), []
    for k in range(table.getNumRows()):
        row = table.getRowAtIndex(k)
        rows.append([time[k], *(row[i].get(axis) for i in range(row.size()) for axis in range(3))])
    return [list(table.getColumnLabels()), rows]


def kinematics(path):
    """Return files, times and weights of an IK set-up."""
    tool = opensim.InverseKinematicsTool(path)
    tasks = tool.getIKTaskSet()
    weights = {
        (one := tasks.get(k)).getName(): one.getWeight() if one.getApply() else 0.0
        for k in range(tasks.getSize())
    }
    return [
        tool.getMarkerDataFileName(),
        tool.getCoordinateFileName(),
        tool.getStartTime(),
        tool.getEndTime(),
        weights,
    ]


def dynamics(path):
    """Return files, times and filter of an ID set-up."""
    tool = opensim.InverseDynamicsTool(path)
    files = tool.getCoordinatesFileName(), tool.getExternalLoadsFileName()
    return [*files, tool.getStartTime(), tool.getEndTime(), tool.getLowpassCutoffFrequency()]


def analysis(path):
    """Return the same of an analysis."""
    tool = opensim.AnalyzeTool(path, False)
    files = tool.getCoordinatesFileName(), tool.getExternalLoadsFileName()
    return [*files, tool.getInitialTime(), tool.getFinalTime(), tool.getLowpassCutoffFrequency()]


def scaling(path):
    """Return what a set-up of scaling says."""
    tool = opensim.ScaleTool(path)
    scaler, placer = tool.getModelScaler(), tool.getMarkerPlacer()
    order = scaler.getScalingOrder()
    times = [one.getTimeRange().get(k) for one in (scaler, placer) for k in (0, 1)]
    words = [order.get(k) for k in range(order.getSize())]
    on = scaler.getApply(), placer.getApply(), scaler.getPreserveMassDist()
    return [tool.getSubjectMass(), words, scaler.getMarkerFileName(), placer.getMarkerFileName(), times, *on]


def loads(path):
    """Return the columns of external forces."""
    found = opensim.ExternalLoads(path, True)
    forces = []
    for k in range(found.getSize()):
        one = found.get(k)
        frames = one.getForceExpressedInBodyName(), one.getPointExpressedInBodyName()
        columns = one.getForceIdentifier(), one.getPointIdentifier(), one.getTorqueIdentifier()
        forces.append([one.getName(), one.get_appliesForce(), one.getAppliedToBodyName(), *columns, *frames])
    return [found.getDataFileName(), forces]


SETUPS = (kinematics, dynamics, analysis, scaling, loads)


def plain(value):
    """Return a value as JSON has it: null for NaN."""
    if isinstance(value, list):
        return [plain(one) for one in value]
    if isinstance(value, dict):
        return {name: plain(one) for name, one in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def alone(read, path):
    """Return what a process of its own reads; None where it fails or ends."""
    out, into = os.pipe()
    child = os.fork()
    if not child:
        signal.alarm(PATIENCE)
        try:
            os.close(out)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            os.write(into, json.dumps(plain(read(path))).encode())
        except Exception:  # noqa: BLE001 (whatever it is, OpenSim does not read the file)
            os._exit(1)
        os._exit(0)
    os.close(into)
    with os.fdopen(out, "rb") as pipe:
        text = pipe.read()
    return json.loads(text) if os.waitpid(child, 0)[1] == 0 and text else None


def main():
    """Record."""
    parser = argparse.ArgumentParser()
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parent / "opensim")
    output = parser.parse_args().output.resolve()
    os.chdir(tempfile.mkdtemp())
    headers = []
    for header in cases.HEADERS:
        row = []
        for suffix in (".mot", ".sto"):
            Path(f"h{suffix}").write_text(f"{header}\nendheader\n{cases.NAMES}{cases.ROWS}", encoding="utf-8")
            row.append(alone(storage, f"h{suffix}")[0])
        headers.append(row)
    right = {}
    for name, text in cases.RIGHT.items():
        Path(name).write_text(text, encoding="utf-8")
        right[name] = alone(markers if name.endswith(".trc") else storage, name)
    found = {}
    for name, text in cases.recordings():
        Path(name).write_text(text, encoding="utf-8", newline="")
        reading = alone(markers if name.endswith(".trc") else storage, name)
        same = [known for known, there in right.items() if there == reading and known[-4:] == name[-4:]]
        found[name] = same[0] if same else reading
    readers = {f"{one.__name__}.xml": one for one in SETUPS}
    setups = {}
    for name, text in (*cases.SETUPS.items(), *cases.setups()):
        Path(name).write_text(text, encoding="utf-8", newline="")
        setups[name] = alone(readers[name.lstrip("0123456789")], name)
    result = {"opensim": opensim.GetVersion(), "headers": headers, "right": right, "recordings": found}
    result["setups"] = setups
    text = (
        json.dumps(result, separators=(",", ":"), ensure_ascii=True)
        .replace('],"', '],\n"')
        .replace(',"1', ',\n"1')
    )
    (output / "readers.json").write_text(text + "\n")


main()

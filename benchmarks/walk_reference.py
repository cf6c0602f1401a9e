"""The reference of `myowarp score`: means and standard deviations of public trials of two people.

    python -m benchmarks.walk_reference

writes `myowarp/apps/reports/walk_reference.json`. Joint angles are found anew from the recorded markers and
joint moments from these and the recorded forces, by the steps of `myowarp motion` at its 6 Hz filter. The
trials are no part of this repository; what is kept of them are numbers of all strides together.
"""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from benchmarks.rivals import ROOT
from myowarp.apps.reports.table import number
from myowarp.apps.reports.walk_measures import SHIPPED, Measured, measured, pooled, reference_dict
from myowarp.apps.reports.walk_score import write_json
from myowarp.motion.movement import motion_in
from myowarp.motion.setup import TrialSetup
from myowarp.motion.steps import dynamics, kinematics
from myowarp.motion.strides import strides_of, within
from myowarp.motion.tool_setup import read_tool_setup
from myowarp.motion.trial_walk import read_walk
from myowarp.osim.body.skeleton import Bones

CUTOFF = 6.0  # Hz
EMG = {
    "soleus": [(3.0, 52.0)],
    "gastrocnemius": [(6.0, 48.0)],
    "tibialis anterior": [(54.0, 9.0)],
    "hamstrings": [(80.0, 5.0)],
    "vasti": [(88.0, 16.0)],
    "rectus femoris": [(55.0, 66.0)],
    "gluteus maximus": [(94.0, 24.0)],
    "gluteus medius": [(95.0, 29.0)],
}
"""Spans of the cycle in which muscles are on [%], Perry 1992. Hamstrings are semimembranosus (81 to 5) and
the long head of biceps femoris (79 to 5), vasti are medialis (87 to 16) and lateralis (88 to 15), gluteus
maximus is its upper part."""
SOURCES = (
    "two people, one trial each: gait2354 subject01 of OpenSim (Delp et al. 1990, Anderson and Pandy 1999; "
    "CC BY 3.0) and the walking subject of Rajagopal et al. 2016, doi:10.1109/TBME.2016.2586891 (MIT), by "
    "way of OpenSim Moco's example3DWalking (Apache-2.0)",
    "on and off of muscles: Perry 1992, Gait Analysis: Normal and Pathological Function",
    "metabolic rate at the speed of the walk, rest included: Ralston 1958, doi:10.1007/BF00698754",
)


@dataclass(frozen=True)
class Trial:
    """Files of a trial, in its folder."""

    model: str
    markers: str
    tasks: str
    loads: str


GAIT2354 = Trial(
    "reference_subject01_simbody.osim",
    "subject01_walk1.trc",
    "subject01_Setup_IK.xml",
    "subject01_walk1_grf.xml",
)
MOCO = Trial("subject_walk_scaled.osim", "markers_walk.trc", "ik_tasks_walk.xml", "grf_walk.xml")


@dataclass
class Options:
    """Compute the reference of `myowarp score`."""

    gait2354: Path = ROOT / "../shared/osim/motion/gait2354"
    """Folder of OpenSim's Gait2354 example."""
    moco: Path = ROOT / "../shared/osim/moco/example3DWalking"
    """Folder of OpenSim Moco's example3DWalking."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = SHIPPED
    """JSON file."""
    keep: Path | None = None
    """Folder in which the two trials are kept, as `myowarp score --trial` reads them."""


def walked(folder: Path, trial: Trial, out: Path) -> Measured:
    """Return what a trial is; angles and moments go into a folder."""
    model, loads = folder / trial.model, folder / trial.loads
    bones = Bones.read(model)
    tasks = read_tool_setup(folder / trial.tasks).tasks
    kinematics(bones, TrialSetup(markers=folder / trial.markers, tasks=tasks)).write(out)
    along = TrialSetup(motion=motion_in(out), loads=loads, cutoff=CUTOFF)
    dynamics(bones, along).write(out)
    return measured(folder.name, [strides_of(read_walk(out, model, loads))])


def main() -> None:
    """Compute, print, write."""
    options, people = tyro.cli(Options), []
    with tempfile.TemporaryDirectory() as scratch:
        for folder, trial in ((options.gait2354, GAIT2354), (options.moco, MOCO)):
            people.append(walked(folder, trial, (options.keep or Path(scratch)) / folder.name))
    strides = sum(person.strides for person in people)
    name = f"{len(people)} people, {strides} strides"
    reference = replace(
        pooled(name, people, SOURCES), active={muscle: within(spans) for muscle, spans in EMG.items()}
    )
    write_json(options.output, reference_dict(reference))
    console = Console(highlight=False)
    for person in people:
        figures = (f"{key} {number(float(rows.mean()))}" for key, rows in person.values.items())
        console.print(f"{person.name}: {person.strides} strides, {', '.join(figures)}", soft_wrap=True)


if __name__ == "__main__":
    main()

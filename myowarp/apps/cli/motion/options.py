"""Options that several steps of `myowarp motion` have, each described once; fields name them as types."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from myowarp.apps.cli.options import UNSET, described
from myowarp.apps.cli.options import Overwrite as Overwrite

OUT = Path("out/motion")
Model = Annotated[Path, tyro.conf.Positional, described("MODEL", "The model, .osim.")]
Motion = Annotated[Path | None, described("FILE", "Joint angles over time, .mot or .sto.", UNSET)]
Loads = Annotated[Path | None, described("FILE", "OpenSim file of external loads.", UNSET)]
ToolFile = Annotated[
    Path | None,
    described(
        "FILE",
        "Set-up file of OpenSim's tool, for files, filter, times, exponent and reserves; an option given here"
        " wins over it.",
        UNSET,
    ),
]
FunctionPaths = Annotated[
    Path | None,
    described(
        "FILE",
        "Set of FunctionBasedPath, such as Moco's, which replaces the paths of the muscles that it names.",
        UNSET,
    ),
]
Contact = Annotated[
    Literal["opensim"] | None,
    described(
        "opensim",
        "Let the model's contact forces act, as OpenSim computes them; by default they do not.",
        UNSET,
    ),
]
Filter = Annotated[
    float | None,
    described("HZ", "Cut-off frequency of the low-pass filter; by default there is none.", UNSET),
]
Span = Annotated[
    tuple[float, float] | None, described("START END", "First and last time [s]; by default all.", UNSET)
]
Mode = Annotated[
    Literal["equilibrium", "opensim"],
    described(
        "{equilibrium,opensim}",
        "equilibrium: fiber and tendon in equilibrium, with passive force. opensim: rigid tendons without"
        " passive force, as OpenSim's static optimisation.",
    ),
]
Exponent = Annotated[
    float | None, described("FLOAT", "Power of activations in the cost, at least 1; by default 2.", UNSET)
]
Reserve = Annotated[
    float | None,
    described(
        "FLOAT",
        "Moment of a reserve actuator on every coordinate at cost 1 [N m, N]; by default those of the set-up"
        " file, or none.",
        UNSET,
    ),
]
Residual = Annotated[
    float | None,
    described("FLOAT", "The same for the coordinates of the root; by default --reserve.", UNSET),
]
Output = Annotated[Path, tyro.conf.arg(aliases=["-o"], help="Folder for the result.")]


@dataclass
class Along:
    """Options of every step along a motion."""

    model: Model
    motion: Motion = None
    setup: ToolFile = None
    function_paths: FunctionPaths = None
    contact: Contact = None
    filter: Filter = None
    span: Span = None
    output: Output = OUT
    overwrite: Overwrite = False

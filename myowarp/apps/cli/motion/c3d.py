"""The step `myowarp motion c3d`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from myowarp.apps.cli.motion import options as of
from myowarp.apps.cli.motion.steps import check_results, say_saved
from myowarp.apps.cli.options import described, optional

FILES = "markers.trc", "grf.mot", "grf.xml", "analog.sto"


@dataclass
class C3d:
    """Take markers, ground forces and electromyograms out of a C3D file, in OpenSim's axes.

    Example: myowarp motion c3d walk.c3d --plates calcn_r calcn_l --names EMG1=soleus_r
    """

    recording: Annotated[Path, tyro.conf.Positional, described("FILE", "The recording, .c3d.")]
    up: Annotated[Literal["x", "y", "z"] | None, optional("{x,y,z}")] = None
    """The laboratory's vertical axis; by default what the file says, or z."""
    plates: Annotated[tuple[str, ...], optional("[BODY ...]")] = ()
    """Body on which each force plate acts, for grf.xml, OpenSim's file of external loads."""
    names: Annotated[tuple[str, ...], optional("[OLD=NEW ...]")] = ()
    """New names of markers and channels, such as the muscle of an electromyogram."""
    output: of.Output = of.OUT
    overwrite: of.Overwrite = False

    def __call__(self) -> None:
        """Check, read, write."""
        from myowarp.motion.c3d import read_c3d

        if wrong := [word for word in self.names if not all(word.partition("="))]:
            raise ValueError(f"--names takes OLD=NEW, such as EMG1=soleus_r, got {wrong[0]!r}")
        names = {old: new for old, _, new in (word.partition("=") for word in self.names)}
        check = check_results(self.output, FILES, self.overwrite)
        found = read_c3d(self.recording, self.up, names)
        check()
        written = found.write(self.output, self.plates)
        lines = [f"no markers, and left out: {', '.join(found.skipped)}"] if found.skipped else []
        if found.plates:
            lines.append(f"{len(found.plates)} force plates, which act at the middle of their corners")
        if found.plates and not self.plates:
            lines.append("no grf.xml: --plates names the body on which each plate acts")
        say_saved(lines, written, self.output)

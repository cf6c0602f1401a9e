"""The command `myowarp motion`, a file a step: from a recording to a person's model, angles and forces."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from myowarp.apps.cli.motion.analyze import Analyze
from myowarp.apps.cli.motion.c3d import C3d
from myowarp.apps.cli.motion.dynamics import Dynamics
from myowarp.apps.cli.motion.emg import Emg
from myowarp.apps.cli.motion.forces import Forces
from myowarp.apps.cli.motion.kinematics import Kinematics
from myowarp.apps.cli.motion.place import Place
from myowarp.apps.cli.motion.report import Report
from myowarp.apps.cli.motion.scale import Scale
from myowarp.apps.cli.motion.study import Study
from myowarp.apps.cli.motion.track import Track


class Motion:
    """Scale an OpenSim model, and find joint angles, joint moments and muscle forces of a recorded motion.

    Each step has a help of its own: myowarp motion forces --help. Writes .sto and .mot files, which OpenSim
    reads. Works without OpenSim.

    Example: myowarp motion kinematics gait.osim --markers walk.trc --setup ik.xml

    And on: myowarp motion forces gait.osim --motion out/motion/ik.mot --loads grf.xml --filter 6
    """

    COMMANDS: ClassVar[dict[str, type[Callable[[], None]]]] = {
        "c3d": C3d,
        "scale": Scale,
        "place": Place,
        "kinematics": Kinematics,
        "analyze": Analyze,
        "dynamics": Dynamics,
        "forces": Forces,
        "track": Track,
        "emg": Emg,
        "report": Report,
        "study": Study,
    }
    chosen: Callable[[], None]

    def __call__(self) -> None:
        """Do the step."""
        self.chosen()

"""The step `myowarp motion emg`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from myowarp.apps.cli.motion import options as of
from myowarp.apps.cli.motion.said import of_emg
from myowarp.apps.cli.motion.steps import check_results, needed, say_saved
from myowarp.apps.cli.options import optional

FILES = "emg.sto", "emg_agreement.csv", "emg.png"


@dataclass
class Emg:
    """Compare raw electromyograms, columns named by muscles, with the activations of the same folder.

    Example: myowarp motion emg gait.osim --emg emg.csv -o out/trial
    """

    model: of.Model
    emg: Annotated[Path | None, optional("FILE")] = None
    """Raw electromyograms over time, .sto, .mot or .csv."""
    output: of.Output = of.OUT
    overwrite: of.Overwrite = False

    def __call__(self) -> None:
        """Check, compare, write."""
        from myowarp.apps.reports.emg import draw_emg
        from myowarp.motion.emg import compare
        from myowarp.motion.storage import read_storage
        from myowarp.osim.document.read.model import read_model

        source = needed(self.emg, "emg", "emg")
        check = check_results(self.output, FILES, self.overwrite)
        path = self.output / "activations.sto"
        if not path.is_file():
            raise ValueError(
                f"{str(self.output)!r} has no activations.sto; write it with myowarp motion forces or track "
                "and the same --output"
            )
        activation, model = read_storage(path), read_model(self.model)
        if unknown := [name for name in activation.labels if name not in model.muscles]:
            raise ValueError(
                f"{str(path)!r} has the muscle {unknown[0]!r}, which the model {model.name!r} has not; give "
                "the model that it was found with"
            )
        found = compare(read_storage(source), activation)
        check()
        found.write(self.output)
        draw_emg(self.output / "emg.png", found)
        say_saved(of_emg(found), FILES, self.output)

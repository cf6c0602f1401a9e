"""The step `myowarp motion scale`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from myowarp.apps.cli.motion.steps import OUT, SHOWN, Model, Output, check_results, needed, say_saved
from myowarp.apps.cli.options import Overwrite, optional
from myowarp.disk import make_folder

if TYPE_CHECKING:
    from myowarp.motion.scaling import Scaled

FILES = "scaled.osim", "scale_factors.xml", "static.mot"


@dataclass
class Scale:
    """Scale a generic model to a person, by markers of one who stands still and an OpenSim set-up file.

    Example: myowarp motion scale generic.osim --setup scale.xml --markers static.trc
    """

    model: Model
    setup: Annotated[Path | None, optional("FILE")] = None
    """Set-up file of OpenSim's ScaleTool."""
    markers: Annotated[Path | None, optional("FILE")] = None
    """Markers over time, .trc; by default those that the set-up file names."""
    output: Output = OUT
    overwrite: Overwrite = False

    def __call__(self) -> None:
        """Check, scale, write."""
        from myowarp.motion import trial

        setup = needed(self.setup, "scale", "setup")
        check_results(self.output, FILES, self.overwrite)
        make_folder(self.output)
        scaled = trial.scale_to(self.model, self.output, setup, self.markers)
        say_saved(_lines(scaled), FILES, self.output)


def _lines(scaled: Scaled) -> list[str]:
    """Return how a model was scaled, one line each; markers that fitted worst come first."""
    lines = []
    if scaled.unknown:
        lines.append(f"not in the model, and left out: {', '.join(scaled.unknown)}")
    if scaled.pose is not None:
        lines += [f"{marker}: {1e3 * most:.1f} mm off before it was moved"
                  for marker, _, most in scaled.pose.worst()[:SHOWN]]  # fmt: skip
        lines += [doubt] if (doubt := scaled.pose.doubt()) else []
    for name, (factor, _) in scaled.measured.items():
        lines.append(f"{name}: {factor:.4f}")
    mass = sum(body.mass for body in scaled.document.model.bodies.values())
    return [*lines, f"{mass:.1f} kg in {len(scaled.document.model.bodies)} bodies"]

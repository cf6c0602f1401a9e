"""The command `myowarp export`: a trained policy for other programs."""

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from myowarp.apps.cli.options import Overwrite
from myowarp.extras import to_install

NEEDS = {".onnx": ("onnx", "`pip install onnx`"), ".pt": ("torch", to_install("torch"))}


@dataclass
class Export:
    """Write a trained policy as ONNX or TorchScript: observations in, deterministic actions out.

    The file holds the normaliser too. Input `obs` (num_worlds, obs_size) float32, output `action`
    (num_worlds, num_actions) in [-1, 1]; `contract` in the file's metadata names both.

    Example: myowarp export runs/elbow elbow.onnx
    """

    checkpoint: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]
    """Folder of a run or of a checkpoint, or a policy of the package: baselines/ID."""
    output: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """File to write, .onnx or .pt (TorchScript)."""
    overwrite: Overwrite = False

    def __call__(self) -> None:
        """Check and write."""
        from myowarp.apps.policies.baselines import policy_folder
        from myowarp.apps.policies.checkpoint import load_checkpoint
        from myowarp.apps.policies.export import write_onnx, write_torchscript
        from myowarp.disk import check_output, check_overwrite

        check_output(self.output, *NEEDS)
        check_overwrite((self.output,), self.overwrite)
        suffix = self.output.suffix.lower()
        package, source = NEEDS[suffix]
        if importlib.util.find_spec(package) is None:
            instead = "; a .pt file needs torch alone" if suffix == ".onnx" else ""
            raise ImportError(f"{suffix} files need {package}, which is not installed; run {source}{instead}")
        checkpoint = load_checkpoint(policy_folder(str(self.checkpoint), None) or self.checkpoint)
        write = write_onnx if suffix == ".onnx" else write_torchscript
        write(checkpoint, self.output)
        Console(stderr=True, soft_wrap=True).print(f"Saved {self.output}")

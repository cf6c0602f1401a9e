"""What `myowarp eval` does; it needs no torch."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.table import Table

from myowarp.apps.cli.options import Device, Physics, check_least, optional
from myowarp.apps.train.plan import eval_command, is_file
from myowarp.apps.train.ranks import Ranks
from myowarp.apps.train.settings import MOST_SEED, SUCCESSES, success_text
from myowarp.definitions.muscle import MUSCLES
from myowarp.definitions.registry import check_choice
from myowarp.definitions.task import PHYSICS, RESETS, TASKS
from myowarp.sim.build import MOST_WORLDS, check_device_name
from myowarp.tasks.from_file import task_or_model
from myowarp.tasks.variants import Variant

if TYPE_CHECKING:
    from myowarp.apps.policies.checkpoint import Checkpoint

EVALUATION_SEED = 1_000_000  # other worlds than those of training
MODES = ("deterministic", "sampled")


@dataclass
class Eval:
    """Evaluate a trained policy: success by three rules with 95 % intervals, return and effort.

    Every world runs one episode. The physics is parity (MyoSuite's integrator and step) unless you choose
    another; reset and conditions are those of the training unless you choose others.

    Example: myowarp eval runs/elbow --conditions sarcopenia
    """

    checkpoint: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]
    """Folder of a run or of a checkpoint, or a policy of the package: baselines/ID."""
    task: Annotated[str | None, optional("ID")] = None
    """Another task with the same observation and actuators; by default that of the training."""
    model: Annotated[Path | None, optional("FILE")] = None
    """MJCF file of the training, for a policy that was trained with --model."""
    episodes: int = 256
    """Episodes of each mode, and worlds simulated together."""
    mode: Literal["both", "deterministic", "sampled"] = "both"
    """Whether actions are the policy's means, or drawn as in training."""
    seed: int = EVALUATION_SEED
    """World i resets with seed + i."""
    physics: Physics = "parity"
    muscle: Annotated[str | None, optional("{" + ",".join(MUSCLES) + "}")] = None
    """Muscle model; by default that of the training."""
    reset: Annotated[str | None, optional("{" + ",".join(RESETS) + "}")] = None
    """What episodes start from; by default as in the training."""
    conditions: Annotated[tuple[str, ...] | None, optional("[NAME ...]")] = None
    """Muscle conditions; by default those of the training; without a name: none."""
    device: Device = None
    json: bool = False
    """Print JSON instead of a table."""

    def __call__(self) -> None:
        """Check, run and print."""
        head, results = self.figures()
        if not Ranks.started().leads:
            return
        if self.json:
            print(json.dumps({**head, **results}, indent=1))
        else:
            _print_table(head, results)

    def figures(self) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Check and run; return under what, and the figures of `Evaluation` of each mode.

        Raises:
            ValueError: An argument is wrong; nothing was built.
        """
        from myowarp.apps.policies.checkpoint import check_contract
        from myowarp.apps.policies.learned import LearnedPolicy
        from myowarp.apps.train.evaluate import evaluate
        from myowarp.bridge_gym import MyoWarpVectorEnv

        checkpoint, variant, options = self.plan()
        modes = MODES if self.mode == "both" else (self.mode,)
        ranks = Ranks.started()
        number, device = ranks.share("--episodes", self.episodes), ranks.device(self.device or "")
        console = Console(stderr=True, quiet=not ranks.leads)
        options |= {"rank": ranks.part, "device": device or None}
        results = {}
        with ranks.together(device, learning=False):
            env = MyoWarpVectorEnv(variant.task, number, autoreset_mode="same_step", **options)
            check_contract(checkpoint, env.sim)
            for mode in modes:
                act = LearnedPolicy(checkpoint, sampled=mode == "sampled", seed=self.seed, rank=ranks.part)
                figures = evaluate(env, act, self.seed, title=mode, console=console, ranks=ranks)
                results[mode] = dataclasses.asdict(figures)
            env.close()
        head = {"task": TASKS[variant.task].env_id, "checkpoint": str(checkpoint.folder), "seed": self.seed}
        head |= {name: options[name] for name in ("physics", "muscle", "reset")}
        head |= {"conditions": list(options["conditions"]), "device": str(env.sim.scene.device)}
        head |= {
            "trained_under": checkpoint.manifest["settings"]["physics"],
            "samples": checkpoint.manifest["samples"],
        }
        return head, results

    def plan(self) -> tuple[Checkpoint, Variant, dict[str, Any]]:
        """Return checkpoint, task and options of the environment.

        Raises:
            ValueError: An argument is wrong; nothing was built.
        """
        from myowarp.apps.policies.baselines import policy_folder
        from myowarp.apps.policies.checkpoint import CheckpointError, load_checkpoint

        check_least(1, MOST_WORLDS, episodes=self.episodes)
        check_least(0, MOST_SEED, seed=self.seed)
        check_choice("physics", self.physics, PHYSICS)
        check_choice("mode", self.mode, ("both", *MODES))
        if self.muscle is not None:
            check_choice("muscle", self.muscle, MUSCLES)
        if self.reset is not None:
            check_choice("reset", self.reset, RESETS)
        check_device_name(self.device)
        own = self.task and self.task.removeprefix("MyoWarp/")
        checkpoint = load_checkpoint(policy_folder(str(self.checkpoint), own) or self.checkpoint)
        manifest = checkpoint.manifest
        trained = manifest["settings"]
        other = self.task is not None or self.model is not None
        if not other and is_file(manifest["task"], manifest["model"]):
            whole = eval_command(manifest["task"], manifest["model"], self.checkpoint)
            raise CheckpointError(
                f"checkpoint {str(self.checkpoint)!r} was trained in a task from a file, which a checkpoint "
                f"does not open by itself; try {whole}"
            )
        variant = task_or_model(self.task if other else manifest["task"], self.model)
        conditions = (
            *variant.conditions,
            *(trained["conditions"] if self.conditions is None else self.conditions),
        )
        options = {
            "physics": self.physics,
            "muscle": self.muscle or trained["muscle"],
            "reset": self.reset or trained["reset"] or variant.reset,
            "conditions": conditions,
            "device": self.device,
        }
        return checkpoint, variant, options


def _print_table(head: dict[str, Any], results: dict[str, dict[str, Any]]) -> None:
    """Print figures, a column for each mode."""
    console = Console(highlight=False)
    with_conditions = f", conditions {' '.join(head['conditions'])}" if head["conditions"] else ""
    console.print(
        f"[bold]{head['task']}[/bold]: {head['physics']} physics{with_conditions}, seed {head['seed']}"
    )
    table = Table("", *results)
    for name, text in SUCCESSES.items():
        table.add_row(text, *(success_text(figures, name) for figures in results.values()))
    some = next(iter(results.values()))
    if some["reachable"] and some["reachable"] < some["episodes"]:
        text = f"{SUCCESSES['success']}, {some['reachable']} reachable targets"
        table.add_row(text, *(success_text(figures, "success_reachable") for figures in results.values()))
    table.add_row("return", *(f"{f['return_mean']:.1f} ± {f['return_std']:.1f}" for f in results.values()))
    plain = {
        "length_mean": "length [steps]",
        "mean_activation": "mean activation",
        "activation_rate": "activation rate [1/s]",
    }
    for name, text in (plain | {"episodes": "episodes", "faults": "faults"}).items():
        table.add_row(text, *("-" if f[name] is None else f"{f[name]:.4g}" for f in results.values()))
    console.print(table)

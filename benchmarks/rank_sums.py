"""Ways to average gradients over ranks: seconds of an iteration with each, in turns within one run.

    torchrun --nproc-per-node 2 -m benchmarks.rank_sums

All ways give the same bits, so that all iterations are those of one training. Each rank needs an idle core.
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from benchmarks.machine import processor
from myowarp.apps.train.plan import plan
from myowarp.apps.train.ranks import Ranks


@dataclass
class Options:
    """Compare ways to average gradients over ranks."""

    task: str = "myoHandReachRandom-v0"
    """Task; its preset is that of PPO."""
    num_worlds: int = 512
    """Worlds of all ranks."""
    rounds: int = 10
    """Iterations with each way, in turns."""


def main() -> None:
    """Measure and print; all ranks do the same work, the first one prints."""
    options, ranks = tyro.cli(Options, description=__doc__), Ranks.started()
    output = Path("unwritten")  # nothing is saved
    job = plan(options.task, algorithm="ppo", num_worlds=options.num_worlds, device="cpu", output=output)
    with ranks.together("cpu"):
        from myowarp.apps.train import agents  # not before: skrl would start NCCL
        from myowarp.apps.train.run import start

        ways: dict[str, Callable[[Any, Any], None]] = {
            "a message for each network (skrl)": lambda policy, value: None,
            "one message": agents.average_together,
        }
        run = start(job)
        models = run.agent.policy, run.agent.value
        run.iterate()
        seconds: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(options.rounds):
            for name, way in ways.items():
                for model in models:
                    model.__dict__.pop("reduce_parameters", None)  # back to skrl's
                way(*models)
                begin = time.perf_counter()
                run.iterate()
                seconds[name].append(time.perf_counter() - begin)
        run.env.close()
    if not ranks.leads:
        return
    print(f"{options.task}, {options.num_worlds} worlds over {ranks.size} ranks, {processor()}")
    first = next(iter(seconds.values()))
    for name, taken in seconds.items():
        times = statistics.median(one / other for one, other in zip(first, taken, strict=True))
        print(
            f"{name}: {statistics.median(taken):.3f} s an iteration, {times:.2f} times as fast as the first"
        )


if __name__ == "__main__":
    main()

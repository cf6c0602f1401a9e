"""Adaptation: policies trained on patients who change, told, remembering or neither, beside one that was not.

Open in the paper, which names the problem and gives no protocol, and chosen here: changes of a drawn extent
that come in mid-episode, at a drawn moment; the policies of a change are trained alike.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.apps.policies.baselines import PREFIX, load_baseline
from myowarp.apps.policies.find import Policy
from myowarp.apps.policies.learned import LearnedPolicy
from myowarp.apps.reports import panel
from myowarp.apps.reports.evaluation import EVALUATION_SEED
from myowarp.apps.reports.intervals import mean_interval
from myowarp.apps.reports.result import PERCENT, Merit
from myowarp.apps.studies import adaptation
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab, Tick
from myowarp.apps.studies.reproduce.policies import Training, available
from myowarp.definitions.condition import Condition
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.inks import INKS
from myowarp.models.conditions import (
    JointDevice,
    NerveCrossing,
    Ramp,
    Sarcopenia,
    TendonTear,
    TendonTransfer,
    Uniform,
)
from myowarp.tasks.setups import complete

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BASELINE, BLIND, TOLD, MEMORY, RETRAINED = "baseline", "blind", "told", "memory", "retrained"
KINDS: dict[str, dict[str, Any]] = {
    BLIND: {},
    TOLD: {"observe": ("parameters",)},
    MEMORY: {"memory": 32},
    RETRAINED: {"observe": ("parameters",)},
}
"""Settings of each kind of policy: what it observes and remembers."""
ELBOW, FINGER = "myoElbowPose1D6MRandom-v0", "myoFingerReachRandom-v0"
HAND, KEY, HOLD = "myoHandReachRandom-v0", "myoHandKeyTurnFixed-v0", "myoHandObjHoldFixed-v0"
NAMES = {ELBOW: "elbow", FINGER: "finger", HAND: "hand", KEY: "key", HOLD: "hold"}
PARALLEL = {"num_worlds": 256, "minibatches": 4}
SETTINGS: dict[str, dict[str, Any]] = {
    ELBOW: {"samples": 600_000},
    FINGER: {"samples": 600_000, "parent": PREFIX + FINGER},
    HAND: {"samples": 1_000_000, "parent": f"{PREFIX}{HAND}/parent"} | PARALLEL,
    KEY: {"samples": 1_000_000, "parent": PREFIX + KEY} | PARALLEL,
    HOLD: {"samples": 600_000, "parent": PREFIX + HOLD} | PARALLEL,
}
"""Settings of a training by task, beside its preset; all kinds have the same."""
MOMENT = Uniform(0.2, 1.0)  # s
WEAKNESS, DEVICE, CROSSING, TEAR, TRANSFER = "weakness", "device", "crossing", "tear", "transfer"
DEVICES = {ELBOW: ("", Uniform(0.0, 2.0)), HAND: ("pro_sup_r", Uniform(2.0, 4.0))}
"""The joint of a device, and the share of the muscles' torque that it adds."""
Case = tuple[str, str]
CHANGES = {
    ELBOW: (WEAKNESS, DEVICE, CROSSING),
    FINGER: (WEAKNESS,),
    HAND: (TRANSFER, DEVICE, CROSSING),
    KEY: (TEAR,),
    HOLD: (TRANSFER,),
}
CASES: tuple[Case, ...] = tuple((task, change) for task, changes in CHANGES.items() for change in changes)
WITH_RETRAINED = (*((ELBOW, change) for change in CHANGES[ELBOW]), (HAND, CROSSING))
LASTING = {"noise": "repeated"}
BESIDE: dict[Case, dict[str, Any]] = {
    (ELBOW, DEVICE): LASTING,
    (ELBOW, CROSSING): LASTING,
    (FINGER, WEAKNESS): LASTING,
    (HAND, DEVICE): LASTING | {"samples": 2_000_000, "mean_bound": "tanh", "epochs": 2},
}
"""Settings of a case in place of its task's: noise that lasts, and means that do not hide it by clipping."""
TAUGHT: dict[Case, dict[str, Any]] = {
    (HAND, CROSSING): {
        "samples": 400_000,
        "num_worlds": 256,
        "parent": PREFIX + HAND,
        "expert": f"{__name__}:uncross",
    }
}
"""Settings of cases in which DAgger imitates a teacher who is told of the change."""
REMEMBERED = {"observe": ("history=1",)}
"""Instead of a recurrent unit, which DAgger does not train."""
CLAIMS = {BLIND: "trained", TOLD: TOLD, MEMORY: MEMORY}
"""Claims about the gain of a kind over the next worse one."""
SEEDS = (0, 1, 2)
QUICK_EPISODES = 32
KEPT = 0.9  # share of what retraining solves


def kinds_of(case: Case) -> tuple[str, ...]:
    """Return the kinds of policies that are trained for a case."""
    return tuple(kind for kind in KINDS if kind != RETRAINED or case in WITH_RETRAINED)


def change_of(case: Case, *, there: bool = False) -> Condition:
    """Return how the patients of a case change, or what they are when the change is there from the begin."""

    def come(before: float, after: float | Uniform) -> float | Uniform | Ramp:
        return after if there else Ramp(before, after, onset=MOMENT)

    task, change = case
    if change == WEAKNESS:
        return Sarcopenia(come(1.0, Uniform(0.0, 1.0, each=True)))
    if change == TEAR:
        return TendonTear(transmission=come(1.0, 0.0))
    if change == TRANSFER:
        return TendonTransfer(come(0.0, 1.0))
    if change == CROSSING:
        # From 0.5 on they are crossed: where half of the elbows stay healthy, healthy ones go on to count.
        return NerveCrossing(come(0.0, Uniform(0.0, 1.0) if task == ELBOW else 1.0))
    joint, share = DEVICES[task]
    return JointDevice(joint, stiffness=0.0, assistance=come(0.0, share), delay=0.1)


def training(case: Case, kind: str) -> Training:
    """Return how a kind of policy is trained for a task and a change."""
    task, change = case
    taught = case in TAUGHT
    own = dict(TAUGHT[case]) if taught else SETTINGS[task] | BESIDE.get(case, {})
    samples, parent = own.pop("samples"), own.get("parent")
    own |= REMEMBERED if taught and kind == MEMORY else KINDS[kind]
    name = f"changing_{task}_{change}_{kind}"
    conditions = (change_of(case, there=kind == RETRAINED),)
    algorithm = "dagger" if taught else "ppo"
    return Training(name, task, lambda: conditions, samples, own, algorithm=algorithm, parent=parent)


@cache
def _healthy_hand() -> tuple[LearnedPolicy, np.ndarray]:
    """Return the package's policy of hand reach, and its actions' order where nerves are crossed."""
    checkpoint = load_baseline(HAND).checkpoint
    muscles = checkpoint.manifest["contract"]["actuators"]
    order = np.arange(len(muscles))
    for one, other in NerveCrossing().indices(TASKS[HAND].body, muscles):
        order[[one, other]] = other, one
    return LearnedPolicy(checkpoint), order


def uncross(obs: np.ndarray, told: np.ndarray) -> np.ndarray:
    """Act as the package's policy of hand reach, and exchange what it asks of muscles with crossed nerves.

    Args:
        obs: Observations, the task's own first, shape (num_worlds, obs_size).
        told: Whether nerves are crossed, from 0.5 on, shape (num_worlds, 1).
    """
    policy, order = _healthy_hand()
    actions = policy(obs[:, : policy.obs_size])
    return np.where(told >= 0.5, actions[:, order], actions)


def seeds_of(lab: Lab, case: Case) -> list[int]:
    """Return the seeds of which all kinds of policies are there."""
    seeds = SEEDS[:1] if lab.quick else SEEDS
    return [
        s for s in seeds if lab.retrain or all(available(training(case, kind), s) for kind in kinds_of(case))
    ]


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    wanted = {case: seeds_of(lab, case) for case in CASES}
    lab.expect(sum(map(len, wanted.values())))
    found = {case: [_study(lab, case, seed) for seed in seeds] for case, seeds in wanted.items()}
    return findings({case: runs for case, runs in found.items() if runs})


def _study(lab: Lab, case: Case, seed: int) -> dict[str, np.ndarray]:
    """Return time after the change [s], success at it and the share of solved steps after it.

    Shapes (steps,), (policies, steps) and (policies, episodes); `falls` has success before, drop and time of
    recovery, shape (policies, 3).
    """
    task, change = case
    policies = {BASELINE: load_baseline(task).checkpoint}
    policies |= {kind: lab.policy(training(case, kind), seed) for kind in kinds_of(case)}
    episodes = QUICK_EPISODES if lab.quick else adaptation.EPISODES

    def measure(tick: Tick) -> dict[str, np.ndarray]:
        asked = Setup(task=task, conditions=(change_of(case),), physics="parity", seed=EVALUATION_SEED)
        setup = complete(asked.over(lab.setup))
        own = {name: Policy(name, checkpoint=checkpoint) for name, checkpoint in policies.items()}
        acting = [
            adaptation.Relieved(name, own[BASELINE], policy) if name == RETRAINED else policy
            for name, policy in own.items()
        ]
        result = adaptation.study(setup, acting, episodes)
        falls = [(p.before, p.drop, p.recovery) for p in result.policies]
        return {
            "seconds": result.seconds,
            "curves": result.curves,
            "shares": result.shares,
            "falls": np.array(falls),
        }

    settings = {
        "task": task,
        "conditions": [str(change_of(case))],
        "seed": EVALUATION_SEED,
        "episodes": episodes,
    }
    return lab.kept(f"{task}-{change}-seed{seed}", settings, measure, *policies.values())


def findings(found: Mapping[Case, list[dict[str, np.ndarray]]]) -> Findings:
    """Return figures of merit, claims and figure, of the runs of each task and change."""
    rows: list[Merit] = []
    lines: list[str] = []
    where: dict[str, list[str]] = {name: [] for name in (*CLAIMS.values(), "kept")}
    for (task, change), runs in found.items():
        case, short = f"{task}, {change}", f"{NAMES[task]} ({change})"
        falls = np.array([own["falls"] for own in runs])  # (seeds, policies, 3)
        after = np.array([own["shares"].mean(axis=1) for own in runs])  # (seeds, policies)
        names = (BASELINE, *kinds_of((task, change)))
        for p, name in enumerate(names):
            who = f"{case}, {name}"
            rows.append(Merit("solved before the change", "%", who, 100.0 * falls[:, p, 0], within=PERCENT))
            rows.append(Merit("drop", "%", who, 100.0 * falls[:, p, 1]))
            rows.append(Merit("time to half of the drop", "s", who, falls[:, p, 2]))
            rows.append(Merit("solved after the change", "%", who, 100.0 * after[:, p], within=PERCENT))
        for name in names[1:]:
            over = BASELINE if name == BLIND else BLIND
            gains = [_gain(own, names.index(name), names.index(over)) for own in runs]
            means = [gain for gain, *_ in gains]
            note = "; ".join(f"{gain:+.2f}, {low:.2f} to {high:.2f}" for gain, low, high in gains)
            what, said = f"gain of {name} over {over}", f"each seed, with its interval over episodes: {note}"
            rows.append(Merit(what, "%", case, means, note=said))
            if all(low > 0.0 for _, low, _ in gains) and (claim := CLAIMS.get(name)):
                where[claim].append(short)
            lines.append(f"* {case}: {name} {np.mean(means):+.2f} points over {over} ({note}).")
        if RETRAINED in names:
            retrained, memory = (after[:, names.index(name)] for name in (RETRAINED, MEMORY))
            if (memory >= KEPT * retrained).all():
                where["kept"].append(short)
    episodes = next(iter(found.values()))[0]["shares"].shape[1]
    seeds = ", ".join(f"{len(runs)} of {NAMES[task]} ({change})" for (task, change), runs in found.items())
    measured = {"lines": "\n".join(lines), "episodes": episodes, "seeds": seeds}
    measured |= {name: ", ".join(cases) or "nobody" for name, cases in where.items()}
    judged = dict.fromkeys(CLAIMS.values(), len(found)) | {"kept": sum(c in WITH_RETRAINED for c in found)}
    holds = {name: len(where[name]) == number if number else None for name, number in judged.items()}
    return Findings(rows, holds, lambda figure: draw(figure, found), measured)


def _gain(own: Mapping[str, np.ndarray], one: int, other: int) -> tuple[float, float, float]:
    """Return the mean gain of a policy over another in the same episodes, with its 95 % interval [%]."""
    pairs = 100.0 * (own["shares"][one] - own["shares"][other])
    return float(pairs.mean()), *mean_interval(pairs, -100.0, 100.0)


def draw(figure: Figure, found: Mapping[Case, list[dict[str, np.ndarray]]]) -> None:
    """Draw success around the change, a panel a task and change."""
    rows = math.ceil(len(found) / 2)
    figure.set_figheight(3.2 * rows)
    panels = figure.subplots(rows, min(2, len(found)), squeeze=False).ravel()
    for axes in panels[len(found) :]:
        axes.set_visible(False)
    for axes, ((task, change), runs) in zip(panels, found.items(), strict=False):
        seconds = runs[0]["seconds"]
        lasts = np.isfinite(runs[0]["curves"]).all(axis=0)
        for p, (name, color) in enumerate(zip((BASELINE, *kinds_of((task, change))), INKS, strict=False)):
            curves = 100.0 * np.array([own["curves"][p] for own in runs])[:, lasts]
            panel.band(axes, seconds[lasts], panel.extent(curves), color=color, alpha=0.15, label=name)
        axes.axvline(0.0, color=panel.INK, linewidth=0.8, linestyle=":")
        axes.set(
            title=f"{NAMES[task]}, {change}",
            xlabel="time after the change [s]",
            ylabel="episodes that are solved [%]",
        )
    panels[0].legend(loc="lower right")


EXPERIMENT = Experiment("adaptation", run, ignores=("models", "seeds", "num_worlds"))

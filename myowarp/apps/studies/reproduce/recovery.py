"""Recovery: three days of work with fatigue that is carried over, in patients who recover ever slower."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.policies.checkpoint import Checkpoint
from myowarp.apps.reports import panel
from myowarp.apps.reports.result import Merit, merits
from myowarp.apps.rollouts.run import run as roll
from myowarp.apps.studies.reproduce.arm import CONTROL_DT, HEALTHY, MUSCLES, arms, follow
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab, Tick
from myowarp.inks import BLUE, GREEN, ORANGE, PINK, VERMILION
from myowarp.models.bodies.arm_muscles import ELBOW_FLEXOR, FATIGUE_RATES
from myowarp.models.conditions import Fatigue3CCR, Load
from myowarp.sim.signals import Signals
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import get_state, set_state

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DAYS, SHIFTS = 3, (8.0, 12.0, 16.0)  # h
A, B, PHASE = 30.0, 90.0, 2.0  # deg, deg, s
ROUNDS, QUICK_ROUNDS = 10, 1
LOADS = (4.0, 2.0)  # kg
SLOWEST = 1e-3  # of the published recovery rate
CHECK = 20.0  # s, a pause that is simulated as well
CLOSE = 2e-3  # of M_F: the least command, 0.0006, is not quite rest
SHOWN = (1.0, 0.1, 0.01, 0.001)  # factors in the table
UNITS = "condition.fatigue_3ccr."


def factors(number: int) -> np.ndarray:
    """Return the factors of the recovery rate, shape (number,)."""
    return np.geomspace(1.0, SLOWEST, number)


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    policies = [lab.policy(HEALTHY, seed) for seed in lab.seeds]
    rounds = QUICK_ROUNDS if lab.quick else ROUNDS
    lab.expect(len(lab.seeds))
    results = []
    for seed, policy in zip(lab.seeds, policies, strict=True):
        settings = {
            "seed": seed,
            "num_worlds": lab.num_worlds,
            "rounds": rounds,
            "loads": LOADS,
            "days": DAYS,
        }

        def measure(tick: Tick, seed: int = seed, policy: Checkpoint = policy) -> dict[str, np.ndarray]:
            return live(lab, seed, policy, rounds, tick)

        results.append(lab.kept(f"days-seed{seed}", settings, measure, policy))
    return findings(results, factors(lab.num_worlds))


def live(lab: Lab, seed: int, policy: Checkpoint, rounds: int, tick: Tick) -> dict[str, np.ndarray]:
    """Let patients live; shapes (shifts, loads, patients), of the flexors' mean fatigue and of the error."""
    n = lab.num_worlds
    slower = np.tile(factors(n), len(LOADS))
    rates = np.outer(slower, [FATIGUE_RATES[muscle].recovery_rate for muscle in MUSCLES])
    sim = arms((Fatigue3CCR(recovery_rate=rates), Load(np.repeat(LOADS, n))), n * len(LOADS), lab.setup)
    signals = Signals(sim)
    sim.reset(seeds=1000 * (seed + 1) + np.tile(np.arange(n), len(LOADS)))
    rest(sim, rates, 0.0)  # every shift begins with the arm hanging
    targets, shifts = np.array([[A], [B]] * rounds), DAYS * len(SHIFTS)
    before, after, error = [], [], []
    for shift in range(shifts):
        before.append(flexors(sim))
        done = shift / shifts
        trace = follow(
            signals,
            [(policy, slice(None))],
            None,
            targets,
            PHASE,
            lambda share, done=done: tick(done + share / shifts),  # type: ignore[misc]
        )
        after.append(flexors(sim))
        error.append(trace.error.mean(axis=0))
        rest(sim, rates, 3600.0 * pause(shift) - len(trace.error) * CONTROL_DT)
    shape = (shifts, len(LOADS), n)
    found = {"before": before, "after": after, "error": error}
    arrays = {name: np.array(values, dtype=np.float32).reshape(shape) for name, values in found.items()}
    return arrays | {"jump": np.array(jump_error(signals, policy, rates, targets))}


def pause(shift: int) -> float:
    """Return hours from the begin of a shift to that of the next one, which may be tomorrow's."""
    now, then = SHIFTS[shift % len(SHIFTS)], SHIFTS[(shift + 1) % len(SHIFTS)]
    return then - now if then > now else then - now + 24.0


def flexors(sim: Simulation) -> np.ndarray:
    """Return the mean fatigued fraction of the flexors, shape (num_worlds,)."""
    return sim.info["fatigue"].numpy()[:, 3:].mean(axis=1)


def rest(sim: Simulation, rates: np.ndarray, seconds: float) -> None:
    """Let the arms hang for a time, in one jump.

    Args:
        sim: The arms.
        rates: Recovery rates R of worlds and muscles [1/s].
        seconds: How long.
    """
    state = get_state(sim)
    faster = np.array([FATIGUE_RATES[muscle].rest_recovery_factor for muscle in MUSCLES])
    left = (1.0 - np.minimum(faster * rates * CONTROL_DT, 1.0)) ** round(seconds / CONTROL_DT)
    tired = state.arrays[UNITS + "fatigued_fraction"] * left
    state.arrays[UNITS + "fatigued_fraction"] = tired.astype(np.float32)
    state.arrays[UNITS + "resting_fraction"] = (1.0 - tired).astype(np.float32)
    for name in ("active_fraction", "rounding"):
        state.arrays[UNITS + name] = np.zeros_like(state.arrays[UNITS + name])
    for name in ("data.qpos", "data.qvel", "muscles.activation"):
        state.arrays[name] = np.zeros_like(state.arrays[name])
    set_state(sim, state)


def jump_error(signals: Signals, policy: Checkpoint, rates: np.ndarray, targets: np.ndarray) -> float:
    """Return the largest difference of M_F between a rest that is simulated and the same in one jump."""
    sim = signals.sim
    follow(signals, [(policy, slice(None))], None, targets[:2], PHASE)
    start = get_state(sim)
    rest(sim, rates, CHECK)
    jumped = sim.info["fatigue"].numpy().copy()
    set_state(sim, start)
    rest_action = np.full(sim.action.shape, -1.0, np.float32)
    roll(sim, lambda obs: rest_action, round(CHECK / CONTROL_DT), fresh=False, again=False)
    return float(np.abs(sim.info["fatigue"].numpy() - jumped).max())


def findings(results: list[dict[str, np.ndarray]], slower: np.ndarray) -> Findings:
    """Return figures of merit, claims and figure."""
    before, after, error = (np.array([r[name] for r in results]) for name in ("before", "after", "error"))
    morning = (DAYS - 1) * len(SHIFTS)
    rows = []
    for factor in SHOWN:
        p = int(np.abs(np.log(slower / factor)).argmin())
        rows += merits(
            [f"recovery at {factor:g} of the rate, {load:g} kg" for load in LOADS],
            ("fatigued fraction, third morning", "%", 100.0 * before[:, morning, :, p].T),
            ("fatigued fraction, last evening", "%", 100.0 * after[:, -1, :, p].T),
            ("growth of the error, first to last shift", "°", (error[:, -1, :, p] - error[:, 0, :, p]).T),
        )
    half = np.log(2.0) / (ELBOW_FLEXOR.rest_recovery_factor * ELBOW_FLEXOR.recovery_rate)
    who, note = "flexors, published rates", "closed form, ln 2 / (r R)"
    rows.append(Merit("half-life of fatigue at rest", "s", who, [half], note=note))
    jump = [float(r["jump"]) for r in results]
    rows.append(Merit("M_F after 20 s of rest: jump against simulation", "1", "largest difference", jump))
    carried = before[:, morning].mean(axis=0)  # (loads, patients)
    lasting = carried[0] > 0.01
    threshold = slower[lasting.argmax()] if lasting.any() else np.nan
    what = "fastest recovery that leaves 1 % for the third morning"
    note = "factor of the published rate; mean over seeds"
    rows.append(Merit(what, "1", "4 kg", [threshold], note=note))
    evenings = after[:, len(SHIFTS) - 1 :: len(SHIFTS), :, -1]
    holds = {
        "published": before[:, 1:, :, 0].max() < 1e-3,
        "slower": (np.diff(carried, axis=1) >= -1e-6).all(),
        "slowest": (np.diff(evenings, axis=1) > 0.0).all(),
        "jump": max(jump) < CLOSE,
    }
    measured = {"number": len(results), "slower": 1.0 / threshold, "half": half}
    return Findings(rows, holds, lambda figure: draw(figure, before, after, error, slower), measured)


def draw(
    figure: Figure, before: np.ndarray, after: np.ndarray, error: np.ndarray, slower: np.ndarray
) -> None:
    """Draw fatigue over three days, and what recovery does to fatigue and error."""
    figure.set_size_inches(8.0, 6.0)
    grid = figure.add_gridspec(2, 2)
    days, tired, errors = (figure.add_subplot(grid[place]) for place in ((0, slice(None)), (1, 0), (1, 1)))
    hours = np.array([24.0 * day + hour for day in range(DAYS) for hour in SHIFTS])
    colors = (GREEN, BLUE, ORANGE, PINK)
    for factor, color in zip(SHOWN, colors, strict=True):
        p = int(np.abs(np.log(slower / factor)).argmin())
        rate = ELBOW_FLEXOR.rest_recovery_factor * ELBOW_FLEXOR.recovery_rate * slower[p] * 3600.0
        for i, begin in enumerate(hours):
            end = hours[i + 1] if i + 1 < len(hours) else 24.0 * DAYS
            resting = np.concatenate(([0.0], np.geomspace(1e-3, end - begin, 60)))
            low, peak = (100.0 * values[:, i, 0, p].mean() for values in (before, after))
            days.plot([begin, begin], [low, peak], color=color)
            label = f"recovery x {factor:g}" if i == 0 else None
            days.plot(begin + resting, peak * np.exp(-rate * resting), color=color, label=label)
    days.set(title="4 kg: fatigued motor units, flexors", xlabel="hour", ylabel="%")
    days.set_xticks(range(0, 24 * DAYS + 1, 12))
    morning = (DAYS - 1) * len(SHIFTS)
    for w, (load, color) in enumerate(zip(LOADS, (VERMILION, BLUE), strict=True)):
        for values, style, label in (
            (before[:, morning, w], "-", f"{load:g} kg, third morning"),
            (after[:, -1, w], "--", f"{load:g} kg, last evening"),
        ):
            panel.band(
                tired, slower, 100.0 * panel.extent(values), style, color=color, alpha=0.12, label=label
            )
        grown = panel.extent(error[:, -1, w] - error[:, 0, w])
        panel.band(errors, slower, grown, color=color, label=f"{load:g} kg")
    for axes in (tired, errors):
        axes.set(xlabel="recovery, times the published rate", xscale="log", xlim=(SLOWEST, 1.0))
        axes.invert_xaxis()
    for axes in (days, tired, errors):
        axes.legend(fontsize=7, loc="upper left")
    tired.set(title="fatigued motor units, flexors", ylabel="%")
    errors.set(title="error, last minus first shift", ylabel="°")


EXPERIMENT = Experiment("recovery", run)

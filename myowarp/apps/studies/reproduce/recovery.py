"""Recovery: three days of work with fatigue that is carried over, for patients who recover slower and slower.

Beyond the paper, whose fatigue never recovers. Every world is a patient of its own whose motor units (3CC-r)
recover at the published rate or slower, down to a thousandth, evenly in its logarithm.

* A day has three shifts, at 8, 12 and 16 o'clock. In a shift the arm moves 4 kg between 30 and 90 degrees,
  2 s at each, for 40 s (4 s with --quick). It is simulated in full, with the healthy policy.
* Between shifts and at night the arm hangs and rests. A resting muscle's M_A is 0 and its M_F shrinks by the
  factor 1 - r R dt in every control step, so that a pause of n steps is one multiplication by its n-th power:
  the state is taken, M_F multiplied, and set. A pause of 20 s is simulated, too, and compared.
* The same patients, with a load of 2 kg, show whether the conclusion hangs on the load.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.policies.checkpoint import Checkpoint
from myowarp.apps.rollouts.run import run as roll
from myowarp.apps.studies.reproduce.arm import CONTROL_DT, HEALTHY, MUSCLES, arms, follow
from myowarp.apps.studies.reproduce.experiment import Experiment, Lab, Tick
from myowarp.apps.studies.reproduce.result import Claim, Findings, Merit
from myowarp.models.conditions import Fatigue3CCR, Load
from myowarp.models.conditions.fatigue_3ccr import ELBOW_FLEXOR, rates_of
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
    rates = np.outer(slower, [rates_of(muscle).recovery_rate for muscle in MUSCLES])
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
    faster = np.array([rates_of(muscle).rest_recovery_factor for muscle in MUSCLES])
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
    merits = []
    for factor in SHOWN:
        p = int(np.abs(np.log(slower / factor)).argmin())
        for w, load in enumerate(LOADS):
            who = f"recovery at {factor:g} of the rate, {load:g} kg"
            merits.append(
                Merit("fatigued fraction, third morning", "%", who, tuple(100.0 * before[:, morning, w, p]))
            )
            merits.append(
                Merit("fatigued fraction, last evening", "%", who, tuple(100.0 * after[:, -1, w, p]))
            )
            grown = error[:, -1, w, p] - error[:, 0, w, p]
            merits.append(Merit("growth of the error, first to last shift", "°", who, tuple(grown)))
    half = np.log(2.0) / (ELBOW_FLEXOR.rest_recovery_factor * ELBOW_FLEXOR.recovery_rate)
    note = "closed form, ln 2 / (r R)"
    merits.append(
        Merit("half-life of fatigue at rest", "s", "flexors, published rates", (half,), None, None, note)
    )
    jump = tuple(float(r["jump"]) for r in results)
    merits.append(Merit("M_F after 20 s of rest: jump against simulation", "1", "largest difference", jump))
    carried = before[:, morning].mean(axis=0)  # (loads, patients)
    threshold = [slower[np.flatnonzero(one > 0.01)[0]] if (one > 0.01).any() else np.nan for one in carried]
    merits.append(
        Merit(
            "fastest recovery that leaves 1 % for the third morning",
            "1",
            "4 kg",
            (float(threshold[0]),),
            None,
            None,
            "factor of the published rate; mean over seeds",
        )
    )
    claims = (
        Claim(
            "At the published rates nothing is carried over from one shift to the next.",
            bool(before[:, 1:, :, 0].max() < 1e-3),
        ),
        Claim(
            "The slower the recovery, the more fatigue is there in the third morning, with either load.",
            bool((np.diff(carried, axis=1) >= -1e-6).all()),
        ),
        Claim(
            "At a thousandth of the rate every evening is worse than the one before, in every seed.",
            bool((np.diff(after[:, len(SHIFTS) - 1 :: len(SHIFTS), :, -1], axis=1) > 0.0).all()),
        ),
        Claim("A pause in one jump is the pause that is simulated, to 0.002 of M_F.", max(jump) < CLOSE),
    )
    return Findings(tuple(merits), claims, TEXT, lambda figure: draw(figure, before, after, error, slower))


TEXT = """
The paper has nothing to compare with; its model of fatigue never recovers, so that a day in it has no
second shift. In 3CC-r with the published rates the flexors' fatigue halves within half a minute of rest: an
hour's pause erases everything, and days do not add up. Fatigue that lasts for hours or days, as after
eccentric work or in post-viral disease, is outside of what these rates were fitted to. The map says how
much slower recovery must be before a night is too short: about a hundred to a thousand times.
"""


def draw(
    figure: Figure, before: np.ndarray, after: np.ndarray, error: np.ndarray, slower: np.ndarray
) -> None:
    """Draw fatigue over three days, and what recovery does to fatigue and error."""
    figure.set_size_inches(8.0, 3.6)
    axes = figure.subplots(1, 3, gridspec_kw={"width_ratios": (1.5, 1.0, 1.0)})
    hours = np.array([24.0 * day + hour for day in range(DAYS) for hour in SHIFTS])
    colors = ("#3f9b63", "#4a90c8", "#d9822b", "#b5446e")
    for factor, color in zip(SHOWN, colors, strict=True):
        p = int(np.abs(np.log(slower / factor)).argmin())
        rate = ELBOW_FLEXOR.rest_recovery_factor * ELBOW_FLEXOR.recovery_rate * slower[p] * 3600.0
        for i, begin in enumerate(hours):
            end = hours[i + 1] if i + 1 < len(hours) else 24.0 * DAYS
            rest_hours = np.concatenate(([0.0], np.geomspace(1e-3, end - begin, 60)))
            peak = after[:, i, 0, p].mean()
            axes[0].plot([begin, begin], [100.0 * before[:, i, 0, p].mean(), 100.0 * peak], color=color)
            label = f"recovery x {factor:g}" if i == 0 else None
            axes[0].plot(
                begin + rest_hours, 100.0 * peak * np.exp(-rate * rest_hours), color=color, label=label
            )
    axes[0].set(title="4 kg: fatigued motor units, flexors", xlabel="hour", ylabel="%")
    axes[0].set_xticks(range(0, 24 * DAYS + 1, 12))
    axes[0].legend(fontsize=7)
    morning = (DAYS - 1) * len(SHIFTS)
    for w, (load, color) in enumerate(zip(LOADS, ("#b5446e", "#4a90c8"), strict=True)):
        for values, style, label in (
            (before[:, morning, w], "-", f"{load:g} kg, third morning"),
            (after[:, -1, w], "--", f"{load:g} kg, last evening"),
        ):
            axes[1].plot(slower, 100.0 * values.mean(axis=0), style, color=color, label=label)
        grown = error[:, -1, w] - error[:, 0, w]
        axes[2].plot(slower, grown.mean(axis=0), color=color, label=f"{load:g} kg")
        axes[2].fill_between(
            slower, grown.min(axis=0), grown.max(axis=0), color=color, alpha=0.2, linewidth=0
        )
    for panel in axes[1:]:
        panel.set(xlabel="recovery, times the published rate", xscale="log")
        panel.invert_xaxis()
        panel.legend(fontsize=7)
    axes[1].set(title="fatigued motor units", ylabel="%")
    axes[2].set(title="error, last minus first shift", ylabel="°")


EXPERIMENT = Experiment(
    "recovery",
    "Recovery: three days of work with fatigue that is carried over",
    "beyond the paper, whose fatigue does not recover.",
    run,
)

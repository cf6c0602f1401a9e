"""The table of results in README.md, from the committed measurements: python -m benchmarks.readme."""

from statistics import fmean
from typing import Any

from benchmarks.result_pages import ROOT, TEXTS, rates, read, renewed
from myowarp.apps.policies.baselines import load_baseline
from myowarp.disk import in_place
from myowarp.kernels.episode import MYOSUITE

README = ROOT / "README.md"
EASY = (
    *("myoElbowPose1D6MFixed-v0", "myoElbowPose1D6MRandom-v0", "myoFingerPoseFixed-v0"),
    *("myoFingerPoseRandom-v0", "myoFingerReachFixed-v0", "myoHandPoseFixed-v0", "myoHandReachFixed-v0"),
    *("myoHandKeyTurnFixed-v0", "myoHandObjHoldFixed-v0", "myoHandPenTwirlFixed-v0"),
)
HARD = {
    "myoHandObjHoldRandom-v0": "object hold",
    "myoFingerReachRandom-v0": "finger reach",
    "myoHandReachRandom-v0": "hand reach",
    "myoHandPenTwirlRandom-v0": "pen twirl",
    "myoHandPoseRandom-v1": "hand pose (`-v1`)",
    "myoHandKeyTurnRandom-v0": "key turn",
}
LEARNED = 95.0  # percent of the episodes
ALIKE = 1e-5


def success(task: str, actions: str = "deterministic") -> list[float]:
    """Return success of all seeds under parity by MyoSuite's rule [%]."""
    return [100.0 * run["evaluation"][actions][MYOSUITE] for run in load_baseline(task).runs]


def exception(task: str) -> str:
    """Return how an easy task falls short."""
    own, drawn = success(task), success(task, "sampled")
    low = sum(value < LEARNED for value in own)
    return (
        f"`{task}`: {low} of {len(own)} seeds fails ({min(own):.0f} %; with drawn actions "
        f"{drawn[own.index(min(own))]:.0f} %)"
    )


def speed() -> dict[str, float]:
    """Return the rate of hands that reach, and ratios of medians under `parity`."""
    rivals = read("rivals")
    families = {family: rates(row) for family, row in rivals["families"].items()}
    hand, pool = families["hand reach"], [row["parity 256"] / row["MuJoCo C"] for row in families.values()]
    return {
        "rate": float(f"{hand['parity 256']:.2g}"),
        "pool": hand["parity 256"] / hand["EnvPool"],
        "suite": hand["parity 256"] / hand["MyoSuite"],
        "slowest": min(pool),
        "fastest": max(pool),
        "rounds": rivals["rounds"],
        "families": len(pool),
    }


def learning() -> dict[str, Any]:
    """Return what trained policies reach."""
    easy = {task: success(task) for task in EASY}
    good = [min(own) for own in easy.values() if min(own) >= LEARNED]
    counts = [len(own) for own in easy.values()]
    walking = [run["evaluation"]["deterministic"] for run in load_baseline("myoLegWalk-v0").runs]
    hard = ", ".join(f"{name} {fmean(own := success(task)):.0f} ({len(own)})" for task, name in HARD.items())
    return {
        "easy": len(easy),
        "good": len(good),
        "least": min(good),
        "exception": "".join("; " + exception(task) for task in easy if min(easy[task]) < LEARNED),
        "seeds": f"{min(counts)} to {max(counts)}",
        "hard": hard,
        "speed": walking[0]["speed"],
        "cost": walking[0]["bhargava2004_per_kg_m"],
        "walkers": len(walking),
    }


def parity() -> dict[str, float]:
    """Return how many of MyoSuite's ids are repeated to 1e-5, of how many, and the worst reward's error."""
    found = [
        {name: error for name, error in row.items() if name.startswith(("observation", "reward"))}
        for row in read("parity")["worst"].values()
    ]
    rewards = (error for row in found for name, error in row.items() if name.startswith("reward"))
    return {
        "ids": len(found),
        "alike": sum(max(row.values()) <= ALIKE for row in found),
        "worst": max(rewards),
    }


def opensim() -> dict[str, float]:
    """Return how near OpenSim's gait2354 is [%, degrees], and the speed of its static optimisation."""
    muscles = read("opensim_muscles")["models"]["gait2354_simbody"]
    angles = [motion["angles [degrees]"] for motion in muscles["forward"]["opensim"].values()]
    trial = next(row for row in read("opensim_motion")["models"] if row["model"] == "gait2354, public trial")
    times = read("motion")
    whole = "paths and static optimisation"
    return {
        "torque": 100.0 * muscles["joint torque of all muscles"]["worst"],
        "acceleration": 100.0
        * read("opensim_accelerations")["models"]["gait2354_simbody"]["step_float32"]["median"],
        "motion": max(angle["median"] for angle in angles),
        "toes": max(angle["worst"] for angle in angles),
        "forces": 100.0 * trial["forces / peak"],
        "frames": float(f"{1.0 / times['myowarp'][whole]['wall']:.2g}"),
        "faster": float(f"{times['opensim'][whole] / times['myowarp'][whole]['wall']:.2g}"),
    }


def page() -> str:
    """Return README with the results made anew."""
    text = (TEXTS / "readme.md").read_text()
    return renewed(README, "benchmarks.readme", text.format(**speed(), **learning(), **opensim(), **parity()))


if __name__ == "__main__":
    with in_place(README) as scratch:
        scratch.write_text(page())

"""Speed and learning in README.md, from the committed measurements: python -m benchmarks.readme."""

import json
from pathlib import Path
from textwrap import fill

from myowarp.apps.policies.baselines import load_baseline
from myowarp.disk import in_place
from myowarp.kernels.episode import MYOSUITE

ROOT = Path(__file__).parents[1]
README, RESULTS = ROOT / "README.md", ROOT / "benchmarks/results"
BEGIN, END = "<!-- written by: python -m benchmarks.readme -->\n", "<!-- end of what is written -->"
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

TEXT = """
- 256 hands that reach make {own:,.0f} control steps a second on two cores: {pool:.1f} times as many as in
  EnvPool, and {async_env:.1f} times as many as in MyoSuite's AsyncVectorEnv (MyoSuite's integrator and
  step, random actions, medians of five rounds). All nine families make {slowest:.1f} to {fastest:.1f} times
  the steps of MuJoCo C's thread pool on the same cores ([speed](docs/speed.md)).
- Trained policies, 256 episodes each without exploration noise, MyoSuite's rule (more than 5 solved steps):
  {good} of {easy} easy tasks have at least {least:.0f} % in every training run ({seeds[0]} to {seeds[1]}
  seeds){but}. Hard tasks, means over seeds [%]: {hard}. Legs walk 10 s ({walkers} training run) at {walk},
  where 1.2 m/s is asked and a person spends a tenth. [Baselines](docs/baselines.md) has every seed, and what
  fails.
"""
LEARNED = 95.0  # percent of the episodes
WIDTH = 118
WHOLE = {"break_long_words": False, "break_on_hyphens": False}


def success(task: str, actions: str = "deterministic", rule: str = MYOSUITE) -> list[float]:
    """Return success of all seeds under parity [%]."""
    return [100.0 * run["evaluation"][actions][rule] for run in load_baseline(task).runs]


def exception(task: str) -> str:
    """Return how an easy task falls short."""
    own, drawn = success(task), success(task, "sampled")
    low = sum(value < LEARNED for value in own)
    return (
        f"; in `{task}` {low} of {len(own)} runs fails ({min(own):.0f} %, though "
        f"{drawn[own.index(min(own))]:.0f} % with exploration noise)"
    )


def results() -> str:
    """Return the list of results."""
    families = json.loads((RESULTS / "rivals.json").read_text())["families"]

    def ratio(family: str, rival: str) -> float:
        """Return by how much 256 worlds are faster under `parity`: of medians, as in docs/speed.md."""
        rows = families[family]["contestants"]
        ours, theirs = (rows[who]["env_steps_per_s"]["median"] for who in ("parity 256", rival))
        return float(ours / theirs)

    pool = [ratio(family, "MuJoCo C") for family in families]
    easy = {task: success(task) for task in EASY}
    means = {name: sum(own) / len(own) for task, name in HARD.items() for own in [success(task)]}
    hard = ", ".join(f"{name} {mean:.0f}" for name, mean in means.items())
    seeds = [len(own) for own in easy.values()]
    walking = [run["evaluation"]["deterministic"] for run in load_baseline("myoLegWalk-v0").runs]
    good = {task: min(own) for task, own in easy.items() if min(own) >= LEARNED}
    hands = families["hand reach"]["contestants"]["parity 256"]["env_steps_per_s"]["median"]
    text = TEXT.format(
        own=float(f"{hands:.2g}"),
        pool=ratio("hand reach", "EnvPool"),
        async_env=ratio("hand reach", "MyoSuite async"),
        slowest=min(pool),
        fastest=max(pool),
        easy=len(easy),
        good=len(good),
        least=min(good.values()),
        but="".join(exception(task) for task in easy if task not in good),
        seeds=(min(seeds), max(seeds)),
        hard=hard,
        walk="{speed:.2f} m/s, {bhargava2004_per_kg_m:.0f} J/kg/m".format(**walking[0]),
        walkers=len(walking),
    )
    bullets = (" ".join(bullet.split()) for bullet in text.split("\n- ")[1:])
    return "\n" + "".join(
        f"{fill('- ' + bullet, WIDTH, subsequent_indent='  ', **WHOLE)}\n" for bullet in bullets
    )


def page() -> str:
    """Return README with the results made anew."""
    before, _, rest = README.read_text().partition(BEGIN)
    return before + BEGIN + results() + "\n" + END + rest.partition(END)[2]


if __name__ == "__main__":
    with in_place(README) as scratch:
        scratch.write_text(page())

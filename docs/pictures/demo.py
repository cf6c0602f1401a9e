"""A trained hand turns a key; beside it the same hand, same state, with a third of its strength: demo.gif.

    python docs/pictures/demo.py

README begins with it, and `myowarp demo` names it where no browser opens.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from myowarp.apps.policies.baselines import load_baseline
from myowarp.apps.policies.learned import LearnedPolicy
from myowarp.apps.rollouts.beside import Beside
from myowarp.apps.rollouts.film import Film
from myowarp.apps.rollouts.run import run
from myowarp.definitions.setup import Setup
from myowarp.sim.simulation import Simulation
from myowarp.view.drawing.render import tiled
from myowarp.view.drawing.video import write_video

TASK, STRENGTH = "myoHandKeyTurnFixed-v0", 1 / 3
SIZE = (450, 300)  # px of each hand
STEPS, EVERY = 80, 2  # control steps that are shown, and from frame to frame
LAST = 20  # frames that the end stays


def main() -> None:
    """Film both hands."""
    weak = f"sarcopenia(strength={STRENGTH:.2f})"
    titles = {"trained hand": (), f"the same hand, strength {100 * STRENGTH:.0f} %": (weak,)}
    setups = [Setup(task=TASK, device="cpu", seed=1, conditions=own) for own in titles.values()]
    sims = [Simulation(setup, 1, progress=False, autoreset="disabled") for setup in setups]
    films = [Film(sim, [0], SIZE, title=title, legend=True) for sim, title in zip(sims, titles, strict=True)]
    act, other = (LearnedPolicy(load_baseline(TASK).checkpoint, setup) for setup in setups)
    run(sims[0], act, STEPS, films[0], Beside(sims[0], sims[1], other, films[1]), again=False)
    rate = 1.0 / sims[0].scene.control_dt / EVERY
    write_video(Path(__file__).with_suffix(".gif"), frames(films), rate)


def frames(films: list[Film]) -> Iterator[np.ndarray]:
    """Yield both hands side by side; the end stays for a while."""
    pairs = zip(*(film.tiles() for film in films), strict=True)
    pair = np.zeros(())
    for step, tiles in enumerate(pairs):
        if step % EVERY == 0:
            pair = tiled([tile for own in tiles for tile in own], 2)
            yield pair
    for _ in range(LAST):
        yield pair


if __name__ == "__main__":
    main()

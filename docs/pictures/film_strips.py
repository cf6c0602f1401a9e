"""What trained hands and legs do, a row of pictures for each task: strips.png.

    python docs/pictures/film_strips.py

Policies of the package in their tasks, with drawn actions: hold and pen were learned with noise and need it.
"""

from pathlib import Path

from myowarp.apps.policies.baselines import load_baseline
from myowarp.apps.policies.learned import LearnedPolicy
from myowarp.apps.rollouts.film import Film
from myowarp.apps.rollouts.run import run
from myowarp.definitions.setup import Setup
from myowarp.progress import progress_bar
from myowarp.sim.simulation import Simulation
from myowarp.view.drawing.render import tiled
from myowarp.view.drawing.video import write_picture

SIZE = (260, 210)  # px of a tile
TASKS = {  # control steps that are shown
    "myoHandPoseFixed-v0": (0, 10, 22, 35, 60, 100),
    "myoHandReachFixed-v0": (0, 3, 6, 12, 30, 100),
    "myoHandKeyTurnFixed-v0": (0, 8, 16, 24, 40, 100),
    "myoHandObjHoldFixed-v0": (0, 3, 6, 12, 30, 75),
    "myoHandPenTwirlFixed-v0": (0, 10, 20, 30, 40, 50),
    "myoLegWalk-v0": (0, 20, 40, 60, 80, 1000),
}


def main() -> None:
    """Draw the strips."""
    rows = []
    with progress_bar("Drawing", "tasks") as bar:
        for task, steps in bar.track(TASKS.items()):
            sim = Simulation(Setup(task=task, device="cpu"), 1, progress=False, autoreset="disabled")
            film = Film(sim, [0], SIZE, title=task)
            act = LearnedPolicy(load_baseline(task).checkpoint, Setup(seed=1))
            run(sim, act, steps[-1], film, again=False)
            frames = [tiles[0] for tiles in film.tiles()]
            rows += [frames[min(step, len(frames) - 1)] for step in steps]
            film.close()
            sim.close()
    write_picture(Path(__file__).parent / "strips.png", tiled(rows, 6))


if __name__ == "__main__":
    main()

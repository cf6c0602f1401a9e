"""Every body and every task family in a picture, and all of them in bodies.png.

    python docs/pictures/contact_sheet.py

Each picture shows a world after some random actions.
"""

from pathlib import Path

import numpy as np

from myowarp.apps.rollouts.film import Film
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.body import BODIES
from myowarp.definitions.task import TASKS
from myowarp.progress import progress_bar
from myowarp.tasks.from_file import pose_task
from myowarp.view.drawing.render import tiled
from myowarp.view.drawing.video import write_picture

SIZE = (400, 300)  # px of a tile
COLUMNS = 4
STEPS = 12
PICTURES = Path(__file__).parent


def scenes() -> list[str]:
    """Return one task for each family and body: the newest version of a random one, or random poses."""
    for body in set(BODIES) - {TASKS[key].body for key in TASKS}:
        pose_task(Path(body))
    best: dict[tuple[str, str], str] = {}
    for key in sorted(TASKS, key=lambda key: ("Random" in key or "Rough" in key, key)):
        best[TASKS[key].family, TASKS[key].body] = key
    return [best[pair] for pair in sorted(best)]


def picture(task: str) -> np.ndarray:
    """Return the picture of a world of a task."""
    env = MyoWarpVectorEnv(task, 1, device="cpu", progress=False)
    film = Film(env.sim, [0], SIZE)
    env.reset(seed=1)
    action = np.random.default_rng(1).uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
    for _ in range(STEPS):
        env.step(action)
    film.add()
    film.captions = [[[task]]]
    image = next(film.tiles())[0]
    film.close()
    env.close()
    return image


def main() -> None:
    """Draw the sheet."""
    with progress_bar("Drawing", "tasks") as bar:
        tiles = {task: picture(task) for task in bar.track(scenes())}
    for task, tile in tiles.items():
        write_picture(PICTURES / f"{TASKS[task].family}_{TASKS[task].body}.png", tile)
    write_picture(PICTURES / "bodies.png", tiled(list(tiles.values()), COLUMNS))


if __name__ == "__main__":
    main()

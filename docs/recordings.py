"""Bodies that the reader turns while they move, one for each task family: made where the site is built.

A Sphinx extension. `recordings/player.html` is viser's page, which plays the recording that its address
names: `player.html#keyturn` plays `keyturn.js`. So the page is there once, and all of it works without a
server, too.
"""

import re
import tempfile
from pathlib import Path

from sphinx.application import Sphinx

from myowarp.apps.policies.find import acting, find_policy
from myowarp.apps.rollouts.film import Film, write
from myowarp.apps.rollouts.run import run
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS, Shown
from myowarp.sim.simulation import Simulation
from myowarp.tasks.setups import complete

FOLDER, PLAYER = "recordings", "player.html"
HEIGHT = "24rem"
RECORDING = re.compile(r"<script>(window\.__VISER_EMBED_DATA__=.*?)</script>", re.DOTALL)  # viser's own name
CHOOSE = "<script>document.write('<script src=\"' + location.hash.slice(1) + '.js\"></'+'script>')</script>"


def by_family() -> dict[str, Shown]:
    """Return what is shown of each family."""
    return {spec.family: spec.shown for spec in map(TASKS.__getitem__, TASKS) if spec.shown}


def frame(family: str, shown: Shown, root: str) -> str:
    """Return a recording as a part of a page, Markdown.

    Args:
        family: Name of the family.
        shown: What is shown of it.
        root: Way from the page to the site's root, ending in "/", or "".
    """
    return (
        "```{raw} html\n"
        f'<iframe src="{root}{FOLDER}/{PLAYER}#{family}" title="{shown.text}" loading="lazy" '
        f'style="width: 100%; height: {HEIGHT}; border: 1px solid var(--color-background-border)"></iframe>\n'
        f"```\n\n*{shown.text} Drag to turn it, scroll to come nearer; colours: activation of the muscles "
        f"({shown.task}, `--policy {shown.policy}`).*"
    )


def record(shown: Shown, path: Path) -> None:
    """Write a recording as a page of its own."""
    setup = complete(Setup(task=shown.task, device="cpu", seed=1))
    sim = Simulation(setup, 1, progress=False, autoreset="disabled")
    film = Film(sim, [0])
    run(sim, acting(find_policy(shown.policy, setup.spec), sim), shown.steps, film)
    film.frames, film.captions = film.frames[:: shown.every], film.captions[:: shown.every]
    write(path, [film], fps=1.0 / sim.scene.control_dt / shown.every)
    film.close()
    sim.close()


def add(app: Sphinx, error: Exception | None) -> None:
    """Make the recordings that are not there yet, unless `-D recordings=0`."""
    folder = Path(app.outdir) / FOLDER
    missing = {
        family: shown for family, shown in by_family().items() if not (folder / f"{family}.js").exists()
    }
    if error is not None or not missing or not app.config.recordings:
        return
    folder.mkdir(exist_ok=True)
    for family, shown in missing.items():
        with tempfile.TemporaryDirectory() as scratch:
            whole = Path(scratch) / "whole.html"
            record(shown, whole)
            page = whole.read_text()
        (recording,) = RECORDING.findall(page)
        (folder / PLAYER).write_text(RECORDING.sub(lambda _: CHOOSE, page))
        (folder / f"{family}.js").write_text(recording)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.add_config_value("recordings", True, "", bool)
    app.connect("build-finished", add)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

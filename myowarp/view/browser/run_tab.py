"""The tab that says what runs: reward terms, the last seconds, the task, what acts, and colours."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from myowarp.definitions.body import BODIES
from myowarp.view.browser import status as html
from myowarp.view.browser.controls import Controls
from myowarp.view.browser.history import SECONDS
from myowarp.view.browser.session import Session
from myowarp.view.browser.task_tree import place_of, task_tree
from myowarp.view.browser.widgets import Widgets
from myowarp.view.drawing import style as look
from myowarp.view.drawing.muscles import QUANTITIES

FASTEST, SLOWEST = 10.0, 0.05
"""Speeds over real time that can be chosen."""


class RunTab:
    """The tab of the running session."""

    def __init__(self, live: Controls, widgets: Widgets) -> None:
        """Add the controls to the container that is open."""
        self._live, self._gui, session = live, live.server.gui, live.session
        gui = self._gui
        self._terms = gui.add_html(html.terms(session))
        widgets.slide(
            "seconds back",
            "seconds ago",
            (0.0, SECONDS),
            0.1,
            lambda: live.back,
            live.look_back,
            "Shows what was seen so many seconds ago; 0 is now. Looking back pauses.",
        )
        widgets.slide(
            "speed",
            "× real time",
            (SLOWEST, FASTEST),
            0.05,
            lambda: live.speed,
            lambda value: setattr(live, "speed", value),
            "Simulated time over the time that it takes, as far as this machine can.",
        )
        self._add_task(widgets)
        policies = live.choices.policies(session.sim.scene.spec)
        if session.policy not in policies:
            policies = (session.policy, *policies)
        widgets.choose("policy", policies, lambda: session.policy, session.act, "What commands the muscles.")
        self._note = gui.add_markdown(live.choices.note(session.policy, session.sim.scene.spec))
        worlds = [str(world) for world in range(session.twin)]
        if len(worlds) > 1:
            widgets.choose("world", worlds, lambda: str(session.world), lambda name: session.show(int(name)))
        widgets.choose(
            "color", tuple(QUANTITIES), lambda: live.color, self._set_color, "What muscles' colours show."
        )
        self._legend = gui.add_html(html.legend(QUANTITIES[live.color]))
        gui.add_html(html.key(*_marks(live)))
        widgets.tick("camera follows", lambda: live.follow, lambda value: setattr(live, "follow", value))

    def refresh(self) -> None:
        """Show reward terms, and what is to be said of the policy."""
        session = self._live.session
        self._terms.content = html.terms(session)
        note = self._live.choices.note(session.policy, session.sim.scene.spec)
        if self._note.content != note:
            self._note.content = note

    def _add_task(self, widgets: Widgets) -> None:
        """Add the tree of tasks: each list opens what it says, with the newest version."""
        live, session = self._live, self._live.session
        tree = task_tree(live.choices.tasks)
        family, level, version = place_of(session.title)

        def open_level(chosen: str) -> None:
            self._open(next(iter(tree[family][chosen].values())))

        widgets.choose(
            "task",
            tuple(tree),
            lambda: family,
            lambda chosen: self._open(next(iter(next(iter(tree[chosen].values())).values()))),
            "Family and body.",
        )
        widgets.choose(
            "variant",
            tuple(tree[family]),
            lambda: level,
            open_level,
            "Fixed goals are easy, drawn ones hard.",
        )
        if len(versions := tree[family][level]) > 1:
            widgets.choose(
                "version",
                tuple(versions),
                lambda: version,
                lambda chosen: self._open(versions[chosen]),
                "The upstream version is MyoSuite's; the next one corrects it.",
            )
        self._gui.add_markdown(_about(session))

    def _open(self, task: str) -> None:
        """Show another task."""
        self._live.open(task, self._live.session.policy)

    def _set_color(self, color: str) -> None:
        """Change what the colour of a muscle shows."""
        self._live.color = color
        self._legend.content = html.legend(QUANTITIES[color])


def _about(session: Session) -> str:
    """Return what runs: a task, or a model that is looked at, Markdown."""
    if session.file is None:
        return session.sim.scene.spec.summary
    model = Path(*session.file.absolute().parts[-2:])
    return f"The model {model}." + (
        f" Its **{session.held} is held in place**, as if in a harness; `--free` lets the body fall."
        if session.held
        else ""
    )


def _marks(live: Controls) -> tuple[bool, bool, bool, list[tuple[str, np.ndarray]]]:
    """Return whether there are tips, targets and a wanted posture, and names and colours of objects."""
    session = live.session
    model, seen = session.sim.full_model, session.seen(session.world)
    tips = bool(look.tip_sites(model, BODIES[session.sim.scene.spec.body].tips))
    objects = look.mobile_bodies(model) & ~look.limb_trees(model)
    rgba = look.shown_rgba(model)
    found: dict[str, np.ndarray] = {}
    for geom in look.drawn_geoms(model):
        body = int(model.geom_bodyid[geom])
        if objects[body] and model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE:
            name = model.body(body).name.replace("_", " ").lower()
            found.setdefault("wanted pose" if name == "target" else name, rgba[geom, :3])
    asked = session.file is None  # of a model's file no goals are shown
    return tips, asked and bool(seen.goals), asked and seen.ghost is not None, list(found.items())

"""The tab of the body: a slider for each coordinate, moment arms over a coordinate, and the muscles by group.

A model that `myowarp convert` wrote has OpenSim's moment arms in the `report.json` beside it; they are drawn
with ours.
"""

from __future__ import annotations

import html
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from myowarp.definitions.body import BODIES, POINT_JOINTS
from myowarp.definitions.registry import check_choice
from myowarp.inks import BLUE, VERMILION
from myowarp.osim.bundle.bundle import COORDINATES
from myowarp.osim.bundle.couplings import couplings, follow
from myowarp.view.browser.chart import Chart, Curve, as_svg
from myowarp.view.browser.controls import Controls
from myowarp.view.browser.names import spoken
from myowarp.view.browser.readings import jacobian
from myowarp.view.browser.widgets import Widgets
from myowarp.view.drawing import style as look

REACH = np.pi
"""rad or m: ends of the slider of a joint without a range."""
STEPS = 200
POINTS = 61
"""Of a curve."""
WIDTH, HEIGHT = 300, 210
"""px of the chart."""
OURS, THEIRS = BLUE, VERMILION


class BodyTab:
    """The body."""

    def __init__(self, live: Controls, widgets: Widgets) -> None:
        """Add the controls to the container that is open."""
        self._live, self._gui, self._model = live, live.server.gui, live.session.sim.full_model
        model = self._model
        driven = {coupling.joint for coupling in couplings(model)}
        self._joints = [
            joint
            for joint in range(model.njnt)
            if model.jnt_type[joint] in POINT_JOINTS and joint not in driven
        ]
        names = [model.joint(joint).name for joint in self._joints]
        self._curves = OpenSimArms(live.session.file)
        if names and live.session.signals is not None:
            with self._gui.add_folder("moment arm"):
                self._add_arms(names)
        self._sliders: dict[int, Any] = {}
        with self._gui.add_folder("coordinates"):
            for joint, name in zip(self._joints, names, strict=True):
                self._add_slider(widgets, joint, name)
        with self._gui.add_folder("muscles", expand_by_default=False):
            self._gui.add_html(muscle_list(live))
        self._shown: np.ndarray | None = None

    def refresh(self) -> None:
        """Move the sliders to where the body is."""
        qpos = self._qpos()
        if self._shown is not None and np.array_equal(qpos, self._shown):
            return
        self._shown = qpos
        for joint, slider in self._sliders.items():
            slider.value = self._value(joint)

    def _add_slider(self, widgets: Widgets, joint: int, name: str) -> None:
        """Add the slider of a coordinate; one that is moved stops the body."""
        low, high = self._ends(joint)

        def turn(value: float) -> None:
            self._live.look_back(0.0)
            qpos = self._qpos()
            qpos[self._model.jnt_qposadr[joint]] = value / self._scale(joint)
            self._live.session.pose(qpos)

        self._sliders[joint] = widgets.slide(
            name,
            f"{spoken(name)} [{self._unit(joint)}]",
            (low, high),
            float(f"{(high - low) / STEPS:.1g}"),
            lambda: self._value(joint),
            turn,
            f"Puts the body there, at rest. In the model it is called {name}.",
        )

    def _unit(self, joint: int) -> str:
        """Return the unit of a joint's coordinate."""
        return "m" if self._model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE else "°"

    def _scale(self, joint: int) -> float:
        """Return what a slider shows over the joint's coordinate."""
        return 1.0 if self._unit(joint) == "m" else float(np.degrees(1.0))

    def _ends(self, joint: int) -> tuple[float, float]:
        """Return the range of a joint as its slider has it, rounded outwards."""
        low, high = self._model.jnt_range[joint]
        if known := self._curves.ranges.get(self._model.joint(joint).name):
            low, high = known
        elif not self._model.jnt_limited[joint] or not high > low:
            low, high = -REACH, REACH
        figures = 100.0 if self._unit(joint) == "m" else 1.0
        ends = figures * self._scale(joint) * np.array((low, high))
        return float(np.floor(ends[0]) / figures), float(np.ceil(ends[1]) / figures)

    def _qpos(self) -> np.ndarray:
        """Return the configuration of the shown world."""
        session = self._live.session
        return session.sim.scene.data.qpos.numpy()[session.world].astype(float)

    def _value(self, joint: int) -> float:
        """Return where a joint is, within its slider's ends."""
        value = self._scale(joint) * self._qpos()[self._model.jnt_qposadr[joint]]
        return float(np.round(np.clip(value, *self._ends(joint)), 3))

    def _add_arms(self, joints: list[str]) -> None:
        """Add the chart of a muscle's moment arm, and what it is of."""
        muscles = tuple(self._live.session.sim.scene.muscles.names)
        pairs = self._curves.pairs()
        muscle, joint = next(iter(pairs), (muscles[0], joints[0]))
        self._muscle: Any = self._gui.add_dropdown("muscle", muscles, initial_value=muscle)
        self._joint: Any = self._gui.add_dropdown("over", joints, initial_value=joint)
        self._picture = self._gui.add_html("")
        for handle in (self._muscle, self._joint):
            handle.on_update(
                lambda _: self._live.ask("moment arm", lambda: self._draw(muscles, tuple(joints)))
            )
        self._draw(muscles, tuple(joints))

    def _draw(self, muscles: tuple[str, ...], joints: tuple[str, ...]) -> None:
        """Draw the moment arm of the chosen muscle."""
        muscle, joint = self._muscle.value, self._joint.value
        check_choice("muscle", muscle, muscles)
        check_choice("joint", joint, joints)
        number = self._model.joint(joint).id
        low, high = self._ends(number)
        shown = np.linspace(low, high, POINTS)
        along = shown / self._scale(number)
        curves = [Curve("ours", 1e3 * moment_arm(self._model, muscle, joint, along), OURS)]
        theirs = self._curves.of(muscle, joint, along)
        if theirs is not None:
            curves.append(Curve("OpenSim", 1e3 * theirs, THEIRS, (6, 4)))
        chart = Chart(
            "moment arm / mm, others at rest",
            shown,
            curves,
            axis=f"{spoken(joint)} / {self._unit(number)}",
        )
        self._picture.content = f"<div style='padding:0 0.5em'>{as_svg([chart], WIDTH, HEIGHT)}</div>"


class OpenSimArms:
    """OpenSim's moment arms over coordinates, as the report of a converted model has them.

    Attributes:
        ranges: The document's range of each joint's coordinate [rad or m], which need not be a limit.
    """

    def __init__(self, model: Path | None) -> None:
        """Read the report beside a model; without one, or in one of an earlier version, there is nothing."""
        self._along: dict[str, Any] = {}
        self._joints: dict[str, tuple[str, float]] = {}
        self.ranges: dict[str, tuple[float, float]] = {}
        if model is None:
            return
        try:
            report = json.loads(model.with_name("report.json").read_bytes())
            coordinates = json.loads(model.with_name(COORDINATES).read_bytes())["coordinates"]
            self._joints = {entry["joint"]: (entry["name"], float(entry["scale"])) for entry in coordinates}
            scaled = {
                entry["joint"]: np.sort(float(entry["scale"]) * np.array(entry["range"]))
                for entry in coordinates
            }
            self.ranges = {joint: (float(low), float(high)) for joint, (low, high) in scaled.items()}
            self._along = dict(report["moment_arms"]["along"])
        except (OSError, ValueError, KeyError, TypeError):
            self._along = {}

    def pairs(self) -> list[tuple[str, str]]:
        """Return muscles and joints of which something is known, the greatest moment arm first."""
        found = []
        for joint, (coordinate, _) in self._joints.items():
            for muscle, arms in self._along.get(coordinate, {}).get("muscles", {}).items():
                found.append((float(np.abs(arms).max()), muscle, joint))
        return [(muscle, joint) for _, muscle, joint in sorted(found, reverse=True)]

    def of(self, muscle: str, joint: str, along: np.ndarray) -> np.ndarray | None:
        """Return moment arms at values of a joint [m]; None where nothing is known, NaN beyond the range."""
        coordinate, scale = self._joints.get(joint, ("", 1.0))
        known = self._along.get(coordinate, {})
        if muscle not in known.get("muscles", {}):
            return None
        values, arms = scale * np.array(known["values"]), np.array(known["muscles"][muscle]) / scale
        order = np.argsort(values)
        return np.interp(along, values[order], arms[order], left=np.nan, right=np.nan)


def moment_arm(model: mujoco.MjModel, muscle: str, joint: str, along: np.ndarray) -> np.ndarray:
    """Return r = -dl/dq of a muscle at values of a joint [m], the others at rest.

    Joints that follow this one move the muscle, too.
    """
    data, rest = mujoco.MjData(model), look.rest_pose(model)
    tendon, number = int(model.actuator(muscle).trnid[0]), model.joint(joint).id
    place, found = model.jnt_qposadr[number], np.zeros(len(along))
    for index, value in enumerate(along):
        qpos = rest.copy()
        qpos[place] = value
        follow(model, qpos)
        look.pose(model, data, qpos)
        slopes = jacobian(model, data)[tendon]
        found[index] = -slopes[model.jnt_dofadr[number]]
        for coupling in couplings(model):
            if coupling.driver == number:
                found[index] -= slopes[model.jnt_dofadr[coupling.joint]] * coupling.derivatives(value)[1]
    return found


def muscle_list(live: Controls) -> str:
    """Return the muscles by group with their peak forces, HTML."""
    sim = live.session.sim
    body = BODIES[sim.scene.spec.body]
    groups: dict[str, list[tuple[str, float]]] = {}
    names = sim.scene.muscles.names
    force = sim.scene.muscles.geometry().max_isometric_force if names else np.zeros((1, 0))
    for index, name in enumerate(names):
        groups.setdefault(body.group_of(name) or "others", []).append((name, force[0, index]))
    rows = "".join(
        f"<tr><th colspan=2 style='text-align:left;padding-top:0.5em'>{html.escape(group)}</th></tr>"
        + "".join(
            f"<tr><td>{html.escape(name)}</td>"
            f"<td style='text-align:right;padding-left:1em'>{peak:.0f} N</td></tr>"
            for name, peak in members
        )
        for group, members in groups.items()
    )
    return f"<div style='padding:0 1em;font-size:0.85em'><table>{rows}</table></div>"

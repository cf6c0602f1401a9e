"""The command `myowarp motion`: from a recorded motion to a person's model, angles, moments and forces."""

from __future__ import annotations

import contextlib
import csv
import importlib.util
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import tyro
from rich.console import Console

from myowarp.apps.cli.options import Overwrite, optional
from myowarp.definitions.registry import check_least
from myowarp.disk import check_folder, check_overwrite, in_place, make_folder, write_rows
from myowarp.progress import patient_bar

if TYPE_CHECKING:
    from myowarp.motion.muscle_forces import MuscleForces
    from myowarp.motion.scaling import Scaled
    from myowarp.motion.skeleton import Bones
    from myowarp.motion.trial import Movement

WRITES = {
    "analyze": (
        *("lengths.sto", "velocities.sto", "moment_arms.sto", "active_forces.sto", "passive_forces.sto"),
        *("full_powers.sto", "passive_moments.sto", "report.html"),
    ),
    "scale": ("scaled.osim", "scale_factors.xml", "static.mot"),
    "kinematics": ("ik.mot", "marker_errors.sto", "gaps.csv"),
    "dynamics": ("moments.sto", "passive_moments.sto"),
    "forces": tuple(
        f"{name}.sto"
        for name in (
            *(
                "moments",
                "passive_moments",
                "activations",
                "forces",
                "powers",
                "metabolic_powers",
                "joint_reactions",
                "actuators",
                "reserves",
            ),
            "missing",
        )
    ),
    "track": (
        "tracked.mot",
        *(f"{name}.sto" for name in ("excitations", "activations", "fiber_lengths", "forces", "reserves")),
    ),
    "emg": ("emg.sto", "emg_agreement.csv", "emg.png"),
    "report": ("report.html",),
}
"""Files of each step; some are there only where the model has what they are about."""

EXPONENT = 2.0
"""Of activations in the cost, by default."""

PATIENCE = 5.0
"""Time after which a bar shows how far a motion is [s]."""

SHOWN = 3
"""The worst of what is listed."""


@dataclass
class Motion:
    """Scale an OpenSim model, and find joint angles, joint moments and muscle forces of a recorded motion.

    analyze: lengths, velocities, moment arms and greatest forces of muscles along a motion.
    myowarp motion analyze gait.osim --motion ik.mot

    scale: a model of the person, from markers of one who stands still and an OpenSim set-up file.
    myowarp motion scale generic.osim --setup scale.xml --markers static.trc

    kinematics: joint angles from markers, with the weights of an OpenSim set-up file.
    myowarp motion kinematics gait.osim --markers walk.trc --setup ik.xml

    dynamics: joint moments of a motion under external loads. forces: those of muscles, too, at the least sum
    of activations to a power, with a reserve of --reserve N m on every coordinate.
    myowarp motion forces gait.osim --motion ik.mot --loads grf.xml --filter 6 --reserve 10

    track: excitations that make a simulation follow the motion under its loads, by computed muscle control,
    and what reserves of --reserve, at the root --residual, have to add; --strength makes muscles weaker.
    myowarp motion track gait.osim --motion ik.mot --loads grf.xml --reserve 1 --strength soleus_r=0.9

    emg: envelopes of raw electromyograms, columns named by muscles, and how the activations of the same
    folder follow them.
    myowarp motion emg gait.osim --emg emg.csv -o out/trial

    report: a page on what other steps wrote into the same folder, the worst first.
    myowarp motion report gait.osim -o out/trial

    study: a table of trials, one a row, with columns for its files (trial, model, markers or motion, setup,
    loads), for factors on its model (max_isometric_force, tendon_slack_length, mass) and for how far --draws
    draws of it spread (max_isometric_force_spread, ..., marker_noise [m]). It writes tidy Parquet, .sto with
    intervals and plots; the same command goes on with what is missing.
    myowarp motion study trials.csv --draws 100 --reserve 10 -o out/study

    Writes .sto and .mot files, which OpenSim reads. Works without OpenSim.
    """

    what: Annotated[
        Literal["scale", "analyze", "kinematics", "dynamics", "forces", "track", "emg", "report", "study"],
        tyro.conf.Positional,
    ]
    """Step."""
    model: Annotated[Path, tyro.conf.Positional]
    """The model, .osim; of study, the table of trials, .csv or .parquet."""
    motion: Annotated[Path | None, optional("FILE")] = None
    """Joint angles over time, .mot or .sto; of every step after kinematics."""
    markers: Annotated[Path | None, optional("FILE")] = None
    """Markers over time, .trc; of kinematics and, in place of those in its set-up file, of scale."""
    setup: Annotated[Path | None, optional("FILE")] = None
    """OpenSim set-up file of the step's tool: of scale; of kinematics, with weights of markers and
    coordinates, by default the same for all markers. Files, filter, times, exponent and reserves are taken
    from it unless they are given here."""
    marker_set: Annotated[Path | None, optional("FILE")] = None
    """Of kinematics: an OpenSim MarkerSet, in place of the model's markers of the same names."""
    fill: Annotated[float | None, optional("SECONDS")] = None
    """Of kinematics: gaps of markers up to so long are bridged by a spline; gaps.csv lists all."""
    loads: Annotated[Path | None, optional("FILE")] = None
    """OpenSim file of external loads."""
    filter: Annotated[float | None, optional("HZ")] = None
    """Frequency below which the motion is kept; by default all is."""
    mode: Literal["equilibrium", "opensim"] = "equilibrium"
    """What muscles can give; opensim: as its static optimisation, rigid tendons without passive force."""
    exponent: float = EXPONENT
    """Of activations in the cost, at least 1."""
    reserve: float = 0.0
    """Moment of a reserve at cost 1 on every coordinate [N m, N]; 0: none."""
    emg: Annotated[Path | None, optional("FILE")] = None
    """Of emg: raw electromyograms over time, .sto, .mot or .csv."""
    residual: Annotated[float | None, optional("FLOAT")] = None
    """The same on coordinates that carry the model through space; by default --reserve."""
    strength: Annotated[tuple[str, ...], optional("[MUSCLE=FACTOR ...]")] = ()
    """Of track: factors on maximum isometric forces of muscles, such as soleus_r=0.9."""
    gain: Annotated[tuple[str, ...], optional("[COORDINATE=GAIN ...]")] = ()
    """Of track: ways back to the motion [1/s^2] of coordinates, such as mtp_angle_r=1600, in place of 100, or
    1600 where bodies are light."""
    span: Annotated[tuple[float, float] | None, optional("START END")] = None
    """First and last time [s]; by default all."""
    draws: int = 0
    """Of each trial of a study, besides the trial as it is."""
    seed: int = 0
    """Of the draws."""
    ray: bool = False
    """Of study: solve parts over a Ray cluster; every node sees the table, its files and the output."""
    address: Annotated[str | None, optional("HOST:PORT")] = None
    """With --ray: head of a cluster, or auto; by default this machine alone."""
    cpus: int = 1
    """With --ray: cores of each part."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out/motion")
    """Folder for the result."""
    overwrite: Overwrite = False
    """Replace files that exist."""

    def __call__(self) -> None:
        """Check, compute, write, say what is worst."""
        if self.what == "report":
            check_overwrite([self.output / "report.html"], self.overwrite)
            self._write_page(self.motion)
            self._say([])
            return
        if not 0.0 <= self.reserve < float("inf"):
            raise ValueError(f"--reserve must be at least 0 and finite, got {self.reserve}")
        if self.what == "study":
            self._study()
            return
        if self.setup is not None and self.what not in ("scale", "emg"):
            return self._filled_in(self.setup)._solve()
        self._solve()

    def _write_page(self, motion: Path | None) -> None:
        """Write the page on what the folder has."""
        from myowarp.apps.reports.motion import page
        from myowarp.opensim.read.model import read_model

        text = page(self.output, read_model(self.model), motion)
        with in_place(self.output / "report.html") as scratch:
            scratch.write_text(text, encoding="utf-8")

    def _page(self, motion: Path) -> list[str]:
        """Write the page where matplotlib is installed; return what is to be said."""
        if importlib.util.find_spec("matplotlib") is None:
            return ["no page: it needs matplotlib; pip install 'myowarp[plot]'"]
        self._write_page(motion)
        return []

    def _filled_in(self, setup: Path) -> Motion:
        """Return the command with what it leaves open as a set-up file of OpenSim has it."""
        from myowarp.motion.tool_setup import read_tool_setup

        said = read_tool_setup(setup)
        if said.unread:
            text = f"left out of {setup}: {', '.join(said.unread)}"
            Console(stderr=True, highlight=False, soft_wrap=True).print(text, markup=False)
        named = {"markers": said.markers, "motion": said.motion, "loads": said.loads, "filter": said.cutoff,
                 "span": said.span}  # fmt: skip
        open_: dict[str, Any] = {name: value for name, value in named.items() if getattr(self, name) is None}
        if said.exponent is not None and self.exponent == EXPONENT:
            open_["exponent"] = said.exponent
        return replace(self, **open_)

    def _solve(self) -> None:
        """Do a step that reads a model."""
        from myowarp.motion import trial
        from myowarp.motion.inverse_kinematics import MarkerErrors
        from myowarp.motion.skeleton import Bones

        source, name = {
            "scale": (self.setup, "setup"),
            "emg": (self.emg, "emg"),
            "kinematics": (self.markers, "markers"),
        }.get(self.what, (self.motion, "motion"))
        if source is None:
            raise ValueError(f"motion {self.what} needs --{name} FILE")
        check_folder(self.output)
        check_overwrite((self.output / file for file in WRITES[self.what]), self.overwrite)
        if self.what == "scale":
            make_folder(self.output)
            self._say(said_of(trial.scale_to(self.model, self.output, source, self.markers)))
            return
        if self.what == "emg":
            self._say(self._beside_emg(source))
            return
        bones = Bones.read(self.model, markers=self.marker_set)
        make_folder(self.output)
        lines = []
        if self.what == "kinematics":
            fitted = MarkerErrors()
            steps = bones, source, self.output, self.setup, self.span, self.fill
            for part in trial.kinematics_in_parts(*steps):
                fitted.add(part)
            lines += gaps_in(self.output / "gaps.csv")
            lines += [f"{marker}: {1e3 * rms:.1f} mm rms, {1e3 * most:.1f} mm at most"
                      for marker, rms, most in fitted.worst()[:SHOWN]]  # fmt: skip
            lines += [doubt] if (doubt := fitted.doubt()) else []
        else:
            bones, lines = self._without_excluded(bones)
            lines += self._along(bones, source)
        self._say(lines)

    def _without_excluded(self, bones: Bones) -> tuple[Bones, list[str]]:
        """Return the model without the forces that a set-up file excludes, and what is to be said."""
        from myowarp.motion.model_forces import without
        from myowarp.motion.skeleton import Bones
        from myowarp.motion.tool_setup import read_tool_setup

        excluded = None if self.setup is None else read_tool_setup(self.setup).excluded
        if excluded is None:
            return bones, []
        model, unknown = without(bones.model, excluded)
        lines = [f"forces_to_exclude names {name!r}, which the model has not" for name in unknown]
        if not {"ALL", "ACTUATORS", "MUSCLES"} & {name.upper() for name in excluded}:
            lines.append(
                "forces_to_exclude has no Muscles: OpenSim's moments are then what muscles at their default "
                "activations leave over; these are what muscles have to give"
            )
        return Bones(model, bones.device), lines

    def _along(self, bones: Bones, source: Path) -> list[str]:
        """Do a step along a motion; return what is to be said, one line each."""
        from myowarp.motion import trial
        from myowarp.motion.loads import Loads
        from myowarp.motion.storage import Tables
        from myowarp.motion.streams import is_long

        if self.what == "track":
            motion = trial.read_motion(source, bones, self.filter)
            return [*absent_from(motion), *self._track(bones, motion)]
        long = is_long(source)
        lines: list[str] = []
        loads, worst, advance = None, Worst(), None
        with contextlib.ExitStack() as stack:
            if self.loads is not None:
                loads = stack.enter_context(contextlib.closing(Loads(self.loads, forwards=long)))
            tables = stack.enter_context(Tables(self.output))
            for motion in trial.read_parts(source, bones, self.filter, self.span):
                if motion.first == 0:
                    lines += absent_from(motion)
                    frames = motion.total or len(motion.time)
                    bar = patient_bar("Motion", "frames", frames, patience=PATIENCE)
                    advance = stack.enter_context(bar)
                if self.what == "analyze":
                    trial.analyze(bones, motion, tables)
                elif self.what == "dynamics":
                    trial.dynamics(bones, motion, tables, loads)
                else:
                    found = trial.forces(
                        bones, motion, tables, loads,
                        mode=self.mode, exponent=self.exponent, reserves=self._reserves(bones) or None,
                    )  # fmt: skip
                    worst.add(found)
                if advance is not None:
                    advance(len(motion.time))
        if self.what == "forces":
            lines += worst.lines(bones)
        if self.what == "analyze":
            lines += ["no page: the motion is too long for one"] if long else self._page(source)
        return lines

    def _beside_emg(self, source: Path) -> list[str]:
        """Write envelopes, and how activations follow them; return those that follow least, one line each."""
        from myowarp.apps.reports.emg import draw_emg
        from myowarp.motion.emg import agreement, envelopes
        from myowarp.motion.storage import read_storage, write_storage

        path = self.output / "activations.sto"
        if not path.is_file():
            raise ValueError(
                f"{str(self.output)!r} has no activations.sto; write it with myowarp motion forces or track "
                "and the same --output"
            )
        activation, envelope = read_storage(path), envelopes(read_storage(source))
        found = agreement(envelope, activation)
        write_storage(self.output / "emg.sto", "envelopes of electromyograms", envelope)
        rows = [(one.muscle, f"{one.delay:.3f}", f"{one.correlation:.4f}") for one in found]
        write_rows(self.output / "emg_agreement.csv", [("muscle", "delay [s]", "correlation"), *rows])
        draw_emg(self.output / "emg.png", envelope, activation, found)
        return [f"{one.muscle}: correlation {one.correlation:.2f} at a delay of {1e3 * one.delay:.0f} ms"
                for one in found[:SHOWN]]  # fmt: skip

    def _reserves(self, bones: Bones) -> dict[str, float]:
        """Return the force of the reserve of each coordinate that has one."""
        from myowarp.motion.tool_setup import read_tool_setup
        from myowarp.opensim.model.kinematics import floating

        root = floating(bones.model)
        at_root = self.reserve if self.residual is None else self.residual
        wanted = {name: at_root if name in root else self.reserve for name in bones.coordinates}
        if not self.reserve and self.setup is not None:
            said = read_tool_setup(self.setup).reserves
            wanted |= {name: force for name, force in said.items() if name in wanted}
        return {name: force for name, force in wanted.items() if force}

    def _track(self, bones: Bones, motion: Movement) -> list[str]:
        """Simulate the motion; return what is worst, one line each."""
        from myowarp.motion import trial
        from myowarp.motion.tool_setup import ToolSetup, read_tool_setup
        from myowarp.motion.tracking import WINDOW
        from myowarp.progress import progress_bar

        factors = numbers_of("strength", self.strength, "soleus_r=0.9")
        said = ToolSetup() if self.setup is None else read_tool_setup(self.setup)
        gains = {**said.gains, **numbers_of("gain", self.gain, "mtp_angle_r=1600")}
        ends = zip(self.span or (-np.inf, np.inf), motion.time[[0, -1]], strict=True)
        begin, end = (edge if np.isinf(x) else x for x, edge in ends)
        with progress_bar("Tracking", "windows", Console(stderr=True)) as bar:
            task = bar.add_task("", total=max(1, round((end - begin) / WINDOW)))
            found = trial.follow(
                bones, motion, self.output, self.loads, reserves=self._reserves(bones), factors=factors,
                gains=gains, controls=said.controls, span=(begin, end),
                advance=lambda count: bar.advance(task, count),
            )  # fmt: skip
        lines, off = [], found.off()[0]
        turns = [bones.model.coordinates[name].rotational for name in bones.coordinates]
        shown = np.where(turns, np.degrees(off), 100.0 * off)  # a degree beside a centimetre
        for k in shown.argsort()[::-1][:SHOWN]:
            unit = "°" if turns[k] else "cm"
            lines.append(f"{bones.coordinates[k]}: {shown[k]:.2f} {unit} rms off the motion")
        most = abs(found.reserve[:, 0]).max(axis=0)
        for k in most.argsort()[::-1][:SHOWN]:
            lines.append(
                f"reserve at {bones.coordinates[k]}: {most[k]:.3g} {'N m' if turns[k] else 'N'} at most"
            )
        return lines

    def _study(self) -> None:
        """Solve a table of trials."""
        from myowarp.apps.studies.motion import run

        for option in ("motion", "markers", "setup", "loads", "filter"):
            if getattr(self, option) is not None:
                raise ValueError(f"of a study the table says {option}, in a column; leave out --{option}")
        if self.overwrite:
            raise ValueError("a study goes on with what is there; leave out --overwrite")
        console = Console(stderr=True, highlight=False, soft_wrap=True)
        names = "draws", "seed", "mode", "exponent", "reserve"
        check_least(1, cpus=self.cpus)
        cluster = run.Cluster(self.address, self.cpus) if self.ray else None
        run.run(self.model, self.output, console, cluster, **{name: getattr(self, name) for name in names})

    def _say(self, lines: list[str]) -> None:
        """Say what was found, and where it is."""
        say = Console(stderr=True, highlight=False, soft_wrap=True).print
        written = [name for name in WRITES[self.what] if (self.output / name).exists()]
        for line in [*lines, f"Saved {', '.join(written)} in {self.output}"]:
            say(line, markup=False)


def numbers_of(option: str, words: tuple[str, ...], example: str) -> dict[str, float]:
    """Return what an option says, by name.

    Raises:
        ValueError: A word is not like the example.
    """
    found = {}
    for word in words:
        name, _, number = word.partition("=")
        try:
            found[name] = float(number)
        except ValueError:
            raise ValueError(f"--{option} must be like {example}, got {word!r}") from None
    return found


def gaps_in(path: Path) -> list[str]:
    """Return the longest gaps of markers that were not filled, one line each."""
    rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))[1:]
    left = [row for row in rows if row[3] == "no"]
    lines = [f"{name} was not seen from {first} to {last} s" for name, first, last, _ in left[:SHOWN]]
    if filled := len(rows) - len(left):
        lines.append(f"{filled} gaps were filled; gaps.csv lists all {len(rows)}")
    elif len(left) > SHOWN:
        lines.append(f"gaps.csv lists all {len(rows)}")
    return lines


def said_of(scaled: Scaled) -> list[str]:
    """Return how a model was scaled, one line each; markers that fitted worst come first."""
    lines = []
    if scaled.unknown:
        lines.append(f"not in the model, and left out: {', '.join(scaled.unknown)}")
    if scaled.pose is not None:
        lines += [f"{marker}: {1e3 * most:.1f} mm off before it was moved"
                  for marker, _, most in scaled.pose.worst()[:SHOWN]]  # fmt: skip
        lines += [doubt] if (doubt := scaled.pose.doubt()) else []
    for name, (factor, _) in scaled.measured.items():
        lines.append(f"{name}: {factor:.4f}")
    mass = sum(body.mass for body in scaled.document.model.bodies.values())
    return [*lines, f"{mass:.1f} kg in {len(scaled.document.model.bodies)} bodies"]


def absent_from(motion: Movement) -> list[str]:
    """Return which coordinates a motion has not, in one line or none."""
    return [f"not in the file, and at default: {', '.join(motion.absent)}"] if motion.absent else []


class Worst:
    """What muscles could not do in a motion, of all its parts."""

    def __init__(self) -> None:
        """Begin with none."""
        self.frames, self.missed, self.full = 0, 0, Counter[str]()
        self.most: dict[str, np.ndarray] = {}

    def add(self, found: MuscleForces) -> None:
        """Count a part."""
        self.frames += len(found.feasible)
        self.missed += int((~found.feasible).sum())
        self.full.update(found.saturated)
        for name in ("missing", "reserve"):
            most = abs(getattr(found, name)).max(axis=0)
            self.most[name] = np.maximum(most, self.most.get(name, 0.0))

    def lines(self, bones: Bones) -> list[str]:
        """Return what muscles could not do, one line each."""
        lines = []
        if self.missed:
            lines.append(
                f"muscles cannot hold {self.missed} of {self.frames} frames; missing.sto has what is left"
            )
        for name, most in self.most.items():
            for k in most.argsort()[::-1][:SHOWN]:
                if most[k] > 1e-3:
                    unit = "N m" if bones.model.coordinates[bones.coordinates[k]].rotational else "N"
                    lines.append(f"{name} at {bones.coordinates[k]}: {most[k]:.3g} {unit} at most")
        full = self.full.most_common(SHOWN)
        return lines + [f"{muscle} is fully active in {n} of {self.frames} frames" for muscle, n in full]

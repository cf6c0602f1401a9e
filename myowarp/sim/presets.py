"""Patients by name: what a condition is in the paper that it comes from, put into a running simulation.

patient = Patient(sim)
PRESETS["older adult"].put_into(patient, worlds=[0])  # world 1 stays as it was
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from myowarp.definitions.condition import CONDITIONS
from myowarp.definitions.registry import Registry
from myowarp.models.conditions.sarcopenia import Sarcopenia
from myowarp.sim.patient import Patient

PAPER = "Caggiano et al. (2022), arXiv:2205.13600"
EFFORT = 60.0
"""s of full effort, after which a patient is "fatigued"."""

Values = Mapping[str, npt.ArrayLike]


@dataclass(frozen=True)
class Preset:
    """A patient.

    Attributes:
        condition: Name of the condition in `CONDITIONS`; its parameters are its defaults.
        doc: What the patient has, a sentence.
        source: Where its values come from.
        muscles: Muscles that have it, without the side suffix `_r`; () for all that the condition is about.
        also: Function from a patient to other values of parameters, by name.
    """

    condition: str
    doc: str
    source: str
    muscles: tuple[str, ...] = ()
    also: Callable[[Patient], Values] = field(default=lambda patient: {})

    def suits(self, patient: Patient) -> bool:
        """Say whether a body can have it: the condition has knobs there, for the muscles that are named."""
        knobs = [knob for knob in patient.knobs.values() if knob.condition == self.condition]
        return bool(knobs) and len(self._own(patient)) == len(self.muscles)

    def _own(self, patient: Patient) -> list[str]:
        """Return the names that a body has for the muscles."""
        return [name for name in patient.groups if name.removesuffix("_r") in self.muscles]

    def put_into(self, patient: Patient, worlds: Sequence[int]) -> None:
        """Make worlds this patient, and nothing else.

        Raises:
            ValueError: The body cannot have it; nothing was changed.
        """
        if not self.suits(patient):
            of = f" of {', '.join(self.muscles)}" if self.muscles else ""
            here = ", ".join(offered(patient)) or "none"
            raise ValueError(
                f"the preset needs {self.condition}{of}, which this body cannot have; available here: {here}"
            )
        patient.undo(worlds)
        kind, also = CONDITIONS[self.condition], self.also(patient)
        for knob in patient.knobs.values():
            value = also.get(knob.field, getattr(kind, knob.field, None))
            if knob.condition == self.condition and value is not None:
                patient.set(knob, value, worlds, self._own(patient))


def offered(patient: Patient) -> tuple[str, ...]:
    """Return the names of the presets that a body can have."""
    return tuple(name for name in PRESETS if PRESETS[name].suits(patient))


def fatigued_after(seconds: float, patient: Patient) -> np.ndarray:
    """Return the fatigued fraction of each muscle after full effort [1], shape (num_muscles,).

    Where all motor units are active or fatigued, dM_F/dt = F (1 - M_F) - R M_F, so that
    M_F(t) = F / (F + R) (1 - exp(-(F + R) t)), with the body's rates F and R.
    """
    rates = (patient.knobs[f"fatigue_3ccr {name}"] for name in ("fatigue_rate", "recovery_rate"))
    fatigue, recovery = (knob.parameter.values(0).astype(float) for knob in rates)
    total = np.maximum(fatigue + recovery, 1e-12)
    return fatigue / total * -np.expm1(-total * seconds)


PRESETS: Registry[Preset] = Registry("preset")
PRESETS.add(
    "older adult",
    Preset("sarcopenia", f"Sarcopenia: {Sarcopenia.strength:g} of the peak force is left.", PAPER),
)
PRESETS.add(
    "FPL torn",
    Preset("tendon_tear", "The long flexor of the thumb passes on no force.", PAPER, muscles=("FPL",)),
)
PRESETS.add(
    "after tendon transfer",
    Preset("tendon_transfer", "An extensor of the index finger pulls the thumb in place of its own.", PAPER),
)
PRESETS.add(
    "fatigued",
    Preset(
        "fatigue_3ccr",
        f"Muscles as {EFFORT:g} s of full effort leave them, and they tire on.",
        "Xia, Frey Law (2008), doi:10.1016/j.jbiomech.2008.07.013, with rates of Rakshit et al. (2021)",
        also=lambda patient: {"initial": fatigued_after(EFFORT, patient)},
    ),
)
PRESETS.add(
    "with exoskeleton",
    Preset("exoskeleton", "A brace of the elbow adds half of the muscles' torque, and its weight.", PAPER),
)

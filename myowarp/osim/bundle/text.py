"""Parts of a bundle: texts that a compiled model brings along, and JSON files beside its MJCF.

A part is read, put into a spec, found again in the compiled model, and held against what that has.
"""

import json
from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, ClassVar, Self, TypeVar

import mujoco
import numpy as np


@dataclass(frozen=True)
class Sidecar:
    """A part of a bundle.

    Attributes:
        NAME: Of the text.
        FILE: Of the JSON.
        KEYS: What its JSON has, as an error says it.
        written: The text that it was read from, "" where it was made here.
    """

    NAME: ClassVar[str]
    FILE: ClassVar[str]
    KEYS: ClassVar[str]
    written: str = field(default="", kw_only=True, compare=False, repr=False)

    @classmethod
    def read(cls, text: str) -> Self:
        """Return what a text says.

        Raises:
            ValueError: It is not one that `as_json` writes.
        """
        return _read(cls, text)  # type: ignore[arg-type]

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Self | None:
        """Return what a model's text says, None for a model without one.

        Raises:
            ValueError: The text is broken, or names what the model has not.
        """
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, cls.NAME)
        if number < 0:
            return None
        first, size = model.text_adr[number], model.text_size[number]
        found = cls.read(model.text_data[first : first + size].rstrip(b"\0").decode())
        found.check(model)
        return found

    @classmethod
    @abstractmethod
    def from_entry(cls, entry: Any) -> Self:
        """Return what parsed JSON says.

        Raises:
            ValueError: A number cannot be computed with; other errors where something is missing.
        """

    @abstractmethod
    def as_json(self) -> str:
        """Return the text."""

    @abstractmethod
    def check(self, model: mujoco.MjModel) -> None:
        """Raise ValueError if it names what a model has not."""

    @property
    def bodies_apart(self) -> Iterable[str]:
        """Names of bodies that need frames or masses of their own."""
        return ()

    @property
    def text(self) -> str:
        """The text, as it was read where it was."""
        return self.written or self.as_json()

    def put_into(self, spec: mujoco.MjSpec) -> mujoco.MjSpec:
        """Give a spec the text and return it; one of the same name that it has already is replaced."""
        for old in [old for old in spec.texts if old.name == self.NAME]:
            spec.delete(old)
        spec.add_text(name=self.NAME, data=self.text)
        for body in filter(None, map(spec.body, self.bodies_apart)):
            body.fuse = 0  # fused with its parent it would have another frame, and could not be weighed
        return spec

    def check_named(self, kind: str, named: Iterable[str], known: Iterable[str]) -> None:
        """Raise ValueError if it names what the model has not."""
        if lost := set(named) - set(known):
            raise ValueError(
                f"the {self.NAME} name {min(lost)!r}, and the model has no {kind} of that name; "
                "they belong to another model"
            )


Part = TypeVar("Part", bound=Sidecar)


@lru_cache(maxsize=16)
def _read(kind: type[Part], text: str) -> Part:
    """Return what a text says; see `Sidecar.read`."""
    try:
        return replace(kind.from_entry(json.loads(text)), written=text)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(
            f"the {kind.NAME} of the model must be JSON with {kind.KEYS} as `myowarp convert` writes it; "
            f"{type(error).__name__}: {error}"
        ) from error


def scalar_joints(model: mujoco.MjModel) -> set[str]:
    """Return the names of a model's hinges and slides."""
    kinds = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    return {model.joint(j).name for j in np.flatnonzero(np.isin(model.jnt_type, kinds))}

"""Options: fields of frozen dataclasses that say what they are; flags, checks and JSON follow from them.

    @dataclass(frozen=True, kw_only=True)
    class Settings:
        num_worlds: int = option(256, "Worlds simulated together.", least=1)

What an environment is (`Setup`) and what a training is told (`apps/train/settings.py`) speak this language.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import Field, field, fields
from typing import Any, cast

from myowarp.definitions.registry import check_choice


def option(
    default: Any,
    text: str,
    form: str = "",
    *,
    choices: Iterable[str] = (),
    least: float | None = None,
    most: float | None = None,
    check: Callable[[Any], object] | None = None,
    flag: bool = False,
    free: bool = False,
) -> Any:
    """Return the field of an option.

    Args:
        default: Its value; None: nothing is said, and any type may be.
        text: Help, a sentence or two.
        form: What a command line shows of its value where neither choices nor its type tell.
        choices: Texts that are allowed.
        least: Smallest number that is allowed.
        most: Largest number that is allowed.
        check: Raises ValueError for a value that is not allowed, in place of choices and bounds.
        flag: Whether it is true unless a command line says --no-NAME.
        free: Whether a run may be resumed with another value, because no number of the run depends on it.
    """
    told = {"text": text, "form": form, "choices": choices, "least": least, "most": most}
    return field(default=default, metadata=told | {"check": check, "flag": flag, "free": free})


def options_of(kind: Any) -> dict[str, Field[Any]]:
    """Return the options of a class by name."""
    return {entry.name: entry for entry in fields(kind)}


def other(of: Any, name: str, default: Any, text: str = "") -> Any:
    """Return an option of another class with another default, and a text where it means something else."""
    told = options_of(of)[name].metadata
    return field(default=default, metadata={**told, "text": text or told["text"]})


def checked(entry: Field[Any], value: Any, name: str) -> Any:
    """Return an option's value in the type of its default; a list for a tuple and 1 for 1.0 are taken.

    Args:
        entry: The option.
        value: Its value, or entries of a tuple, which are as the default's first one, else texts.
        name: What the sentence calls it.

    Raises:
        ValueError: It has another type, is none of the choices or out of its range.
    """
    told, default = entry.metadata, cast(Any, entry.default)
    kind = type(default)
    if kind is float and type(value) is int:
        value = float(value)
    if kind is tuple and isinstance(value, list):
        value = tuple(value)
    if default is not None and type(value) is not kind:
        raise ValueError(f"{name} must be of type {kind.__name__}, got {value!r}")
    if told["check"]:
        told["check"](value)
        return value
    for item in value if kind is tuple else (value,):
        if told["choices"]:
            check_choice(name, item, told["choices"])
        elif kind is tuple and type(item) is not (wanted := type(default[0]) if default else str):
            raise ValueError(f"{name} must be {'integers' if wanted is int else 'texts'}, got {item!r}")
        elif default is not None and isinstance(item, int | float):
            _check_range(name, item, told["least"], told["most"])
    return value


def _check_range(name: str, value: float, least: float | None, most: float | None) -> None:
    """Raise ValueError if a number is not within its bounds, or not finite."""
    low, high = float("-inf") if least is None else least, float("inf") if most is None else most
    if low <= value <= high and abs(value) != float("inf"):
        return
    wanted = f"at least {least}" if most is None else f"from {least} to {most}"
    raise ValueError(f"{name} must be {wanted if least is not None else 'finite'}, got {value}")


def flag(name: str) -> str:
    """Return an option's name on the command line."""
    return "--" + name.replace("_", "-")


def shown(value: Any) -> str:
    """Return an option's value for people."""
    return " ".join(map(str, value)) or "none" if isinstance(value, tuple | list) else str(value) or "empty"

"""Names to objects: the one way in which bodies, muscle models and tasks are found.

A registered object is found by its name everywhere: in `gymnasium.make_vec`, on the command line and
in the tests, which run over everything registered.
"""

import contextlib
import difflib
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Generic, TypeGuard, TypeVar

import numpy as np

T = TypeVar("T")


def check_flag(name: str, value: object) -> None:
    """Raise ValueError if `value` is neither True nor False: "no" and NaN would count as true."""
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{name} must be True or False, got {value!r}")


MOST_LISTED = 30  # names in an error message


def did_you_mean(name: object, known: Iterable[str], cutoff: float = 0.6) -> str:
    """Return a question with up to three names that are nearly the one that was typed; "" if none is."""
    close = difflib.get_close_matches(str(name), list(known), n=3, cutoff=cutoff)
    return f"did you mean {', '.join(close)}?" if close else ""


def check_choice(name: str, value: object, choices: Iterable[object]) -> None:
    """Raise ValueError if `value` is none of `choices`."""
    known = tuple(choices)  # a list that was given as `value` has no hash
    if value not in known:
        raise ValueError(f"{name} {value!r} unknown; available: {', '.join(map(str, known))}")


def check_bounds(name: str, low: Sequence[float], high: Sequence[float]) -> None:
    """Raise ValueError if a lower bound is above its upper one; as many as there are of both are compared."""
    for i, (bottom, top) in enumerate(zip(low, high, strict=False)):
        if bottom > top:
            raise ValueError(f"{name} must not be above its upper bound, got {bottom:g} > {top:g} at {i}")


class Registry(Generic[T]):
    """An ordered mapping from names to objects that explains itself when a name is unknown.

    Args:
        kind: What is registered, in the singular; used in error messages.
        listed_by: Where to find all names, for a registry with more than a message can list.
    """

    def __init__(self, kind: str, listed_by: str = "") -> None:
        self.kind, self.listed_by = kind, listed_by
        self._entries: dict[str, T] = {}
        self._sealed: frozenset[str] = frozenset()
        self._watchers: list[Callable[[str], None]] = []

    def add(self, name: str, entry: T, *, replace: bool = False) -> T:
        """Register `entry` under `name`.

        Args:
            name: Its name.
            entry: What is registered.
            replace: Whether it may take the place of another entry, such as the one of an edited notebook
                cell; what was made with the other keeps it. Entries of the package cannot be replaced.

        Raises:
            ValueError: `name` is taken, or one who watches refuses it.
        """
        if name in self._sealed:
            raise ValueError(f"{self.kind} {name!r} belongs to myowarp; choose another name")
        if name in self._entries and not replace:
            raise ValueError(
                f"{self.kind} {name!r} is already registered; choose another name, or pass replace=True"
            )
        before = dict(self._entries)
        self._entries[name] = entry
        try:
            for watcher in self._watchers:
                watcher(name)
        except ValueError:
            self._entries = before
            raise
        return entry

    def register(self, name: str, *, replace: bool = False) -> Callable[[T], T]:
        """Decorator form of `add`."""
        return lambda entry: self.add(name, entry, replace=replace)

    def watch(self, watcher: Callable[[str], None]) -> None:
        """Call a function with the name of every entry, of those that come later too.

        Args:
            watcher: The function; a ValueError of it refuses an entry.
        """
        for name in self._entries:
            watcher(name)
        self._watchers.append(watcher)

    def seal(self) -> None:
        """Let no entry so far be replaced."""
        self._sealed = frozenset(self._entries)

    @contextlib.contextmanager
    def temporary(self) -> Iterator[None]:
        """Forget after the block what was registered or replaced in it; for tests and notebooks."""
        before = dict(self._entries)
        try:
            yield
        finally:
            self._entries = before

    def __getitem__(self, name: str) -> T:
        """Return the entry called `name`.

        Raises:
            ValueError: No such entry; the message lists the close names, or all, or says where they are.
        """
        if name in self:
            return self._entries[name]
        hint = did_you_mean(name, self._entries) or self._available()
        raise ValueError(f"{self.kind} {name!r} unknown; {hint}")

    def _available(self) -> str:
        """Return what there is, in a few words."""
        if len(self) <= MOST_LISTED:
            return f"available: {', '.join(self)}"
        some = ", ".join(itertools.islice(self, 3))
        return f"there are {len(self)}, such as {some}" + (f"; {self.listed_by}" if self.listed_by else "")

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name in self._entries  # others may have no hash

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)


def is_integer(value: object) -> TypeGuard[int]:
    """Whether a value is an integer and no truth value."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def check_least(least: int, most: float = math.inf, /, **numbers: int) -> None:
    """Raise ValueError if an integer, called like its option with `_` for `-`, is not within bounds."""
    for name, number in numbers.items():
        flag = f"--{name.replace('_', '-')}"
        if not is_integer(number):
            raise ValueError(f"{flag} must be an integer, got {number!r}")
        if number < least:
            raise ValueError(f"{flag} must be at least {least}, got {number}")
        if number > most:
            raise ValueError(f"{flag} must be at most {most}, got {number}")

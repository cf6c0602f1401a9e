"""Names to objects: the one way in which bodies, muscle models and tasks are found.

A registered object is found by its name everywhere: in `gymnasium.make_vec`, on the command line and
in the tests, which run over everything registered.
"""

import difflib
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


def check_choice(name: str, value: object, choices: Iterable[object]) -> None:
    """Raise ValueError if `value` is none of `choices`."""
    if value not in choices:
        raise ValueError(f"{name} {value!r} unknown; available: {', '.join(map(str, choices))}")


class Registry(Generic[T]):
    """An ordered mapping from names to objects that explains itself when a name is unknown.

    Args:
        kind: What is registered, in the singular; used in error messages.
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._entries: dict[str, T] = {}
        self._sealed: frozenset[str] = frozenset()
        self._watchers: list[Callable[[str], None]] = []

    def add(self, name: str, entry: T, *, replace: bool = False) -> T:
        """Register `entry` under `name`.

        Args:
            name: Its name.
            entry: What is registered.
            replace: Whether it may take the place of another entry, such as the one of an edited notebook
                cell; what was made with the other keeps it. What the package brings stays what it is.

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

    def __getitem__(self, name: str) -> T:
        """Return the entry called `name`.

        Raises:
            ValueError: No such entry; the message lists the close names, or all.
        """
        if name in self._entries:
            return self._entries[name]
        close = difflib.get_close_matches(str(name), self._entries, n=3)
        hint = f"did you mean {', '.join(close)}?" if close else f"available: {', '.join(self)}"
        raise ValueError(f"{self.kind} {name!r} unknown; {hint}")

    def __contains__(self, name: str) -> bool:
        return name in self._entries

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

"""The XML of an .osim file: parsed with limits, every element with its line, errors that name both.

Expat with handlers of our own, because the limits must hold while parsing and every element needs its
line: ElementTree keeps no lines, defusedxml (same parser, same handlers) adds none, and libxml2 would
be a large dependency for that. A document type, and with it every entity, is refused; size, depth and
number of elements are limited. OpenSim's own reader is more lenient than XML allows, so three things
that files in circulation contain are accepted: `--` in comments, a bare `&`, and bytes that are not
UTF-8 although the file says so. Tags with `::` need no care: expat is used without namespaces.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from myowarp.disk import in_place

MAX_BYTES = 64 * 2**20  # the largest model in circulation has about 10 MB
MAX_DEPTH = 64  # models need about 15
MAX_ELEMENTS = 2_000_000
MAX_NUMBER = 1e15  # of any unit: beyond it arithmetic overflows sooner or later
LONG_WORD = re.compile(r"\S{80,}")
DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?")
BARE_AMPERSAND = re.compile(r"&(?!(?:amp|lt|gt|quot|apos|#\d{1,7}|#x[0-9A-Fa-f]{1,6});)")


@dataclass(eq=False)
class Element:
    """An element of the document."""

    source: Path
    tag: str
    attributes: dict[str, str]
    line: int
    """From 1."""
    text: str = ""
    children: "list[Element]" = field(default_factory=list)
    parent: "Element | None" = None
    fallback: "Element | None" = None
    """The entry of its class in the document's `<defaults>`."""

    @property
    def name(self) -> str:
        """Its attribute `name`, or ""; tabs and line breaks are blanks, as in the texts that refer to it."""
        return " ".join(self.attributes.get("name", "").split())

    def error(self, message: str) -> ValueError:
        """Return an error that says where: file, line, element."""
        name = f" name={self.name!r}" if self.name else ""
        text = LONG_WORD.sub(lambda word: word[0][:60] + "...", f"<{self.tag}{name}> {message}")
        return ValueError(f"{self.source}:{self.line}: {text}")

    def unsupported(self, message: str) -> NotImplementedError:
        """Return an error that says where: file, line, element."""
        return NotImplementedError(str(self.error(message)))

    def own(self, *tags: str) -> "Element | None":
        """Return the first child with one of these tags."""
        return next((child for tag in tags for child in self.children if child.tag == tag), None)

    def find(self, *tags: str) -> "Element | None":
        """Return the first child with one of these tags, here or in the class's defaults."""
        found = self.own(*tags)
        return found if found is not None or self.fallback is None else self.fallback.own(*tags)

    def need(self, *tags: str) -> "Element":
        """Return the first child with one of these tags, or raise."""
        found = self.find(*tags)
        if found is None:
            raise self.error(f"has no <{tags[0]}>")
        return found

    def objects(self, *tags: str) -> "list[Element]":
        """Return the members of a set: the children of `<tag>`, or of the `<objects>` in it."""
        found = self.find(*tags)
        if found is None:
            return []
        inner = found.find("objects")
        return [child for child in (found if inner is None else inner).children if child.tag != "groups"]

    def walk(self) -> "Iterator[Element]":
        """Yield this element and all below."""
        stack = [self]
        while stack:
            element = stack.pop()
            yield element
            stack.extend(reversed(element.children))

    def words(self) -> frozenset[str]:
        """Return the words of its texts, of paths the last part."""
        words = (word for element in self.walk() for word in element.text.split())
        return frozenset(word.rstrip("/").rpartition("/")[2] for word in words)

    def string(self, *tags: str, default: str = "") -> str:
        """Return the text of a child."""
        found = self.find(*tags)
        return default if found is None else " ".join(found.text.split())

    def numbers(
        self, *tags: str, default: tuple[float, ...] | None = None, count: int | None = None
    ) -> np.ndarray:
        """Return the numbers of a child, shape (count,).

        Raises:
            ValueError: Missing without a default, not numbers, not finite, or not as many as required.
        """
        found = self.find(*tags)
        if found is None and default is not None:
            return np.array(default, float)
        found = self.need(*tags)
        values = found.parsed(finite=True)
        if default is not None and not len(values):
            return np.array(default, float)
        if count is not None and len(values) != count:
            raise found.error(f"must be {count} numbers, got {found.text.strip()[:60]!r}")
        return values

    def parsed(self, finite: bool) -> np.ndarray:
        """Return the text of this element as numbers; commas may stand between them, not for their points."""
        if any(DECIMAL_COMMA.fullmatch(word) for word in self.text.split()):
            raise self.error(f"must have numbers with points, not commas, got {self.text.strip()[:60]!r}")
        words = self.text.replace(",", " ").strip(" \t\r\n()~[]").split()
        try:
            values = np.array([number_of(word) for word in words])
        except ValueError:
            raise self.error(f"must be numbers, got {self.text.strip()[:60]!r}") from None
        if finite and not (np.abs(values) < MAX_NUMBER).all():
            raise self.error(f"must be finite, below {MAX_NUMBER:g} in size, got {self.text.strip()[:60]!r}")
        return values

    def number(
        self, *tags: str, default: float | None = None, finite: bool = True, least: float = -math.inf
    ) -> float:
        """Return the number of a child, at least `least`; `finite=False` lets infinities pass, never NaN."""
        found = self.find(*tags)
        if default is not None and (found is None or not found.text.strip()):
            return default
        found = self.need(*tags)
        values = found.parsed(finite)
        if len(values) != 1 or math.isnan(values[0]):
            raise found.error(f"must be one number, got {found.text.strip()[:60]!r}")
        if values[0] < least:
            raise found.error(f"must be at least {least:g}, got {values[0]:g}")
        return float(values[0])

    def flag(self, *tags: str, default: bool) -> bool:
        """Return the truth value of a child."""
        found = self.find(*tags)
        if found is None or not found.text.strip():
            return default
        word = found.text.strip().lower()
        if word not in ("true", "false", "1", "0"):
            raise found.error(f"must be true or false, got {word[:60]!r}")
        return word in ("true", "1")

    def put(self, tag: str, text: str) -> "Element":
        """Set the text of a child, which is added where there is none, and return the child."""
        child = self.own(tag)
        if child is None:
            child = Element(self.source, tag, {}, self.line, parent=self)
            self.children.append(child)
        child.text = text
        return child

    def put_numbers(self, tag: str, values: np.ndarray) -> None:
        """Set the numbers of a child, to their last bit."""
        self.put(tag, " ".join(repr(float(value)) for value in np.ravel(values)))


def write(path: Path, root: Element) -> None:
    """Write a document; comments are not kept.

    Raises:
        OSError: The file cannot be written.
    """

    def lines(element: Element, depth: int) -> Iterator[str]:
        indent = "\t" * depth
        head = "".join(f" {key}={quoteattr(value)}" for key, value in element.attributes.items())
        text = escape(element.text.strip())
        if not element.children:
            yield f"{indent}<{element.tag}{head}>{text}</{element.tag}>"
            return
        yield f"{indent}<{element.tag}{head}>{text}"
        for child in element.children:
            yield from lines(child, depth + 1)
        yield f"{indent}</{element.tag}>"

    text = '<?xml version="1.0" encoding="UTF-8"?>\n' + "\n".join(lines(root, 0)) + "\n"
    with in_place(path) as scratch:
        scratch.write_text(text, "utf-8")


def parse(path: Path) -> tuple[Element, bool]:
    """Read a document.

    Returns:
        The root element, and whether its bytes had to be read as Latin-1.

    Raises:
        ValueError: Not a well-formed document, or one beyond the limits; one sentence with file and line.
        OSError: The file cannot be read.
    """
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise ValueError(f"{path} has {size} bytes; a model may have at most {MAX_BYTES}")
    text, latin = decoded(path.read_bytes())
    text = BARE_AMPERSAND.sub("&amp;", _without_comments(text))
    text = re.sub(r"^\s*<\?xml[^>]{0,200}\?>", lambda match: "\n" * match[0].count("\n"), text)
    return _tree(path, text), latin


def number_of(word: str) -> float:
    """Return a number as it stands in files: in ASCII, and without the underscores that Python lets pass.

    Raises:
        ValueError: It is none.
    """
    if "_" in word or not word.isascii():
        raise ValueError(f"{word!r} is no number")
    return float(word)


def decoded(raw: bytes) -> tuple[str, bool]:
    """Return the text, and whether it is no UTF-8 and was read as Latin-1."""
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", errors="replace"), False
    try:
        return raw.decode("utf-8-sig"), False
    except UnicodeDecodeError:
        return raw.decode("latin-1"), True


def _without_comments(text: str) -> str:
    """Return the text with every comment replaced by its line breaks."""
    parts, start = [], 0
    while (begin := text.find("<!--", start)) >= 0 and (end := text.find("-->", begin + 4)) >= 0:
        parts += [text[start:begin], "\n" * text.count("\n", begin, end)]
        start = end + 3
    return "".join([*parts, text[start:]])


def _tree(path: Path, text: str) -> Element:
    """Return the root of the tree."""
    parser = expat.ParserCreate("utf-8")
    parser.buffer_text, parser.buffer_size = True, 2**20
    top = Element(path, "", {}, 0)
    stack, count = [top], 0

    def refuse(message: str) -> ValueError:
        return ValueError(f"{path}:{parser.CurrentLineNumber}: {message}")

    def start(tag: str, attributes: Mapping[str, str]) -> None:
        nonlocal count
        count += 1
        if len(stack) > MAX_DEPTH:
            raise refuse(f"<{tag[:60]}> is nested more than {MAX_DEPTH} deep")
        if count > MAX_ELEMENTS:
            raise refuse(f"<{tag[:60]}> is one of more than {MAX_ELEMENTS} elements")
        element = Element(path, tag, dict(attributes), parser.CurrentLineNumber, parent=stack[-1])
        stack[-1].children.append(element)
        stack.append(element)

    def end(_: str) -> None:
        stack.pop()

    def data(text: str) -> None:
        stack[-1].text += text

    def doctype(*_: object) -> None:
        raise refuse("a document type is not allowed; a model needs none, and entities come with it")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = data, doctype
    try:
        parser.Parse(text.encode("utf-8", errors="replace"), True)
    except expat.ExpatError as error:
        inside = f" inside <{stack[-1].tag[:60]}>" if len(stack) > 1 else ""
        raise ValueError(
            f"{path}:{error.lineno}: not a complete XML document: {expat.ErrorString(error.code)}{inside}"
        ) from None
    root = top.children[0]
    root.parent = None
    return root

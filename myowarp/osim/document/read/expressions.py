"""Formulas of OpenSim's `ExpressionBased` classes, in Lepton's words, and functions -> `laws.expressions`."""

import re
from collections.abc import Sequence

from myowarp.laws.expressions import UNARY, Expression
from myowarp.osim.document.functions import (
    Composed,
    Function,
    Held,
    Multiplier,
    Sine,
    curves,
)
from myowarp.osim.document.read.element import Element

TOKEN = re.compile(r"\s*((?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[A-Za-z_][A-Za-z0-9_]*|[-+*/^(),])")
ORDER = {"+": (1, "add"), "-": (1, "sub"), "*": (2, "mul"), "/": (2, "div"), "^": (4, "pow")}
SIGN = 3
"""Precedence of a sign: below that of a power, above that of a product."""
FUNCTIONS = {name: 1 for name in UNARY if name not in ("curve", "neg")} | {"min": 2, "max": 2}
MOST_CHARACTERS = 4000

Code = list[tuple[str, float]]


def expression_in(element: Element, tag: str, variables: Sequence[str]) -> Expression:
    """Return the formula that a property states; "0" where it is missing.

    Raises:
        ValueError: It is no formula of these variables.
    """
    text = element.string(tag, default="0")
    try:
        return parsed(text, variables)
    except ValueError as error:
        raise element.error(f"must have a formula of {', '.join(variables)} as {tag}: {error}") from None


def parsed(text: str, variables: Sequence[str]) -> Expression:
    """Return a formula; what stands behind ";" names parts of it, as in `q*k; k=2`.

    Raises:
        ValueError: It is none.
    """
    if len(text) > MOST_CHARACTERS:
        raise ValueError(f"it has {len(text)} characters, more than {MOST_CHARACTERS}")
    whole, *parts = text.split(";")
    named: dict[str, Code] = {name: [("variable", float(k))] for k, name in enumerate(variables)}
    for part in reversed([part for part in parts if part.strip()]):
        name, equals, formula = part.partition("=")
        if not equals or not name.strip().isidentifier():
            raise ValueError(f"{part.strip()!r} names no part")
        named[name.strip()] = _Parser(formula, named).code
    return Expression(tuple(_Parser(whole, named).code))


class _Parser:
    """A formula, read from left to right by precedence."""

    def __init__(self, text: str, named: dict[str, Code]) -> None:
        self.named, self.tokens, at = named, [], 0
        while at < len(text.rstrip()):
            found = TOKEN.match(text, at)
            if found is None:
                raise ValueError(f"{text[at:].strip()[:20]!r} is not understood")
            self.tokens.append(found[1])
            at = found.end()
        self.at = 0
        self.code = self._sum(0)
        if self.at < len(self.tokens):
            raise ValueError(f"{self.tokens[self.at]!r} follows what is complete")

    def _next(self) -> str:
        if self.at >= len(self.tokens):
            raise ValueError("it ends too early")
        self.at += 1
        return self.tokens[self.at - 1]

    def _sum(self, least: int) -> Code:
        """Return what stands here, with all operators that bind as tightly as the least."""
        code = self._operand()
        while self.at < len(self.tokens) and self.tokens[self.at] in ORDER:
            order, name = ORDER[self.tokens[self.at]]
            if order < least:
                break
            self.at += 1
            code = [*code, *self._sum(order if name == "pow" else order + 1), (name, 0.0)]
        return code

    def _operand(self) -> Code:
        token = self._next()
        if token == "-":
            return [*self._sum(SIGN), ("neg", 0.0)]
        if token == "+":
            return self._sum(SIGN)
        if token == "(":
            code = self._sum(0)
            self._close()
            return code
        if token[0].isdigit() or token[0] == ".":
            return [("number", float(token))]
        if self.at < len(self.tokens) and self.tokens[self.at] == "(":
            return self._call(token)
        if token not in self.named:
            raise ValueError(f"{token!r} is not known; it may have {', '.join(self.named)}")
        return self.named[token]

    def _call(self, name: str) -> Code:
        if name not in FUNCTIONS:
            raise ValueError(f"{name!r} is no function; these are: {', '.join(FUNCTIONS)}")
        self.at += 1
        code = self._sum(0)
        for _ in range(FUNCTIONS[name] - 1):
            if self._next() != ",":
                raise ValueError(f"{name} needs {FUNCTIONS[name]} arguments")
            code = [*code, *self._sum(0)]
        self._close()
        return [*code, (name, 0.0)]

    def _close(self) -> None:
        if self._next() != ")":
            raise ValueError("a bracket is not closed")


def expression_of(function: Function, variable: int = 0) -> Expression:
    """Return a function of one variable as a program.

    Raises:
        NotImplementedError: Its class has no program.
    """
    start: tuple[tuple[str, float], ...] = (("variable", float(variable)),)
    chain = curves(function)
    if chain is not None:
        return Expression((*start, ("curve", 0.0)), (chain,))
    match function:
        case Multiplier(inner, scale):
            found = expression_of(inner, variable)
            return Expression((*found.code, ("number", scale), ("mul", 0.0)), found.curves)
        case Composed(outer, inner):
            return expression_of(outer) | expression_of(inner, variable)
        case Held(inner, low, high):
            code = (*start, ("number", low), ("max", 0.0), ("number", high), ("min", 0.0))
            return expression_of(inner) | Expression(code)
        case Sine(amplitude, omega, phase, offset):
            steps = [("number", omega), ("mul", 0.0), ("number", phase), ("add", 0.0), ("sin", 0.0)]
            steps += [("number", amplitude), ("mul", 0.0), ("number", offset), ("add", 0.0)]
            return Expression((*start, *steps))
    raise NotImplementedError(f"{type(function).__name__} has no program")

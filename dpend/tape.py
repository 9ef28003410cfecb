"""Numbers that record what is done to them, and the statements that do it again, common sub-expressions shared."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any

_SUM, _PRODUCT, _ATOM = 1, 2, 3  # how tightly an expression binds
_BINARY = {"+": _SUM, "-": _SUM, "*": _PRODUCT, "/": _PRODUCT}


def _recording(operation: str, swapped: bool = False) -> Callable[..., Number]:
    def method(*operands: Any) -> Number:
        return operands[0].tape.put(operation, *(operands[::-1] if swapped else operands))

    return method


class Number:
    """A number that records what is done to it, on the tape of what it came from.

    It adds, subtracts, multiplies and divides, and takes absolute values, squares and, as a power, the square root;
    numpy's ``sin``, ``cos``, ``sqrt``, ``rint`` and ``tanh`` call the methods of these names.
    """

    __slots__ = ("place", "tape")

    def __init__(self, tape: Tape, place: int) -> None:
        self.tape, self.place = tape, place

    __add__, __radd__ = _recording("+"), _recording("+", swapped=True)
    __sub__, __rsub__ = _recording("-"), _recording("-", swapped=True)
    __mul__, __rmul__ = _recording("*"), _recording("*", swapped=True)
    __truediv__, __rtruediv__ = _recording("/"), _recording("/", swapped=True)
    __neg__, __abs__ = _recording("neg"), _recording("fabs")
    sin, cos, sqrt, rint, tanh = (_recording(name) for name in ("sin", "cos", "sqrt", "rint", "tanh"))
    __eq__ = __hash__ = None  # type: ignore[assignment]

    def __bool__(self) -> bool:
        raise TypeError("a recorded number has no truth value, so that nothing can branch on it")

    def __pow__(self, power: float) -> Number:
        if power not in (0.5, 2):
            raise ValueError(f"A recorded number takes the powers 2 and 0.5; got {power!r}.")
        return self.sqrt() if power == 0.5 else self.tape.put("*", self, self)


class Tape:
    """What was done to the numbers of a computation, each different operation once."""

    def __init__(self) -> None:
        self._places: dict[tuple[Any, ...], int] = {}
        self._nodes: list[tuple[str, list[Any]]] = []

    def put(self, operation: str, *operands: Any) -> Number:
        """Return the result of an operation on numbers, or on words that name an input."""
        places = [each if isinstance(each, str) else self._place(each) for each in operands]
        key = (operation, *(sorted(places) if operation in "+*" else places))
        if key not in self._places:
            self._places[key] = len(self._nodes)
            self._nodes.append((operation, places))
        return Number(self, self._places[key])

    def _place(self, operand: Any) -> int:
        return operand.place if isinstance(operand, Number) else self.put("constant", number(operand)).place

    def inputs(self, name: str, entries: int | Iterable[str] | None) -> Any:
        """Return numbers that stand for an array of so many entries, the fields of a structure, or a number."""
        if entries is None:
            return self.put("input", name)
        if isinstance(entries, int):
            return [self.put("input", f"{name}[{i}]") for i in range(entries)]
        return SimpleNamespace(**{field: self.put("input", f"{name}->{field}") for field in entries})

    def lines(self, results: dict[str, Any]) -> list[str]:
        """Return the statements that compute results and assign them to places, in the common form of both languages.

        Inputs are read before any result is written, so that a result may be written over an input.
        """
        wanted = {name: self._place(value) for name, value in results.items()}
        uses = [0] * len(self._nodes)
        for place in wanted.values():
            uses[place] += 2 if len(wanted) > 1 else 1
        for place, (operation, operands) in reversed([*enumerate(self._nodes)]):
            if uses[place] and operation not in ("constant", "input"):
                for operand in operands:
                    uses[operand] += 1
        written: dict[int, tuple[str, int]] = {}
        lines: list[str] = []
        for place, (operation, operands) in enumerate(self._nodes):
            if not uses[place]:
                continue
            text, binds = _expression(operation, [written.get(each, each) for each in operands])
            entry = operation == "input" and "[" in text
            if entry or (uses[place] > 1 and operation not in ("constant", "input")):
                name = re.sub(r"\W", "", text) if entry else f"t{len(lines)}"
                lines.append(f"const real {name} = {text};")
                text, binds = name, _ATOM
            written[place] = text, binds
        return lines + [f"{name} = {written[place][0]};" for name, place in wanted.items()]


def _expression(operation: str, operands: list[Any]) -> tuple[str, int]:
    if operation in ("constant", "input"):
        return operands[0], _SUM if operands[0].startswith("-") else _ATOM
    if operation not in _BINARY:
        (text, binds), *_ = operands
        if operation != "neg":
            return f"{operation}({text})", _ATOM
        return f"-{text}" if binds == _ATOM else f"-({text})", _SUM
    binds = _BINARY[operation]
    (left, left_binds), (right, right_binds) = operands
    left = left if left_binds >= binds else f"({left})"
    right = right if right_binds > binds else f"({right})"  # what is grouped stays grouped, to the last bit
    return f"{left} {operation} {right}", binds


def number(value: float) -> str:
    """Return a number as both languages write it, to the last bit of a double."""
    return repr(float(value)).replace("inf", "INFINITY")

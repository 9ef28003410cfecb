"""The help of a study's command line: what it asks, and a line an option, those of this study first."""

from __future__ import annotations

import ast
import inspect
import textwrap
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import tyro

_WORDS = {int: "N", float: "X", str: "NAME", Path: "PATH"}
_GROUPS = {"studies._field": "Who takes part", "studies._runner": "Every study"}


def help_of(options: Any, program: str, question: str, width: int = 80) -> str:
    """Return what ``--help`` shows of a study, within a width.

    Parameters
    ----------
    options : type
        Its options, a dataclass whose fields say what they are in a comment at their end, or a string below.
    program : str
        What it is called by.
    question : str
        What the study asks.
    width : int
        Columns.
    """
    hints, known = get_type_hints(options, include_extras=True), {each.name: each for each in fields(options)}
    groups: dict[str, list[str]] = {}
    for cls in options.__mro__:
        for name, text in _described(cls).items() if cls is not object else ():
            if name in known:
                shown = f"  --{name.replace('_', '-')} {_values(hints[name])}".rstrip()
                groups.setdefault(_GROUPS.get(cls.__module__, "This study"), []).append(
                    textwrap.fill(
                        text + _default(known.pop(name)), width, break_on_hyphens=False,
                        initial_indent=f"{shown:<23} ", subsequent_indent=" " * 24,
                    )
                )  # fmt: skip
    above = [f"usage: {program} [options]", textwrap.fill(question, width)]
    pointer = f"What it does and what it found: python -m pydoc {options.__module__}"
    return "\n\n".join([*above, *(f"{title}\n" + "\n".join(lines) for title, lines in groups.items()), pointer])


def _described(cls: type) -> dict[str, str]:
    """Return what the fields of a class say of themselves in its source, by name."""
    source = textwrap.dedent(inspect.getsource(cls))
    lines, body = source.splitlines(), getattr(ast.parse(source).body[0], "body", [])
    found = {}
    for each, below in zip(body, [*body[1:], None], strict=True):
        match each, below:
            case ast.AnnAssign(ast.Name(name)), ast.Expr(ast.Constant(str(text))):
                found[name] = " ".join(text.split())
            case ast.AnnAssign(ast.Name(name)), _:
                found[name] = lines[(each.end_lineno or 0) - 1].encode()[each.end_col_offset :].decode().strip(" #")
    return found


def _values(hint: Any) -> str:
    """Return what an option takes: nothing where it is a flag."""
    repeated = tyro.conf.UseAppendAction in getattr(hint, "__metadata__", ())
    hint = getattr(hint, "__origin__", hint) if hasattr(hint, "__metadata__") else hint
    if hint is bool:
        return ""
    if get_origin(hint) is Literal:
        return "|".join(get_args(hint))
    if get_origin(hint) is tuple:
        return _values(get_args(hint)[0]) + " ..." * (not repeated)
    return next(word for kind, word in _WORDS.items() if kind is hint or kind in get_args(hint))


def _default(field: Field[Any]) -> str:
    """Return what an option is where it is left out, in brackets, as far as it is anything."""
    value = field.default if field.default_factory is MISSING else field.default_factory()
    if value is None or value is False or value == ():
        return ""
    return f" [{' '.join(map(str, value)) if isinstance(value, tuple) else value}]"

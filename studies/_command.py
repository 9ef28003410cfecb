"""The command ``dpend``: a word for each module that has a command line, which gets all that follows."""

from __future__ import annotations

import ast
import importlib
import re
import runpy
import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path
from textwrap import wrap

import shtab

import dpend
from dpend.suggest import suggestion

from ._runner import studies

MODULES = {
    "studies": "studies",
    "sweep": "studies.lambda_sweep",
    "train": "rl.train",
    "check": "dpend.check",
    "emit": "dpend.emit",
    "export": "studies.export",
    "play": "studies.playground",
    "report": "studies.report",
    **{name.removeprefix("studies.").replace("_", "-"): name for name in studies()},
}
"""What ``python -m`` would be given, by word."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the module that the first word stands for, as ``python -m`` does.

    ``rigs`` lists the presets, ``completion`` prints what a shell needs to complete words and options.
    """
    word, *others = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    if word == "rigs":
        print("\n".join(_line(name, what, 24) for name, what in dpend.rigs().items()))
    elif word in ("-h", "--help"):
        print(_words())
    elif word == "completion":
        print(_completion(*others))
    elif word not in MODULES:
        raise SystemExit(f"dpend does not know {word!r}.{suggestion(word, ['rigs', 'completion', *MODULES])}")
    else:
        sys.argv = ["-m", *others]
        runpy.run_module(MODULES[word], run_name="__main__", alter_sys=True)


def _words() -> str:
    """Return the help: a line for each word, and the studies together, since their own list has their questions."""
    own = {each: module for each, module in MODULES.items() if module not in studies()}
    lines = ["usage: dpend WORD [options]; dpend WORD --help says more", "", _line("  rigs", "List the presets.")]
    lines += [_line("  completion SHELL", "Print what a shell needs to complete words and options.")]
    lines += [_line(f"  {each}", _purpose(module)) for each, module in {"sweep": "studies.lambda_sweep", **own}.items()]
    names = " ".join(each for each in MODULES if each not in own and each != "sweep")
    lines += ["", "Studies, whose questions and minutes `dpend studies` lists:"]
    return "\n".join([*lines, *wrap(names, 80, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False)])


def _purpose(module: str) -> str:
    """Return the first line of a module's docstring, without importing it."""
    spec = find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    page = Path(spec.origin).with_name("__main__.py") if spec.submodule_search_locations else Path(spec.origin)
    words = ast.get_docstring(ast.parse(page.read_text(encoding="utf-8"))) or ""
    first = " ".join(words.partition("\n\n")[0].split()).partition(": ``")[0]
    return re.sub(r":\w+:`(.*?)`", r"\1", first).rstrip(".?") + ("?" if first.endswith("?") else ".")


def _line(name: str, what: str, column: int = 20) -> str:
    """Return a name and what it is, no wider than a terminal of 80 columns."""
    return "\n".join(wrap(what, 80, initial_indent=f"{name:<{column}}", subsequent_indent=" " * column))


def _completion(shell: str = "", *_: str) -> str:
    """Return the script with which a shell completes the words, and the options of studies."""
    if shell not in shtab.SUPPORTED_SHELLS:
        raise SystemExit(f"dpend completion takes a shell, of {', '.join(shtab.SUPPORTED_SHELLS)}; got {shell!r}.")
    parser, known = ArgumentParser("dpend"), set(studies())
    words = parser.add_subparsers()
    for word in ("rigs", "completion", *MODULES):
        name = MODULES.get(word, "")
        command = words.add_parser(word, help=name or word)
        for each in fields(importlib.import_module(name).Options) if name in known else ():
            command.add_argument(f"--{each.name.replace('_', '-')}")
    return shtab.complete(parser, shell)

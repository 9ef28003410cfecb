"""The command ``dpend``: a word for each module that has a command line, which gets all that follows."""

from __future__ import annotations

import importlib
import runpy
import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from dataclasses import fields

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
        print("\n".join(f"{name:<24}{what}" for name, what in dpend.rigs().items()))
    elif word in ("-h", "--help"):
        print("usage: dpend WORD [options]; dpend WORD --help says more\n\n  rigs\n  completion SHELL")
        print("\n".join(f"  {each:<20}python -m {module}" for each, module in MODULES.items()))
    elif word == "completion":
        print(_completion(*others))
    elif word not in MODULES:
        raise SystemExit(f"dpend does not know {word!r}.{suggestion(word, ['rigs', 'completion', *MODULES])}")
    else:
        sys.argv = ["-m", *others]
        runpy.run_module(MODULES[word], run_name="__main__", alter_sys=True)


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

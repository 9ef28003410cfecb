"""The command ``dpend``: a word for each module that has a command line, which gets all that follows."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Sequence

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
    """Run the module that the first word stands for, as ``python -m`` does; ``rigs`` lists the presets."""
    word, *others = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    if word == "rigs":
        print("\n".join(f"{name:<24}{what}" for name, what in dpend.rigs().items()))
    elif word in ("-h", "--help"):
        print("usage: dpend WORD [options]; dpend WORD --help says more\n\n  rigs")
        print("\n".join(f"  {each:<20}python -m {module}" for each, module in MODULES.items()))
    elif word not in MODULES:
        raise SystemExit(f"dpend does not know {word!r}.{suggestion(word, ['rigs', *MODULES])}")
    else:
        sys.argv = ["-m", *others]
        runpy.run_module(MODULES[word], run_name="__main__", alter_sys=True)

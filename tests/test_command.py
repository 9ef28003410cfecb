"""The command dpend: each word leads to a module that is there, and an unknown one to the nearest that is known."""

import re
import sys
from importlib.util import find_spec

import pytest

import dpend
from studies._command import MODULES, main


def test_every_word_stands_for_a_module_that_python_can_run():
    for module in MODULES.values():
        spec = find_spec(module)
        assert spec is not None
        assert spec.submodule_search_locations is None or find_spec(f"{module}.__main__")


def test_what_follows_the_word_goes_to_the_module(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["dpend", "sdre", "--help"])
    monkeypatch.delitem(sys.modules, "studies.sdre", raising=False)  # as in a new process
    with pytest.raises(SystemExit, match="0"):
        main()
    assert "usage: python -m studies.sdre [options]" in capsys.readouterr().out


def test_the_presets_are_listed_and_an_unknown_word_is_refused(capsys):
    main(["rigs"])
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(dpend.rigs())
    with pytest.raises(SystemExit, match=re.escape("dpend does not know 'swepe'. Did you mean 'sweep'?")):
        main(["swepe"])

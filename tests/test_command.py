"""The command dpend: each word leads to a module that is there, and an unknown one to the nearest that is known."""

import re
import shutil
import subprocess
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
    names = [line.split()[0] for line in capsys.readouterr().out.splitlines() if not line.startswith(" ")]
    assert names == list(dpend.rigs())
    with pytest.raises(SystemExit, match=re.escape("dpend does not know 'swepe'. Did you mean 'sweep'?")):
        main(["swepe"])


def test_the_lists_of_words_and_of_presets_fit_a_terminal_and_say_what_each_is(capsys):
    main([])
    words = capsys.readouterr().out
    main(["rigs"])
    assert max(map(len, (words + capsys.readouterr().out).splitlines())) <= 80
    assert len(words.splitlines()) <= 24
    for word in ("rigs", "completion", *MODULES):
        assert re.search(rf"\b{word}\b", words), word


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes_words_and_the_options_of_studies(tmp_path, capsys):
    main(["completion", "bash"])
    (tmp_path / "dpend.sh").write_text(capsys.readouterr().out)
    script = """source dpend.sh; COMP_WORDS=({words}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1))
    $(complete -p dpend | sed 's/.*-F \\([^ ]*\\).*/\\1/'); echo "${{COMPREPLY[@]}}" """

    def completed(words):
        command = ["bash", "-c", script.format(words=words)]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout.split()

    assert completed("dpend sw") == ["sweep", "swing-up"]
    assert completed("dpend sweep --part") == ["--part-of"]
    with pytest.raises(SystemExit, match=r"dpend completion takes a shell, of bash, .*; got 'dos'"):
        main(["completion", "dos"])

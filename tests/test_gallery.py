"""What the gallery and the labs show, runs."""

import runpy
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest
from matplotlib.text import Text

EXAMPLES = Path(__file__).parent.parent / "examples"
SCRIPTS = sorted([*EXAMPLES.glob("gallery/plot_*.py"), *EXAMPLES.glob("labs/lab_*.py")])


@pytest.mark.nightly
@pytest.mark.parametrize("script", SCRIPTS, ids=[path.stem for path in SCRIPTS])
def test_a_script_runs_and_draws_figures_worth_a_slide(script, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mpl.use("Agg")
    monkeypatch.setattr(plt, "show", lambda: None)
    plt.close("all")
    with mpl.rc_context():
        mpl.rcdefaults()
        runpy.run_path(str(script))
        figures = [plt.figure(number) for number in plt.get_fignums()]
        assert figures or script.stem == "lab_2_learn_it"  # whose figures are the student's
        for figure in figures:
            texts = [each for each in figure.findobj(Text) if isinstance(each, Text) and each.get_text()]
            assert min(float(text.get_fontsize()) for text in texts) >= 7
    plt.close("all")


def test_each_sheet_of_tasks_has_a_solution_that_names_it():
    sheets = [path for path in SCRIPTS if path.parent.name == "labs" and not path.stem.endswith("solution")]
    assert len(sheets) == 2
    for sheet in sheets:
        solution = sheet.with_name("_".join(sheet.stem.split("_")[:2]) + "_solution.py")
        assert f":doc:`{sheet.stem}`" in solution.read_text()

"""Who takes part in comparisons: all are controllers for what they claim; a user's own joins, or is refused in time."""

import importlib

import numpy as np
import pytest

import dpend
from dpend.controller import check_controller
from studies import _study
from studies._entrants import ENTRANTS, RIG, Options, own, styles

BY_HAND = """
class ByHand:
    def start(self, n, rng):
        return lambda t, y: y @ [-1, 150, -165, -2.5, 7, -29]

def limited(rig):
    assert rig.sample_time == 0.02
    return ByHand()

def tame(gain=0.5):
    class Tame(ByHand):
        def start(self, n, rng):
            return lambda t, y: gain * y[:, 1]
    return Tame()

ready = ByHand()
wrong_shape = lambda: type("Wrong", (), {"start": lambda self, n, rng: lambda t, y: y})()
number = 3
def nothing():
    return None
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(BY_HAND)
    return path


@pytest.mark.parametrize("entrant", ENTRANTS, ids=lambda entrant: entrant.name)
def test_each_who_takes_part_is_a_controller_for_the_tasks_it_claims(entrant):
    tasks = {"balance": dpend.Balance(), "swing-up": dpend.SwingUp()}
    for task in entrant.tasks:
        check_controller(entrant.make(RIG, tasks[task]))


def test_names_and_styles_tell_all_apart():
    assert len({entrant.name for entrant in ENTRANTS}) == len(ENTRANTS)
    assert len({str(entrant.style) for entrant in ENTRANTS}) == len(ENTRANTS)


def test_styles_come_in_the_order_of_those_known_and_users_own_differ():
    found = styles(["mine", "LSPI", "LQR", "theirs", "LQR"])
    assert list(found) == ["LQR", "LSPI", "mine", "theirs"]
    assert len(set(map(str, found.values()))) == 4


def test_a_share_of_the_runs_is_never_less_than_twenty():
    (mpc,) = (entrant for entrant in ENTRANTS if entrant.name == "iLQR MPC")
    assert [mpc.runs(n) for n in (10, 50, 1000)] == [10, 20, 200]


@pytest.mark.parametrize("factory", ["ByHand", "limited", "tame", "ready"])
def test_a_class_a_function_and_an_object_join_by_the_name_they_have(file, factory):
    entrant = Options(controller=(f"{file}:{factory}",)).entrants("swing-up")[-1]
    assert entrant.name == factory
    force = entrant.make(RIG, dpend.Balance()).start(1, np.random.default_rng(0))(0.0, np.full((1, 6), 0.1))
    assert force == pytest.approx(0.05 if factory == "tame" else 0.1 * (150 - 165 - 1 - 2.5 + 7 - 29))


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("{}", "--controller must be path.py:factory or module:factory; got '{}'."),
        ("none.py:x", "--controller none.py:x: FileNotFoundError: there is no file none.py"),
        ("{}:Hand", "--controller {}:Hand: AttributeError: there is no 'Hand' in {}"),
        ("{}:number", "--controller {}:number: TypeError: expected a function, a class or a controller; got 3"),
        ("{}:nothing", "--controller {}:nothing: TypeError: A controller has a method start(n, rng) that returns "
         "act(t, y); NoneType has none."),
        ("{}:wrong_shape", "--controller {}:wrong_shape: LawError: Wrong failed at t = 0 s in row 0: Expected one "
         "force per row, shape (1,); got shape (1, 6). The runs up to there are kept in the error's `runs`."),
    ],
)  # fmt: skip
def test_what_is_no_controller_is_refused_before_a_study_begins(file, spec, message):
    with pytest.raises(ValueError, match="controller") as refusal:
        Options(controller=(spec.replace("{}", str(file)),))
    assert str(refusal.value) == message.replace("{}", str(file))


def test_two_of_one_name_are_refused(file, tmp_path):
    (tmp_path / "other.py").write_text(BY_HAND)
    message = "--controller: two of those that take part are called 'ByHand'; rename the factory."
    with pytest.raises(ValueError, match="two of those") as refusal:
        Options(controller=(f"{file}:ByHand", f"{tmp_path / 'other.py'}:ByHand"))
    assert str(refusal.value) == message


def test_an_unknown_name_gets_the_nearest():
    with pytest.raises(ValueError, match=r"Nobody that can take part is called 'LQE'. Did you mean 'LQR'\?"):
        Options(only=("LQE",))


def test_some_may_take_part_alone_with_ones_own(file):
    options = Options(only=("LSPI", "LQR", "TVLQR"), controller=(f"{file}:ByHand",))
    assert [entrant.name for entrant in options.entrants("balance")] == ["LQR", "LSPI", "ByHand"]


def test_a_controller_that_joins_leaves_the_results_of_the_others_as_they_are(file):
    importlib.import_module("studies.lambda_sweep")
    job = _study.Job("LQR")
    keys = {
        _study._key("studies.lambda_sweep", job, Options(controller=own))
        for own in ((), (f"{file}:ByHand",), (f"{file}:tame",))
    }
    assert len(keys) == 1


def test_results_of_ones_own_controller_are_kept_only_as_long_as_its_file_is_the_same(file):
    def key():
        source = own(f"{file}:ByHand").source
        return _study._key("studies.lambda_sweep", _study.Job("ByHand", 0, source), Options())

    before = key()
    assert key() == before
    file.write_text(BY_HAND + "\n# changed")
    own.cache_clear()
    importlib.import_module("dpend.provenance").fingerprint.cache_clear()
    assert key() != before

"""The field: all contenders are controllers for what they claim; a user's own joins, or is refused in time."""

import contextlib
import io
import multiprocessing
import os
from dataclasses import dataclass

import numpy as np
import pytest

import dpend
from dpend.controller import check_controller
from studies import _runner
from studies._field import CONTENDERS, LONG, RIG, Contender, Cost, Options, find, longest_first, own, styles
from studies._own import Own

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
def law(t, x):
    return float(x @ [-1, 150, -165, -2.5, 7, -29])
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


@pytest.mark.parametrize("contender", CONTENDERS, ids=lambda contender: contender.name)
def test_each_contender_is_a_controller_for_the_tasks_it_claims(contender):
    tasks = {"balance": dpend.Balance(), "swing-up": dpend.SwingUp()}
    for task in contender.tasks:
        check_controller(contender.make(RIG, tasks[task]))


def test_names_and_styles_tell_all_apart():
    assert len({contender.name for contender in CONTENDERS}) == len(CONTENDERS)
    assert len({str(contender.style) for contender in CONTENDERS}) == len(CONTENDERS)


def test_styles_come_in_the_order_of_those_known_and_users_own_differ():
    found = styles(["mine", "LSPI", "LQR", "theirs", "LQR"])
    assert list(found) == ["LQR", "LSPI", "mine", "theirs"]
    assert len(set(map(str, found.values()))) == 4


def test_a_share_of_the_runs_is_never_less_than_twenty():
    assert [Cost.MODERATE.runs(n) for n in (10, 50, 1000)] == [10, 20, 200]


def test_all_but_two_meet_every_start_and_what_takes_longest_comes_first():
    order, few = [contender.name for contender in longest_first(CONTENDERS)], ["NMPC", "learned model, iLQR"]
    assert [contender.name for contender in CONTENDERS if contender.cost is not Cost.CHEAP] == order[:2] == few
    assert set(order[2 : 2 + len(LONG)]) == LONG


@pytest.mark.parametrize("factory", ["ByHand", "limited", "tame", "ready", "law"])
def test_a_class_a_function_an_object_and_a_plain_law_join_by_the_name_they_have(file, factory):
    contender = Options(controller=(f"{file}:{factory}",)).contenders("swing-up")[-1]
    assert contender.name == factory
    force = contender.make(RIG, dpend.Balance()).start(1, np.random.default_rng(0))(0.0, np.full((1, 6), 0.1))
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
    message = "--controller: two contenders are called 'ByHand'; rename the factory."
    with pytest.raises(ValueError, match="two contenders") as refusal:
        Options(controller=(f"{file}:ByHand", f"{tmp_path / 'other.py'}:ByHand"))
    assert str(refusal.value) == message


def test_an_unknown_name_gets_the_nearest():
    with pytest.raises(ValueError, match=r"No contender is called 'LQE'. Did you mean 'LQR'\?"):
        Options(only=("LQE",))


def test_some_may_take_part_alone_with_ones_own(file):
    options = Options(only=("LSPI", "LQR", "TVLQR"), controller=(f"{file}:ByHand",))
    assert [contender.name for contender in options.contenders("balance")] == ["LQR", "LSPI", "ByHand"]


# ------------------------------------------------------------------------- results of one's own: neither stale nor lost

USES = """
import numpy as np
from helper import scale
from controllers import LQR

FILE = {file!r}
BEFORE = np.load(FILE)

class Mine:
    'A law.'

    def start(self, n, rng):
        K = np.load(FILE) if {lazy} else BEFORE
        return lambda t, y: scale() * y @ K

class Hidden:
    def start(self, n, rng):
        return lambda t, y: y @ BEFORE

def in_a_closure():
    weights = np.load(FILE)
    class Law:
        def start(self, n, rng):
            return lambda t, y: y @ weights
    return Law()

class Counted:
    def __init__(self):
        self.gain = float({environment})
    def start(self, n, rng):
        return lambda t, y: self.gain * y[:, 1]
"""


@pytest.fixture
def place(tmp_path):
    np.save(tmp_path / "gain.npy", np.arange(6.0))
    (tmp_path / "helper.py").write_text("def scale():\n    return 1.0\n")
    source = USES.format(file=str(tmp_path / "gain.npy"), lazy=True, environment="__import__('os').environ['GAIN']")
    (tmp_path / "mine.py").write_text(source)
    return tmp_path


FRESH = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"


@pytest.fixture(scope="module")
def fresh():
    """Return processes in which the field has been loaded, and nothing of a user's own; each does one thing."""
    context = multiprocessing.get_context(FRESH)
    if FRESH == "forkserver":
        context.set_forkserver_preload(["studies._field", __name__])
    with context.Pool(1, maxtasksperchild=1) as pool:
        yield pool


def seen(place, name, gain):
    """Return the fingerprint of a controller, and what is said of it."""
    os.environ["GAIN"] = gain
    with contextlib.redirect_stderr(io.StringIO()) as said:
        found = own(f"{place / 'mine.py'}:{name}").own
    return found, said.getvalue()


@pytest.fixture
def fingerprint(fresh, place):
    """Return what gives the fingerprint of a controller as a process of its own sees it."""

    def taken(name="Mine", gain="1", expected=""):
        found, said = fresh.apply(seen, (place, name, gain))
        assert " ".join(said.split()) == expected
        return found

    return taken


def change_gain(place):
    np.save(place / "gain.npy", np.zeros(6))


CHANGES = {
    "its code": lambda place: (place / "mine.py").write_text((place / "mine.py").read_text() + "\nX = 1\n"),
    "the helper it imports": lambda place: (place / "helper.py").write_text("def scale():\n    return 2.0\n"),
    "the file it loads": change_gain,
}


@pytest.mark.slow
@pytest.mark.parametrize("what", CHANGES)
def test_results_of_ones_own_are_computed_again_when_something_changes(what, place, fingerprint):
    before = fingerprint()
    assert fingerprint() == before
    CHANGES[what](place)
    assert fingerprint() != before


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Hidden", "in_a_closure"])
def test_numbers_count_wherever_they_are_held(name, place, fingerprint):
    before = fingerprint(name)
    change_gain(place)
    assert fingerprint(name) != before


@pytest.mark.slow
def test_numbers_count_wherever_they_come_from(fingerprint):
    assert fingerprint("Counted", "1") == fingerprint("Counted", "1")
    assert fingerprint("Counted", "1") != fingerprint("Counted", "2")


@pytest.mark.slow
def test_a_comment_and_a_docstring_lose_no_results_of_ones_own(place, fingerprint):
    before = fingerprint()
    (place / "mine.py").write_text((place / "mine.py").read_text().replace("A law.", "A good law.") + "# by me\n")
    (place / "helper.py").write_text('"""Help."""\n' + (place / "helper.py").read_text())
    assert fingerprint() == before


@pytest.mark.slow
def test_a_controller_whose_numbers_cannot_be_read_is_run_again_each_time(place, fingerprint):
    add = "import threading\nclass Locked(Counted):\n    def __init__(self):\n        self.lock = threading.Lock()\n"
    add += "        super().__init__()\n"
    (place / "mine.py").write_text((place / "mine.py").read_text() + add)
    said = f"--controller {place / 'mine.py'}:Locked: what lock holds cannot be read, so its runs are not kept."
    assert fingerprint("Locked", expected=said) != fingerprint("Locked", expected=said)


@dataclass(frozen=True)
class Job:
    contender: str
    own: Own | None


def job(contender: Contender) -> Job:
    return Job(contender.name, contender.own)


def test_a_controller_that_joins_leaves_the_results_of_the_others_as_they_are(file):
    keys = []
    for spec in ((), (f"{file}:ByHand",), (f"{file}:tame",)):
        jobs = [job(each) for each in Options(controller=spec).contenders("balance")]
        keys.append([_runner.key("tests.study_example", each) for each in jobs if each.own is None])
    assert keys[0] == keys[1] == keys[2]
    mine = own(f"{file}:ByHand")
    assert find("ByHand", mine.own) is not None
    assert _runner.key("tests.study_example", job(mine)) != _runner.key("tests.study_example", Job("ByHand", None))


def test_a_controller_that_changes_under_way_is_refused(file):
    mine = own(f"{file}:ByHand").own
    assert mine is not None
    with pytest.raises(ValueError, match="changed while the study ran; start it again"):
        find("ByHand", mine._replace(code="another"))


def test_the_cost_class_of_ones_own_follows_from_whether_it_takes_batches(file):
    file.write_text(BY_HAND + "class Slow(ByHand):\n    batched = False\n")
    assert own(f"{file}:Slow").cost is Cost.MODERATE

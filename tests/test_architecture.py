"""The house is built as its plan says: imports run one way, heavy libraries stay in their rooms, all is documented."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("dpend", "controllers", "rl", "studies")
SOURCES = {str(path.relative_to(ROOT)): path for name in PACKAGES for path in sorted((ROOT / name).rglob("*.py"))}


class Import(NamedTuple):
    """One imported module, and whether it is loaded along with the file that imports it."""

    module: str
    names: tuple[str, ...]
    at_once: bool


@cache
def tree(path: Path) -> ast.Module:
    """Return a file's syntax tree, parsed once for all tests."""
    return ast.parse(path.read_text())


@cache
def imports(path: Path, source: str | None = None) -> tuple[Import, ...]:
    """Return what a file imports, relative names resolved; not what only type checkers see."""
    package = ".".join(path.relative_to(ROOT).parts[:-1])

    def walk(node: ast.AST, at_once: bool) -> Iterator[Import]:
        if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            return
        if isinstance(node, ast.Import):
            yield from (Import(alias.name, (), at_once) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = ".".join(package.split(".")[: len(package.split(".")) + 1 - node.level]) if node.level else ""
            names = tuple(alias.name for alias in node.names)
            if node.level and node.module is None:  # from . import a, b
                yield from (Import(f"{above}.{name}", (), at_once) for name in names)
            else:
                yield Import(".".join(filter(None, (above, node.module))), names, at_once)
        inside = at_once and not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for child in ast.iter_child_nodes(node):
            yield from walk(child, inside)

    return tuple(walk(tree(path) if source is None else ast.parse(source), True))


def importers(module: str) -> set[str]:
    """Return the files that import a module or anything in it, now or later."""
    return {
        name
        for name, path in SOURCES.items()
        if any(found.module == module or found.module.startswith(f"{module}.") for found in imports(path))
    }


# --------------------------------------------------------------------------------------------------------------- arrows


def test_the_walk_sees_imports_of_every_kind() -> None:
    source = """
import a.b, c
from d import e
from . import f
from .g import h, i
from .. import j
if TYPE_CHECKING:
    import unseen
class K:
    import l
def m():
    from .n import o
    if True:
        import p
"""
    found = list(imports(ROOT / "package" / "inner" / "file.py", source))
    assert found == [
        Import("a.b", (), True),
        Import("c", (), True),
        Import("d", ("e",), True),
        Import("package.inner.f", (), True),
        Import("package.inner.g", ("h", "i"), True),
        Import("package.j", (), True),
        Import("l", (), True),
        Import("package.inner.n", ("o",), False),
        Import("p", (), False),
    ]


@pytest.mark.parametrize(
    ("package", "stranger"),
    [
        ("dpend", "controllers"),
        ("dpend", "rl"),
        ("dpend", "studies"),
        ("controllers", "rl"),
        ("controllers", "studies"),
        ("rl", "studies"),
        *((package, outside) for package in PACKAGES for outside in ("tests", "benchmarks", "examples")),
    ],
)
def test_imports_run_one_way_from_studies_over_controllers_and_learning_to_the_rig(package: str, stranger: str) -> None:
    assert not {name for name in importers(stranger) if name.startswith(f"{package}/")}


def test_of_learning_only_what_plans_knows_a_controller_and_that_is_ilqr() -> None:
    planning = {f"rl/{name}.py" for name in ("model_based", "identify_plan", "harmonic", "kernel_model")}
    known = {
        found.module
        for name, path in SOURCES.items()
        if name.startswith("rl/")
        for found in imports(path)
        if found.module.startswith("controllers")
    }
    assert {name for name in importers("controllers") if name.startswith("rl/")} <= planning
    assert known <= {"controllers.ilqr", "controllers.ilqr_kernels"}


def test_the_equations_import_nothing() -> None:
    assert not list(imports(SOURCES["dpend/equations.py"]))


def inside(name: str) -> set[str]:
    """Return the modules of dpend that one of them imports, now or later."""
    found = imports(SOURCES[f"dpend/{name}.py"])
    return {each.module.removeprefix("dpend.") for each in found if each.module.startswith("dpend.")}


@pytest.mark.parametrize(
    ("name", "allowed"),
    [
        ("archive", {"arguments"}),
        ("arguments", set()),
        ("state", {"arguments", "params", "suggest"}),
        ("episode", {"status"}),
        ("kernels", {"cache", "episode", "equations", "params", "provenance", "state", "status", "trigonometry"}),
        ("symbolic", {"equations", "params", "rig"}),
        ("plant", {"arguments", "equations", "params", "state"}),
        ("linear", {"arguments", "params", "plant", "state"}),
        ("rig", {"archive", "arguments", "equations", "params", "suggest"}),
        ("tasks", {"arguments", "deprecation", "kernels", "params", "rig", "state", "suggest"}),
        ("stepper", {"arguments", "kernels", "params", "rig", "state"}),
        ("controller", {"params"}),
        ("laws", {"controller", "kernels", "params"}),
        ("workers", {"arguments"}),
        ("check", {"arguments", "controller", "params", "rig", "simulate", "stepper", "suggest", "tasks"}),
    ],
)
def test_within_the_rig_each_module_knows_only_what_it_stands_on(name: str, allowed: set[str]) -> None:
    assert inside(name) <= allowed


def test_nothing_in_the_rig_knows_its_environments() -> None:
    environments = {"dpend/env.py", "dpend/vector_env.py"}
    users = (importers("dpend.env") | importers("dpend.vector_env")) - environments
    assert not {name for name in users if name.startswith("dpend/")}


def test_no_modules_import_each_other_in_a_circle_now_or_later() -> None:
    file_of = {name.removesuffix(".py").removesuffix("/__init__").replace("/", "."): name for name in SOURCES}

    def needs(name: str) -> set[str]:
        """Return the files that one imports: modules, or names of a package that are modules of it."""
        named = {
            module
            for each in imports(SOURCES[name])
            for module in ([f"{each.module}.{taken}" for taken in each.names] or [each.module])
        }
        found = {file_of.get(module) or file_of.get(module.rpartition(".")[0]) for module in named}
        return {other for other in found if other is not None and not other.endswith("__init__.py")} - {name}

    known = {name: needs(name) for name in SOURCES if not name.endswith("__init__.py")}
    while known:
        free = {name for name, others in known.items() if not others & set(known)}
        assert free, f"a circle among {sorted(set(known) & set().union(*known.values()))}"
        known = {name: others for name, others in known.items() if name not in free}


def test_only_the_stepper_advances_the_plant_and_only_learners_and_planners_call_its_scalar_step() -> None:
    taken = {
        name: {taken for found in imports(path) if found.module == "dpend.kernels" for taken in found.names}
        for name, path in SOURCES.items()
    }
    assert {name for name, names in taken.items() if "plant_step" in names} == {"dpend/stepper.py"}
    callers = {name for name, names in taken.items() if names & {"sample", "rk4"}}
    assert {name for name in callers if not name.startswith("rl/")} <= {"controllers/ilqr_kernels.py"}  # it plans ahead
    stating = {name for name, path in SOURCES.items() if "make_rk4" in path.read_text()}
    assert stating == {f"dpend/{name}.py" for name in ("emit", "equations", "jax_plant", "kernels", "symbolic")}


# ------------------------------------------------------------------------------------------------------ heavy libraries

ROOMS: dict[str, tuple[str, ...]] = {
    "casadi": (
        "dpend/symbolic.py",
        "controllers/trajopt.py",
        "controllers/least_force.py",
        "controllers/tvlqr.py",
        "controllers/codegen.py",
        "controllers/shooting.py",
        "controllers/nmpc.py",
        "studies/export/planner.py",
    ),
    "matplotlib": ("dpend/draw.py", "studies/*"),
    "torch": ("rl/sb3.py", "rl/pilco.py"),
    "stable_baselines3": ("rl/sb3.py",),
    "jax": ("dpend/jax_plant.py", "rl/sb3_jax.py"),
    "sbx": ("rl/sb3_jax.py",),
    "numba": ("dpend/kernels.py", "controllers/ilqr_kernels.py", "rl/*"),
    "control": ("controllers/*",),
    "distributed": ("studies/_cluster.py",),
    "gymnasium": ("dpend/__init__.py", "dpend/env.py", "dpend/vector_env.py", "rl/*", "studies/*"),
    "pandas": ("studies/*",),
    "onnx": ("studies/export/network.py",),
    "starlette": ("studies/playground/server.py",),
    "uvicorn": ("studies/playground/server.py",),
}


@pytest.mark.parametrize("library", ROOMS)
def test_a_heavy_library_stays_in_its_rooms(library: str) -> None:
    astray = {name for name in importers(library) if not any(Path(name).match(room) for room in ROOMS[library])}
    assert not astray


@pytest.mark.parametrize(
    ("statement", "heavy"),
    [
        ("import dpend", ("numba", "scipy", "control", "casadi", "matplotlib", "torch")),
        ("from controllers import LQR; LQR('gustafsson2016')", ("numba", "control", "casadi", "matplotlib", "torch")),
    ],
)
def test_what_is_light_loads_nothing_heavy(statement: str, heavy: tuple[str, ...]) -> None:
    program = f"import sys; {statement}; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_a_name_is_exported_as_type_checkers_see_it() -> None:
    module = importlib.import_module("controllers")
    (seen,) = (node for node in tree(SOURCES["controllers/__init__.py"]).body if isinstance(node, ast.If))
    imported = {name.name: node.module for node in seen.body if isinstance(node, ast.ImportFrom) for name in node.names}
    assert imported == module._MODULES
    assert set(imported) == set(module.__all__)


def test_ilqr_is_the_function_whatever_has_been_imported() -> None:
    function = importlib.import_module("controllers.ilqr").ilqr
    assert importlib.import_module("controllers").ilqr is function


def test_no_module_is_a_drawer_for_odds_and_ends() -> None:
    assert not [
        name for name in SOURCES if Path(name).stem.strip("_") in ("utils", "util", "common", "helpers", "misc")
    ]


def test_no_number_is_drawn_from_a_global_state() -> None:
    allowed = {"Generator", "SeedSequence", "default_rng", "BitGenerator", "PCG64"}
    for name, path in SOURCES.items():
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.Attribute) and ast.unparse(node.value) in ("np.random", "numpy.random"):
                assert node.attr in allowed, f"{name}:{node.lineno} calls numpy.random.{node.attr}"
        assert not any(found.module == "random" for found in imports(path)), name


def test_nothing_that_is_loaded_can_run_code() -> None:
    for name, path in SOURCES.items():
        assert not {found.module.partition(".")[0] for found in imports(path)} & {"pickle", "dill", "joblib", "shelve"}
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.Call):
                function = ast.unparse(node.func)
                assert function not in ("eval", "exec", "pickle.load", "pickle.loads"), f"{name}:{node.lineno}"
                trusting = [
                    key for key in node.keywords if key.arg == "allow_pickle" and ast.unparse(key.value) != "False"
                ]
                assert not trusting, f"{name}:{node.lineno}"


# -------------------------------------------------------------------------------------------------------- documentation


@pytest.mark.parametrize("name", SOURCES)
def test_every_module_says_what_it_is(name: str) -> None:
    said = ast.get_docstring(tree(SOURCES[name]))
    assert said, f"{name} has no docstring"


def sections(docstring: str) -> dict[str, str]:
    """Cut a numpydoc docstring at its underlined titles."""
    parts = re.split(r"^(\w[\w ]*)\n-{3,}\n", inspect.cleandoc(docstring), flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def names_in(section: str) -> set[str]:
    """Return names that a section explains: what stands before a colon, or alone, on lines that are not indented."""
    lines = [line for line in section.splitlines() if line and not line[0].isspace()]
    return {name.strip("* ") for line in lines for name in line.partition(" : ")[0].split(",")}


def arguments(thing: Callable[..., Any]) -> set[str]:
    """Return the names of what a function or class takes."""
    return {name for name in inspect.signature(thing).parameters if name not in ("self", "cls")}


def public() -> dict[str, Any]:
    """Return the classes and functions that the packages export, by their full names."""
    found: dict[str, Any] = {}
    for package in ("dpend", "controllers", "rl"):
        module = importlib.import_module(package)
        for name in module.__all__:
            thing = getattr(module, name)
            if inspect.isfunction(thing) or inspect.isclass(thing):
                found[f"{package}.{name}"] = thing
    return found


def gaps(thing: Any) -> list[str]:
    """Say what the documentation of a class or function lacks, and what it has too much."""
    if not thing.__doc__ or thing.__doc__.startswith(f"{thing.__name__}("):  # dataclasses write their own otherwise
        return ["has no docstring"]
    protocol = getattr(thing, "_is_protocol", False)
    if inspect.isclass(thing) and (issubclass(thing, Enum | Exception) or protocol):
        return []
    parts = sections(thing.__doc__)
    explained = names_in(parts.get("Parameters", ""))
    plain = dataclasses.is_dataclass(thing) or (inspect.isclass(thing) and issubclass(thing, tuple))
    attributes = names_in(parts.get("Attributes", "")) if plain else set()
    taken = arguments(thing)
    return [
        *(f"does not explain {name}" for name in sorted(taken - explained - attributes)),
        *(f"explains {name}, which it does not take" for name in sorted(explained - taken)),
    ]


def test_the_checker_of_documentation_sees_gaps() -> None:
    def documented(a: int, *b: int, c: int = 0, **d: int) -> None:
        """Do something.

        Parameters
        ----------
        a, c : int
            Numbers.
        *b : int
            More.
        **d
            Others: named ones.

        Returns
        -------
        nothing : at all
        """

    def lacking(a: int, b: int) -> None:
        """Do something.

        Parameters
        ----------
        a : int
        x : int
        """

    def silent() -> None: ...

    assert gaps(documented) == []
    assert gaps(lacking) == ["does not explain b", "explains x, which it does not take"]
    assert gaps(silent) == ["has no docstring"]


@pytest.mark.parametrize("name", public())
def test_everything_public_explains_all_that_it_takes_and_nothing_else(name: str) -> None:
    thing = public()[name]
    found = gaps(thing)
    for attribute, value in vars(thing).items() if inspect.isclass(thing) else ():
        function = value.fget if isinstance(value, property) else getattr(value, "__func__", value)
        if attribute.startswith("_") or not inspect.isfunction(function):
            continue
        if not function.__doc__:
            found.append(f"{attribute} has no docstring")
        elif "Parameters" in sections(function.__doc__):
            found.extend(f"{attribute} {gap}" for gap in gaps(function))
    assert not found


def test_what_the_packages_export_exists_and_is_listed_in_order() -> None:
    for package in ("dpend", "controllers", "rl"):
        module = importlib.import_module(package)
        assert len(set(module.__all__)) == len(module.__all__)
        for name in module.__all__:
            assert hasattr(module, name), f"{package}.{name}"

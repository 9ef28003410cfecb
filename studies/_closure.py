"""What a result was computed from: a hash of the code that a function reaches, and of the data shipped with it.

The walk begins at some definitions of a study and follows names: to other definitions of the studies, one by one, and
to modules of the other packages, whole.  Imports count wherever they stand, also within functions; what only type
checkers see does not, nor do docstrings, comments, annotations, layout, and modules that draw.

The walk stops at a table of contenders, a tuple of ``Contender(name="LQR", ...)``.  Of its entries those count whose
names are words of the job or literals in the definitions that were reached in the studies, and all if there is none.
So do the policies that are shipped, of which a job that names contenders has those alone that they name.  While a job
is done, no other contender can be looked up.
"""

from __future__ import annotations

import ast
import hashlib
import re
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from contextvars import ContextVar
from copy import copy
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from symtable import SymbolTable, symtable
from typing import NamedTuple

ROOT = Path(__file__).parent.parent
PACKAGES = ("dpend", "controllers", "rl", "studies")

covered: ContextVar[frozenset[str] | None] = ContextVar("covered", default=None)
"""Words that hold the names of the contenders that may be looked up: of those in the job's key; None for any."""

_DATA = {"controllers.data": "controllers/data/*.npz"}
"""What is shipped beside a module and read by it."""
_POLICIES = "rl/trained/*.npz"
"""What ``load_policy`` reads, by name."""
_SHOWN_ONLY = frozenset({"style", "prior_knowledge"})
"""Keywords that only figures and tables read."""
_ASIDE = frozenset({"dpend.draw", "studies._closure", "studies._own", "studies._runner"})
"""Modules that change no result: they draw, and find out what results depend on and keep them."""
_MODULE_NAME = re.compile(r"(\w+(?:\.\w+)+)(?::\w+)?")

_Statements = list[ast.stmt]


class Binding(NamedTuple):
    """A module, or a name in one: what an import binds, or a contender such as ``CONTENDERS[LQR]``."""

    module: str
    name: str | None


def source_hash(module: str, words: frozenset[str] | None = None, root: Path = ROOT) -> str:
    """Return a hash of all that ``run`` and ``Job`` of a study depend on, see :func:`closure`: sixteen digits."""
    return combined(closure(module, ("run", "Job"), words, root)[0])


def combined(parts: dict[str, str]) -> str:
    """Return one hash of several, whatever their order."""
    return hashlib.sha256(repr(sorted(parts.items())).encode()).hexdigest()[:16]


def file_hash(file: Path) -> str:
    """Return a hash of a file's content."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16]


@cache
def closure(
    module: str, names: tuple[str, ...], words: frozenset[str] | None = None, root: Path = ROOT
) -> tuple[dict[str, str], frozenset[str] | None]:
    """Return what definitions of a module depend on: hashes by name of definition, module or file; and :data:`covered`.

    Parameters
    ----------
    module : str
        The module's name, such as ``"studies.lambda_sweep"``.
    names : tuple of str
        Definitions in it at which the walk begins.
    words : frozenset of str, optional
        The words in a job, which may name contenders and shipped policies; left out, all of these count.
    root : Path
        The folder that holds the packages.
    """
    return _with_entries(_walked(module, names, root), words)


@cache
def _walked(module: str, names: tuple[str | None, ...], root: Path, before: _Walk | None = None) -> _Walk:
    """Return a walk from definitions, through what another has not found before."""
    walk = _Walk(root, (*PACKAGES, module.partition(".")[0]), found=before.found if before else {})
    for name in names:
        walk.reach(module, name)
    return walk


def _with_entries(walk: _Walk, words: frozenset[str] | None) -> tuple[dict[str, str], frozenset[str] | None]:
    """Return what a walk has found, with the contenders and policies that are named; and which may be looked up."""
    parts, entries, loads = dict(walk.found), dict(walk.entries), walk.loads
    said = walk.words | (words or frozenset())
    whole = words is None or said.isdisjoint(entries.values())
    added: set[Binding] = set()
    while new := {entry for entry, name in entries.items() if whole or name in said} - added:
        for entry in new:
            further = _walked(entry.module, (entry.name,), walk.root, walk)
            parts |= further.found
            said |= further.words
            entries |= further.entries
            loads |= further.loads
        added |= new
    policies = {file.stem: file for file in walk.root.glob(_POLICIES)} if loads else {}
    every = words is None or (whole and said.isdisjoint(policies))
    parts |= {f"policy {name}": file_hash(file) for name, file in policies.items() if every or name in said}
    return parts, None if whole else said


def closure_of_file(file: Path, root: Path = ROOT) -> tuple[dict[str, str], list[str]]:
    """Return hashes of what a user's file depends on, and the modules from outside the environment among it.

    Parameters
    ----------
    file : Path
        Python source; its imports are looked up as Python does, so that the folders they lie in must be on the path.
    root : Path
        The folder that holds the packages.

    Returns
    -------
    parts : dict
        As :func:`closure` gives them.
    outside : list of str
        Names of modules that are neither installed nor part of this project; the file itself is not named.
    """
    walk = _Walk(root, PACKAGES, {}, outside=True)
    walk.whole(str(file), file)
    return _with_entries(walk, None)[0], walk.strangers


class _Walk:
    """One walk through the sources: what it has found, by name, and the contenders and literals on its way."""

    def __init__(self, root: Path, packages: Iterable[str], found: dict[str, str], outside: bool = False) -> None:
        self.root = root
        self.packages = frozenset(packages)
        self.outside = outside
        self.found = dict(found)
        self.strangers: list[str] = []
        self.entries: dict[Binding, str] = {}
        self.words: frozenset[str] = frozenset()
        self.loads = False

    def path(self, module: str) -> Path | None:
        """Return the file of a module that counts, or none."""
        if module.partition(".")[0] not in self.packages:
            return self._stranger(module) if self.outside else None
        base = self.root.joinpath(*module.split("."))
        return next((file for file in (base.with_suffix(".py"), base / "__init__.py") if file.is_file()), None)

    def _stranger(self, module: str) -> Path | None:
        try:
            loaded = sys.modules.get(module)
            spec = loaded.__spec__ if loaded else find_spec(module)
        except (ImportError, ValueError, AttributeError):
            return None
        if spec is None or not spec.has_location or not str(spec.origin).endswith(".py"):
            return None
        file = Path(str(spec.origin))
        if within_environment(file):
            return None
        if module not in self.strangers:
            self.strangers.append(module)
        return file

    def reach(self, module: str, name: str | None) -> None:
        """Add what a name in a module stands for; without a name, all of the module."""
        file = self.path(module)
        if file is None or module in _ASIDE:
            return
        self.loads |= name == "load_policy"
        is_package = file.name == "__init__.py"
        if is_package and name is not None and self.path(f"{module}.{name}"):
            self.reach(f"{module}.{name}", None)
        elif is_package and (
            found := _bindings(ast.parse(file.read_bytes()).body, module, True, typing=True).get(str(name))
        ):
            self.reach(*found)  # what a package only passes on, at once or when it is asked for
        elif module.partition(".")[0] in self.packages - {"dpend", "controllers", "rl"}:
            self._definitions(module, file, None if name is None else {name})
        else:
            self.whole(module, file)

    def whole(self, module: str, file: Path) -> None:
        """Add a module, all it imports, and the data that lies beside it."""
        if module in self.found:
            return
        body = _body(file.read_bytes())
        self.found[module] = _hash(body)
        for data in sorted(self.root.glob(_DATA[module])) if module in _DATA else ():
            self.found[str(data.relative_to(self.root))] = file_hash(data)
        self._follow(body, _bindings(body, module, file.name == "__init__.py"))

    def _definitions(self, module: str, file: Path, names: set[str] | None) -> None:
        """Add definitions of a module, and what they use."""
        body = _body(file.read_bytes())
        imports = _bindings(body, module, file.name == "__init__.py")
        known, always = _split(body)
        open_names = list(known if names is None else names)
        if always and f"{module}:" not in self.found:
            self.found[f"{module}:"] = _hash(always)
            open_names += sorted(_globals(always))
            self.words |= self._follow(always, {alias: imports[alias] for alias in imports.keys() & _globals(always)})
        while open_names:
            name = open_names.pop()
            if name not in known:
                if names and name in names and name in imports:
                    self.reach(*imports[name])
                continue
            if f"{module}:{name}" in self.found:
                continue
            self.found[f"{module}:{name}"] = _hash(known[name])
            self.entries |= {Binding(module, at): at[len(name) + 1 : -1] for at in known if at.startswith(f"{name}[")}
            used = _globals(known[name])
            open_names += sorted(used & known.keys())
            inner = _bindings(known[name], module, file.name == "__init__.py")
            self.words |= self._follow(known[name], {alias: imports[alias] for alias in imports.keys() & used} | inner)

    def _follow(self, body: _Statements, bindings: dict[str, Binding]) -> frozenset[str]:
        """Go on to what statements use of their imports, and to what they name in literals; return these."""
        attributes: dict[str, set[str | None]] = {}
        literals: set[str] = set()
        for node in (node for statement in body for node in ast.walk(statement)):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                attributes.setdefault(node.value.id, set()).add(node.attr)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                literals.add(node.value)
            elif isinstance(node, ast.Call):
                self._kept_table(node)
        for text in sorted(literals):  # a module, such as an entry point's, or an environment of Gymnasium's
            if text.startswith("dpend/"):
                self.reach("dpend", None)
            elif (match := _MODULE_NAME.fullmatch(text)) and match[1].partition(".")[0] in self.packages:
                self.reach(match[1], None)
        bare = _bare_names(body)
        for alias, (module, name) in bindings.items():
            if name is not None and self.path(f"{module}.{name}"):
                module, name = f"{module}.{name}", None
            if name is not None:
                self.reach(module, name)
            else:
                for attribute in sorted(attributes.get(alias, set()) | ({None} if alias in bare else set()), key=str):
                    self.reach(module, attribute)
        return frozenset(literals)

    def _kept_table(self, call: ast.Call) -> None:
        """Add the shipped table that a call reads."""
        called = ast.unparse(call.func).rpartition(".")[2]
        for name in (each.value for each in call.args if isinstance(each, ast.Constant) and called == "kept_table"):
            file = kept_table(str(name), self.root)
            self.found[f"table {name}"] = file_hash(file) if file.exists() else ""


def kept_table(name: str, root: Path = ROOT) -> Path:
    """Return the ``rows.csv`` of a study that is shipped: in the package where it is installed, else in docs/results.

    Parameters
    ----------
    name : str
        The study, such as ``"recoverable"``; a literal, since the key of a result that reads it is found by its text.
    root : Path
        The folder that holds the packages.
    """
    installed = root / "studies" / "data" / f"{name}.csv"
    return installed if installed.exists() else root / "docs" / "results" / name / "rows.csv"


def kept_folder(name: str, root: Path = ROOT) -> Path | None:
    """Return the folder of a study's whole kept table, in the package or in docs/results; None if there is none."""
    folders = (root / "studies" / "data" / name, root / "docs" / "results" / name)
    return next((folder for folder in folders if (folder / "meta.json").exists()), None)


def within_environment(file: Path) -> bool:
    """Return whether a file belongs to Python, to an installed package or to this project's packages."""
    places = [Path(sysconfig.get_path(kind)) for kind in ("stdlib", "platstdlib", "purelib", "platlib")]
    places += [ROOT / package for package in PACKAGES]
    return any(file.resolve().is_relative_to(place.resolve()) for place in places)


# --------------------------------------------------------------------------------------------------------- the sources


@cache
def _body(content: bytes) -> _Statements:
    """Return a source's statements without what changes no result; cached by content, so that an edit shows."""
    return _Plain().visit(ast.parse(content)).body


def _hash(body: _Statements) -> str:
    text = "\n".join(ast.dump(statement, annotate_fields=False) for statement in body)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")


def _bindings(body: _Statements, module: str, package: bool, *, typing: bool = False) -> dict[str, Binding]:
    """Return what imports bind anywhere in statements, relative names resolved."""
    parents = module.split(".") if package else module.split(".")[:-1]
    found: dict[str, Binding] = {}

    def imports(nodes: Iterable[ast.AST]) -> Iterator[ast.Import | ast.ImportFrom]:
        for node in nodes:
            if isinstance(node, ast.Import | ast.ImportFrom):
                yield node
            elif typing or not _type_checking(node):
                yield from imports(ast.iter_child_nodes(node))

    for node in imports(body):
        for alias in node.names:
            if isinstance(node, ast.ImportFrom):
                above = parents[: len(parents) + 1 - node.level] if node.level else []
                found[alias.asname or alias.name] = Binding(
                    ".".join([*above, *filter(None, [node.module])]), alias.name
                )
            elif alias.asname:
                found[alias.asname] = Binding(alias.name, None)
            else:
                top = alias.name.partition(".")[0]  # import a.b binds a; b counts where a.b is used
                found[top] = Binding(top, None)
    return found


class _Plain(ast.NodeTransformer):
    """Leave out what changes no result: docstrings, annotations, what type checkers and tables alone read."""

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        return None if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str) else node

    def visit_If(self, node: ast.If) -> ast.AST | None:
        main = ast.unparse(node.test).startswith("__name__ ==")
        return None if main or _type_checking(node) else self.generic_visit(node)

    def visit_arg(self, node: ast.arg) -> ast.arg:
        return ast.arg(node.arg)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        self.generic_visit(node)
        kinds = [kind for kind in ("ClassVar", "InitVar") if kind in ast.unparse(node.annotation)]
        node.annotation = ast.Constant("".join(kinds))
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        node.keywords = [keyword for keyword in node.keywords if keyword.arg not in _SHOWN_ONLY]
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef | ast.ClassDef) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node, ast.FunctionDef):
            node.returns = None
        node.body = node.body or [ast.Pass()]
        return node

    visit_ClassDef = visit_FunctionDef


def _split(body: _Statements) -> tuple[dict[str, _Statements], _Statements]:
    """Return a module's definitions by name, tables of contenders entry by entry, and other statements than imports."""
    known: dict[str, _Statements] = {}
    always: _Statements = []
    for statement in body:
        if isinstance(statement, ast.Import | ast.ImportFrom):
            continue
        names = {
            node.id for node in ast.walk(statement) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
        }
        if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names = {statement.name}
        elif not isinstance(statement, ast.Assign | ast.AnnAssign | ast.AugAssign):
            names = set()
        statement, entries = _cut(statement)
        for name in names:
            known.setdefault(name, []).append(statement)
            for entry, call in entries.items():
                known.setdefault(f"{name}[{entry}]", []).append(ast.Expr(call))
        if not names:
            always.append(statement)
    return known, always


def _cut(statement: ast.stmt) -> tuple[ast.stmt, dict[str, ast.expr]]:
    """Return a statement without the contenders in a tuple that it assigns, and these by name."""
    entries: dict[str, ast.expr] = {}
    if isinstance(statement, ast.Assign | ast.AnnAssign) and isinstance(statement.value, ast.Tuple):
        others: list[ast.expr] = []
        for each in statement.value.elts:
            match each:
                case ast.Call(ast.Name("Contender"), [], [ast.keyword("name", ast.Constant(str(name))), *_]) if (
                    name not in entries
                ):
                    entries[name] = each
                case _:
                    others.append(each)
        statement = copy(statement)
        statement.value = ast.Tuple(others, ast.Load())
    return statement, entries


def _globals(body: _Statements) -> set[str]:
    """Return the global names that statements read, in whatever scope."""

    def read(table: SymbolTable) -> Iterator[str]:
        top = table.get_type() == "module"
        yield from (s.get_name() for s in table.get_symbols() if s.is_referenced() and (top or s.is_global()))
        for child in table.get_children():
            yield from read(child)

    return set(read(symtable("\n".join(map(ast.unparse, body)), "", "exec")))


def _bare_names(body: _Statements) -> set[str]:
    """Return names that stand without an attribute somewhere."""
    nodes = [node for statement in body for node in ast.walk(statement)]
    within = {id(node.value) for node in nodes if isinstance(node, ast.Attribute)}
    return {node.id for node in nodes if isinstance(node, ast.Name) and id(node) not in within}

"""Controllers of a user's own: loaded from a file or module, tried for two samples, and fingerprinted.

A fingerprint holds the code from outside the environment, what of this project it uses, the files that were read while
it was loaded and tried, and the numbers in the controller and in the modules.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from types import FunctionType, MethodType, ModuleType
from typing import Any, NamedTuple

import numpy as np

import dpend
from dpend import Controller, Rig
from dpend.controller import as_controller, check_controller, is_batched

from ._closure import closure_of_file, combined, file_hash, within_environment

tried_on: ContextVar[Rig | None] = ContextVar("tried_on", default=None)
"""The rig of the study that loads a controller, where that is another than that of the comparisons."""


class Own(NamedTuple):
    """A user's own controller as a job names it."""

    spec: str  # ``path.py:factory`` or ``module:factory``.
    code: str  # Hash of its code and of the files that it read.
    numbers: str  # Hash of the numbers in it.


class Loaded(NamedTuple):
    """A user's own controller, loaded."""

    own: Own
    factory: Any
    batched: bool

    @property
    def name(self) -> str:
        """That of the factory."""
        return self.own.spec.rpartition(":")[2]

    def make(self, rig: Rig) -> Controller:
        """Return the controller for a rig; a ValueError if the factory refuses it in any way."""
        try:
            return _made(self.factory, rig)
        except Exception as error:
            raise ValueError(_said(self.own.spec, error)) from error


def _said(spec: str, error: Exception) -> str:
    return f"--controller {spec}: {type(error).__name__}: {error}"


def load_own(spec: str, rig: Rig) -> Loaded:
    """Return a user's own controller.

    It is built once and acts for two samples, so that what is wrong with it shows before a study begins.

    Parameters
    ----------
    spec : str
        ``path.py:factory`` or ``module:factory``.  The factory is a function or class, called with the rig, or with
        nothing where it takes nothing; or a controller, or a plain function ``law(t, x)`` of one state.
    rig : Rig
        The rig on which it is tried, unless :data:`tried_on` has another.

    Raises
    ------
    ValueError
        If there is no such file or name, it raises, or what it returns is no controller.
    """
    place, _, name = spec.rpartition(":")
    if not place or not name:
        raise ValueError(f"--controller must be path.py:factory or module:factory; got {spec!r}.")
    rig = tried_on.get() or rig
    try:
        with _files_read() as read:
            before = set(sys.modules)
            module = _module(place)
            if not hasattr(module, name):
                raise AttributeError(f"there is no {name!r} in {place}")
            factory = getattr(module, name)
            made = _made(factory, rig)
            check_controller(made)
            dpend.simulate(rig, made, [0, 0.01, 0.01, 0, 0, 0], 2 * rig.sample_time)
    except Exception as error:
        raise ValueError(_said(spec, error)) from error
    parts, outside = closure_of_file(Path(str(module.__file__)))
    names = {*outside, *(set(sys.modules) - before)} - {module.__name__}
    brought = {key: loaded for key in names if (loaded := _outside(key))}
    modules = {**brought, module.__name__: module}
    parts |= {f"module {key}": file_hash(Path(str(each.__file__))) for key, each in brought.items() if key not in parts}
    parts |= {f"file {file}": file_hash(file) for file in read}
    return Loaded(Own(spec, combined(parts), _numbers_hash(spec, made, modules)), factory, is_batched(made))


def _module(place: str) -> ModuleType:
    """Import a file by its path, with its folder on the path for what it imports, or a module by its name."""
    if not place.endswith(".py"):
        return importlib.import_module(place)
    path = Path(place).resolve()
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {place}")
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    spec = importlib.util.spec_from_file_location(f"{path.stem} {hashlib.sha256(str(path).encode()).hexdigest()}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def _made(factory: object, rig: Rig) -> Controller:
    """Call a factory with the rig, or with nothing where it takes nothing; a controller or law(t, x) is one already."""
    if not isinstance(factory, type) and isinstance(factory, Controller):
        return factory
    if not callable(factory):
        raise TypeError(f"expected a function, a class or a controller; got {factory!r}")
    taken = list(inspect.signature(factory).parameters.values())
    if inspect.isfunction(factory) and [each.name for each in taken[:1]] == ["t"]:
        return as_controller(factory)
    wants_rig = any(parameter.name == "rig" or parameter.default is parameter.empty for parameter in taken)
    made: Any = factory(rig) if wants_rig else factory()
    return made


def _outside(name: str) -> ModuleType | None:
    """Return a loaded module that comes neither with Python nor from an installed package nor from this project."""
    module = sys.modules.get(name)
    file = getattr(module, "__file__", None)
    return module if module and file and Path(file).suffix == ".py" and not within_environment(Path(file)) else None


# -------------------------------------------------------------------------------------------------- what it consists of

_reading: set[Path] | None = None


def _notice(event: str, arguments: tuple[Any, ...]) -> None:
    if _reading is not None and event == "open" and isinstance(arguments[0], str | bytes | os.PathLike):
        _reading.add(Path(os.fsdecode(arguments[0])).resolve())


@cache
def _watch() -> None:
    sys.addaudithook(_notice)  # can never be taken away again, so there is one


@contextmanager
def _files_read() -> Iterator[set[Path]]:
    """Return a set that holds, after the block, the user's files of data that were opened in it."""
    global _reading
    _watch()
    _reading = read = set[Path]()
    try:
        yield read
    finally:
        _reading = None
        code = {".py", ".pyc", ".so", ".nbi", ".nbc"}
        read -= {file for file in read if file.suffix in code or not file.is_file() or within_environment(file)}
        read -= {file for file in read if file.is_relative_to("/proc")}


class _Unknown(Exception):
    """A value of which no numbers can be read."""


def _numbers_hash(spec: str, made: Controller, modules: dict[str, ModuleType]) -> str:
    """Hash the numbers in a controller and in the modules it comes from; anew each time where they cannot be read."""
    digest = _Digest(frozenset(modules))
    try:
        digest.add(made)
    except _Unknown as error:
        said = f"--controller {spec}: what {error} holds cannot be read, so its runs are not kept."
        print(said, file=sys.stderr)
        return os.urandom(8).hex()
    for name in sorted(modules):
        for key, value in sorted(vars(modules[name]).items()):
            if not key.startswith("__") and not isinstance(value, ModuleType):
                digest.try_to_add(key, value)
    return digest.hash.hexdigest()[:16]


class _Digest:
    """A hash of values, followed into everything that they hold."""

    def __init__(self, modules: frozenset[str]) -> None:
        self.hash = hashlib.sha256()
        self.modules = modules
        self.seen: dict[int, Any] = {}

    def try_to_add(self, name: str, value: Any) -> None:
        """Add a named value, or its name alone where it cannot be read."""
        kept = self.hash.copy()
        try:
            self.add((name, value))
        except _Unknown:
            self.hash = kept
            self.add(name)

    def add(self, value: Any) -> None:
        """Add a value.

        Raises
        ------
        _Unknown
            If it holds something that cannot be read.
        """
        if value is None or isinstance(value, str | bytes | bool | int | float | complex | np.generic):
            self._words(type(value).__name__, repr(value))
        elif id(value) in self.seen:
            self._words("seen", type(value).__name__)
        else:
            self.seen[id(value)] = value  # kept alive, so that its id stays its own
            self._add_structure(value)

    def _add_structure(self, value: Any) -> None:
        self._words(type(value).__module__, type(value).__qualname__)
        if isinstance(value, np.ndarray) and value.dtype != object:
            self._words(str(value.dtype), str(value.shape))
            self.hash.update(value.tobytes())
        elif isinstance(value, dict):
            self._all(sorted(value.items(), key=lambda item: repr(item[0])))
        elif isinstance(value, set | frozenset):
            self._all(sorted(value, key=repr))
        elif isinstance(value, list | tuple | np.ndarray):
            self._all(value)
        elif isinstance(value, type):
            self._words(value.__module__, value.__qualname__)
            if value.__module__ in self.modules:
                self._all(
                    (key, held) for key, held in vars(value).items() if not key.startswith("__") or key == "__call__"
                )
        elif isinstance(value, MethodType):
            self._all((value.__func__, value.__self__))
        elif isinstance(value, FunctionType):
            self._words(value.__module__, value.__qualname__)
            cells = (cell.cell_contents for cell in value.__closure__ or ())
            self._all((value.__defaults__, value.__kwdefaults__, *cells))
        elif callable(getattr(value, "py_func", None)):  # compiled by numba
            self.add(value.py_func)
        else:
            self.add(type(value))
            try:
                self.add(value.__reduce_ex__(2))
            except (TypeError, AttributeError, NotImplementedError) as error:
                raise _Unknown(type(value).__name__) from error

    def _all(self, values: Any) -> None:
        for each in values:
            self.add(each)
        self._words("end")

    def _words(self, *words: str) -> None:
        for word in words:
            self.hash.update(word.encode() + b"\0")

"""numba's ``njit``, typed, and with a disk cache that notices changes in called functions.

numba caches machine code on disk and takes it as up to date as long as the file of the function
itself has not changed. The functions that it calls are compiled into it, though, often from other
files: if only those were updated, the old code would silently go on running. Here the name of the
cache folder is a digest of all files that a function is compiled from.

Division by zero gives inf or NaN (``error_model="numpy"``), which the callers check for, and no
ZeroDivisionError in the middle of a simulation; without that branch, loops with divisions can also
be turned into SIMD code.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, TypeVar, cast

_hidden = {"coverage"} - set(sys.modules)
# numba imports this developers' tool if it is installed, which takes 0.15 s; so hide it.
cast(dict[str, Any], sys.modules).update(dict.fromkeys(_hidden))

import numba  # noqa: E402
from numba.core.event import Event, Listener, register  # noqa: E402
from numba.extending import register_jitable  # noqa: E402

for _name in _hidden:
    del sys.modules[_name]

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Mark a function that is to be compiled into the compiled functions that call it.

    It is always inlined, since a call would only add copies of its arguments and, where values are
    packed (:mod:`armimp_sim.simd`), of registers. Called from Python it is not compiled: code for
    such calls would make up a fifth of the compile time.
    """
    options: Any = {"forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return register_jitable(error_model="numpy", **options)(function)


def compiled_entry(function: Function) -> Function:
    """Compile a function that Python calls: cached on disk, and run without the interpreter's lock.

    If no cache folder is writable, it is compiled anew in every process.
    """
    folder = cache_folder(function)
    config = cast(Any, numba.config)
    before = config.CACHE_DIR
    try:
        config.CACHE_DIR = str(folder or "")
        compiler = numba.njit(cache=folder is not None, nogil=True, error_model="numpy")
        return cast(Function, compiler(function))
    finally:
        config.CACHE_DIR = before


class _OnStart(Listener):
    """Listener that calls an action whenever an event starts."""

    def __init__(self, action: Callable[[], None]) -> None:
        self._action = action

    def on_start(self, event: Event) -> None:
        self._action()

    def on_end(self, event: Event) -> None:
        pass


def on_compiling(action: Callable[[], None]) -> None:
    """Register an action to be called whenever a function is compiled, as no cache has its code."""
    register("numba:compile", _OnStart(action))


def source_digest(function: Callable[..., Any]) -> str:
    """Return a digest of all that is compiled into ``function``: files and imported constants."""
    files = {Path(__file__)}  # it holds the compiler's options
    constants: set[str] = set()
    _collect(function, files, constants)
    digest = hashlib.sha256()
    for part in sorted(file.read_bytes() for file in files):
        digest.update(hashlib.sha256(part).digest())
    digest.update("\n".join(sorted(constants)).encode())
    return digest.hexdigest()[:16]


def _collect(function: Callable[..., Any], files: set[Path], constants: set[str]) -> None:
    """Collect files and constants of ``function`` and, by its global names, of all it calls."""
    plain = _plain(function)
    files.add(Path(plain.__code__.co_filename))
    names = set(plain.__code__.co_names)
    for name, value in _used(names, plain.__globals__):
        ours = str(getattr(value, "__module__", "")).startswith("armimp_")
        if hasattr(value, "py_func") or (ours and isinstance(value, FunctionType)):
            _collect(value, files, constants)
        elif ours:  # such as an intrinsic
            files.add(Path(str(sys.modules[value.__module__].__file__)))
        elif isinstance(value, int | float | str | tuple):
            constants.add(f"{name} = {value!r}")


def _used(names: set[str], namespace: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield name and value of those ``names`` that a namespace or our modules in it define."""
    for name in names & namespace.keys():
        value = namespace[name]
        if not isinstance(value, ModuleType):
            yield name, value
        elif value.__name__.startswith("armimp_"):
            yield from _used(names, vars(value))


def _plain(function: Callable[..., Any]) -> FunctionType:
    return cast(FunctionType, getattr(function, "py_func", function))


def cache_folder(function: Callable[..., Any]) -> Path | None:
    """Return the cache folder for this version of an entry function; None if none is writable.

    The first writable one is taken: the user's choice, beside the source, in the user's cache.
    """
    plain = _plain(function)
    name = f"numba-{source_digest(function)}"
    chosen = str(cast(Any, numba.config).CACHE_DIR)
    candidates = [Path(chosen)] if chosen else []
    candidates.append(Path(plain.__code__.co_filename).parent / "__pycache__")
    candidates.append(Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache") / "armimp")
    for candidate in candidates:
        try:
            folder = candidate.expanduser() / name
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
        except (OSError, RuntimeError):  # RuntimeError: there is no home
            continue
        return folder
    return None

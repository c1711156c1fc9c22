"""Compiled functions: cached, but never older than the sources that they are made from."""

import os
from pathlib import Path
from typing import Any, cast

import numba
import pytest

from armimp_common import compiled as compiling
from armimp_common.compiled import compiled_entry
from support.processes import run_python

CALLEE = """
from armimp_common.compiled import compiled
from numba.extending import intrinsic
FACTOR = {factor}
@compiled
def scaled(x):
    return {expression}
@intrinsic
def scaled_by_code(context, x):
    return x(x), lambda c, b, s, a: c.compile_internal(b, lambda x: {expression}, s, a)
"""
CALLER = """
from armimp_common.compiled import compiled_entry, source_digest
import armimp_callee
from armimp_callee import FACTOR, scaled, scaled_by_code
@compiled_entry
def of_function(x):
    return FACTOR * scaled(x)
@compiled_entry
def of_intrinsic(x):
    return FACTOR * scaled_by_code(x)
@compiled_entry
def of_module(x):
    return armimp_callee.FACTOR * armimp_callee.scaled(x)
for entry in (of_function, of_intrinsic, of_module):
    print(entry(2.0), sum(entry.stats.cache_hits.values()), source_digest(entry))
"""
ENTRIES = 3


def _run(folder: Path, *, factor: float, expression: str) -> list[tuple[float, int, str]]:
    """Result, number of cache hits and digest of each entry in a fresh process."""
    (folder / "armimp_callee.py").write_text(CALLEE.format(factor=factor, expression=expression))
    (folder / "armimp_caller.py").write_text(CALLER)
    paths = [str(folder), str(Path(compiling.__file__).parents[1])]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(paths),
        "PYTHONDONTWRITEBYTECODE": "1",  # sources change within the resolution of their times
        "NUMBA_CACHE_DIR": str(folder / "cache"),
    }
    lines = run_python("-c", "import armimp_caller", env=environment, timeout=100).splitlines()
    return [(float(value), int(hits), digest) for value, hits, digest in map(str.split, lines)]


@pytest.mark.slow
def test_when_only_a_called_function_changes_expect_its_caller_compiled_anew(
    tmp_path: Path,
) -> None:
    first = _run(tmp_path, factor=1.0, expression="3.0 * x")
    again = _run(tmp_path, factor=1.0, expression="3.0 * x")
    assert again == [(6.0, 1, digest) for _, _, digest in first]
    other_function = _run(tmp_path, factor=1.0, expression="4.0 * x")
    other_constant = _run(tmp_path, factor=5.0, expression="3.0 * x")
    for runs, value in ((first, 6.0), (other_function, 8.0), (other_constant, 30.0)):
        assert [one[:2] for one in runs] == [(value, 0)] * ENTRIES
    for entry in zip(first, other_function, other_constant, strict=True):
        assert len({digest for *_, digest in entry}) == 3


def test_without_any_folder_to_write_to_functions_are_compiled_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise PermissionError("read-only")

    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(blocked))
    monkeypatch.setattr(Path, "mkdir", refuse)
    entry = compiled_entry(lambda x: 1.0 / x)
    assert entry(4.0) == 0.25
    assert entry(0.0) == float("inf"), "not an error, as for numpy"
    assert cast(Any, entry).stats.cache_path is None

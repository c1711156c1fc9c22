"""Compiled functions: cached, but never older than the sources that they are made from."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, cast

import numba
import pytest

from armimp_common import compiled as compiling
from armimp_common.compiled import compiled, compiled_entry
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
CALLERS = {
    "of_function": """
from armimp_common.compiled import compiled_entry
from armimp_callee import FACTOR, scaled
@compiled_entry
def entry(x):
    return FACTOR * scaled(x)
""",
    "of_intrinsic": """
from armimp_common.compiled import compiled_entry
from armimp_callee import FACTOR, scaled_by_code
@compiled_entry
def entry(x):
    return FACTOR * scaled_by_code(x)
""",
    "of_module": """
from armimp_common.compiled import compiled_entry
import armimp_callee
@compiled_entry
def entry(x):
    return armimp_callee.FACTOR * armimp_callee.scaled(x)
""",
}
REPORT = """
from armimp_caller import entry
from armimp_common.compiled import source_digest
print(entry(2.0), sum(entry.stats.cache_hits.values()), source_digest(entry))
"""


def _run(folder: Path, caller: str, *, factor: float, expression: str) -> tuple[float, int, str]:
    """Result, number of cache hits and digest in a fresh process."""
    (folder / "armimp_callee.py").write_text(CALLEE.format(factor=factor, expression=expression))
    (folder / "armimp_caller.py").write_text(CALLERS[caller])
    paths = [str(folder), str(Path(compiling.__file__).parents[1])]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(paths),
        "PYTHONDONTWRITEBYTECODE": "1",  # sources change within the resolution of their times
        "NUMBA_CACHE_DIR": str(folder / "cache"),
    }
    value, hits, digest = run_python("-c", REPORT, env=environment, timeout=100).split()
    return float(value), int(hits), digest


@pytest.mark.slow
@pytest.mark.parametrize("caller", CALLERS)
def test_when_only_a_called_function_changes_expect_its_caller_compiled_anew(
    tmp_path: Path, caller: str
) -> None:
    first = _run(tmp_path, caller, factor=1.0, expression="3.0 * x")
    assert first[:2] == (6.0, 0)
    assert _run(tmp_path, caller, factor=1.0, expression="3.0 * x") == (6.0, 1, first[2])
    other_function = _run(tmp_path, caller, factor=1.0, expression="4.0 * x")
    assert other_function[:2] == (8.0, 0)
    other_constant = _run(tmp_path, caller, factor=5.0, expression="3.0 * x")
    assert other_constant[:2] == (30.0, 0)
    assert len({first[2], other_function[2], other_constant[2]}) == 3


@compiled
def _inverse(x: float) -> float:
    return 1.0 / x


@compiled_entry
def _plain_inverse(x: float) -> float:
    return _inverse(x)


def test_without_any_folder_to_write_to_functions_are_compiled_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(blocked))
    monkeypatch.setattr(Path, "mkdir", _refuse)
    entry = compiled_entry(_plain_inverse.__wrapped__)  # type: ignore[attr-defined]
    assert entry(4.0) == 0.25
    assert cast(Any, entry).stats.cache_path is None


def _refuse(*_: Any, **__: Any) -> None:
    raise PermissionError("read-only")

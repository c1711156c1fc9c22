"""The recipes of docs/extending.md, applied to a copy of the sources, do what they say there."""

import os
import re
import shutil
from pathlib import Path

import pytest

from support.places import ROOT
from support.processes import run_program, run_python

pytestmark = pytest.mark.slow

PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
NEW_FILES = re.findall(r"New file `([^`]+)`:\n\n```python\n(.*?)^```$", PAGE, re.M | re.S)
PATCHES = re.findall(r"^```diff\n(.*?)^```$", PAGE, re.M | re.S)
TESTS = [name for name, _ in NEW_FILES if "/test/" in name]
COPIED = ("docs", "scripts", "ros2_ws/src", "tests/support")
TESTS_OF_THE_WHOLE = ("tests/test_interface_page.py", "tests/test_generated_files.py")


def python(copy: Path, *arguments: str, jit: bool = True) -> None:
    sources = (copy / "ros2_ws" / "src").glob("*/package.xml")
    path = os.pathsep.join([*(str(manifest.parent) for manifest in sources), str(copy / "tests")])
    environment = {
        **os.environ,
        "PYTHONPATH": path,
        "PYTHONDONTWRITEBYTECODE": "1",
        "NUMBA_DISABLE_JIT": "0" if jit else "1",
    }
    run_python(*arguments, cwd=copy, env=environment)


@pytest.fixture(scope="module")
def extended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources with everything that the page adds."""
    copy = tmp_path_factory.mktemp("extended")
    leave = shutil.ignore_patterns("__pycache__", "*.egg-info", "build", "install", "log")
    for folder in COPIED:
        shutil.copytree(ROOT / folder, copy / folder, ignore=leave)
    for name in ("pyproject.toml", "conftest.py", "tests/conftest.py", *TESTS_OF_THE_WHOLE):
        shutil.copy(ROOT / name, copy / name)
    for name, text in NEW_FILES:
        assert not (copy / name).exists(), name
        (copy / name).write_text(text, encoding="utf-8")
    for patch in PATCHES:
        run_program("git", "apply", cwd=copy, input=patch)
    python(copy, "scripts/write_generated.py")
    return copy


def test_the_tests_of_the_recipes_pass_beside_those_of_the_interfaces(extended: Path) -> None:
    plant = [name for name in TESTS if "armimp_sim" in name]
    others = [name for name in TESTS if name not in plant]
    # The plant has no uncompiled form. The law has, and compiling it takes long; but
    # then numpy warns where compiled code divides by zero in silence.
    silent = "-Wignore::RuntimeWarning"
    for names, jit in ((plant, True), ([*others, *TESTS_OF_THE_WHOLE, silent], False)):
        python(extended, "-m", "pytest", "-q", *names, jit=jit)


def test_the_examples_of_configurations_are_accepted(extended: Path) -> None:
    blocks = re.findall(r"^```yaml\n(.*?)^```$", PAGE, re.M | re.S)
    assert len(blocks) == 2
    program = [
        "from pathlib import Path",
        "from armimp_bringup.config import load_config",
        "from armimp_bringup.parameters import node_parameters",
    ]
    for number, block in enumerate(blocks):
        path = extended / f"own{number}.yaml"
        path.write_text(block, encoding="utf-8")
        program.append(f"node_parameters(load_config(Path({str(path)!r}), {{}}), None)")
    python(extended, "-c", "\n".join(program))

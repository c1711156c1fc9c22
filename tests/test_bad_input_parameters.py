"""Parameter files of every wrong kind: one line with the file or the value, and exit status 2."""

from pathlib import Path

import pytest

from support.command import refused

COMMANDS = (("run",), ("reproduce", "--no-figures"))

NOT_YAML = {
    "binary": bytes(range(256)),
    "unclosed": b"a: [",
    "undefined alias": b"*nowhere",
    "foreign tag": b"friction: !level 3",
    "tag of Python": b"!!python/object/apply:os.system ['true']",
}

WRONG = {
    # Shapes of the file
    "[1, 2]": "not [1, 2]",
    # Names
    "colour: red": "'colour' does not exist",
    '"a\\nb": 1': r"'a\nb' does not exist",
    "arm_sim: {1: 2}": "arm_sim[1]",
    "frition: 2": "'frition' does not exist; the nearest valid name is 'friction'",
    "arm_sim: {arm: {inertai: [1.0]}}": "'arm.inertai' does not exist; the nearest valid name",
    "arm_sim: {'arm.inertia': {x: 3}}": "'arm.inertia.x' does not exist",
    # Types
    "friction: high": "'friction' = \"high\"",
    'mode: "a\\nb"': r"'mode' = " + '"a\\nb"',
    "estimators: lpm_full": "'estimators' = \"lpm_full\"",
    "estimators: []": "'estimators' needs distinct names",
    "estimators: [guess]": "there is no 'guess'",
    "arm_sim: null": "'arm_sim' = None",
    "impedance_estimator: {directory: 5}": "'directory' = 5",
    "impedance_estimator: {metadata: '[1]'}": "'metadata' is not a JSON object of strings: '[1]'",
    # Shapes of matrices
    "arm_sim: {arm: {inertia: [[1, 0], [0]]}}": "'arm.inertia' = [[1, 0], [0]]: rows differ",
    "arm_sim: {arm: {inertia: [[1, 0, 0, 1]]}}": "'arm.inertia' has 1 row for 4 columns",
    "arm_sim: {arm: {inertia: [1.0]}}": "'arm.inertia' has 1 values, needs 4",
    "arm_sim: {joints: []}": "0 joints",
    # Numbers
    "duration: .nan": "'duration' = nan",
    "arm_sim: {seed: 99999999999999999999}": "'seed' = 99999999999999999999: is too large",
    # Physics
    "arm_sim: {arm: {inertia: [-1.0, 0.0, 0.0, 1.0]}}": "inertia of joint 1 must be positive",
    "arm_sim: {arm: {stiffness: [1.0e+300, 0, 0, 1.0]}}": "'arm.stiffness' = 1e+300: is too large",
    "arm_sim: {arm: {stiffness: [1.0e+20, 0, 0, 1.0]}}": "|h·λ|",
    "imbic_controller: {law: {internal_model: tde, model_inertia: [9.0, 0.0, 0.0, 9.0]}}": (
        "unstable when sampled"
    ),
}


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("parameters") / "experiment.yaml"


def complaint(file: Path, content: bytes | str) -> str:
    """What both commands that take such a file say of it."""
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    out = file.parent / "out"
    told = [refused(*command, "--config", str(file), "--out", str(out)) for command in COMMANDS]
    assert {one.status for one in told} == {2}
    assert len({one.err for one in told}) == 1
    assert not out.exists()
    return told[0].err


@pytest.mark.parametrize("kind", NOT_YAML)
def test_what_is_not_yaml_is_named(kind: str, file: Path) -> None:
    told = complaint(file, NOT_YAML[kind])
    assert told.startswith(
        (f"armimp: {file}: is not a text file", f"armimp: {file}: cannot be read as YAML: ")
    )


@pytest.mark.parametrize("text", WRONG)
def test_a_wrong_value_is_named(text: str, file: Path) -> None:
    assert WRONG[text] in complaint(file, text)


@pytest.mark.parametrize("text", ["arm_sim: &a {b: *a}", "&a {arm_sim: *a}", "estimators: &a [*a]"])
def test_a_file_that_contains_itself_is_refused(text: str, file: Path) -> None:
    assert "cannot be read as YAML: the alias *a is not allowed" in complaint(file, text)

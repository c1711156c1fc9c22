"""Wrong options and configurations: one line with the value, exit status 2 (or 1), nothing left."""

from pathlib import Path

import pytest

from support.bag_files import write_bag
from support.command import refused
from support.synthetic_bags import recorded_arm

LONG = "a" * 300


@pytest.fixture(autouse=True)
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty directory to work in, with a file and a full directory beside it."""
    (tmp_path / "file").write_text("ten years of work")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").touch()
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    return here


OF_RUN = [
    ("--friction", "7", "'friction' = 7"),
    ("--friction", "3\n4", "--friction"),
    ("--duration", "nan", "'duration' = nan"),
    ("--duration", "ten", "--duration"),
    ("--joints", "9", "'joints' = 9: input should be 1, 2, 3, 4, 5, 6 or 7"),
    ("--config", "nowhere.yaml", "nowhere.yaml"),
    ("--estimator", "foo", "'foo'"),
    ("--config", ".", ".: Is a directory"),
    ("--out", "../file/x", "../file/x: cannot be made: Not a directory"),
    ("--out", "../full", "../full: is not empty"),
    ("--out", LONG, f"{LONG}: cannot be made: File name too long"),
    ("--colour", "red", "--colour"),
    ("--target-error", "2", '= "2": is no share such as 2% or 0.02; did you mean 2%?'),
    *(("--target-error", text, f'"{text}": is no share') for text in ("-1%", "100%", "nan")),
]
STRANGE = {
    **dict.fromkeys(("nowhere", "no\nwhere", "\x1b[31mred", "a\u2028b"), "does not exist"),
    "no\udcffwhere": r"no\udcffwhere: its name is not UTF-8",
}
"""Bad names of recordings, and the complaint about each."""
READING = ("estimate", "replay")
OF_OTHERS: list[tuple[tuple[str, ...], int, str]] = [
    *(((command, name), 1, said) for command in READING for name, said in STRANGE.items()),
    *(((command, __file__), 1, "neither an MCAP nor an SQLite3 file") for command in READING),
    (("estimate", str(Path(__file__).parent)), 1, "is not a bag"),
    (("run", "--frition", "2"), 2, "--friction"),
    (
        ("run", "--as-in-paper", "--internal-model", "observer"),
        2,
        "(--as-in-paper) has the internal model tde, not internal_model (--internal-model) obs",
    ),
    (("estimat", "nowhere"), 2, "Did you mean 'estimate'"),
    (("estimate",), 2, "bags"),
    (("bench", "guess"), 2, "there is no benchmark 'guess', only speed, jitter"),
    *(
        (("check-driver", *options), 2, words)
        for options, words in (
            (("--joint", "elbow", "--joint", "elbow"), "names are not distinct"),
            (("--torque", "21"), "'torque' = 21.0: input should be less than or equal to 20"),
            (("--move",), "--move: there is nobody to ask; --yes says that it is safe"),
        )
    ),
    *(
        (("reproduce", *options), 2, words)
        for options, words in (
            (("--seeds", "1:"), "--seeds '1:': '1:' is neither a seed nor a range"),
            (("--workers", "two"), "Invalid value for '--workers'"),
            (("--workers", "2", "--scheduler", "tcp://x:1"), "--workers is for processes"),
            (("--estimator", "guess"), "unknown estimator 'guess', known are welch_siso"),
            (("--config", "nowhere.yaml"), "nowhere.yaml: No such file or directory"),
        )
    ),
]
WRONG_USE = [*((("run", option, value), 2, words) for option, value, words in OF_RUN), *OF_OTHERS]


@pytest.mark.parametrize(
    ("arguments", "status", "words"), WRONG_USE, ids=[ascii(one)[:60] for one, *_ in WRONG_USE]
)
def test_wrong_use_of_a_command_ends_in_one_line_that_names_it_and_leaves_nothing(
    directory: Path, arguments: tuple[str, ...], status: int, words: str
) -> None:
    told = refused(*arguments)
    assert told.status == status
    assert told.err[:-1].isprintable()
    assert words in told.err
    assert list(directory.iterdir()) == []


# --- Parameter files of every wrong kind: one line with the file or the value, and exit status 2


COMMANDS = (("run",), ("reproduce", "--no-figures"))

NOT_YAML = "experiment.yaml: cannot be read as YAML: "
WRONG = {
    # Shapes of the file
    "a: [": NOT_YAML,
    "friction: !level 3": NOT_YAML,
    "!!python/object/apply:os.system ['true']": NOT_YAML,
    "arm_sim: &a {b: *a}": f"{NOT_YAML}the alias *a is not allowed",
    "&a {arm_sim: *a}": f"{NOT_YAML}the alias *a is not allowed",
    "estimators: &a [*a]": f"{NOT_YAML}the alias *a is not allowed",
    "estimators: &a [x]\narm_sim: {b: *a}": f"{NOT_YAML}the alias *a is not allowed",
    "[1, 2]": "not [1, 2]",
    # Names
    "colour: red": "'colour' does not exist",
    "joints: true": "'joints' = True: should be no truth value",
    '"a\\nb": 1': r"'a\nb' does not exist",
    "arm_sim: {1: 2}": "arm_sim[1]",
    "arm_sim: {arm: {inertai: [1.0]}}": "'arm.inertai' does not exist; the nearest valid name",
    # Types
    "estimators: []": "estimators must be distinct",
    "estimators: [guess]": "unknown estimator 'guess'",
    "impedance_estimator: {metadata: '[1]'}": "'metadata' is not a JSON object of strings: '[1]'",
    # Shapes of matrices
    "arm_sim: {arm: {inertia: [[1, 0], [0]]}}": "'arm.inertia' = [[1, 0], [0]]: is no square",
    # Numbers
    "arm_sim: {seed: 99999999999999999999}": "'seed' = 99999999999999999999: is too large",
    # Physics
    "arm_sim: {arm: {stiffness: [1.0e+300, 0, 0, 1.0]}}": "'arm.stiffness' = 1e+300: is too large",
    "imbic_controller: {law: {internal_model: tde, model_inertia: [9.0, 0.0, 0.0, 9.0]}}": (
        "unstable when sampled"
    ),
}


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("parameters") / "experiment.yaml"


def complaint(config: Path, content: str) -> str:
    """What both commands that take such a file say of it, which must be the same."""
    config.write_text(content)
    out = config.parent / "out"
    told = [refused(*command, "--config", str(config), "--out", str(out)) for command in COMMANDS]
    assert {one.status for one in told} == {2}
    assert len({one.err for one in told}) == 1
    assert not out.exists()
    return told[0].err


@pytest.mark.parametrize("text", WRONG)
def test_a_wrong_value_is_named(text: str, config: Path) -> None:
    assert WRONG[text] in complaint(config, text)


MESSAGES = recorded_arm(1800).messages


def test_one_bad_bag_among_good_ones_is_named(tmp_path: Path) -> None:
    good = write_bag(tmp_path / "good", MESSAGES, {})
    (tmp_path / "empty.mcap").touch()
    told = refused("estimate", str(good), str(tmp_path / "empty.mcap"))
    assert f"{tmp_path / 'empty.mcap'}: is empty" in told.err
    others = [(t, n, raw.replace(b"joint_", b"whale_")) for t, n, raw in MESSAGES]
    told = refused("estimate", str(good), str(write_bag(tmp_path / "other", others, {})))
    assert "joints whale_1, whale_2 differ from joint_1, joint_2" in told.err

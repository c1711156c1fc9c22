"""Wrong values of options: one line with the value, exit status 2 (or 1), nothing left behind."""

from pathlib import Path

import pytest

from support.command import refused

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


@pytest.mark.parametrize(
    ("option", "value", "quoted"),
    [
        ("--friction", "7", "'friction' = 7"),
        ("--friction", "3\n4", "--friction"),
        ("--duration", "nan", "'duration' = nan"),
        ("--duration", "1e300", "'duration' = 1e+300"),
        ("--duration", "ten", "--duration"),
        ("--seed", "9" * 30, "'seed' = 9999"),
        ("--joints", "9", "'joints' = 9: input should be 1, 2, 3, 4, 5, 6 or 7"),
        ("--duration", "1", "'duration' = 1.0"),
        ("--processes", "many", "many"),
        ("--config", "nowhere.yaml", "nowhere.yaml"),
        ("--estimator", "foo", "'foo'"),
        ("--estimator", "a\nb", r"'a\nb'"),
        ("--mode", "warp", '"warp"'),
        ("--config", ".", ".: Is a directory"),
        ("--config", "/proc/self/mem", "/proc/self/mem: Input/output error"),
        ("--config", LONG * 20, "File name too long"),
        ("--out", "../file/x", "../file/x: cannot be made: Not a directory"),
        ("--out", "../full", "../full: is not empty"),
        ("--out", "/proc/here", "/proc/here: cannot be made"),
        ("--out", LONG, f"{LONG}: cannot be made: File name too long"),
        ("--colour", "red", "--colour"),
        ("--target-error", "2", '= "2": is no share such as 2% or 0.02; did you mean 2%?'),
        *(
            ("--target-error", text, f'"{text}": is no share')
            for text in ("0", "100%", "-1%", "nan", "two")
        ),
    ],
)
def test_a_wrong_value_of_run_ends_in_one_line_with_the_value(
    directory: Path, option: str, value: str, quoted: str
) -> None:
    told = refused("run", option, value)
    assert told.status == 2
    assert quoted in told.err
    made = [path for path in directory.rglob("*") if path.is_file()]
    assert not made


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["estimate", __file__], 1, "neither an MCAP nor an SQLite3 file"),
        (["replay", __file__], 1, "neither an MCAP nor an SQLite3 file"),
        (["estimate", str(Path(__file__).parent)], 1, "is not a bag"),
        (["run", "--frition", "2"], 2, "--friction"),
        (["estimat", "nowhere"], 2, "Did you mean 'estimate'"),
        (["estimate"], 2, "bags"),
        (["frobnicate"], 2, "frobnicate"),
    ],
)
def test_what_is_no_bag_or_no_command_is_named(
    arguments: list[str], status: int, words: str
) -> None:
    told = refused(*arguments)
    assert told.status == status
    assert words in told.err


@pytest.mark.parametrize("name", ["nowhere", "no\nwhere", "\x1b[31mred", "a\u2028b"])
@pytest.mark.parametrize("command", ["estimate", "replay"])
def test_a_name_with_strange_characters_is_shown_on_one_line(command: str, name: str) -> None:
    told = refused(command, name)
    assert told.status == 1
    assert told.err[:-1].isprintable()
    assert told.err.endswith(": does not exist\n")


@pytest.mark.parametrize("command", ["estimate", "replay"])
def test_a_name_that_is_not_text_is_refused_whatever_it_names(command: str) -> None:
    told = refused(command, "no\udcffwhere")
    assert told.status == 1
    assert told.err == "armimp: no\\udcffwhere: its name is not UTF-8\n"

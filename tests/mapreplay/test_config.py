"""Configuration: errors name the key, the value and what is allowed."""

import os
from pathlib import Path

import pytest

from mapreplay.config import EpisodeConfig, MapKind, RunConfig, read_toml
from mapreplay.errors import ConfigError


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("coverage", 1.5, "config: coverage = 1.5: should be less than or equal to 1"),
        ("coverage", 0, "config: coverage = 0: should be greater than 0"),
        ("delta_free", -0.1, "config: delta_free = -0.1: should be greater than or equal to 0"),
        ("plan_on", "truth", "config: plan_on = 'truth': should be 'observed' or 'fused'"),
        ("rays", 12, "config: rays = 12: should be a multiple of 8"),
        ("seed", -1, "config: seed = -1: should be greater than or equal to 0"),
        ("max_steps", 0, "config: max_steps = 0: should be greater than or equal to 1"),
        (
            "prediction_dtype",
            "int8",
            "config: prediction_dtype = 'int8': should be 'uint8', 'uint16' or 'float32'",
        ),
        ("start", (-1, 2), "config: start.0 = -1: should be greater than or equal to 0"),
        ("planner", "", "config: planner = '': should be a name of 1 to 512 characters"),
        ("delta", 0.5, "config: unknown key 'delta'"),
        ("coverage", float("nan"), "config: coverage = nan: should be a finite number"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(key: str, value: object, message: str) -> None:
    with pytest.raises(ConfigError) as error:
        EpisodeConfig.of({key: value})
    assert str(error.value) == message


def test_the_defaults_are_those_of_the_paper() -> None:
    config = EpisodeConfig()
    assert (config.delta_free, config.delta_occupied, config.coverage) == (0.93, 0.95, 0.98)
    assert (config.rays, config.reach, config.fail_safe) == (16, 20, False)


def test_a_configuration_survives_json() -> None:
    config = EpisodeConfig(start=(3, 4), plan_on=MapKind.OBSERVED, seed=7, max_steps=9)
    assert EpisodeConfig.model_validate_json(config.model_dump_json()) == config


@pytest.mark.parametrize(
    ("maps", "expected"),
    [
        ({}, "d2"),
        ({"plan_on": "observed"}, "d2"),
        ({"plan_on": "observed", "build": "observed"}, "none"),
        ({"plan_on": "observed", "build": "observed", "predictor": "d1"}, "d1"),
        ({"predictor": "none"}, "none"),
    ],
)
def test_the_predictor_is_what_suits_the_plans_and_is_needed(
    maps: dict[str, str], expected: str
) -> None:
    assert RunConfig.of(maps).episode("d2", seed=1).predictor == expected


def test_a_toml_file_has_the_same_keys(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text('planner = "nearest"\nfail_safe = true\nstart = [3, 4]\njobs = 2\n')
    config = RunConfig.of(read_toml(path))
    assert (config.planner, config.fail_safe, config.start, config.jobs) == (
        "nearest", True, (3, 4), 2,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "message"),
    [(b"planner = ", "not TOML"), (b"\xff\xfe", "not UTF-8"), (b"#" * (2 << 20), "larger than")],
)
def test_a_file_that_is_no_configuration_is_refused(
    tmp_path: Path, text: bytes, message: str
) -> None:
    path = tmp_path / "run.toml"
    path.write_bytes(text)
    with pytest.raises(ConfigError, match=message):
        read_toml(path)


def test_a_missing_configuration_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: cannot be read \(No such file"):
        read_toml(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"seed = 1\nx = " + b"[" * 9999, r"c\.toml, line 2: nested too deeply"),
        (b"\n\nx = " + b"{a=" * 3000 + b"1" + b"}" * 3000, r"c\.toml, line 3: nested too deeply"),
        (
            b"seed = 1\nepisodes = " + b"9" * 5000,
            r"c\.toml, line 2: an invalid value \(.+\)$",
        ),
        (b"seed = 1\n# caf\xe9\n", r"c\.toml, line 2: not UTF-8 text \(save it as UTF-8\)"),
        ("seed = 1".encode("utf-16"), r"c\.toml, line 1: not UTF-8 text"),
        (b"\x1f\x8b\x08\xff", r"not UTF-8 text \(gzip-compressed; unpack it"),
        (b"version https://git-lfs.github.com/spec/v1\n", r"not TOML \(a Git LFS pointer"),
        (b"seed = 1\nseed = 2\n", r"not TOML \(Cannot overwrite a value \(at line 2"),
        (b"seed = 1\n\x00", r"not TOML \(.*line 2"),
        (b"plan-on = 'fused'\nplan_on = 'fused'\n", r"plan_on is given twice"),
        (b"#" * (1 << 20) + b"\n", r"larger than 1 MiB"),
    ],
    ids=lambda value: "" if isinstance(value, bytes) else None,
)
def test_what_is_wrong_with_a_file_is_named_with_its_line(
    tmp_path: Path, content: bytes, said: str
) -> None:
    (tmp_path / "c.toml").write_bytes(content)
    with pytest.raises(ConfigError, match=said) as caught:
        read_toml(tmp_path / "c.toml")
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize(
    "content", [b"\xef\xbb\xbfseed = 5\n", b"# a\r\nseed = 5\r\n"], ids=["mark", "Windows"]
)
def test_files_of_windows_are_read(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "c.toml").write_bytes(content)
    assert read_toml(tmp_path / "c.toml") == {"seed": 5}


@pytest.mark.parametrize("name", ["/dev/zero", "/proc", "nowhere.toml", "a\0b"])
def test_what_is_no_file_is_named(name: str) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        read_toml(Path(name))


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "c.toml")
    with pytest.raises(ConfigError, match=r"cannot be read \(not a regular file\)"):
        read_toml(tmp_path / "c.toml")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"seed = 0x" + b"f" * 5000, "seed = a number of thousands of digits: should"),
        (b"seed." + b"a." * 20_000 + b"b = 1", "seed = something nested too deeply: should"),
        (b"planner = '" + b"x" * 10_000 + b"'", r"planner = 'x{79}\.\.\.: should"),
    ],
    ids=["digits", "depth", "length"],
)
def test_a_value_is_shown_as_far_as_it_can_be(tmp_path: Path, content: bytes, said: str) -> None:
    (tmp_path / "c.toml").write_bytes(content)
    with pytest.raises(ConfigError, match=said):
        RunConfig.of(read_toml(tmp_path / "c.toml"))


@pytest.mark.parametrize(
    "line",
    ["seed = 1.5", "seed = 1.0", 'seed = "1"', "seed = true", "start = [5.3, 2]",
     "start = [5.0, 2]", 'fail_safe = "yes"', "fail_safe = 1", 'coverage = "0.9"',
     "coverage = true", "jobs = 2.0",
     "episodes = 2.0", 'profile = "on"', 'resolution = "0.1"'],
)  # fmt: skip
def test_nothing_in_a_file_is_cut_or_guessed(tmp_path: Path, line: str) -> None:
    path = tmp_path / "run.toml"
    path.write_text(line)
    with pytest.raises(ConfigError, match=line.partition(" ")[0]):
        RunConfig.of(read_toml(path))


def test_a_whole_number_is_a_number() -> None:
    assert EpisodeConfig.of({"coverage": 1}).coverage == 1.0

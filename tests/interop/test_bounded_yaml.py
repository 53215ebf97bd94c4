"""YAML that is made to hang, to blow up or to end in a traceback is one line for each of its readers."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from rendezvous.config.load import load_config
from rendezvous.errors import PipelineError
from rendezvous.interop.bounded_yaml import (
    MOST_DIGITS,
    MOST_LETTERS,
    MOST_LEVELS,
    MOST_WEIGHT,
    BoundedLoader,
    FaultyYamlError,
    load_document,
)
from rendezvous.interop.camera_info import read_camera_info
from rendezvous.interop.ros_map import read_ros_map
from rendezvous.robot_file import load_robot
from tests.conftest import ROOT

MOST_S = 10.0  # for what takes a second or two where nothing else runs

LAUGHS = "a0: &a0 [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"a{n}: &a{n} [{','.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 10)
)
MERGES = "a0: &a0 {k: 1}\n" + "".join(
    f"a{n}: &a{n} {{<<: [{','.join([f'*a{n - 1}'] * 9)}]}}\n" for n in range(1, 10)
)
CHAIN = "a0: &a0 [1]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}]\n" for n in range(1, 120))
LONG_ALIAS = f'a: &a "{"x" * 300_000}"\nb: [{",".join(["*a"] * 5000)}]\n'

HOSTILE = {
    "aliases": (LAUGHS, "a4.*: more than 10,000 values up to here, with all that aliases stand for"),
    "merges": (MERGES, "more than 10,000 values|a merge key"),
    "a chain of aliases": (CHAIN, "nested more than 40 levels deep"),
    "a long text many times": (LONG_ALIAS, "more than 10,000 values"),
    "a cycle": ("a: &a [*a]", r"a\[0\]: \*a is part of what it stands for"),
    "a cycle of maps": ("b: &a {k: {l: *a}}", r"b\.k\.l: \*a is part"),
    "a cycle in a merge": ("a: &a {<<: *a}", r"\*a is part"),
    "a bool": ("x: {y: !!bool maybe}", "x.y: 'maybe' is no !!bool"),
    "an empty int": ("x: !!int ''", "x: '' is no !!int"),
    "an empty float": ("x: !!float ''", "x: '' is no !!float"),
    "a set of text": ("x: !!set y", "x: 'y' is no !!set|expected a mapping"),
    "a map of text": ("!!map y", "expected a mapping"),
    "half of base 64": ("x: !!binary y", "x: 'y' is no !!binary"),
    "digits": (f"x: {'7' * 5000}", "x: a number of 5,000 digits; at most 1000 are read"),
    "hex digits": (f"x: 0x{'f' * 5000}", "x: a number of 5,002 digits"),
    "a sexagesimal number": (f"x: 1{':1' * 2500}", "x: a number of 5,001 digits"),
    "lists in lists": (f"x: {'[' * 3000}{']' * 3000}", "nested more than 40 levels deep"),
    "maps in maps": ("{a: " * 3000, "nested more than 40 levels deep"),
    "dashes": ("- " * 3000, "nested more than 40 levels deep"),
    "no code point": (r'x: "\UFFFFFFFF"', "too large to convert"),
    "nearly a code point": (r'x: "\U00110000"', "not in range"),
    "a long version": (f"%YAML {'9' * 5000}.1\n---\na", "Exceeds the limit"),
    "a comment": (f"#{'x' * 3_000_000}", f"longer than {MOST_LETTERS:,} letters|[Mm]ore than 1,000,000"),
    "blank lines": ("\n" * 900_000, f"longer than {MOST_LETTERS:,} letters"),
    "many keys": ("".join(f"k{n}: 1\n" for n in range(30_000)), "k4999: more than 10,000 values"),
}


class Lenient(BoundedLoader):
    HALF_CHARACTERS = True


def loaded(text: str) -> Any:
    return load_document(text, BoundedLoader, more_may_follow=False)


def robot(path: Path) -> object:
    return load_robot(str(path))


READERS: dict[str, Callable[[Path], object]] = {
    "stages": load_config,
    "robot": robot,
    "map": lambda path: read_ros_map(path, strict=False),
    "camera": read_camera_info,
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_yaml_is_one_line_for_each_reader(tmp_path: Path, name: str, reader: str):
    text, said = HOSTILE[name]
    path = tmp_path / "hostile.yaml"
    path.write_text(text)
    began_s = time.process_time()
    with pytest.raises(PipelineError, match=rf"\A.*hostile\.yaml.*({said}).*\Z"):
        READERS[reader](path)
    assert time.process_time() - began_s < MOST_S


@pytest.mark.parametrize("name", sorted(HOSTILE.keys() - {"a comment", "blank lines", "a long version"}))
def test_a_hostile_override_is_one_line(name: str):
    text, said = HOSTILE[name]
    with pytest.raises(PipelineError, match=rf"\A--set render\.draws=.*({said}).*\Z"):
        load_config(ROOT / "stages.yaml", overrides=[f"render.draws={text}"])


@pytest.mark.parametrize("key", ["a." * 3000 + "b", "\udcff", "render.\ud800"])
def test_a_hostile_key_of_an_override_is_one_line(key: str):
    with pytest.raises(PipelineError, match=r"\A--set .*: must be KEY=VALUE"):
        load_config(ROOT / "stages.yaml", overrides=[f"{key}=1"])


def test_what_is_too_large_is_told_by_its_full_key():
    with pytest.raises(FaultyYamlError, match=r"\Aline 3: stages\.train\[1\]: a number of 1,001 digits"):
        loaded(f"stages:\n  train: [1,\n   {'1' * (MOST_DIGITS + 1)}]")
    assert loaded("1" * MOST_DIGITS) == int("1" * MOST_DIGITS)


def test_the_bounds_are_exact():
    deep = MOST_LEVELS - 1
    assert loaded("[" * deep + "1" + "]" * deep)
    with pytest.raises(FaultyYamlError, match="levels"):
        loaded("[" * MOST_LEVELS + "1" + "]" * MOST_LEVELS)
    assert len(loaded(str([1] * (MOST_WEIGHT - 1)))) == MOST_WEIGHT - 1
    with pytest.raises(FaultyYamlError, match="values"):
        loaded(str([1] * MOST_WEIGHT))


def test_aliases_that_stand_for_little_are_read():
    assert loaded("a: &a [1, 2]\nb: [*a, *a]\n") == {"a": [1, 2], "b": [[1, 2], [1, 2]]}
    assert loaded("a: &a {k: 1}\nb: {<<: *a, l: 2}\n")["b"] == {"k": 1, "l": 2}


def test_half_a_character_is_a_fault_where_text_is_not_a_files_name():
    with pytest.raises(FaultyYamlError, match=r"a: text with '\\ud800', half a character"):
        loaded(r'a: "\ud800"')
    assert load_document(r'a: "\ud800"', Lenient, more_may_follow=False) == {"a": "\ud800"}


def test_only_the_first_document_is_read_however_much_follows():
    text = "a: 1\n---\n" + "b: 2\n---\n" * MOST_LETTERS
    assert load_document(text, BoundedLoader, more_may_follow=True) == {"a": 1}
    with pytest.raises(FaultyYamlError, match="another document"):
        loaded("a: 1\n---\nb: 2")


@given(st.text(alphabet="ab01:-[]{}&*!<>|?,'\"%#=.~\\Ux\n \t", max_size=60))
def test_any_text_is_read_as_pyyaml_reads_it_or_is_a_fault(text: str):
    try:
        value = loaded(text)
    except FaultyYamlError:
        return
    assert repr(value) == repr(yaml.safe_load(text))

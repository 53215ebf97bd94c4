"""YAML by PyYAML's safe loader within bounds: text is read, or refused with its line and key, in a second.

Aliases and merge keys may stand for a billion nodes or for themselves; deep nesting, long numbers, half
characters, and tags such as `!!int ''` raise whatever comes in PyYAML. Aliases are read as long as what they
stand for stays small.
"""

from __future__ import annotations

import re
from typing import Any

import yaml

MOST_LETTERS = 400_000
"""Of the first document; PyYAML takes about a second for as many."""
MOST_WEIGHT = 10_000
"""A node weighs 1, and 1 more for every hundred letters; an alias weighs as much as what it stands for."""
MOST_LEVELS = 40
MOST_DIGITS = 1000

_LETTERS_PER_WEIGHT = 100
_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
_HALF_CHARACTER = re.compile("[\ud800-\udfff]")
_LONGEST_KEY = 100
_RAISED = (yaml.YAMLError, ValueError, LookupError, AttributeError, TypeError, ArithmeticError)
"""By PyYAML, for text that its scanner or the constructor of a tag does not expect, such as `!!bool x`."""


class FaultyYamlError(Exception):
    """What is wrong, and where."""

    def __init__(self, what: str, *, line: int | None = None) -> None:
        super().__init__(what if line is None else f"line {line}: {what}")
        self.what, self.line = what, line


class BoundedLoader(yaml.SafeLoader):
    """A safe loader that gives up early."""

    HALF_CHARACTERS = False  # whether text may hold them, as names of files that are not UTF-8 do

    def __init__(self, text: str) -> None:
        super().__init__(text[:MOST_LETTERS])
        self._too_long = len(text) > MOST_LETTERS
        self._path: list[yaml.Node | int | None] = []  # of the node that is being composed
        self._weight = self._deepest = 0
        self._size: dict[int, tuple[int, int]] = {}  # weight and levels of each finished node
        self._key: dict[int, str] = {}  # full key of each node

    def passed_the_end(self) -> bool:
        """Whether the text was cut off before the document's end."""
        return self._too_long and self.index >= MOST_LETTERS

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        self._path.append(index)
        level, deepest, weight = len(self._path), self._deepest, self._weight
        self._deepest = level
        line = self.peek_event().start_mark.line + 1
        if self.check_event(yaml.AliasEvent):
            node, (adds, levels) = self._alias(parent, index, line)
            self._weight += adds
            self._deepest += levels
            self._check_bounds(line)
        else:
            self._weight += 1
            self._check_bounds(line)
            key = self._shown_path()
            node = super().compose_node(parent, index)
            self._key[id(node)] = key
            self._size[id(node)] = self._weight - weight, self._deepest - level
        self._deepest = max(deepest, self._deepest)
        self._path.pop()
        return node

    def _alias(self, parent: yaml.Node | None, index: Any, line: int) -> tuple[Any, tuple[int, int]]:
        name = self.peek_event().anchor
        node = super().compose_node(parent, index)
        if id(node) not in self._size:
            raise FaultyYamlError(f"{self._shown_path()}*{name} is part of what it stands for", line=line)
        return node, self._size[id(node)]

    def compose_scalar_node(self, anchor: Any) -> yaml.ScalarNode:
        node = super().compose_scalar_node(anchor)
        value, line = node.value, node.start_mark.line + 1
        self._weight += len(value) // _LETTERS_PER_WEIGHT
        self._check_bounds(line)
        if not self.HALF_CHARACTERS and (half := _HALF_CHARACTER.search(value)):
            raise FaultyYamlError(f"{self._shown_path()}text with {half[0]!a}, half a character", line=line)
        if node.tag in _NUMBERS and len(value) > MOST_DIGITS:
            raise FaultyYamlError(
                f"{self._shown_path()}a number of {len(value):,} digits; at most {MOST_DIGITS} are read",
                line=line,
            )
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep=deep)
        except _RAISED as error:
            key, tag = self._key.get(id(node), ""), node.tag.rpartition(":")[2]
            told = f" ({_told(error)})" if isinstance(error, ValueError | yaml.YAMLError) else ""
            shown = f"{node.value!r:.60}" if isinstance(node, yaml.ScalarNode) else "this"
            raise FaultyYamlError(
                f"{key}{shown} is no !!{tag}{told}", line=node.start_mark.line + 1
            ) from error

    def _check_bounds(self, line: int) -> None:
        if self._deepest > MOST_LEVELS:
            raise FaultyYamlError(
                f"{self._shown_path()}nested more than {MOST_LEVELS} levels deep", line=line
            )
        if self._weight > MOST_WEIGHT:
            raise FaultyYamlError(
                f"{self._shown_path()}more than {MOST_WEIGHT:,} values up to here, with all that aliases "
                "stand for",
                line=line,
            )

    def _shown_path(self) -> str:
        """The full key of what is being composed, with a colon: `stages.train: `; '' at the top."""
        keys = [
            f"[{step}]" if isinstance(step, int) else f".{step.value}"
            for step in self._path
            if isinstance(step, int | yaml.ScalarNode)
        ]
        key = "".join(keys).removeprefix(".")
        shown = " ".join(key.encode("utf-8", "backslashreplace").decode().split())
        if len(shown) > _LONGEST_KEY:
            shown = f"{shown[:_LONGEST_KEY]}..."
        return f"{shown}: " if shown else ""


def load_document(text: str, loader_type: type[BoundedLoader], *, more_may_follow: bool) -> Any:
    """The value of a text's first document; None if it has none.

    Args:
        text: YAML.
        loader_type: which tags are known.
        more_may_follow: whether other documents are ignored; they are a fault otherwise.

    Raises:
        FaultyYamlError: it is not YAML, or is out of bounds.
    """
    loader: BoundedLoader | None = None
    try:
        loader = loader_type(text)
        node = (loader.check_node() and loader.get_node()) if more_may_follow else loader.get_single_node()
        if not loader.passed_the_end():
            return loader.construct_document(node) if node else None
    except _RAISED as error:
        if loader is None or not loader.passed_the_end():
            mark = error.problem_mark if isinstance(error, yaml.MarkedYAMLError) else None
            mark = mark or (loader and loader.get_mark())
            raise FaultyYamlError(_told(error), line=mark.line + 1 if mark else None) from error
    raise FaultyYamlError(f"longer than {MOST_LETTERS:,} letters")


def _told(error: Exception) -> str:
    problem = (error.problem or error.context) if isinstance(error, yaml.MarkedYAMLError) else None
    return " ".join((problem or str(error)).split())

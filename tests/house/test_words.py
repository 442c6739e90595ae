"""One word for each thing: words that were given up are in no identifier and no YAML key."""

import re
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from zoac.core.parameters import ParameterSpace

ROOT = Path(__file__).parents[2]
CODE = ("zoac", "tasks", "baselines", "analysis", "benchmarks", "stress", "examples", "conf")

GIVEN_UP = {
    "lane": "env_index or environment",
    "lanes": "num_envs or environments",
    "branch": "restore or snapshot",
    "branches": "supports_snapshots",
    "scout": "initial_samples",
    "race": "successive halving",
    "finals": "final selection",
    "contenders": "candidates",
    "gate": "acceptance_test",
    "trust": "initial_sigma",
    "spread": "std or initial_sigma",
    "caution": "max_termination_rate",
    "tolerated": "max_termination_rate",
    "meanwhile": "background_update",
    "careful": "robust",
    "optimism": "selection_bias",
    "sink": "logger",
    "sinks": "loggers",
    "ours": "zoac",
    "MOST": "MAX",
    "LONGEST": "MAX",
    "WIDEST": "MAX",
    "FEWEST": "MIN",
    "MANY": "MAX",
}
"""Part of a name -> the word to use. Words in capitals count in names of constants only."""

ELSEWHERE = {
    # A lane of a vector register: `riccati` solves several problems in one, and its benchmarks too.
    "zoac/mpc/riccati": {"lane", "lanes", "spread"},
    "benchmarks/qp": {"lane", "lanes"},
    # A lane of a road.
    "tasks/lane_change": {"lane"},
}
"""Beginning of a path -> words that mean another thing there."""

NAMES = {"trust_code", "add_trust", "lane_change"}
"""Names that say another thing: permission to run code of a run folder, and a task."""


def words(name: str) -> list[str]:
    """Return the words of a name, which underscores and capitals separate."""
    return re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)


def faults(name: str, path: str) -> list[str]:
    """Return a sentence for each word of a name that was given up."""
    if name in NAMES:
        return []
    allowed = {word for start, some in ELSEWHERE.items() if path.startswith(start) for word in some}
    found = [word if word in GIVEN_UP else word.lower() for word in words(name)]
    return [
        f"{path}: {name!r}: write {GIVEN_UP[word]!r}, not {word!r}"
        for word in found
        if word in GIVEN_UP and word not in allowed
    ]


def identifiers(path: Path) -> set[str]:
    with path.open(encoding="utf-8") as file:
        tokens = tokenize.generate_tokens(file.readline)
        return {token.string for token in tokens if token.type == tokenize.NAME}


def keys(node: Any) -> Iterator[str]:
    children = node if isinstance(node, list) else []
    if isinstance(node, dict):
        yield from map(str, node)
        children = list(node.values())
    for child in children:
        yield from keys(child)


@pytest.mark.parametrize("folder", CODE)
def test_identifiers_and_keys_use_the_words_of_the_field(folder: str) -> None:
    found = []
    for path in sorted((ROOT / folder).rglob("*.py")):
        where = path.relative_to(ROOT).as_posix()
        for name in sorted(identifiers(path)):
            found += faults(name, where)
    for path in sorted((ROOT / folder).rglob("*.yaml")):
        for key in keys(yaml.safe_load(path.read_text(encoding="utf-8"))):
            found += faults(key, path.relative_to(ROOT).as_posix())
    assert not found, "\n".join(found)


def test_a_unit_is_one_of_measurement() -> None:
    """`unit` and `physical` name what a number means, no longer the maps between the two."""
    assert not hasattr(ParameterSpace, "unit")
    assert not hasattr(ParameterSpace, "physical")


@pytest.mark.parametrize(
    "name", ["lane", "_lane_of", "LaneEnv", "gate_share", "LONGEST_WAIT", "trust", "sinks"]
)
def test_a_word_that_comes_back_is_found(name: str) -> None:
    assert faults(name, "zoac/core/tuner.py")


@pytest.mark.parametrize("name", ["plane", "longest", "trust_code", "aggregate", "trace"])
def test_other_words_are_not(name: str) -> None:
    assert not faults(name, "zoac/core/tuner.py")

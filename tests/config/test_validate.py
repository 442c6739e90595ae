import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field

from zoac.config.validate import check_arguments, locate
from zoac.core.errors import ConfigError


class Thing:
    def __init__(
        self,
        problem: object,
        *,
        step: Annotated[float, Field(gt=0, le=1)],
        count: int = 3,
        mode: Literal["fast", "safe"] = "fast",
        sizes: Sequence[Annotated[int, Field(ge=1)]] = (2,),
        limit: float | None = None,
    ) -> None: ...


def check(**given):
    check_arguments(Thing, given, "tuner", provided=("problem",))


def test_good_values_pass():
    check(step=0.5, count=1, mode="safe", sizes=[1, 2], limit=None)
    check(step=1)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"step": "abc"}, r"tuner.step='abc': input should be a valid number"),
        ({"step": -1}, r"tuner.step=-1: input should be greater than 0"),
        ({"step": 2.0}, r"tuner.step=2.0: input should be less than or equal to 1"),
        ({"step": float("nan")}, r"tuner.step=nan: input should be a finite number"),
        ({"step": True}, r"tuner.step=True"),
        ({}, r"tuner.step: a value is needed"),
        ({"step": 1.0, "count": 1.5}, r"tuner.count=1.5"),
        ({"step": 1.0, "mode": "fats"}, r"tuner.mode='fats': input should be 'fast' or 'safe'"),
        ({"step": 1.0, "sizes": [1, 0]}, r"tuner.sizes\[1\]=0"),
        ({"step": 1.0, "sizes": 3}, r"tuner.sizes=3"),
        ({"stp": 1.0}, r"unknown key 'stp'; did you mean 'step'"),
    ],
)
def test_bad_values_are_named(given, message):
    with pytest.raises(ConfigError, match=message):
        check(**given)


def test_all_faults_are_told_at_once():
    with pytest.raises(ConfigError) as error:
        check(step=-1, count="x", nonsense=1)
    assert len(str(error.value).splitlines()) == 3


def test_a_target_that_does_not_exist_gets_the_nearest():
    with pytest.raises(ConfigError, match=r"no 'Zoca' in zoac.algorithm.zoac; did you mean 'Zoac'"):
        locate("zoac.algorithm.zoac.Zoca", "tuner._target_")


def test_a_module_that_does_not_exist_is_named():
    with pytest.raises(ConfigError, match=r"cannot import 'nowhere.Thing'"):
        locate("nowhere.Thing", "task._target_")


class Child(Thing):
    def __init__(self, problem: object, *, extra: int = 0, **options: object) -> None: ...


def test_options_handed_on_to_a_base_class_are_checked_there():
    check_arguments(Child, {"step": 0.5, "extra": 1}, "tuner", provided=("problem",))
    with pytest.raises(ConfigError, match=r"tuner.step=-1.*\n.*unknown key 'extar'.*'extra'"):
        check_arguments(Child, {"step": -1, "extar": 1}, "tuner", provided=("problem",))


def test_a_target_that_takes_anything_is_given_anything():
    def anything(**options: object) -> None: ...

    check_arguments(anything, {"a": 1}, "tuner")


def named(name: str, folder: str | Path | None = None, mode: Literal["a", "b"] = "a") -> None: ...


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("name", "name=nan: input should be a valid string"),
        ("folder", "folder=nan: input should be a valid string"),
        ("mode", "mode=nan: input should be 'a' or 'b'"),
    ],
)
def test_where_text_is_expected_nan_is_told_so(option, said):
    with pytest.raises(ConfigError, match=said):
        check_arguments(named, {"name": "x", option: math.nan}, "")


def test_a_whole_number_that_no_float_can_hold_is_refused():
    with pytest.raises(ConfigError, match="larger than any float; expected a finite number"):
        check(count=10**400)

"""How exceptions of users' code are told."""

import pytest

from zoac.core.errors import as_text


@pytest.mark.parametrize(
    ("error", "text"), [(ValueError("too hot"), "ValueError: too hot"), (OSError(), "OSError")]
)
def test_an_exception_is_told_by_its_class_and_what_it_says(error, text):
    assert as_text(error) == text

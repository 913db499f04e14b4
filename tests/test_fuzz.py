"""A short run of the fuzzer (tests/fuzz.py): malformed input ends in a working set-up or in an error that names it."""

import pytest
from fuzz import fuzz

pytestmark = pytest.mark.wrong_types


def test_malformed_input_is_refused_by_name():
    count, failures = fuzz(range(400))
    assert not failures, failures[:5]
    assert count["refused"] > 300 and count["accepted"] > 5

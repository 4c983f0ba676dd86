"""A user's mistake is one line, whatever is in it."""

import pickle

from hypothesis import given
from hypothesis import strategies as st

from grainfall.errors import InputError


@given(st.text(), st.text(), st.text())
def test_a_mistake_is_one_printable_line(where, wrong, right):
    fault = InputError(where, wrong, right)
    assert str(fault).isprintable()  # a line break, an escape sequence are not
    assert str(pickle.loads(pickle.dumps(fault))) == str(fault)
    assert len(str(InputError("a.png", "x" * 10_000))) < 1000

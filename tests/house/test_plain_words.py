"""Docstrings, comments and pages use standard technical terms."""

from __future__ import annotations

from .plain_words import Text, marks_of, prose_of_python, too_many
from .samples import COUNT, drawn

RIDDLE = '''
def tell() -> None:
    """Who is not heard is told nothing."""
    # What it does, nobody hears. A `none` in code does not count.


LIMIT = 3
"""Whose limit."""
'''


def test_marks_are_found_in_docstrings_comments_and_strings_below_constants() -> None:
    marks = sorted(marks_of(prose_of_python(RIDDLE)))
    assert [line for line, _ in marks] == [3, 3, 4, 4, 8]
    assert list(marks_of([Text(1, "The gate refuses a setpoint that is late.")])) == []


def test_no_file_has_more_marks_than_allowed() -> None:
    more = too_many()
    assert not more, f"write these more plainly (python -m tests.house.plain_words FILE): {more}"


def test_samples_for_a_reader_are_drawn_by_their_seed() -> None:
    once, again = drawn(1), drawn(1)
    assert once == again and {len(texts) for texts in once.values()} == {COUNT}

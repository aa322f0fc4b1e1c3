"""Docstrings, comments and pages use the words of the trade."""

from __future__ import annotations

from .plain_words import Text, exceptions, marks_of, prose_of_python, too_many
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


def test_no_file_has_more_marks_than_its_exception_allows() -> None:
    allowed = exceptions()
    more = {path: count for path, count in too_many().items() if count > allowed.get(path, 0)}
    assert not more, f"write these more plainly (python -m tests.house.plain_words FILE): {more}"


def test_the_exceptions_only_shrink() -> None:
    """A file that was rewritten leaves the list."""
    counts = too_many()
    stale = {path: count for path, count in exceptions().items() if counts.get(path, 0) < count}
    assert not stale, "run python -m tests.house.plain_words to lower the exceptions"


def test_samples_for_a_reader_are_drawn_by_their_seed() -> None:
    once, again = drawn(1), drawn(1)
    assert once == again and {len(texts) for texts in once.values()} == {COUNT}

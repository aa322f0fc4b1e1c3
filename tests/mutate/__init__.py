"""Break the safety code in many small ways, and see an ordinary test notice each.

``python -m tests mutate [--only PART] [--resume FILE] [--jobs N]``: every mutation of
``mutations.py`` in every place of ``places.py`` is made in a copy of the project, and the tests that
hold that place are run until one fails. What no test notices survives. A survivor is a missing test,
or has a reason in ``reasons.toml``. ``docs/mutations.md`` is the table.
"""

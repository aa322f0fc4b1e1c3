"""Break the safety code in many small ways, and check that an ordinary test notices each.

``python -m tests mutate [--only PART] [--resume FILE] [--jobs N]`` makes every mutation of
``mutations.py`` in every place of ``places.py``, in a copy of the project. After each it runs the tests
of that place until one fails. A mutation that no test notices survives. A survivor means that a test is
missing, or has a reason in ``reasons.toml``. ``docs/mutations.md`` is the table.
"""

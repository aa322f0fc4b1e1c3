"""The pages of ``docs/guide``: their Python blocks run, and their commands exist."""

"""Tests of the console in a real browser, by ``python -m tests console``.

They need Chromium or Chrome: the file that the environment variable ``CHROMIUM`` names, or one on ``PATH``. The
audit of accessibility also needs axe-core: ``AXE_CORE`` names its ``axe.min.js`` (``npm install axe-core``).
"""

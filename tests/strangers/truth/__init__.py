"""Ground truth: run one session on a simulator that others publish and on our twin, and compare the two.

A session yields events. The order of the events, the answers, the times, and the signs and sizes of the readings
are compared (``compare.py``). What differs is listed on the page, and not hidden by a wider tolerance.
"""

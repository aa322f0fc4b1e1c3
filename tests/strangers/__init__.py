"""Run vendors' clients and their example programs, unmodified but for host and port, against our twins.

``python -m tests strangers`` fetches each client of ``clients.toml`` from the package index into a cache, runs its
programs one by one against a fresh twin, and prints what the robot's body did. ``--truth`` runs one session on the
vendor's own simulator and on our twin, and lists what differs.

The fetched packages stay in the cache. Nothing of them is part of this project.
"""

"""The clients that move robots in the question ``wires``: one module per client, with a class ``Client``.

``ours`` is this package. Each other module implements ``BaseClient`` with the client that most users of that robot
have. A module imports only packages of the environment in which it runs.
"""

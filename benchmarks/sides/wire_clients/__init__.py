"""The clients that move robots in the question ``wires``: one module per client, with a class ``Client``.

``ours`` is this package. Each other module implements ``Hand`` with the client that most users of its robot
have. The modules import only what their environment has.
"""

"""Who moves a robot in the question ``wires``: a module for each, with a class ``Client``.

``ours`` is this package; each other one does, with the client that its robot's users mostly have,
what ``Hand`` asks for. They import nothing that their environment lacks.
"""

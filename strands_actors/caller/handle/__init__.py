"""The objects that a user commands a robot with (``Robot`` and its variants), and their methods."""

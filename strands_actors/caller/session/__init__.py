"""A caller's session with one robot: lease, orders, rollouts."""

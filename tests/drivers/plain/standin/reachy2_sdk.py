"""Stand-in for an SDK of which only the presence is checked."""

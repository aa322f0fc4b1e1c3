"""Messages and their bytes. Pure: no clock, no socket."""

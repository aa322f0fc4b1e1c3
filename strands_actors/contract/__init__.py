"""What the author of a driver reads: axes, safe states, options, and the gates that follow from them. Pure."""

"""Parts that drivers, wires and stop channels are made of."""

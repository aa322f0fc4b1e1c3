"""Building blocks of the drivers, of the code that talks to robots, and of the code that stops them."""

"""Bodies of twins and simulations, and the solvers that move them."""

"""Bodies of simulated robots, and the solvers that compute their motion."""

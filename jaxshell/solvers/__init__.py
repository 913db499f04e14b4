"""Newton's iteration and the linear solvers under it."""

"""Runs: in time, static, along a path, eigenvalues; and the programs that they compile."""

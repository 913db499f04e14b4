"""Sweeps: many runs of scenes that differ in a few values, as batches of one compiled program, over many processes."""

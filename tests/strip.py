"""A strip of two triangles as a scene file, for sweeps: one explicit program, and few steps of it."""

STRIP = """
name = "strip"
units = "SI"
[mesh]
generator = "rectangle"
length = 1.0
width = 0.5
divisions = [1, 1]
[section]
thickness = 0.02
young_modulus = 1e6
poisson_ratio = 0.3
density = 1000
[[supports]]
plane = { x = 0.0 }
hold = "clamped"
[[loads]]
kind = "edge force"
plane = { x = 1.0 }
force = [0.0, 0.0, 1.0]
[watch]
tip = { nearest = [1.0, 0.0, 0.0], component = "uz" }
"tip velocity" = { nearest = [1.0, 0.0, 0.0], component = "vz" }
[run]
method = "CentralDifference"
dt = 2e-4
t_end = 0.02
"""

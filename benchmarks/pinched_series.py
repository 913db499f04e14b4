"""The linear answer of the pinched cylinder between diaphragms, by its double Fourier series.

With m half waves along and n around, u = U cos(λx) cos(nθ), v = V sin(λx) sin(nθ), w = W sin(λx) cos(nθ), λ = mπ/L, meet
the ends' conditions, and each pair (m, n) has three equations of its own: those of the strains of Koiter and Sanders
(J. L. Sanders, Q. Appl. Math. 21 (1963) 21-36),

    ε_x = u_x,  ε_θ = (v_θ + w)/R,  γ = u_θ/R + v_x,
    κ_x = -w_xx,  κ_θ = (v_θ - w_θθ)/R²,  2τ = -2 w_xθ/R + 3 v_x/(2R) - u_θ/(2R²).

G. M. Lindberg, M. D. Olson & G. R. Cowper, Q. Bull. Div. Mech. Eng., NRC Canada (1969) 4, have 1.8248e-5 for R 300, L 600,
h 3, E 3e6, ν 0.3 and the force 1, which most papers compare with.
"""

import numpy as np


def pinched_series(
    radius=100.0, length=200.0, thickness=1.0, young=30e3, ratio=0.3, force=12e3, waves=1600
) -> tuple[float, float]:
    """Deflections under one of the two forces, inwards, and a quarter turn from them, outwards [length].

    The series of the first converges with 1/waves².
    """
    R, L, C = radius, length, young * thickness / (1 - ratio**2)
    D = C * thickness**2 / 12
    # Both forces are in the middle and opposite: only odd m and even n.
    m, n = np.meshgrid(np.arange(1, waves, 2), np.arange(0.0, 2 * waves, 2), indexing="ij")
    a, zero = m * np.pi / L, np.zeros(m.shape)
    stretch = [[-a, zero, zero], [zero, n / R, 1 / R + zero], [-n / R, a, zero]]
    bend = [[zero, zero, a**2], [zero, n / R**2, (n / R) ** 2], [n / (2 * R**2), 1.5 * a / R, 2 * a * n / R]]
    law = np.array([[1, ratio, 0], [ratio, 1, 0], [0, 0, (1 - ratio) / 2]])
    K = sum(
        stiffness * np.einsum("ki...,kl,lj...->...ij", np.array(strains), law, np.array(strains), optimize=True)
        for stiffness, strains in ((C, stretch), (D, bend))
    )
    K[n == 0, 1, 1] = 1.0  # where there is no v
    area = np.where(n == 0, 2, 1) * np.pi * R * L / 2
    middle = np.sin(m * np.pi / 2)
    loads = np.stack([zero, zero, 2 * force * middle / area], axis=-1)
    W = np.linalg.solve(K, loads[..., None])[..., 2, 0] * middle
    return float(W.sum()), -float((W * np.cos(n * np.pi / 2)).sum())


if __name__ == "__main__":
    print("under the force {:.6g}, a quarter turn from it {:.6g}".format(*pinched_series()))

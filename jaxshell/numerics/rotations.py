"""Finite rotations of one node: exp, log, Cayley, H(θ) and the scalar functions of the angle in them.

Yang & Xia 2014, eqs. (2)-(11) and (83). `~v` below is the skew matrix of v (`~v w = v × w`) and R turns
vectors: x_new = R x. Every function takes a single vector (3,) or matrix (3, 3); callers vmap.

All of them are smooth where the rotation vanishes: the scalars are functions of θ², never of θ, so that
values and derivatives of any order, forward and reverse, are right at θ = 0. Every matrix is built as
a I + b ~θ + c θθᵀ, which costs no matrix product.
"""

from math import factorial, fsum, pi

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.numerics.fusion import formed
from jaxshell.numerics.products import cross, dot, product, scaled

Scalar = Float[Array, ""]
Vector = Float[Array, "3"]
Matrix = Float[Array, "3 3"]


def skew(v: Vector) -> Matrix:
    """The skew matrix ~v: `skew(v) @ w == cross(v, w)`."""
    x, y, z = jnp.unstack(v)
    zero = jnp.zeros_like(x)
    return jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)


# --- scalar functions of the squared angle ---------------------------------------------------------------

# sin θ/θ, (1 - cos θ)/θ² and (θ - sin θ)/θ³ are Σ (-θ²)ᵏ/(2k+m)! with m = 1, 2, 3. Their closed forms lose
# digits to cancellation below 1 rad, and twice as many with each derivative; above it the loss in a
# second derivative stays under 1e-12. Ten terms leave less than that at the switch.
_SWITCH = 1.0
_SINE_SERIES, _COSINE_SERIES, _REMAINDER_SERIES = (
    [(-1) ** k / factorial(2 * k + m) for k in range(10)] for m in (1, 2, 3)
)


def _horner(coefficients: list[float], x: Scalar) -> Scalar:
    """Σ coefficients[k] xᵏ."""
    total = coefficients[-1] * x + coefficients[-2]
    for coefficient in coefficients[-3::-1]:
        total = total * x + coefficient
    return total


def _safe_angle(theta_sq):
    """θ where the closed form is used, 1 where the series is: so the unused branch has finite derivatives."""
    return jnp.sqrt(jnp.where(theta_sq < _SWITCH, 1.0, theta_sq))


def sine_ratio(theta_sq: Scalar) -> Scalar:
    """sin θ/θ as a function of θ² [rad²]."""
    angle = _safe_angle(theta_sq)
    return jnp.where(theta_sq < _SWITCH, _horner(_SINE_SERIES, theta_sq), jnp.sin(angle) / angle)


def cosine_ratio(theta_sq: Scalar) -> Scalar:
    """(1 - cos θ)/θ² as a function of θ² [rad²]."""
    angle = _safe_angle(theta_sq)
    closed_form = (1.0 - jnp.cos(angle)) / (angle * angle)
    return jnp.where(theta_sq < _SWITCH, _horner(_COSINE_SERIES, theta_sq), closed_form)


def sine_remainder_ratio(theta_sq: Scalar) -> Scalar:
    """(θ - sin θ)/θ³ as a function of θ² [rad²]."""
    angle = _safe_angle(theta_sq)
    closed_form = (angle - jnp.sin(angle)) / (angle * angle * angle)
    return jnp.where(theta_sq < _SWITCH, _horner(_REMAINDER_SERIES, theta_sq), closed_form)


def _powers_from_four(s: int) -> float:
    """Σ_{k≥4} k⁻ˢ, Hurwitz' ζ(s, 4), from k = n on by Euler and Maclaurin. To import SciPy's takes 0.15 s."""
    n = 1000
    return fsum([*(float(k) ** -s for k in range(4, n)), n ** (1.0 - s) / (s - 1), n**-s / 2, s * n ** (-s - 1.0) / 12])


# Euler's partial fractions of the cotangent, x cot x = 1 - 2 Σ x²/(k²π² - x²), turn (83) with x = θ/2 into
#   η = 2 Σ_k 1/(4π²k² - θ²),  μ = 2 dη/d(θ²) = 4 Σ_k 1/(4π²k² - θ²)².
# Nothing cancels in these sums, at any angle, and they need neither a tangent nor a branch at zero. The
# first three terms (with the pole at 2π, where H ceases to exist) are taken as they stand and the rest,
# k ≥ 4, as a power series in θ²; at 2π it falls by 16 with each term.
_POLES = [(2 * pi * k) ** 2 for k in (1, 2, 3)]
_ETA_SERIES = [2.0 * _powers_from_four(2 * j + 2) / (2 * pi) ** (2 * j + 2) for j in range(13)]
_MU_SERIES = [2.0 * j * _ETA_SERIES[j] for j in range(1, 13)]


def eta(theta_sq: Scalar) -> Scalar:
    """η = [1 - (θ/2)/tan(θ/2)]/θ² of eq. (83) as a function of θ² [rad²], for angles up to 2π."""
    first_terms = sum(2.0 / (pole - theta_sq) for pole in _POLES)
    return first_terms + _horner(_ETA_SERIES, theta_sq)


def mu(theta_sq: Scalar) -> Scalar:
    """μ = (θ² + 4 cos θ + θ sin θ - 4)/(4 θ⁴ sin²(θ/2)) of eq. (83) as a function of θ² [rad²], up to 2π."""
    first_terms = sum((2.0 / (pole - theta_sq)) ** 2 for pole in _POLES)
    return first_terms + _horner(_MU_SERIES, theta_sq)


# --- maps between rotation vectors and matrices ----------------------------------------------------------


def compose(a, b, c, v: Vector) -> Matrix:
    """a I + b ~v + c v vᵀ."""
    a, b, c = formed((a, b, c))
    outer = product(v[:, None], v[None, :])
    return scaled(a, jnp.eye(3)) + scaled(b, skew(v)) + scaled(c, outer)


def exp(theta: Vector) -> Matrix:
    """Rotation matrix exp(~θ) of the rotation vector θ [rad], any angle (eq. (3))."""
    theta_sq = formed(dot(theta, theta))
    c = cosine_ratio(theta_sq)
    return compose(1.0 - c * theta_sq, sine_ratio(theta_sq), c, theta)


def turned(theta: Vector, v: Vector) -> Vector:
    """exp(~θ) v without the matrix: v + sin θ/θ θ × v + (1 - cos θ)/θ² θ × (θ × v)."""
    theta_sq = formed(dot(theta, theta))
    b, c, across = formed((sine_ratio(theta_sq), cosine_ratio(theta_sq), cross(theta, v)))
    return v + scaled(b, across) + scaled(c, cross(theta, across))


def cayley(theta: Vector) -> Matrix:
    """Rotation matrix cay(θ) = (I - ½~θ)⁻¹ (I + ½~θ) of the Cayley vector θ = 2 tan(angle/2) n.

    It obeys cay(θ) - I = ½ ~θ (cay(θ) + I), which the exactly conserving scheme of Simo & Tarnow rests on.
    """
    theta_sq = formed(dot(theta, theta))
    b = 1.0 / (1.0 + 0.25 * theta_sq)
    return compose(1.0 - 0.5 * b * theta_sq, b, 0.5 * b, theta)


_LOG_SERIES = [4.0**k * factorial(k) ** 2 / factorial(2 * k + 1) for k in range(14)]  # see `log`


def log(R: Matrix) -> Vector:
    """Rotation vector θ [rad] with exp(~θ) = R and |θ| ≤ π.

    Eq. (5) by way of the unit quaternion (w, **v**) = (cos θ/2, n sin θ/2), since the paper's arcsin is right
    only below π/2. Right, with its derivatives along rotations, from the identity up to and at π, where
    either of the two vectors ±πn is a right answer.
    """
    r11, r12, r13, r21, r22, r23, r31, r32, r33 = jnp.unstack(R.reshape(9))
    # Row i of the symmetric matrix 4 q_i q_j, linear in R (Shepperd 1978). The row of a large q_i loses no
    # digits: one of the four q_i² is at least ¼, and with a positive trace w² is.
    rows = (
        (1.0 + r11 + r22 + r33, r32 - r23, r13 - r31, r21 - r12),
        (r32 - r23, 1.0 + r11 - r22 - r33, r12 + r21, r13 + r31),
        (r13 - r31, r12 + r21, 1.0 - r11 + r22 - r33, r23 + r32),
        (r21 - r12, r13 + r31, r23 + r32, 1.0 - r11 - r22 + r33),
    )
    use_w = r11 + r22 + r33 > 0.0
    use_x = (r11 >= r22) & (r11 >= r33)
    use_y = r22 >= r33

    def select(of_w, of_x, of_y, of_z):
        return jnp.where(use_w, of_w, jnp.where(use_x, of_x, jnp.where(use_y, of_y, of_z)))

    scale = 0.5 / jnp.sqrt(select(*(rows[i][i] for i in range(4))))
    w, x, y, z = (select(*(row[j] for row in rows)) * scale for j in range(4))
    sign = jnp.where(w < 0.0, -1.0, 1.0)  # q and -q are the same rotation: take the one with θ ≤ π
    # θ = 2 f v with f = (θ/2)/sin(θ/2), a smooth function of w = cos(θ/2) down to w = 0 and beyond. Halving
    # the angle twice leaves the classical series  arcsin(√s)/√(s(1-s)) = Σ 4ᵏ(k!)²/(2k+1)! sᵏ
    # with s = sin²(θ/16) ≤ 0.038: no arc function, and no branch at θ = 0.
    cos_quarter = jnp.sqrt(0.5 + 0.5 * sign * w)
    cos_eighth = jnp.sqrt(0.5 + 0.5 * cos_quarter)
    f = _horner(_LOG_SERIES, 0.5 - 0.5 * cos_eighth) / (cos_quarter * cos_eighth)
    return (2.0 * f * sign) * jnp.stack([x, y, z])


def H(theta: Vector) -> Matrix:
    """H(θ) with dθ = H dω for the spin exp(~dω) exp(~θ) (eqs. (9), (11)); exists for angles below 2π.

    H = I - ½ ~θ + η ~θ~θ, with ~θ~θ = θθᵀ - θ² I.
    """
    theta_sq = formed(dot(theta, theta))
    c = eta(theta_sq)
    return compose(1.0 - c * theta_sq, -0.5, c, theta)


def H_inverse(theta: Vector) -> Matrix:
    """H(θ)⁻¹ with dω = H⁻¹ dθ, any angle: I + (1 - cos θ)/θ² ~θ + (θ - sin θ)/θ³ ~θ~θ."""
    theta_sq = formed(dot(theta, theta))
    c = sine_remainder_ratio(theta_sq)
    return compose(1.0 - c * theta_sq, cosine_ratio(theta_sq), c, theta)

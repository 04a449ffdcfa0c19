"""Fit the polynomials of ``bicycle_env/physics/elementary.py`` and print them.

    pip install mpmath && python tools/fit_elementary.py

Each is the interpolant at Chebyshev nodes of an analytic function of z, found with 60 digits: within a small factor of
the minimax polynomial of the same degree. The printed error is relative to the function, before rounding.
"""

import mpmath as mp

mp.mp.dps = 60


def fit(function, z_max, degree):
    """Coefficients c_0 ... c_degree of the interpolant of `function` on [0, z_max], and its relative error."""
    low, high = mp.mpf(0), mp.mpf(z_max)
    nodes = [
        (low + high) / 2 + (high - low) / 2 * mp.cos(mp.pi * (2 * k + 1) / (2 * degree + 2)) for k in range(degree + 1)
    ]
    matrix = mp.matrix(degree + 1, degree + 1)
    right = mp.matrix(degree + 1, 1)
    for i, node in enumerate(nodes):
        right[i] = function(node)
        for j in range(degree + 1):
            matrix[i, j] = node**j
    coefficients = mp.lu_solve(matrix, right)
    samples = [low + (high - low) * k / 400 for k in range(401)]
    error = max(abs(mp.polyval(list(coefficients)[::-1], z) / function(z) - 1) for z in samples)
    return [float(c) for c in coefficients], float(error)


def series(function, at_zero):
    return lambda z: at_zero if z == 0 else function(z)


def main():
    half = mp.pi / 2 * mp.mpf("1.001")
    eighth = mp.tan(mp.pi / 8) * mp.mpf("1.001")
    table = {
        # sin x = x + x z S(z), cos x = 1 - z/2 + z^2 C(z), z = x^2, |x| <= pi/2
        "SIN": fit(series(lambda z: (mp.sin(mp.sqrt(z)) / mp.sqrt(z) - 1) / z, mp.mpf(-1) / 6), half**2, 7),
        "COS": fit(series(lambda z: (mp.cos(mp.sqrt(z)) - 1 + z / 2) / z**2, mp.mpf(1) / 24), half**2, 6),
        # atan x = x + x z A(z), z = x^2, |x| <= tan(pi/8)
        "ATAN": fit(series(lambda z: (mp.atan(mp.sqrt(z)) / mp.sqrt(z) - 1) / z, mp.mpf(-1) / 3), eighth**2, 10),
        # expm1 y = y + y^2 E(y), 0 <= y <= 5/8
        "EXPM1": fit(series(lambda y: (mp.expm1(y) - y) / y**2, mp.mpf(1) / 2), mp.mpf(5) / 8, 10),
    }
    for name, (coefficients, error) in table.items():
        print(f"# relative error {error:.1e}")
        print(f"{name} = (")
        for c in coefficients:
            print(f"    {c!r},")
        print(")")


if __name__ == "__main__":
    main()

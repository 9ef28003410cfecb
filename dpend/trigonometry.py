"""Sine and cosine as polynomials, for every kind of number that can be rounded, where a library's do not vectorise."""

import math

# pi in three parts: the first two have 33 bits each, so their products with a number of half turns below 2^20 are exact
# and the reduced angle keeps full accuracy.
_PI = tuple(map(float.fromhex, ("0x1.921fb544p+1", "0x1.0b4611a6p-33", "0x1.3198a2e037073p-68")))
_SIN = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(10))
_COS = tuple((-1) ** k / math.factorial(2 * k) for k in range(11))


def make_sines(rint):
    """Return sine and cosine, built on rounding to the nearest whole number.

    Taylor polynomials of degree 19 and 20 within a quarter turn of the nearest half turn; in double precision the error
    is below 5e-16 for angles up to 30.
    """

    def reduced(angle):
        half_turns = rint(angle * (1.0 / math.pi))
        y = ((angle - half_turns * _PI[0]) - half_turns * _PI[1]) - half_turns * _PI[2]
        turns = 0.5 * half_turns
        return y, y * y, 1.0 - 4.0 * abs(turns - rint(turns))

    def series(z, coefficients):
        p = coefficients[-1]
        for coefficient in coefficients[-2:0:-1]:
            p = p * z + coefficient
        return p

    def sin(angle):
        y, z, sign = reduced(angle)
        return sign * (y + y * z * series(z, _SIN))

    def cos(angle):
        _, z, sign = reduced(angle)
        return sign * (1.0 + z * series(z, _COS))

    return sin, cos

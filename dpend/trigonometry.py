"""Sine and cosine as polynomials, for every kind of number that can be rounded, where a library's do not vectorise."""

import math

# pi in three parts: the first two have 33 bits each, so their products with a number of half turns below 2^20 are exact
# and the reduced angle keeps full accuracy.
_PI = tuple(map(float.fromhex, ("0x1.921fb544p+1", "0x1.0b4611a6p-33", "0x1.3198a2e037073p-68")))
# Polynomials in y^2 for (sin y - y) / y^3 and (cos y - 1) / y^2 within a quarter turn, by Remez's algorithm: their
# greatest contributions to the error, 5e-19 and 8e-18, are the least.
_SIN = tuple(
    map(
        float.fromhex,
        (
            "-0x1.5555555555555p-3",
            "0x1.11111111110dbp-7",
            "-0x1.a01a01a015aa8p-13",
            "0x1.71de3a52e3d61p-19",
            "-0x1.ae6454ea4a5e7p-26",
            "0x1.6123d0ac0846bp-33",
            "-0x1.ae4411ac3af38p-41",
            "0x1.8838a90dda1aep-49",
        ),
    )
)
_COS = tuple(
    map(
        float.fromhex,
        (
            "-0x1.ffffffffffffep-2",
            "0x1.5555555555456p-5",
            "-0x1.6c16c16c0c79dp-10",
            "0x1.a01a019a19af9p-16",
            "-0x1.27e4f997ccefcp-22",
            "0x1.1eece3c154b00p-29",
            "-0x1.93512c61e0f5bp-37",
            "0x1.9f2421234ee8fp-45",
        ),
    )
)


def make_sines(rint, inline=lambda function: function):
    """Return sine and cosine, built on rounding to the nearest whole number.

    Polynomials of degree 17 and 16 within a quarter turn of the nearest half turn; in double precision the error is
    below 4e-16 for angles up to 1e5.  ``inline`` puts functions in the form the kind of number needs (numba wants them
    compiled).
    """

    @inline
    def reduced(angle):
        """Return the difference to the nearest half turn, and the sign that so many half turns give both."""
        half_turns = rint(angle * (1.0 / math.pi))
        y = ((angle - half_turns * _PI[0]) - half_turns * _PI[1]) - half_turns * _PI[2]
        turns = 0.5 * half_turns
        return y, 1.0 - 4.0 * abs(turns - rint(turns))

    @inline
    def polynomial(z, c):
        return c[0] + z * (c[1] + z * (c[2] + z * (c[3] + z * (c[4] + z * (c[5] + z * (c[6] + z * c[7]))))))

    @inline
    def sin(angle):
        y, sign = reduced(angle)
        z = y * y
        return sign * (y + y * z * polynomial(z, _SIN))

    @inline
    def cos(angle):
        y, sign = reduced(angle)
        z = y * y
        return sign * (1.0 + z * polynomial(z, _COS))

    return sin, cos

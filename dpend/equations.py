r"""The equations of motion, stated once, for every kind of number.

A cart of mass :math:`m_0` carries link 1, and link 1 carries link 2.  Angles are absolute, zero is up, and a
positive angle leans towards positive positions.  With :math:`q = (p, \theta_1, \theta_2)` the plant is

.. math:: D(q)\,\ddot q + C(q, \dot q)\,\dot q + G(q) = f - f_\text{friction}(\dot q)

in the lumped coefficients of :class:`dpend.params.Coefficients`.

The functions here build straight-line scalar code that is closed over the sine and cosine they are given and uses
nothing but arithmetic, so the same lines serve floats, complex numbers, whole arrays, numba and CasADi symbols.
A state is anything that unpacks to six numbers ``(pos, th1, th2, vel, om1, om2)`` and ``f`` anything that can be
indexed for three generalised forces: on the cart in N, on link 1 and on link 2 in N m.

Source: A. Bogdanov, *Optimal Control of a Double Inverted Pendulum on a Cart*, CSE-04-006, 2004; joint and Coulomb
friction added.
"""


def coulomb(vel, c):
    r"""Return the Coulomb friction of the cart, :math:`F_c v / \sqrt{v^2 + v_s^2}`."""
    return c.coulomb * vel / (vel * vel + c.coulomb_speed * c.coulomb_speed) ** 0.5


def no_coulomb(_vel, _c):
    """Return the Coulomb friction of a cart that has none."""
    return 0.0


def make_rates(sin, cos, coulomb=coulomb):
    r"""Build :math:`\dot x = (\dot q, D^{-1}(f - f_\text{friction} - C\dot q - G))`.

    The cart is eliminated first, so what is left to invert is the 2 x 2 matrix of the links.

    ``rates(x, f, c)`` returns six time derivatives, given state, generalised forces and coefficients; ``sin`` and
    ``cos`` are those for the kind of number that the result is to take, and so is :func:`coulomb`, for which
    :func:`no_coulomb` may stand where there is no such friction.
    """

    def rates(x, f, c):
        _, th1, th2, vel, om1, om2 = x
        s1 = sin(th1)
        c1 = cos(th1)
        s2 = sin(th2)
        c2 = cos(th2)
        s12 = s1 * c2 - c1 * s2
        c12 = c1 * c2 + s1 * s2

        # Forces and torques on the right-hand side: what is applied, centrifugal, gravity, friction.
        cart_friction = c.b0 * vel + coulomb(vel, c)
        joint_friction = c.b2 * (om2 - om1)
        w1 = om1 * om1
        w2 = om2 * om2
        r0 = f[0] + c.d2 * s1 * w1 + c.d3 * s2 * w2 - cart_friction
        r1 = f[1] + c.f1 * s1 - c.d5 * s12 * w2 - c.b1 * om1 + joint_friction
        r2 = f[2] + c.f2 * s2 + c.d5 * s12 * w1 - joint_friction

        # Block elimination of D = [[d1, d2 c1, d3 c2], [., d4, d5 c12], [., ., d6]].
        # Reciprocals, because division takes several times as long as multiplication.
        per_mass = 1.0 / c.d1
        e1 = c.d2 * c1 * per_mass
        e2 = c.d3 * c2 * per_mass
        m11 = c.d4 - c.d2 * c1 * e1
        m12 = c.d5 * c12 - c.d2 * c1 * e2
        m22 = c.d6 - c.d3 * c2 * e2
        p1 = r1 - e1 * r0
        p2 = r2 - e2 * r0
        per_det = 1.0 / (m11 * m22 - m12 * m12)
        al1 = (m22 * p1 - m12 * p2) * per_det
        al2 = (m11 * p2 - m12 * p1) * per_det
        acc = r0 * per_mass - e1 * al1 - e2 * al2
        return vel, om1, om2, acc, al1, al2

    return rates


def make_acceleration_slopes(sin, cos):
    r"""Build :math:`\partial\ddot q/\partial z = D^{-1}(\partial r/\partial z - (\partial D/\partial z)\,\ddot q)`.

    Here :math:`D\ddot q = r` are the equations of :func:`make_rates`, which alone say what the plant is.  This is their
    derivative for planners that need it a million times a second; a test holds it to the complex step.

    ``slopes(x, accelerations, c)`` returns for each of ``(th1, th2, vel, om1, om2, force on the cart)`` the three
    slopes of the accelerations ``(acc, al1, al2)``, given state, accelerations and coefficients.
    """

    def slopes(x, accelerations, c):
        _, th1, th2, vel, om1, om2 = x
        acc, al1, al2 = accelerations
        s1 = sin(th1)
        c1 = cos(th1)
        s2 = sin(th2)
        c2 = cos(th2)
        s12 = s1 * c2 - c1 * s2
        c12 = c1 * c2 + s1 * s2
        w1 = om1 * om1
        w2 = om2 * om2
        per_mass = 1.0 / c.d1
        e1 = c.d2 * c1 * per_mass
        e2 = c.d3 * c2 * per_mass
        m11 = c.d4 - c.d2 * c1 * e1
        m12 = c.d5 * c12 - c.d2 * c1 * e2
        m22 = c.d6 - c.d3 * c2 * e2
        per_det = 1.0 / (m11 * m22 - m12 * m12)
        # D^{-1}, entry by entry
        i11 = m22 * per_det
        i12 = -m12 * per_det
        i22 = m11 * per_det
        i01 = -(e1 * i11 + e2 * i12)
        i02 = -(e1 * i12 + e2 * i22)
        i00 = per_mass - e1 * i01 - e2 * i02

        # dr/dz - dD/dz qdd, for both angles
        p0 = c.d2 * (c1 * w1 + s1 * al1)
        p1 = c.f1 * c1 - c.d5 * (c12 * w2 - s12 * al2) + c.d2 * s1 * acc
        p2 = c.d5 * (c12 * w1 + s12 * al1)
        q0 = c.d3 * (c2 * w2 + s2 * al2)
        q1 = c.d5 * (c12 * w2 - s12 * al2)
        q2 = c.f2 * c2 - c.d5 * (c12 * w1 + s12 * al1) + c.d3 * s2 * acc
        # dr/dz, for the three rates
        speed = c.coulomb_speed * c.coulomb_speed
        root = (vel * vel + speed) ** 0.5
        friction = -c.b0 - c.coulomb * speed / (root * root * root)
        r0 = 2.0 * c.d2 * s1 * om1
        r1 = -c.b1 - c.b2
        r2 = 2.0 * c.d5 * s12 * om1 + c.b2
        t0 = 2.0 * c.d3 * s2 * om2
        t1 = c.b2 - 2.0 * c.d5 * s12 * om2
        t2 = -c.b2
        return (
            (i00 * p0 + i01 * p1 + i02 * p2, i01 * p0 + i11 * p1 + i12 * p2, i02 * p0 + i12 * p1 + i22 * p2),
            (i00 * q0 + i01 * q1 + i02 * q2, i01 * q0 + i11 * q1 + i12 * q2, i02 * q0 + i12 * q1 + i22 * q2),
            (i00 * friction, i01 * friction, i02 * friction),
            (i00 * r0 + i01 * r1 + i02 * r2, i01 * r0 + i11 * r1 + i12 * r2, i02 * r0 + i12 * r1 + i22 * r2),
            (i00 * t0 + i01 * t1 + i02 * t2, i01 * t0 + i11 * t1 + i12 * t2, i02 * t0 + i12 * t1 + i22 * t2),
            (i00, i01, i02),
        )

    return slopes


def make_energies(cos):
    r"""Build :math:`T = \tfrac12 \dot q^\top D(q)\,\dot q` and :math:`V = f_1\cos\theta_1 + f_2\cos\theta_2`.

    ``energies(x, c)`` returns kinetic and potential energy in J; the potential is zero with every centre of mass at the
    height of the cart's joint.
    """

    def energies(x, c):
        _, th1, th2, vel, om1, om2 = x
        c1 = cos(th1)
        c2 = cos(th2)
        kinetic = 0.5 * (c.d1 * vel * vel + c.d4 * om1 * om1 + c.d6 * om2 * om2) + (
            c.d2 * c1 * vel * om1 + c.d3 * c2 * vel * om2 + c.d5 * cos(th1 - th2) * om1 * om2
        )
        potential = c.f1 * c1 + c.f2 * c2
        return kinetic, potential

    return energies


def make_positions(sin, cos):
    """Build the places of the second joint and of the tip.

    ``positions(x, c)`` returns ``(x_joint, y_joint, x_tip, y_tip)`` in m, heights above the cart's joint.
    """

    def positions(x, c):
        pos, th1, th2 = x[0], x[1], x[2]
        x_joint = pos + c.length1 * sin(th1)
        y_joint = c.length1 * cos(th1)
        return x_joint, y_joint, x_joint + c.length2 * sin(th2), y_joint + c.length2 * cos(th2)

    return positions


def axpy(x, k, h):
    r"""Return :math:`x + h k`, number by number."""
    return (
        x[0] + h * k[0],
        x[1] + h * k[1],
        x[2] + h * k[2],
        x[3] + h * k[3],
        x[4] + h * k[4],
        x[5] + h * k[5],
    )


def make_rk4(rates, axpy=axpy):
    r"""Build one classical Runge-Kutta step, :math:`x + \tfrac{h}{6}(k_1 + 2k_2 + 2k_3 + k_4)`.

    ``step(x, f, c, h)`` returns the state ``h`` seconds later under forces held at ``f``, given what :func:`make_rates`
    returned, and :func:`axpy` in the form the kind of number needs (numba wants it compiled).
    """

    def step(x, f, c, h):
        k1 = rates(x, f, c)
        k2 = rates(axpy(x, k1, 0.5 * h), f, c)
        k3 = rates(axpy(x, k2, 0.5 * h), f, c)
        k4 = rates(axpy(x, k3, h), f, c)
        slope = (
            k1[0] + 2.0 * (k2[0] + k3[0]) + k4[0],
            k1[1] + 2.0 * (k2[1] + k3[1]) + k4[1],
            k1[2] + 2.0 * (k2[2] + k3[2]) + k4[2],
            k1[3] + 2.0 * (k2[3] + k3[3]) + k4[3],
            k1[4] + 2.0 * (k2[4] + k3[4]) + k4[4],
            k1[5] + 2.0 * (k2[5] + k3[5]) + k4[5],
        )
        return axpy(x, slope, h / 6.0)

    return step

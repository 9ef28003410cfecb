${about}
${rint}${tables}
/** Make the law's memory as it was at first. */
export function reset(m = new Float64Array(MEMORY)) {
    m.fill(0);
${memory}    return m;
}

/** Return the force, N, for measurements y; m is the memory that reset made. */
export function act(m, y) {
    int i, finite = 1;
    real u = 0.0;
    for (i = 0; i < ${measured}; i++) if (!(fabs(y[i]) < 1e30)) finite = 0;
    if (finite) {
        for (i = 0; i < ${measured}; i++) m[i] = y[i];
        m[6] = 1.0;
    }
${lines}
    if (m[6] === 0.0 || !(fabs(u) < 1e30)) return 0.0;
${limit}    return u;
}

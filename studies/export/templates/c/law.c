#include "law.h"
#include <math.h>

${tables}
void law_reset(real m[LAW_MEMORY])
{
    int i;
    for (i = 0; i < LAW_MEMORY; i++) m[i] = 0.0;
${memory}}

real law_act(real m[LAW_MEMORY], const real y[6])
{
    int i, finite = 1;
    real u = 0.0;
    for (i = 0; i < ${measured}; i++) if (!(fabs(y[i]) < 1e30)) finite = 0;
    if (finite) {
        for (i = 0; i < ${measured}; i++) m[i] = y[i];
        m[6] = 1.0;
    }
${lines}
    if (m[6] == 0.0 || !(fabs(u) < 1e30)) return 0.0;
${limit}    return u;
}

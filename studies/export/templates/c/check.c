/* Compare the law with what Python answered: cc -std=c99 -O2 check.c ${sources} -o check -lm && ./check < vector.csv */
#include "law.h"
#include <math.h>
#include <stdio.h>

int main(void)
{
    real m[LAW_MEMORY], y[6];
    double in[6], wanted, apart, worst = 0.0;
    int run, before = -1, rows = 0, i;
    while (scanf("%d,%lf,%lf,%lf,%lf,%lf,%lf,%lf", &run, in, in + 1, in + 2, in + 3, in + 4, in + 5, &wanted) == 8) {
        if (run != before) law_reset(m);
        before = run;
        for (i = 0; i < 6; i++) y[i] = (real)in[i];
        apart = law_act(m, y) - wanted;
        if (apart < 0.0) apart = -apart;
        if (!(apart <= worst)) worst = apart;
        rows++;
    }
    printf("%d forces, at most %g N apart, %g N allowed\n", rows, worst, ${allowed});
    return !(rows > 0 && worst <= ${allowed});
}

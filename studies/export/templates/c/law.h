#ifndef LAW_H
#define LAW_H
${about}
/* What it remembers is in m; without a heap, and with as many copies as there are such arrays. */
void law_reset(real m[LAW_MEMORY]);
real law_act(real m[LAW_MEMORY], const real y[6]);
#endif

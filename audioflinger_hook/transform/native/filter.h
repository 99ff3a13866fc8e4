/* A linear filter as one recursion, continued from block to block. */

#ifndef CUSHION_FILTER_H
#define CUSHION_FILTER_H

#include "common.h"
#include "settings.h"

/* The transposed direct form II, with the operations of scipy.signal.lfilter in the same order.
 *
 * order: that of the filter. When the compiler knows it, states are registers. */
INLINED double filter_step(const double *b, const double *a, double *state, size_t order, double x)
{
    const double y = state[0] + b[0] * x;
    for (size_t one = 1; one < order; one++)
        state[one - 1] = state[one] + x * b[one] - y * a[one];
    state[order - 1] = x * b[order] - y * a[order];
    return y;
}

#endif

/* Recursive filters, which keep their state from block to block. */

#pragma once

#include "settings.h"

/* Filter one sample in transposed direct form II, with the order of operations of scipy.signal.lfilter. If
 * `order` is a compile-time constant, the compiler can keep the state in registers. */
INLINED double filter_step(const double *b, const double *a, double *state, size_t order, double x)
{
    const double y = state[0] + b[0] * x;
    for (size_t one = 1; one < order; one++)
        state[one - 1] = state[one] + x * b[one] - y * a[one];
    state[order - 1] = x * b[order] - y * a[order];
    return y;
}

#define SECTION_NUMBERS 6
#define SECTIONS_MAX 8
#define DECAYED 1e-30 /* a smaller state is set to 0, because arithmetic with denormal numbers is slow */

typedef struct {
    const double *sections;
    size_t count;
} CascadeDesign;

typedef struct {
    double state[SECTIONS_MAX][2];
} Cascade;

INLINED double cascade_step(Cascade *cascade, CascadeDesign design, double sample)
{
    for (size_t one = 0; one < design.count; one++) {
        const double *section = design.sections + SECTION_NUMBERS * one;
        double *state = cascade->state[one];
        const double filtered = section[0] * sample + state[0];
        state[0] = section[1] * sample - section[4] * filtered + state[1];
        state[1] = section[2] * sample - section[5] * filtered;
        sample = filtered;
    }
    return sample;
}

/* Set a filter's state to 0 if all its magnitudes are below DECAYED. */
INLINED void drop_decayed(void *state, size_t bytes)
{
    const double *numbers = state;
    double most = 0.0;
    for (size_t one = 0; one < bytes / sizeof(double); one++)
        most = larger(fabs(numbers[one]), most);
    if (most < DECAYED)
        memset(state, 0, bytes);
}

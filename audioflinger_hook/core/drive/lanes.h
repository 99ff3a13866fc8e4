/* Sums over several numbers side by side, with the same bits on every processor. */

#pragma once

#include "../../transform/native/common.h"

/* Numbers that one instruction computes on many processors. */
enum { LANES = 8 };

/* Numbers in a column: zeros behind the last one fill whole groups of LANES. */
#define WHOLE_LANES(count) (((count) + LANES - 1) / LANES * LANES)

/* Several numbers side by side, at any place; every processor does the same operations on each. */
typedef double Lanes __attribute__((vector_size(LANES * sizeof(double)), aligned(8), may_alias));
typedef int64_t Bits __attribute__((vector_size(LANES * sizeof(double)), aligned(8), may_alias));

#define LANES_AT(place) (*(Lanes *)(void *)(place))
#define CONST_LANES_AT(place) (*(const Lanes *)(const void *)(place))
#define SIGN INT64_MIN

/* Of each lane, without a function: vectors as arguments would depend on the processor. */
#define MAGNITUDES(lanes) ((Lanes)((Bits)(lanes) & ~SIGN))
#define SELECT(mask, one, other) ((Lanes)(((mask) & (Bits)(one)) | (~(mask) & (Bits)(other))))
#define LARGER(one, other) SELECT((one) > (other), one, other)
#define SMALLER(one, other) SELECT((one) < (other), one, other)

/* The sum of lanes, in an order that does not depend on the compiler. */
INLINED double sum_of(const Lanes *lanes)
{
    const Lanes l = *lanes;
    return ((l[0] + l[4]) + (l[2] + l[6])) + ((l[1] + l[5]) + (l[3] + l[7]));
}

/* Write the sums of products of an impulse response with two rows of drive. What lies behind the frames is
 * 0 in the response. */
INLINED void two_products(const double *response, const double *one, const double *other, size_t frames,
                          double *with_one, double *with_other)
{
    Lanes first = {0.0}, second = {0.0};
    for (size_t at = 0; at < frames; at += LANES) {
        const Lanes weights = CONST_LANES_AT(response + at);
        first += weights * CONST_LANES_AT(one + at);
        second += weights * CONST_LANES_AT(other + at);
    }
    *with_one = sum_of(&first);
    *with_other = sum_of(&second);
}

/* The sum of products of two rows or columns, whose lengths are multiples of LANES or which end in zeros. */
INLINED double product(const double *one, const double *other, size_t count)
{
    Lanes sums = {0.0};
    for (size_t at = 0; at < count; at += LANES)
        sums += CONST_LANES_AT(one + at) * CONST_LANES_AT(other + at);
    return sum_of(&sums);
}

enum { PARTS = 3 };

/* out = the matrix (rows, states), stored by columns, times the state of each of up to PARTS parts. */
INLINED void apply_to(size_t parts, const double *matrix, size_t rows, size_t states,
                      const double *const *state, double *const *out)
{
    for (size_t row = 0; row < rows; row += LANES) {
        Lanes sums[PARTS] = {{0.0}};
        for (size_t one = 0; one < states; one++) {
            const Lanes weights = CONST_LANES_AT(matrix + one * rows + row);
            for (size_t part = 0; part < parts; part++)
                sums[part] += weights * state[part][one];
        }
        for (size_t part = 0; part < parts; part++)
            LANES_AT(out[part] + row) = sums[part];
    }
}

INLINED void apply(const double *matrix, size_t rows, size_t states, const double *state, double *out)
{
    apply_to(1, matrix, rows, states, &state, &out);
}

/* out += factor * more */
INLINED void add(double *out, const double *more, double factor, size_t count)
{
    for (size_t at = 0; at < count; at += LANES)
        LANES_AT(out + at) += factor * CONST_LANES_AT(more + at);
}

/* The largest magnitude. */
INLINED double largest(const double *numbers, size_t count)
{
    Lanes most = {0.0};
    double found = 0.0;
    for (size_t at = 0; at < count; at += LANES) {
        const Lanes sizes = MAGNITUDES(CONST_LANES_AT(numbers + at));
        most = LARGER(sizes, most);
    }
    for (size_t lane = 0; lane < LANES; lane++)
        found = larger(most[lane], found);
    return found;
}

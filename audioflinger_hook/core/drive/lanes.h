/* Vector arithmetic with bit-identical results on every processor. */

#pragma once

#include "../../transform/native/common.h"

enum { LANES = 8 }; /* doubles in a vector */

/* `count` rounded up to a multiple of LANES. Rows and columns are padded with zeros to this length. */
#define WHOLE_LANES(count) (((count) + LANES - 1) / LANES * LANES)

/* Vectors of doubles and of the bit patterns of doubles, with the alignment of a single double. */
typedef double Lanes __attribute__((vector_size(LANES * sizeof(double)), aligned(8), may_alias));
typedef int64_t Bits __attribute__((vector_size(LANES * sizeof(double)), aligned(8), may_alias));

#define LANES_AT(place) (*(Lanes *)(void *)(place))
#define CONST_LANES_AT(place) (*(const Lanes *)(const void *)(place))
#define SIGN INT64_MIN

/* Element-wise operations. Macros avoid vector arguments, whose calling convention varies by processor. */
#define MAGNITUDES(lanes) ((Lanes)((Bits)(lanes) & ~SIGN))
#define SELECT(mask, one, other) ((Lanes)(((mask) & (Bits)(one)) | (~(mask) & (Bits)(other))))
#define LARGER(one, other) SELECT((one) > (other), one, other)
#define SMALLER(one, other) SELECT((one) < (other), one, other)

/* Return the sum of a vector's elements, added in a fixed order. */
INLINED double sum_of(const Lanes *lanes)
{
    const Lanes l = *lanes;
    return ((l[0] + l[4]) + (l[2] + l[6])) + ((l[1] + l[5]) + (l[3] + l[7]));
}

/* Write the inner product of an impulse response with each of two rows. The response must be 0 from `frames`
 * to the next multiple of LANES. */
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

/* Return the inner product of two rows. At least one must be 0 from `count` to the next multiple of LANES. */
INLINED double product(const double *one, const double *other, size_t count)
{
    Lanes sums = {0.0};
    for (size_t at = 0; at < count; at += LANES)
        sums += CONST_LANES_AT(one + at) * CONST_LANES_AT(other + at);
    return sum_of(&sums);
}

enum { PARTS = 3 };

/* Multiply a matrix (rows, states), stored column by column, by `parts` state vectors. rows: a multiple of
 * LANES. parts: at most PARTS. */
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

INLINED void add(double *out, const double *more, double factor, size_t count)
{
    for (size_t at = 0; at < count; at += LANES)
        LANES_AT(out + at) += factor * CONST_LANES_AT(more + at);
}

/* Return the largest magnitude of `count` numbers. count: a multiple of LANES. */
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

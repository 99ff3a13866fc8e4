/* Elementary functions that a loop over an array can hold: no calls, no branches.
 *
 * They are made of sums, products and bits alone, so they give the same bits on every machine.
 */

#ifndef CUSHION_FUNCTIONS_H
#define CUSHION_FUNCTIONS_H

#include "common.h"

/* 1.5 x 2^52: a number of up to 2^51 added to it is rounded to a whole one. */
#define TO_WHOLE 6755399441055744.0

/* 2^52: the whole number in its lowest bits is added to it. */
#define WHOLE_BITS UINT64_C(0x4330000000000000)
#define WHOLE 4503599627370496.0

INLINED uint64_t bits_of(double number)
{
    uint64_t bits;
    memcpy(&bits, &number, sizeof bits);
    return bits;
}

INLINED double of_bits(uint64_t bits)
{
    double number;
    memcpy(&number, &bits, sizeof number);
    return number;
}

/* A^(1/5) for A from 1e-300 to 1e300, within a unit in the last place; 0 for 0.
 *
 * The upper half of a number's bits is nearly its logarithm: a fifth of it, taken from a constant,
 * makes the inverse root within 3 %. The series of (1 - h)^(-1/5) takes the rest.
 */
INLINED double fifth_root(double a)
{
    const double logarithm = of_bits((bits_of(a) >> 32) | WHOLE_BITS) - WHOLE;
    const double guess = (1287170000.0 - 0.2 * logarithm) + WHOLE;
    double inverse = of_bits(bits_of(guess) << 32);
    double square = inverse * inverse, fourth = square * square;
    double rest = 1.0 - a * inverse * fourth;
    inverse *= 1.0 + rest * (0.2 + rest * (0.12 + rest * (0.088 + rest * 0.0704)));
    square = inverse * inverse, fourth = square * square;
    rest = 1.0 - a * inverse * fourth;
    inverse *= 1.0 + rest * (0.2 + rest * 0.12);
    square = inverse * inverse, fourth = square * square;
    const double root = a * fourth;
    const double root_square = root * root;
    return root + (a - root_square * root_square * root) * (0.2 * fourth);
}

/* The cosine of so many turns, up to 2^51 of them, within 5e-16. */
INLINED double cosine_of_turns(double turns)
{
    const double within = fabs(turns - ((turns + TO_WHOLE) - TO_WHOLE));
    /* A quarter of a turn on it is a sine, of a quarter of a turn at most. */
    const double x = (2.0 * PI) * (0.25 - within), y = x * x;
    /* Taylor's series; the next term is under 3e-16. */
    return x * (1.0 +
                y * (-1.0 / 6.0 +
                     y * (1.0 / 120.0 +
                          y * (-1.0 / 5040.0 +
                               y * (1.0 / 362880.0 +
                                    y * (-1.0 / 39916800.0 +
                                         y * (1.0 / 6227020800.0 +
                                              y * (-1.0 / 1307674368000.0 +
                                                   y * (1.0 / 355687428096000.0 +
                                                        y * (-1.0 / 121645100408832000.0))))))))));
}

#endif

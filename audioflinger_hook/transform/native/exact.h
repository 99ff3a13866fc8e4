/* Elementary functions of sums, products, quotients and bits alone, in place of libm's.
 *
 * They give the same bits with every compiler (without contraction), C library and processor.
 * Errors are in units in the last place of the result, measured by tests/transform/test_exact.py.
 */

#pragma once

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

#define LOG2_E 1.44269504088896338700
#define LOG10_E 0.43429448190325182765

/* log 2 as a sum: the upper part has 20 zero bits at its end, so that k times it is exact. */
#define LN2_UPPER 6.93147180369123816490e-01
#define LN2_LOWER 1.90821492927058770002e-10

/* exp(r) - 1 for |r| up to half of log 2: Taylor's series up to r^13. */
INLINED double exact_series(double r)
{
    const double r2 = r * r, r4 = r2 * r2;
    const double low = (1.0 / 2.0 + r * (1.0 / 6.0)) + r2 * (1.0 / 24.0 + r * (1.0 / 120.0));
    const double middle =
        (1.0 / 720.0 + r * (1.0 / 5040.0)) + r2 * (1.0 / 40320.0 + r * (1.0 / 362880.0));
    const double high = (1.0 / 3628800.0 + r * (1.0 / 39916800.0)) +
                        r2 * (1.0 / 479001600.0 + r * (1.0 / 6227020800.0));
    return r + r2 * (low + r4 * (middle + r4 * high));
}

/* exp(x), within 1 unit; 0 below -708, where results would be denormal; infinity above 709. */
static inline double exact_exp(double x)
{
    if (!(x > -708.0))
        return x != x ? x : 0.0;
    if (x > 709.0)
        return INFINITY;
    const double k = (x * LOG2_E + TO_WHOLE) - TO_WHOLE;
    const double r = (x - k * LN2_UPPER) - k * LN2_LOWER;
    return (1.0 + exact_series(r)) * of_bits((uint64_t)((int64_t)k + 1023) << 52);
}

/* log(x), within 1 unit, for normal x above 0; minus infinity for 0, NaN below. */
static inline double exact_log(double x)
{
    if (!(x > 0.0) || !(x < INFINITY))
        return x == 0.0 ? -INFINITY : x > 0.0 ? x : NAN;
    const uint64_t least = UINT64_C(0x3fe6a09e667f3bcd); /* 1/sqrt(2): x = m 2^e, m from there on */
    const uint64_t bits = bits_of(x) - least;
    const double e = (double)((int64_t)bits >> 52);
    const double m = of_bits((bits & UINT64_C(0xfffffffffffff)) + least);
    /* log m = 2 artanh s = f - f²/2 + s (f²/2 + rest), exact near 1. */
    const double f = m - 1.0, s = f / (2.0 + f), z = s * s, half = 0.5 * f * f;
    double sum = 1.0 / 23.0;
    for (int odd = 21; odd >= 3; odd -= 2)
        sum = sum * z + 1.0 / odd;
    const double rest = s * (half + 2.0 * z * sum);
    return e * LN2_UPPER - ((half - (rest + e * LN2_LOWER)) - f);
}

static inline double exact_log2(double x) { return exact_log(x) * LOG2_E; }

static inline double exact_log10(double x) { return exact_log(x) * LOG10_E; }

/* x^y for x from 0 on, within 1 + |y log x| units. */
static inline double exact_pow(double x, double y)
{
    return y == 0.0 ? 1.0 : x == 0.0 ? (y > 0.0 ? 0.0 : INFINITY) : exact_exp(y * exact_log(x));
}

/* 10^(decibels/20). */
static inline double exact_amplitude(double decibels)
{
    return exact_exp(decibels * (2.30258509299404568402 / 20.0));
}

/* tanh(x), within 3 units. */
static inline double exact_tanh(double x)
{
    const double twice = 2.0 * fabs(x);
    /* exp(2 |x|) - 1; where that is small, the difference would lose its last bits. */
    const double grown = twice < 0.34 ? exact_series(twice) : exact_exp(twice) - 1.0;
    return copysign(grown < 1.0 ? grown / (grown + 2.0) : 1.0 - 2.0 / (grown + 2.0), x);
}

/* The sum of coefficients[k] y^(count - 1 - k). */
INLINED double exact_polynomial(double y, const double *coefficients, int count)
{
    double sum = coefficients[0];
    for (int one = 1; one < count; one++)
        sum = sum * y + coefficients[one];
    return sum;
}

/* sin(x), within 1 unit, for |x| up to pi/4. */
static inline double exact_sin(double x)
{
    static const double SERIES[] = {1.0 / 355687428096000.0, -1.0 / 1307674368000.0, 1.0 / 6227020800.0,
                                    -1.0 / 39916800.0,       1.0 / 362880.0,         -1.0 / 5040.0,
                                    1.0 / 120.0,             -1.0 / 6.0};
    const double y = x * x;
    return x + x * y * exact_polynomial(y, SERIES, 8);
}

/* cos(x), within 1 unit, for |x| up to pi/4. */
static inline double exact_cos(double x)
{
    static const double SERIES[] = {1.0 / 20922789888000.0, -1.0 / 87178291200.0, 1.0 / 479001600.0,
                                    -1.0 / 3628800.0,       1.0 / 40320.0,        -1.0 / 720.0,
                                    1.0 / 24.0,             -1.0 / 2.0};
    const double y = x * x;
    return 1.0 + y * exact_polynomial(y, SERIES, 8);
}

/* Elementary functions with bit-identical results for every compiler, C library and processor. They use
 * basic arithmetic and bit operations, without fused multiply-add. An ulp is a unit in the result's last place.
 * tests/transform/test_exact.py measures errors. */

#pragma once

#include "common.h"

/* 1.5 x 2^52. Adding and then subtracting it rounds a number of magnitude up to 2^51 to an integer. */
#define TO_WHOLE 6755399441055744.0

/* The bits of WHOLE, which is 2^52. With an integer k in the lowest 52 bits, they represent 2^52 + k. */
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

/* A^(1/5) for A from 1e-300 to 1e300, within 1 ulp; 0 for 0. The upper 32 bits of A approximate its
 * logarithm, which gives A^(-1/5) within 4 %. Two steps with the series of (1 - h)^(-1/5) refine A^(-1/5),
 * and a Newton step refines A^(1/5). */
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

/* Return the sum of coefficients[k] y^(count - 1 - k) over k from 0 to count - 1. */
INLINED double exact_polynomial(double y, const double *coefficients, int count)
{
    double sum = coefficients[0];
    for (int one = 1; one < count; one++)
        sum = sum * y + coefficients[one];
    return sum;
}

/* cos(2 pi turns) for |turns| up to 2^51, with an absolute error below 5e-16. */
INLINED double cosine_of_turns(double turns)
{
    /* Taylor series of the sine for arguments up to pi/2. The first omitted term is under 3e-16. */
    static const double SERIES[] = {-1.0 / 121645100408832000.0, 1.0 / 355687428096000.0,
                                    -1.0 / 1307674368000.0,      1.0 / 6227020800.0,
                                    -1.0 / 39916800.0,           1.0 / 362880.0,
                                    -1.0 / 5040.0,               1.0 / 120.0,
                                    -1.0 / 6.0,                  1.0};
    const double within = fabs(turns - ((turns + TO_WHOLE) - TO_WHOLE));
    const double x = (2.0 * PI) * (0.25 - within);
    return x * exact_polynomial(x * x, SERIES, 10);
}

#define LOG2_E 1.44269504088896338700
#define LOG10_E 0.43429448190325182765

/* ln 2 as a sum. The upper part ends in 21 zero bits, so its product with an exponent is exact. */
#define LN2_UPPER 6.93147180369123816490e-01
#define LN2_LOWER 1.90821492927058770002e-10

/* exp(r) - 1 for |r| up to (ln 2) / 2: Taylor series up to r^13. */
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

/* exp(x) within 1 ulp; 0 for x <= -708, which avoids denormal results; infinity for x > 709. */
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

/* ln(x) within 1 ulp for normal x > 0. Compilers can vectorise loops that call it. */
INLINED double log_of_normal(double x)
{
    const uint64_t least = UINT64_C(0x3fe6a09e667f3bcd); /* bits of 1/sqrt(2), the least m in x = m 2^e */
    const uint64_t bits = bits_of(x) - least;
    const double e = of_bits((bits + (UINT64_C(1024) << 52)) >> 52 | WHOLE_BITS) - (WHOLE + 1024.0);
    const double m = of_bits((bits & UINT64_C(0xfffffffffffff)) + least);
    /* ln m = 2 artanh(s) = f - f²/2 + rest. Near m = 1, f is exact and the other terms are small. */
    const double f = m - 1.0, s = f / (2.0 + f), z = s * s, half = 0.5 * f * f;
    double sum = 1.0 / 23.0;
    for (int odd = 21; odd >= 3; odd -= 2)
        sum = sum * z + 1.0 / odd;
    const double rest = s * (half + 2.0 * z * sum);
    return e * LN2_UPPER - ((half - (rest + e * LN2_LOWER)) - f);
}

/* ln(x) within 1 ulp for normal x > 0; -infinity for 0, NaN for negative x and for NaN. */
static inline double exact_log(double x)
{
    if (!(x > 0.0) || !(x < INFINITY))
        return x == 0.0 ? -INFINITY : x > 0.0 ? x : NAN;
    return log_of_normal(x);
}

static inline double exact_log2(double x) { return exact_log(x) * LOG2_E; }

static inline double exact_log10(double x) { return exact_log(x) * LOG10_E; }

/* x^y for x >= 0, within 1 + 3 |y ln x| ulp; 0 where y ln x <= -708, infinity where y ln x > 709. */
static inline double exact_pow(double x, double y)
{
    return y == 0.0 ? 1.0 : x == 0.0 ? (y > 0.0 ? 0.0 : INFINITY) : exact_exp(y * exact_log(x));
}

/* Return 10^(decibels/20). */
static inline double exact_amplitude(double decibels)
{
    return exact_exp(decibels * (2.30258509299404568402 / 20.0));
}

/* tanh(x) within 4 ulp. */
static inline double exact_tanh(double x)
{
    const double twice = 2.0 * fabs(x);
    /* exp(2 |x|) - 1. For small |x| the series avoids cancellation. */
    const double grown = twice < 0.34 ? exact_series(twice) : exact_exp(twice) - 1.0;
    return copysign(grown < 1.0 ? grown / (grown + 2.0) : 1.0 - 2.0 / (grown + 2.0), x);
}

/* sin(x) within 1 ulp for |x| up to pi/4. */
static inline double exact_sin(double x)
{
    static const double SERIES[] = {1.0 / 355687428096000.0, -1.0 / 1307674368000.0, 1.0 / 6227020800.0,
                                    -1.0 / 39916800.0,       1.0 / 362880.0,         -1.0 / 5040.0,
                                    1.0 / 120.0,             -1.0 / 6.0};
    const double y = x * x;
    return x + x * y * exact_polynomial(y, SERIES, 8);
}

/* cos(x) within 1.5 ulp for |x| up to pi/4. */
static inline double exact_cos(double x)
{
    static const double SERIES[] = {1.0 / 20922789888000.0, -1.0 / 87178291200.0, 1.0 / 479001600.0,
                                    -1.0 / 3628800.0,       1.0 / 40320.0,        -1.0 / 720.0,
                                    1.0 / 24.0,             -1.0 / 2.0};
    const double y = x * x;
    return 1.0 + y * exact_polynomial(y, SERIES, 8);
}

/* FFT of real samples in double precision, for lengths that are products of 2, 3 and 5.
 *
 * - At an even length, pairs of samples form complex numbers, so the complex FFT has half the length.
 * - With zero padding, a decimation-in-frequency step splits the FFT into two lanes, for even and odd bins.
 *   The step multiplies each number of the odd-bin lane by one twiddle factor.
 * - Each lane is a four-step FFT: column FFTs, twiddle factors, transpose, row FFTs. */

#include "fft.h"

/* --------------------------------------------------------------------------------------- stages */

/* Store output `which` of a butterfly. If `turned`, multiply it by its twiddle factor, cosine - i sine. */
#define TURNED(out, which, re, im)                                                                 \
    do {                                                                                           \
        const double one_re = (re), one_im = (im);                                                 \
        if (turned) {                                                                              \
            const double c = twiddle[2 * (which) - 2], s = twiddle[2 * (which) - 1];                     \
            out_re[(which) * (out) + at] = one_re * c + one_im * s;                                \
            out_im[(which) * (out) + at] = one_im * c - one_re * s;                                \
        } else {                                                                                   \
            out_re[(which) * (out) + at] = one_re;                                                 \
            out_im[(which) * (out) + at] = one_im;                                                 \
        }                                                                                          \
    } while (0)

/* Strides of a butterfly's inputs and outputs, and the number of interleaved FFTs. */
typedef struct {
    size_t in, out, run;
} Places;

INLINED void by_two(const double *restrict re, const double *restrict im, double *restrict out_re,
                    double *restrict out_im, Places places, const double *twiddle, int turned)
{
    const size_t in = places.in;
    NO_ALIAS
    for (size_t at = 0; at < places.run; at++) {
        const double a_re = re[at], a_im = im[at], b_re = re[in + at], b_im = im[in + at];
        out_re[at] = a_re + b_re;
        out_im[at] = a_im + b_im;
        TURNED(places.out, 1, a_re - b_re, a_im - b_im);
    }
}

INLINED void by_three(const double *restrict re, const double *restrict im, double *restrict out_re,
                      double *restrict out_im, Places places, const double *twiddle, int turned)
{
    static const double SIN = 0.86602540378443864676;
    const size_t in = places.in;
    NO_ALIAS
    for (size_t at = 0; at < places.run; at++) {
        const double sum_re = re[in + at] + re[2 * in + at], sum_im = im[in + at] + im[2 * in + at];
        const double dif_re = SIN * (re[in + at] - re[2 * in + at]);
        const double dif_im = SIN * (im[in + at] - im[2 * in + at]);
        const double mid_re = re[at] - 0.5 * sum_re, mid_im = im[at] - 0.5 * sum_im;
        out_re[at] = re[at] + sum_re;
        out_im[at] = im[at] + sum_im;
        TURNED(places.out, 1, mid_re + dif_im, mid_im - dif_re);
        TURNED(places.out, 2, mid_re - dif_im, mid_im + dif_re);
    }
}

INLINED void by_four(const double *restrict re, const double *restrict im, double *restrict out_re,
                     double *restrict out_im, Places places, const double *twiddle, int turned)
{
    const size_t in = places.in;
    NO_ALIAS
    for (size_t at = 0; at < places.run; at++) {
        const double even_re = re[at] + re[2 * in + at], even_im = im[at] + im[2 * in + at];
        const double odd_re = re[at] - re[2 * in + at], odd_im = im[at] - im[2 * in + at];
        const double sum_re = re[in + at] + re[3 * in + at], sum_im = im[in + at] + im[3 * in + at];
        const double dif_re = re[in + at] - re[3 * in + at], dif_im = im[in + at] - im[3 * in + at];
        out_re[at] = even_re + sum_re;
        out_im[at] = even_im + sum_im;
        TURNED(places.out, 1, odd_re + dif_im, odd_im - dif_re);
        TURNED(places.out, 2, even_re - sum_re, even_im - sum_im);
        TURNED(places.out, 3, odd_re - dif_im, odd_im + dif_re);
    }
}

INLINED void by_five(const double *restrict re, const double *restrict im, double *restrict out_re,
                     double *restrict out_im, Places places, const double *twiddle, int turned)
{
    static const double C1 = 0.30901699437494742410, S1 = 0.95105651629515357212;
    static const double C2 = -0.80901699437494742410, S2 = 0.58778525229247312917;
    const size_t in = places.in;
    NO_ALIAS
    for (size_t at = 0; at < places.run; at++) {
        const double r0 = re[at], i0 = im[at];
        const double sr1 = re[in + at] + re[4 * in + at], si1 = im[in + at] + im[4 * in + at];
        const double dr1 = re[in + at] - re[4 * in + at], di1 = im[in + at] - im[4 * in + at];
        const double sr2 = re[2 * in + at] + re[3 * in + at];
        const double si2 = im[2 * in + at] + im[3 * in + at];
        const double dr2 = re[2 * in + at] - re[3 * in + at];
        const double di2 = im[2 * in + at] - im[3 * in + at];
        const double mr1 = r0 + C1 * sr1 + C2 * sr2, mi1 = i0 + C1 * si1 + C2 * si2;
        const double mr2 = r0 + C2 * sr1 + C1 * sr2, mi2 = i0 + C2 * si1 + C1 * si2;
        const double ar = S1 * dr1 + S2 * dr2, ai = S1 * di1 + S2 * di2;
        const double br = S2 * dr1 - S1 * dr2, bi = S2 * di1 - S1 * di2;
        out_re[at] = r0 + sr1 + sr2;
        out_im[at] = i0 + si1 + si2;
        TURNED(places.out, 1, mr1 + ai, mi1 - ar);
        TURNED(places.out, 2, mr2 + bi, mi2 - br);
        TURNED(places.out, 3, mr2 - bi, mi2 + br);
        TURNED(places.out, 4, mr1 - ai, mi1 + ar);
    }
}

INLINED void butterfly(size_t factor, const double *re, const double *im, double *out_re,
                       double *out_im, Places places, const double *twiddle, int turned)
{
    switch (factor) {
    case 2: by_two(re, im, out_re, out_im, places, twiddle, turned); break;
    case 3: by_three(re, im, out_re, out_im, places, twiddle, turned); break;
    case 4: by_four(re, im, out_re, out_im, places, twiddle, turned); break;
    default: by_five(re, im, out_re, out_im, places, twiddle, turned); break;
    }
}

typedef struct {
    double *re, *im;
} Complexes;

/* Run one stage of radix `factor`; `from` becomes the result. Return the next stage's twiddle factors. */
INLINED const double *pass_once(size_t factor, size_t size, size_t run, const double *twiddle,
                                Complexes *from, Complexes *to)
{
    const size_t rest = size / factor;
    const Places places = {rest * run, run, run};
    butterfly(factor, from->re, from->im, to->re, to->im, places, twiddle, 0);
    twiddle += 2 * (factor - 1);
    for (size_t place = 1; place < rest; place++, twiddle += 2 * (factor - 1))
        butterfly(factor, from->re + run * place, from->im + run * place,
                  to->re + run * factor * place, to->im + run * factor * place, places, twiddle, 1);
    const Complexes done = *to;
    *to = *from;
    *from = done;
    return twiddle;
}

/* Run all stages of a Stockham FFT, whose output is in natural order. `from` becomes the result. */
SIMD_CLONES static void pass_through(const FftStages *stages, Complexes *from, Complexes *to)
{
    const double *twiddle = stages->twiddles;
    size_t size = stages->size, run = stages->run;
    for (size_t which = 0; which < stages->count; which++) {
        const size_t factor = stages->factors[which];
        twiddle = pass_once(factor, size, run, twiddle, from, to);
        size /= factor;
        run *= factor;
    }
}

/* Multiply `lanes` interleaved grids by twiddle factors and transpose them. */
INLINED void exchanged(size_t lanes, const double *twiddle, size_t rows, size_t columns, Complexes from,
                       Complexes to)
{
    for (size_t column = 0; column < columns; column++, twiddle += 2 * rows) {
        const double *restrict re = from.re + lanes * column, *restrict im = from.im + lanes * column;
        double *restrict to_re = to.re + lanes * column * rows;
        double *restrict to_im = to.im + lanes * column * rows;
        NO_ALIAS
        for (size_t row = 0; row < rows; row++) {
            const double c = twiddle[2 * row], s = twiddle[2 * row + 1];
            for (size_t lane = 0; lane < lanes; lane++) {
                const double x = re[lanes * row * columns + lane], y = im[lanes * row * columns + lane];
                to_re[lanes * row + lane] = x * c + y * s;
                to_im[lanes * row + lane] = y * c - x * s;
            }
        }
    }
}

SIMD_CLONES static void exchange(const Fft *fft, Complexes from, Complexes to)
{
    if (fft->lanes == 2)
        exchanged(2, fft->grid_turn, fft->columns.size, fft->rows.size, from, to);
    else
        exchanged(1, fft->grid_turn, fft->columns.size, fft->rows.size, from, to);
}

/* Run the FFT of 120 complex numbers, which the onset window needs at 44.1 and 48 kHz; `to` is the result.
 * Constant lengths make these loops faster. */
SIMD_CLONES_NARROW static void transform_120(const Fft *fft, Complexes *from, Complexes *to)
{
    const double *twiddle = pass_once(3, 12, 10, fft->columns.twiddles, from, to);
    pass_once(4, 4, 30, twiddle, from, to);
    exchanged(1, fft->grid_turn, 12, 10, *from, *to);
    twiddle = pass_once(5, 10, 12, fft->rows.twiddles, to, from);
    pass_once(2, 2, 60, twiddle, to, from);
}

/* ------------------------------------------------------------------------------ real to complex */

/* Pack samples into complex numbers. With two lanes, multiply the odd-bin lane by twiddle factors. */
SIMD_CLONES static void pair_samples(const Fft *fft, const double *restrict samples, Complexes to)
{
    double *restrict re = to.re, *restrict im = to.im;
    if (fft->lanes == 1) {
        for (size_t at = 0; at < fft->points; at++) {
            re[at] = fft->halved ? samples[2 * at] : samples[at];
            im[at] = fft->halved ? samples[2 * at + 1] : 0.0;
        }
        return;
    }
    const double *restrict twiddle = fft->lane_turn;
    NO_ALIAS
    for (size_t at = 0; at < fft->points; at++) {
        const double x = samples[2 * at], y = samples[2 * at + 1];
        const double c = twiddle[2 * at], s = twiddle[2 * at + 1];
        re[2 * at] = x;
        re[2 * at + 1] = x * c + y * s;
        im[2 * at] = y;
        im[2 * at + 1] = y * c - x * s;
    }
}

/* Separate the spectra of even and odd samples, and combine them into the spectrum of all samples. */
SIMD_CLONES static void join_halves(const Fft *fft, Complexes from, size_t bins, double *restrict real,
                        double *restrict imaginary)
{
    const size_t half = fft->halved;
    const double *restrict re = from.re, *restrict im = from.im;
    const double *restrict bin_cos = fft->bin_cos, *restrict bin_sin = fft->bin_sin;
    real[0] = re[0] + im[0];
    imaginary[0] = 0.0;
    const size_t inner = bins < half ? bins : half;
    for (size_t bin = 1; bin < inner; bin++) {
        const double a_re = re[bin], a_im = im[bin], b_re = re[half - bin], b_im = im[half - bin];
        const double c = bin_cos[bin], s = bin_sin[bin];
        const double dif_re = a_re - b_re, sum_im = a_im + b_im;
        real[bin] = 0.5 * (a_re + b_re + c * sum_im - s * dif_re);
        imaginary[bin] = 0.5 * (a_im - b_im - c * dif_re - s * sum_im);
    }
    if (bins > half) {
        real[half] = re[0] - im[0];
        imaginary[half] = 0.0;
    }
}

void fft_spectrum(const Fft *fft, const double *samples, size_t bins, double *real,
                  double *imaginary, double *work)
{
    const size_t size = fft->points * fft->lanes + FREE;
    Complexes one = {work, work + size}, other = {work + 2 * size, work + 3 * size};
    pair_samples(fft, samples, one);
    if (fft->points == 120 && fft->lanes == 1) {
        transform_120(fft, &one, &other);
    } else {
        pass_through(&fft->columns, &one, &other);
        exchange(fft, one, other);
        pass_through(&fft->rows, &other, &one);
    }
    if (fft->halved) {
        join_halves(fft, other, bins, real, imaginary);
    } else {
        memcpy(real, other.re, bins * sizeof(double));
        memcpy(imaginary, other.im, bins * sizeof(double));
    }
}

SIMD_CLONES void apply_window(const double *restrict samples, const double *restrict window,
                              size_t count, double *restrict out)
{
    for (size_t one = 0; one < count; one++)
        out[one] = samples[one] * window[one];
}

/* Single functions of the transform's C code for tests, which compare the results with those of other
 * programs. kernel_probes.py compiles and calls them. */

#include <stdlib.h>

#include "analysis.h"
#include "exact.h"
#include "fft.h"

/* Split `bins` complex numbers of a spectrum into real and imaginary parts. */
static void split(const Settings *settings, const double *spectrum, double *real, double *imaginary)
{
    for (size_t bin = 0; bin < settings->bins; bin++) {
        real[bin] = spectrum[2 * bin];
        imaginary[bin] = spectrum[2 * bin + 1];
    }
}

/* Find the principal frequencies of `rows` spectra; return their total number. limits: threshold_hz,
 * peak_span_min, weakest_image, side_lobe. pitch: length of each of the four rows of `numbers`. */
int64_t find(const double *spectra, size_t rows, size_t columns, double *table,
             size_t table_length, double *turn, size_t turns, double first_sample, size_t bins,
             size_t first, size_t last, double bin_hz, const double *limits, size_t most,
             int64_t *row_of, double *numbers, size_t pitch)
{
    const Settings settings = {
        .bins = bins,
        .first_bin = first,
        .last_bin = last,
        .bin_hz = bin_hz,
        .threshold_hz = limits[0],
        .peak_span_min = limits[1],
        .weakest_image = limits[2],
        .side_lobe = limits[3],
        .partials_max = most < bins ? most : bins,
        .image_table = {table, table_length},
        .image_turn = {turn, 2 * turns},
        .image_first = first_sample,
    };
    double *real = malloc(2 * bins * sizeof *real);
    void *work = malloc(analysis_work(bins));
    int64_t total = 0;
    for (size_t row = 0; row < rows; row++) {
        split(&settings, spectra + 2 * columns * row, real, real + bins);
        double *to = numbers + total;
        const Principals found = {to, to + pitch, to + 2 * pitch, to + 3 * pitch};
        int32_t count = find_principal(&settings, (Spectrum){real, real + bins}, found, work);
        while (count-- > 0)
            row_of[total++] = (int64_t)row;
    }
    free(work);
    free(real);
    return total;
}

/* Compute a spectrum. Return 0 if `length` has prime factors other than 2, 3 and 5. */
int spectrum(const double *samples, size_t frames, size_t length, double *bins, size_t count)
{
    Fft fft = {0};
    Arena arena = {NULL, 0};
    if (!fft_open(&fft, length, frames <= length / 2, &arena))
        return 0;
    arena = (Arena){malloc(arena.used), 0};
    fft_open(&fft, length, frames <= length / 2, &arena);
    double *work = calloc(fft_work(&fft) + fft.frames, sizeof *work);
    memcpy(work, samples, frames * sizeof *samples);
    fft_spectrum(&fft, work, count, bins, bins + count, work + fft.frames);
    free(work);
    free(arena.base);
    return 1;
}

#define EACH(name, value)                                                                          \
    void each_##name(double *numbers, size_t count)                                                \
    {                                                                                              \
        for (size_t one = 0; one < count; one++) {                                                 \
            const double x = numbers[one];                                                         \
            numbers[one] = value;                                                                  \
        }                                                                                          \
    }

SIMD_CLONES EACH(fifth_roots, fifth_root(x))
SIMD_CLONES EACH(cosines, cosine_of_turns(x))
EACH(exact_exp, exact_exp(x))
EACH(exact_log, exact_log(x))
EACH(exact_log2, exact_log2(x))
EACH(exact_log10, exact_log10(x))
EACH(exact_amplitude, exact_amplitude(x))
EACH(exact_tanh, exact_tanh(x))
EACH(exact_sin, exact_sin(x))
EACH(exact_cos, exact_cos(x))
EACH(power_035, exact_pow(x, 0.35))

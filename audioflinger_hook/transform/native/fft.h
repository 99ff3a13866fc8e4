/* FFT of real samples. The second half of the input may be zero padding. */

#pragma once

#include "common.h"

#define FACTORS_MAX 24

/* Gap between the arrays of the work space, in doubles. It reduces cache conflicts. */
#define FREE 72

/* `run` interleaved FFTs of `size` complex numbers each. */
typedef struct {
    size_t size, run;
    size_t factors[FACTORS_MAX], count;
    const double *twiddles; /* twiddle factors of all stages, each a cosine and a sine */
} FftStages;

/* Plan for spectra of one length. */
typedef struct {
    size_t length; /* FFT length; bins are samplerate / length apart */
    size_t frames; /* number of samples that fft_spectrum reads; callers pad shorter windows with zeros */
    size_t points; /* number of complex numbers in each lane */
    size_t lanes;  /* parallel FFTs: 2 (even and odd bins) if padded and length is a multiple of 4, else 1 */
    size_t halved; /* length / 2 if length is even (pairs of samples form complex numbers), else 0 */
    FftStages columns, rows;
    const double *lane_turn; /* twiddle factors of the odd-bin lane, each a cosine and a sine */
    const double *grid_turn; /* twiddle factors between columns and rows, each a cosine and a sine */
    const double *bin_cos;   /* twiddle factors by bin; they combine the spectra of even and odd samples */
    const double *bin_sin;
} Fft;

/* Create a plan and its tables; if arena->base is NULL, only count their bytes. Return 0 if length is 0 or
 * has a prime factor above 5. padded: 1 if the second half of the samples is 0. */
int fft_open(Fft *fft, size_t length, int padded, Arena *arena);

/* Return the size of the work space of `fft_spectrum`, in doubles. */
INLINED size_t fft_work(const Fft *fft) { return 4 * (fft->points * fft->lanes + FREE); }

/* Write the first `bins` bins of a spectrum; bins: at most length / 2 + 1. samples: `fft->frames` numbers.
 * work: `fft_work` numbers. */
void fft_spectrum(const Fft *fft, const double *samples, size_t bins, double *real,
                  double *imaginary, double *work);

void apply_window(const double *samples, const double *window, size_t count, double *out);

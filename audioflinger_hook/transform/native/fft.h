/* The spectrum of a window of real samples, which may be padded with as many zeros or more. */

#pragma once

#include "common.h"

#define FACTORS_MAX 24

/* Doubles that are left free between the parts of the work space. Of lengths that are powers of 2 all
 * parts would else share the same lines of the cache. */
#define FREE 72

/* A transform of `size` complex numbers that stand `run` apart, for `run` of them side by side. */
typedef struct {
    size_t size, run;
    size_t factors[FACTORS_MAX], count;
    const double *twiddles; /* for each factor what its outputs are turned by, cosine and sine */
} FftStages;

/* How spectra of one length are made. Its tables lie in the arena. */
typedef struct {
    size_t length; /* of the spectrum's grid: bins are samplerate / length apart */
    size_t frames; /* samples that are read; those past the window are 0 */
    size_t points; /* complex numbers in one small transform */
    size_t lanes;  /* small transforms side by side */
    size_t halved; /* complex numbers that hold the samples in pairs; 0 where they are not paired */
    FftStages columns, rows;
    const double *lane_turn; /* of each number on its way to the odd bins; cosine and sine */
    const double *grid_turn; /* of each number between columns and rows */
    const double *bin_cos;   /* of each bin, by which the odd samples' spectrum is turned */
    const double *bin_sin;
} Fft;

/* Make a plan, with tables in the arena; without memory, only count it. Return 0 if the length has
 * other factors than 2, 3 and 5. */
int fft_open(Fft *fft, size_t length, int padded, Arena *arena);

/* Doubles of work space that `fft_spectrum` needs. */
INLINED size_t fft_work(const Fft *fft) { return 4 * (fft->points * fft->lanes + FREE); }

/* Write the first `bins` bins, real and imaginary parts. samples: `frames` of them, no more than
 * length / 2 other than 0 where it was said to be padded. bins: length / 2 + 1 at most. */
void fft_spectrum(const Fft *fft, const double *samples, size_t bins, double *real,
                  double *imaginary, double *work);

/* Write `count` samples times those of a window. */
void apply_window(const double *samples, const double *window, size_t count, double *out);

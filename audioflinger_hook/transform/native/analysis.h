/* Finds principal frequencies: spectral peaks whose amplitude times bandwidth exceeds a threshold. */

#pragma once

#include "settings.h"

typedef struct {
    const double *real, *imaginary;
} Spectrum;

/* Principal frequencies as parallel arrays, ascending in frequency. r: amplitude times bandwidth, in Hz. */
typedef struct {
    double *audio_hz, *amplitude, *bandwidth_hz, *r;
} Principals;

/* Return the size of the work space of `find_principal`, in bytes. */
size_t analysis_work(size_t bins);

/* Find the principal frequencies; return their number, at most partials_max. work: `analysis_work` bytes,
 * 16-byte aligned. */
int32_t find_principal(const Settings *s, Spectrum spectrum, Principals found, void *work);

/* Amplitudes beside a peak are raised to at least this share of the peak's amplitude or of its half-power
 * amplitude. At zeros of the spectrum, A^0.2 and ln A would magnify rounding errors. */
#define FLOOR 1e-6

/* The two adjacent bins that bracket half power on one side of each peak, as parallel arrays. */
typedef struct {
    double *near, *far;    /* offsets of both bins from the interpolated peak, in bins */
    double *above, *under; /* amplitudes of both bins, clamped so that above >= level >= under */
} Side;

/* Peaks as parallel arrays, ascending in frequency. */
typedef struct {
    int32_t count;
    int32_t *left, *bin, *right;  /* bins of the minimum below, the peak, the minimum above */
    double *before, *top, *after; /* amplitudes of the bin below, the peak's bin, the bin above */
    double *offset, *height;      /* interpolated peak: offset from the peak's bin, in bins; amplitude */
    double *level;                /* amplitude at half power */
    Side down, up;
    double *bandwidth_hz, *r;
} Peaks;

void peaks_amplitudes(Spectrum spectrum, double *amplitude, int32_t bins);

/* Around each strong peak at a low frequency, subtract the leakage of the peak's mirror image, which lies at
 * the negative frequency. peaks: work space. */
void peaks_clear_images(const Settings *s, Spectrum spectrum, double *amplitude, Peaks *peaks);

/* Set count, left, bin, right of all peaks that may be principal. turns: work space of bins + 1 numbers. */
void peaks_list(const Settings *s, const double *amplitude, int32_t *turns, Peaks *peaks);

/* Interpolate all peaks: set before, top, after, offset, height and level. */
void peaks_refine(const double *amplitude, Peaks *peaks);

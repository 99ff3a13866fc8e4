/* The live form's analysis of one window: its spectrum in, principal frequencies out. */

#ifndef CUSHION_ANALYSIS_H
#define CUSHION_ANALYSIS_H

#include <stddef.h>
#include <stdint.h>

/* Bins to either side of a peak that are cleared of its image: its main lobe, and the half-power
 * walk on it. */
#define NEIGHBOURS 7

/* Peaks under this bin are cleared twice: the first time their images are looked up in a place that
 * those very images have moved. */
#define TWICE_BELOW 20

/* Entries of the window's table a bin: between them a straight line is within 0.2 % of a side
 * lobe. */
#define TABLE_BINS_A_BIN 32

/* The window's own spectrum, by which images are known. */
typedef struct {
    const double *table; /* real, 1 at 0, TABLE_BINS_A_BIN entries a bin; without the first sample, */
    double first_sample; /* which is this share of the others' sum */
    int32_t entries;
    const double *cosine, *sine; /* of the turn of a bin's phase to the window's centre */
    int32_t low_bins;            /* peaks under this bin are cleared */
    double weakest;              /* peaks up to this amplitude are left alone, */
    double weakest_share;        /* and those up to this share of the highest */
} Window;

/* What makes a peak principal, and which of them are kept. */
typedef struct {
    int32_t bins, first, last; /* bins looked at; the first and last on which a peak counts */
    double bin_hz, threshold_hz;
    double peak_span_min; /* amplitude times bins between valleys from which r can pass */
    double side_lobe;     /* share of the highest amplitude that the others must exceed */
    int32_t most;         /* of more than these the ones with the largest r stay */
} PeakCriteria;

/* Bins, real and imaginary parts, each `step` after the last. */
typedef struct {
    const double *real, *imaginary;
    int32_t step;
} Spectrum;

/* Principal frequencies, parallel arrays ascending in frequency. */
typedef struct {
    double *audio_hz, *amplitude, *bandwidth_hz, *r;
} Principals;

/* Bytes of work space for so many bins. */
size_t analysis_work(size_t bins);

/* Find what is principal in a spectrum; return how many, at most `criteria->most` or bins / 2.
 * found: room for as many. work: aligned as malloc does. */
int32_t find_principal(const PeakCriteria *criteria, const Window *window, Spectrum spectrum,
                       Principals found, void *work);

#endif

/* The live form's analysis of one window: its spectrum in, principal frequencies out. */

#pragma once

#include "settings.h"

/* Real and imaginary parts of bins. */
typedef struct {
    const double *real, *imaginary;
} Spectrum;

/* Principal frequencies, parallel arrays ascending in frequency. */
typedef struct {
    double *audio_hz, *amplitude, *bandwidth_hz, *r;
} Principals;

/* Bytes of work space for so many bins. */
size_t analysis_work(size_t bins);

/* Find what is principal in a spectrum; return how many, at most partials_max or bins / 2.
 * found: room for as many. work: aligned as malloc does. */
int32_t find_principal(const Settings *settings, Spectrum spectrum, Principals found, void *work);

/* The bins beside a peak count as this share of it at least. Where the window's spectrum has a
 * zero, A^0.2 would make 1e-3 of a rounding of 1e-16, and ln A even more. */
#define FLOOR 1e-6

/* Where the walk down one side of each peak falls under half power, parallel arrays. */
typedef struct {
    double *near, *far;    /* bins from the refined top to the bins before and after that step */
    double *above, *under; /* amplitudes there, no less and no more than half power */
    double *bound;         /* of the bins to half power, from above */
} Side;

/* Peaks, parallel arrays ascending in frequency; bins fit into 32 bits. */
typedef struct {
    int32_t count;
    int32_t *left, *bin, *right;  /* the peak's bin and those of the valleys beside it */
    double *before, *top, *after; /* amplitudes around it */
    double *offset, *height;      /* of its refined top: bins from its own, and amplitude */
    double *level;                /* of half power */
    Side down, up;
    double *bandwidth_hz, *r; /* r under 0 where it is not known yet */
    double *rank;             /* by which the strongest are chosen: r, a little less higher up */
    double *bound;            /* of both, from above */
} Peaks;

/* Where a spectrum turns from falling to rising, and back. */
typedef struct {
    int32_t *bin;    /* a valley, a peak, a valley ...; room for bins + 1 */
    uint8_t *rising; /* for each bin, whether the next is higher; room for bins */
} Turns;

/* Write the amplitudes of so many bins. */
void peaks_amplitudes(Spectrum spectrum, double *amplitude, int32_t bins);

/* Clear the low amplitudes of what the images of strong peaks add; `peaks` is work space. */
void peaks_clear_images(const Settings *settings, Spectrum spectrum, double *amplitude, Peaks *peaks);

/* List the peaks of the band that can be principal: bins, and those of the valleys. */
void peaks_list(const Settings *settings, const double *amplitude, Turns turns, Peaks *peaks);

/* Set offset, height and level of all peaks. */
void peaks_refine(const double *amplitude, Peaks *peaks);

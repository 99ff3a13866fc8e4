/* What one kernel is made for: numbers and tables, all of them made in Python. */

#ifndef CUSHION_SETTINGS_H
#define CUSHION_SETTINGS_H

#include <stddef.h>

/* Whole numbers: frames, bins, hops and other counts. */
#define COUNTS(ENTRY)                                                                              \
    ENTRY(window_frames)  /* in one analysis */                                                    \
    ENTRY(hop_frames)     /* from one to the next: decimation x steps */                           \
    ENTRY(decimation)     /* frames in a step of the low rate */                                   \
    ENTRY(steps)          /* of the low rate in a hop */                                           \
    ENTRY(hops_in_window) /* hops that together cover one window */                                \
    ENTRY(fft_length)                                                                              \
    ENTRY(bins)         /* that are looked at */                                                   \
    ENTRY(first_bin)    /* on which a peak counts, */                                              \
    ENTRY(last_bin)     /* and the last; under the first for none */                               \
    ENTRY(partials_max) /* at a time */                                                            \
    ENTRY(ring_hops)    /* that the low-pass rings after the last partial */                       \
    ENTRY(by_energy)    /* the level law: 1 by energy, 0 the paper's */

#define NUMBERS(ENTRY)                                                                             \
    ENTRY(magnitude_max)  /* of a sample; above it is damage */                                    \
    ENTRY(denormal_guard) /* added to every sample */                                              \
    ENTRY(silence)        /* a window whose peak is under this holds nothing */                    \
    ENTRY(bin_hz)         /* from bin to bin */                                                    \
    ENTRY(threshold_hz)   /* r of what is principal is above */                                    \
    ENTRY(peak_span_min)  /* amplitude times bins between valleys from which it can be */          \
    ENTRY(weakest_image)  /* amplitude up to which a peak keeps its image */                       \
    ENTRY(weakest_share)  /* or this share of the highest low amplitude */                         \
    ENTRY(side_lobe)      /* share of the highest amplitude up to which a peak is left out */      \
    ENTRY(full_scale_r)   /* r of a tone at full scale, Hz */                                      \
    ENTRY(scale_hz)       /* equation (4): Hz of vibration for each factor e, */                   \
    ENTRY(scale_ratio)    /* or, where it is not 0, that factor's power of the vibration, */       \
    ENTRY(band_low_hz)    /* from this frequency of audio, */                                      \
    ENTRY(bottom_hz)      /* which is felt at this one */                                          \
    ENTRY(ceiling)        /* of a hop's sum of amplitudes */                                       \
    ENTRY(knee)           /* of samples */                                                         \
    ENTRY(hop_s)                                                                                   \
    ENTRY(match_audio_hz) /* by which a partial may move in a hop, */                              \
    ENTRY(match_ratio)    /* or by this share */                                                   \
    ENTRY(split_hz)       /* a birth this near to a partial is in phase with it */                 \
    ENTRY(steady_hz)      /* changes well under these are averaged */                              \
    ENTRY(steady_ratio)                                                                            \
    ENTRY(steady_gain)  /* share of the smallest changes that is followed */                       \
    ENTRY(still)        /* up to which a sum of amplitudes does not rise */                        \
    ENTRY(gain_step_hz) /* between entries of gain_table */                                        \
    FOLLOWER(ENTRY)

/* Numbers of the loudness follower, dB and dB a hop but for factors; see follower.py. */
#define FOLLOWER(ENTRY)                                                                            \
    ENTRY(nothing)         /* energy that counts as none */                                        \
    ENTRY(programme_start) /* level of the programme before anything is heard, */                  \
    ENTRY(programme_min)                                                                           \
    ENTRY(programme_top)                                                                           \
    ENTRY(programme_step) /* how it moves, */                                                      \
    ENTRY(rise)           /* and by which share of what is missing */                              \
    ENTRY(fall)                                                                                    \
    ENTRY(far)         /* more than this is not missing */                                         \
    ENTRY(release)     /* of what was loud */                                                      \
    ENTRY(floor_min)   /* loudness up to which nothing is felt */                                  \
    ENTRY(floor_rise)  /* of the noise floor */                                                    \
    ENTRY(floor_under) /* it stays under the programme's level */                                  \
    ENTRY(gate)        /* from the floor to where all is felt, */                                  \
    ENTRY(gate_margin) /* of which this share is still silent */                                   \
    ENTRY(target)      /* vibration at the programme's level */                                    \
    ENTRY(slope)       /* of vibration for each dB of loudness */                                  \
    ENTRY(gain_max)    /* of amplitudes, a factor */

/* Tables, each with its length. */
#define TABLES(ENTRY)                                                                              \
    ENTRY(window) /* of the analysis */                                                            \
    ENTRY(band_b) /* the band-pass as one recursion */                                             \
    ENTRY(band_a)                                                                                  \
    ENTRY(image_table) /* the window's spectrum */                                                 \
    ENTRY(image_turn)  /* cosines, then sines, of each bin's turn to the window's centre */        \
    ENTRY(attack)      /* shape of a rise, one entry a step */                                     \
    ENTRY(glide)       /* shape of a fall */                                                       \
    ENTRY(seconds)     /* from the hop's start */                                                  \
    ENTRY(glide_s)     /* the integral of a glide of frequency */                                  \
    ENTRY(low_b)       /* the low-pass as one recursion */                                         \
    ENTRY(low_a)                                                                                   \
    ENTRY(phases)     /* of the interpolation: taps rows of decimation */                          \
    ENTRY(gain_table) /* that undoes the low-pass's ripple, by vibration frequency */              \
    ENTRY(loudness_weights) /* of bins; empty where loudness is not followed */

typedef struct {
    double *at;
    size_t length;
} Table;

typedef struct {
#define ENTRY(name) size_t name;
    COUNTS(ENTRY)
#undef ENTRY
#define ENTRY(name) double name;
    NUMBERS(ENTRY)
#undef ENTRY
#define ENTRY(name) Table name;
    TABLES(ENTRY)
#undef ENTRY
} Settings;

/* The longest recursion of a filter. */
#define ORDER_MAX 8

/* Return what of the settings does not fit the rest; NULL where all of it does. */
const char *settings_misfit(const Settings *settings);

#endif

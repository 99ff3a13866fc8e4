/* What one kernel is made for: numbers and tables, all of them made in Python. */

#pragma once

#include "common.h"

/* Whole numbers: frames, bins, hops and other counts. */
#define COUNTS(ENTRY)                                                                              \
    ENTRY(window_frames)  /* in one analysis */                                                    \
    ENTRY(hop_frames)     /* from one to the next: decimation x steps */                           \
    ENTRY(decimation)     /* frames in a step of the low rate */                                   \
    ENTRY(steps)          /* of the low rate in a hop */                                           \
    ENTRY(ticks)          /* in a hop */                                                           \
    ENTRY(tick_steps)     /* of the low rate in a tick */                                          \
    ENTRY(tick_frames)                                                                             \
    ENTRY(hops_in_window) /* hops that together cover one window */                                \
    ENTRY(fft_length)                                                                              \
    ENTRY(bins)         /* that are looked at */                                                   \
    ENTRY(first_bin)    /* on which a peak counts, */                                              \
    ENTRY(last_bin)     /* and the last; under the first for none */                               \
    ENTRY(partials_max) /* at a time */                                                            \
    ENTRY(ring_hops)    /* that the low-pass rings after the last partial */                       \
    ENTRY(find_onsets)  /* 0 where there is only the analysis */                                   \
    ENTRY(short_frames) /* in the window in which onsets are looked for */                         \
    ENTRY(short_length) /* of its spectrum */                                                      \
    ENTRY(short_bins)   /* that are looked at */                                                   \
    ENTRY(short_ticks) /* that it touches */                                                       \
    ENTRY(newest_frames) /* of a tick that count by themselves */                                  \
    ENTRY(back_ticks)   /* so many ticks ago is the past that a band rises over */                 \
    ENTRY(rest_ticks)   /* from one onset to the next, */                                          \
    ENTRY(rearmed_ticks) /* or so many to one that is `rearmed` times as strong */                 \
    ENTRY(heard_ticks)  /* from which an onset's sound is told */                                  \
    ENTRY(groups_max)   /* of bands in which an onset gives birth */                               \
    ENTRY(onset_partials_max) /* partials at a time that the analysis does not know yet */         \
    ENTRY(hold_hops)    /* for which those are held then */                                        \
    ENTRY(average_ticks) /* over which the power of high bands is averaged */                      \
    ENTRY(begin_frames) /* at the start of a stream, which are silent */                           \
    ENTRY(energy_mapping) /* 1: by energy; 0: as the paper */

#define NUMBERS(ENTRY)                                                                             \
    ENTRY(magnitude_max)  /* of a sample; above it is damage */                                    \
    ENTRY(denormal_guard) /* added to every sample */                                              \
    ENTRY(mix_slow)    /* share of a sample in the powers that tell where the mono mix cancels, */ \
    ENTRY(mix_newest)  /* in the power of late, */                                                 \
    ENTRY(mix_evidence) /* and of that in the power of the mean; */                                \
    ENTRY(mix_cancels_from)  /* the mean's share of power from which down it begins to cancel, */  \
    ENTRY(mix_cancels_up_to) /* and up to which all of it does */                                  \
    ENTRY(mix_power_guard)   /* added to what is squared */                                        \
    ENTRY(silence)        /* a window whose peak is under this holds nothing */                    \
    ENTRY(bin_hz)         /* from bin to bin */                                                    \
    ENTRY(threshold_hz)   /* principal tones have a larger r */                                    \
    ENTRY(peak_span_min)  /* amplitude times bins between valleys from which it can be */          \
    ENTRY(weakest_image)  /* amplitude up to which a peak keeps its image */                       \
    ENTRY(image_first)    /* the window's first sample as a share of the others' sum */            \
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
    ENTRY(merge_ratio) /* partials closer than this share of their frequency are one; 0: none */   \
    ENTRY(merge_hz)    /* or closer than this */                                                   \
    ENTRY(merge_again) /* groups closer than this share of that become one */                      \
    ENTRY(first_hz)  /* of slots as near the first is nearer by this */                            \
    ENTRY(split_hz)       /* a birth this near to a partial is in phase with it */                 \
    ENTRY(steady_hz)      /* changes well under these are averaged */                              \
    ENTRY(steady_ratio)                                                                            \
    ENTRY(steady_gain)  /* share of the smallest changes that is followed */                       \
    ENTRY(still)        /* up to which a sum of amplitudes does not rise */                        \
    ENTRY(gain_step_hz) /* between entries of gain_table */                                        \
    ENTRY(tick_s)                                                                                  \
    ENTRY(short_scale)  /* from squared bins to mean squares */                                    \
    ENTRY(quietest)     /* power under which there are no onsets */                                \
    ENTRY(weakest)      /* amplitude under which nothing is born */                                \
    ENTRY(fading)       /* of the highest power of late, each tick */                              \
    ENTRY(forgotten)    /* power that is as good as none */                                        \
    ENTRY(rise)         /* a band rises where its power is so many times that */                   \
    ENTRY(minor)        /* and more than this share of all, */                                     \
    ENTRY(rearmed)                                                                                 \
    ENTRY(risen_share)  /* of which what rose is more than this share at an onset */               \
    ENTRY(apart_from)   /* ratio from which on two bands are told apart */                         \
    ENTRY(min_gain_share) /* what is born adds what lacks, if that is more than this share */      \
    ENTRY(start_phase)  /* cycles */                                                               \
    ENTRY(onset_reach)  /* a partial that is held is matched so much further away */               \
    ENTRY(min_held_share) /* share of its amplitude up to which it is not held */                  \
    ENTRY(stronger)      /* ratio from which on one amplitude is larger than another */            \
    ENTRY(joined_from)   /* amplitude up to which a partial is as good as none to join */          \
    FOLLOWER(ENTRY)                                                                                \
    SPEECH_NUMBERS(ENTRY)

/* Numbers of the strength by loudness, dB and dB a tick but for factors; see design/strength.py. */
#define FOLLOWER(ENTRY)                                                                            \
    ENTRY(nothing) /* loudness that counts as none */                                              \
    ENTRY(silence_db) /* level of a group in silence */                                            \
    ENTRY(programme_start) /* level of the programme before anything is heard, */                  \
    ENTRY(programme_min) ENTRY(programme_top)                                                      \
    ENTRY(programme_step) /* how it moves, */                                                      \
    ENTRY(programme_rise) /* and the share of its distance */                                      \
    ENTRY(programme_fall)                                                                          \
    ENTRY(far) /* longest distance that counts */                                                  \
    ENTRY(start_ticks) /* of sound in which it is found fast, */                                   \
    ENTRY(start_weight) /* as if so many had been heard before */                                  \
    ENTRY(start_near) /* until it is so near */                                                    \
    ENTRY(release) /* of the loud level, */                                                        \
    ENTRY(slow_followed) /* which is averaged */                                                   \
    ENTRY(floor_min) /* loudness up to which nothing is felt */                                    \
    ENTRY(floor_rise) /* of the noise floor */                                                     \
    ENTRY(floor_under) /* it stays under the programme's level */                                  \
    ENTRY(gate) /* from the floor to where all is felt, */                                         \
    ENTRY(gate_margin) /* of which this share is still silent */                                   \
    ENTRY(jitter) /* smaller changes of loudness are jitter, */                                    \
    ENTRY(jitter_followed) /* of which this share is followed, */                                  \
    ENTRY(jump) /* but after a jump, a rise in one tick by more, */                                \
    ENTRY(attack_ticks) /* for so many ticks */                                                    \
    ENTRY(group_smooth) /* share of a tick in the average of a group of bands */                   \
    ENTRY(group_sone) /* added to that before the logarithm */                                     \
    ENTRY(group_up) /* share by which what is usual follows a rise */                              \
    ENTRY(group_down) /* or a fall */                                                              \
    ENTRY(group_deviates) /* and the mean deviation follows */                                     \
    ENTRY(deviation_max) ENTRY(deviation_start)                                                    \
    ENTRY(boost_deviations) /* a rise is more than so many of them; */                             \
    ENTRY(boost_slope) /* dB that are wanted for each more, */                                     \
    ENTRY(boost_max) /* up to so many, */                                                          \
    ENTRY(boost_share_from) /* from this share of all loudness on */                               \
    ENTRY(boost_share_width) /* fully from so much more; */                                        \
    ENTRY(boost_natural) /* dB that need not be added */                                           \
    ENTRY(boost_hold_ticks) /* for which it stays */                                               \
    ENTRY(boost_fall)                                                                              \
    ENTRY(beat_hz) /* partials so far apart do not beat, */                                        \
    ENTRY(beat_width_hz) /* and those this much closer do fully */                                 \
    ENTRY(beat_least) /* least ratio by which beats are undone */                                  \
    ENTRY(weakest_step) /* least strength of a step, as a share of its tick's */                   \
    ENTRY(concentrated) /* power of the sensitivity that moves what would be limited, at most */   \
    ENTRY(slope_a_bark) /* share by which specific loudness falls, times its fourth root */        \
    ENTRY(target) /* vibration at the programme's level */                                         \
    ENTRY(slope) /* of vibration for each dB of loudness */                                        \
    ENTRY(gain_max) /* of amplitudes, a factor */

/* Numbers of each row of low_poles. */
#define LOW_NUMBERS 3

/* Tables, each with its length. */
#define TABLES(ENTRY)                                                                              \
    ENTRY(mix_weights) /* of all layouts, see downmix.c */                                         \
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
    ENTRY(tick_glide) /* shape of a glide within a tick */                                         \
    ENTRY(tick_glide_s) ENTRY(short_window)                                                        \
    ENTRY(short_hz)    /* vibration frequency of each bin */                                       \
    ENTRY(band_edges)  /* bins: the first of each band, and past the last */                       \
    ENTRY(one_tone)    /* purity of a tone, by ticks since its onset */                            \
    ENTRY(rise_shares) /* of its amplitude that an onset partial has after each tick */             \
    ENTRY(low_sections) /* low-pass and high-pass in sections, then without low_b and low_a */     \
    ENTRY(begin_fade) /* of the first frames of a stream, after begin_frames of silence */         \
    ENTRY(low_smooth) /* sections before the low rate, for the low bands */                        \
    ENTRY(quadrature) /* squares of the all-passes: of one chain, then of the other */             \
    ENTRY(low_poles)   /* LOW_NUMBERS of each low band: its pole, and the gain before it */        \
    ENTRY(low_weights) /* of each: factor on its squares, */                                       \
    ENTRY(low_band_of) /* and its band of loudness */                                              \
    ENTRY(high_edges) /* short bins: the first of each high band, and past the last */             \
    ENTRY(high_weights) /* of each high band: factor on its power */                               \
    ENTRY(loudness_scale) /* of bands: sone per Bark at the threshold; empty if not followed */    \
    ENTRY(loudness_widths) /* of bands: Bark */                                                    \
    ENTRY(loudness_groups) /* bands: the first of each group, and past the last */                 \
    ENTRY(felt_weights)       /* sensitivity by vibration frequency */                             \
    SPEECH_TABLES(ENTRY)

/* What speech.c works by; design/speech.py says what each is. Shares are those that an average takes on in
 * a hop, other changes are those of a hop. */
#define SPEECH_NUMBERS(ENTRY)                                                                      \
    ENTRY(speech_db) /* by how much speech is lowered; 0 for off */                                \
    ENTRY(speech_average) ENTRY(speech_fast) ENTRY(speech_slow) ENTRY(speech_learnt)               \
    ENTRY(speech_background_fall) ENTRY(speech_background_rise_db) ENTRY(speech_voice_fall_db)     \
    ENTRY(speech_peak_fall) ENTRY(speech_attack) ENTRY(speech_release) ENTRY(speech_rest_hops)     \
    ENTRY(speech_quiet_share) ENTRY(speech_swing_max_db) ENTRY(speech_silent_power)                \
    ENTRY(speech_unheard) ENTRY(speech_even) ENTRY(speech_equal) ENTRY(speech_flat)                \
    ENTRY(speech_steady_pitch) ENTRY(speech_likely) ENTRY(speech_likely_still)                     \
    ENTRY(speech_sure) ENTRY(speech_clear_db) ENTRY(speech_apart)

#define SPEECH_TABLES(ENTRY)                                                                       \
    ENTRY(speech_edges)       /* bins at which octaves begin, and the last ends */                 \
    ENTRY(speech_centres_hz)  /* of the octaves */                                                 \
    ENTRY(speech_log_pitches) /* evenly spaced */                                                  \
    ENTRY(speech_teeth)       /* in bins: of all combs on harmonics, then between; 0 for unused */ \
    ENTRY(speech_ramps)       /* two numbers each, in the order of speech.c */

typedef struct {
    double *at;
    size_t length;
} Table;

INLINED int table_is_finite(Table table)
{
    size_t at = 0;
    while (at < table.length && isfinite(table.at[at]))
        at++;
    return at == table.length;
}

#define COUNT_FIELD(name) size_t name;
#define NUMBER_FIELD(name) double name;
#define TABLE_FIELD(name) Table name;

typedef struct {
    COUNTS(COUNT_FIELD)
    NUMBERS(NUMBER_FIELD)
    TABLES(TABLE_FIELD)
} Settings;

#define ORDER_MAX 12 /* the longest recursion of a filter */
#define FRESH_MAX 16 /* the largest onset_partials_max */
#define BACK_MAX 64  /* the largest back_ticks */

/* Return what of the settings does not fit the rest; NULL where all of it does. */
const char *settings_error(const Settings *settings);

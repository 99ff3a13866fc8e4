/* Settings of one transform: counts, numbers and tables, which LiveDesign in transform/design/ computes. */

#pragma once

#include "design_blob.h"

#define ORDER_MAX 12 /* highest allowed order of band_b and low_b */
#define FRESH_MAX 16 /* largest allowed onset_partials_max */
#define BACK_MAX 64  /* largest allowed back_ticks */

/* Integer settings. The classes in transform/design/ and VibrationMapping describe all settings. */
#define COUNTS(ENTRY)                                                                              \
    /* grid */ ENTRY(window_frames) ENTRY(decimation) ENTRY(tick_steps) ENTRY(ticks) ENTRY(steps)  \
    ENTRY(tick_frames) ENTRY(hop_frames) ENTRY(hops_in_window)                                     \
    /* analysis */ ENTRY(fft_length) ENTRY(bins) ENTRY(first_bin) ENTRY(last_bin)                  \
    ENTRY(partials_max)                                                                            \
    /* mapping */ ENTRY(energy_mapping)                                                            \
    /* onset */ ENTRY(find_onsets) ENTRY(short_frames) ENTRY(short_length) ENTRY(short_bins)       \
    ENTRY(short_ticks) ENTRY(newest_frames) ENTRY(back_ticks) ENTRY(rest_ticks)                    \
    ENTRY(rearmed_ticks) ENTRY(heard_ticks) ENTRY(groups_max) ENTRY(onset_partials_max)            \
    /* tracking */ ENTRY(hold_hops)                                                                \
    /* synthesis */ ENTRY(ring_hops) ENTRY(begin_frames)                                           \
    /* loudness */ ENTRY(average_ticks)

#define NUMBERS(ENTRY)                                                                             \
    /* grid */ ENTRY(hop_s) ENTRY(tick_s)                                                          \
    /* input */ ENTRY(silence) ENTRY(mix_slow) ENTRY(mix_newest) ENTRY(mix_evidence)               \
    ENTRY(mix_cancels_from) ENTRY(mix_cancels_up_to) ENTRY(mix_power_guard) ENTRY(magnitude_max)   \
    ENTRY(denormal_guard)                                                                          \
    /* analysis */ ENTRY(bin_hz) ENTRY(threshold_hz) ENTRY(peak_span_min) ENTRY(weakest_image)     \
    ENTRY(weakest_share) ENTRY(image_first) ENTRY(side_lobe)                                       \
    /* mapping */ ENTRY(band_low_hz) ENTRY(bottom_hz) ENTRY(scale_hz) ENTRY(scale_ratio)           \
    ENTRY(full_scale_r)                                                                            \
    /* onset */ ENTRY(short_scale) ENTRY(quietest) ENTRY(weakest) ENTRY(fading)                    \
    ENTRY(min_gain_share) ENTRY(rise) ENTRY(minor) ENTRY(risen_share) ENTRY(rearmed)               \
    ENTRY(forgotten) ENTRY(apart_from) ENTRY(start_phase)                                          \
    /* tracking */ ENTRY(match_audio_hz) ENTRY(steady_ratio) ENTRY(merge_ratio) ENTRY(merge_hz)    \
    ENTRY(merge_again) ENTRY(match_ratio) ENTRY(split_hz) ENTRY(steady_hz) ENTRY(steady_gain)      \
    ENTRY(first_hz) ENTRY(onset_reach) ENTRY(min_held_share) ENTRY(stronger) ENTRY(joined_from)    \
    /* synthesis */ ENTRY(gain_step_hz) ENTRY(still) ENTRY(ceiling) ENTRY(knee)                    \
    /* speech */ ENTRY(speech_db) ENTRY(speech_average) ENTRY(speech_fast) ENTRY(speech_slow)      \
    ENTRY(speech_learnt) ENTRY(speech_background_fall) ENTRY(speech_background_rise_db)            \
    ENTRY(speech_voice_fall_db) ENTRY(speech_peak_fall) ENTRY(speech_attack) ENTRY(speech_release) \
    ENTRY(speech_rest_hops) ENTRY(speech_quiet_share) ENTRY(speech_swing_max_db)                   \
    ENTRY(speech_silent_power) ENTRY(speech_unheard) ENTRY(speech_even) ENTRY(speech_equal)        \
    ENTRY(speech_flat) ENTRY(speech_steady_pitch) ENTRY(speech_likely) ENTRY(speech_likely_still)  \
    ENTRY(speech_sure) ENTRY(speech_clear_db) ENTRY(speech_apart)                                  \
    /* strength */ STRENGTH_NUMBERS(ENTRY)

/* Numbers for the vibration strength that follows loudness. These numbers must be finite. */
#define STRENGTH_NUMBERS(ENTRY)                                                                    \
    /* loudness */ ENTRY(slope_a_bark)                                                             \
    /* strength */ ENTRY(programme_start) ENTRY(programme_min) ENTRY(programme_step)               \
    ENTRY(programme_rise) ENTRY(programme_fall) ENTRY(start_ticks) ENTRY(start_weight)             \
    ENTRY(release) ENTRY(slow_followed) ENTRY(floor_min) ENTRY(floor_rise) ENTRY(gate)             \
    ENTRY(jitter) ENTRY(jitter_followed) ENTRY(attack_ticks) ENTRY(group_smooth) ENTRY(group_up)   \
    ENTRY(group_down) ENTRY(group_deviates) ENTRY(boost_hold_ticks) ENTRY(boost_fall)              \
    ENTRY(boost_max) ENTRY(target) ENTRY(slope) ENTRY(gain_max) ENTRY(programme_top)               \
    ENTRY(start_near) ENTRY(far) ENTRY(floor_under) ENTRY(gate_margin) ENTRY(jump)                 \
    ENTRY(group_sone) ENTRY(silence_db) ENTRY(deviation_start) ENTRY(deviation_max)                \
    ENTRY(boost_deviations) ENTRY(boost_slope) ENTRY(boost_share_from) ENTRY(boost_share_width)    \
    ENTRY(boost_natural) ENTRY(beat_hz) ENTRY(beat_width_hz) ENTRY(beat_least) ENTRY(weakest_step) \
    ENTRY(concentrated) ENTRY(nothing)

/* Tables of free length. Other settings determine the lengths of SIZED_TABLES. */
#define FREE_TABLES(ENTRY)                                                                         \
    /* input */ ENTRY(band_b) ENTRY(band_a) ENTRY(mix_weights)                                     \
    /* analysis */ ENTRY(image_table) ENTRY(image_turn)                                            \
    /* onset */ ENTRY(band_edges) ENTRY(rise_shares)                                               \
    /* synthesis */ ENTRY(low_b) ENTRY(low_a) ENTRY(low_sections) ENTRY(begin_fade) ENTRY(phases)  \
    ENTRY(gain_table)                                                                              \
    /* loudness */ ENTRY(low_smooth) ENTRY(low_weights) ENTRY(high_weights) ENTRY(loudness_scale)  \
    ENTRY(loudness_groups)                                                                         \
    /* strength */ ENTRY(felt_weights)                                                             \
    /* speech */ ENTRY(speech_log_pitches) ENTRY(speech_teeth)

#define SIZED_TABLES(ENTRY)                                                                        \
    /* analysis */ ENTRY(window, s->window_frames)                                                 \
    /* onset */ ENTRY(short_window, s->short_frames) ENTRY(short_hz, s->short_bins)                \
    ENTRY(one_tone, s->heard_ticks)                                                                \
    /* synthesis */ ENTRY(attack, s->steps) ENTRY(glide, s->steps) ENTRY(seconds, s->steps)        \
    ENTRY(glide_s, s->steps) ENTRY(tick_glide, s->tick_steps) ENTRY(tick_glide_s, s->tick_steps)   \
    /* loudness */ ENTRY(quadrature, s->loudness_scale.length ? 2 * CHAIN : 0)                     \
    ENTRY(low_poles, LOW_NUMBERS * s->low_weights.length)                                          \
    ENTRY(low_band_of, s->low_weights.length)                                                      \
    ENTRY(high_edges, s->high_weights.length ? s->high_weights.length + 1 : 0)                     \
    ENTRY(loudness_widths, s->loudness_scale.length)                                               \
    /* speech */ ENTRY(speech_edges, OCTAVES + 1) ENTRY(speech_centres_hz, OCTAVES)                \
    ENTRY(speech_ramps, 2 * RAMPS)

#define COUNT_FIELD(name) size_t name;
#define NUMBER_FIELD(name) double name;
#define TABLE_FIELD(name, ...) Table name;

typedef struct {
    COUNTS(COUNT_FIELD)
    NUMBERS(NUMBER_FIELD)
    FREE_TABLES(TABLE_FIELD)
    SIZED_TABLES(TABLE_FIELD)
} Settings;

/* Read and check all settings; return NULL or an error message. Tables stay in the memory of the design. The
 * checks keep all later accesses within the tables. */
const char *settings_read(Settings *settings, Records records);

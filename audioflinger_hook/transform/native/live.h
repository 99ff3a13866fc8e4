/* Real-time transform: at the end of each tick (about 2 ms), computes the next tick of vibration. */

#pragma once

#include "analysis.h"
#include "input_stage.h"
#include "loudness.h"
#include "synthesis.h"

/* State of one channel of vibration. */
typedef struct {
    double *band;   /* state of the band-pass */
    double *past;   /* ring buffer of the newest window_frames band-passed frames, from LiveState.oldest on */
    double *peaks;  /* largest band-passed magnitude in each of hops_in_window hops, the current hop last */
    double *output_tick; /* the tick of vibration that is being delivered */
    double *hop_low_rate; /* one hop of vibration at the low rate; NULL if the strength follows loudness */
    Onsets onsets;
    OnsetPartial *onset_partials;
    Slots slots;
    BandPowers powers;
    Strength strength;
    Oscillators oscillators;
    double begun; /* delivered frames, counted up to the end of the fade-in at the stream's start */
    Smoothing smoothing;
    double tail; /* remaining hops until the output filters have decayed */
    Speech speech;
} Channel;

/* The strongest partials of all channels in the latest hop, for display only. */
typedef struct {
    uint64_t hops; /* hops since live_open */
    size_t count;
    double rows[CORE_PARTIALS][3]; /* audio frequency in Hz, vibration frequency in Hz, amplitude */
} DisplayPartials;

/* Stream state that all channels share. */
typedef struct {
    DownmixState downmix;
    size_t filled; /* received frames of the current tick */
    size_t tick;   /* complete ticks in the current hop */
    size_t oldest; /* index of the oldest frame in the ring buffers */
    size_t silent; /* number of trailing frames that are exactly 0, at most window_frames */
    uint64_t replaced, limited; /* replaced samples of sound, limited samples of vibration */
} LiveState;

/* Settings, work space and state. Nothing is allocated after `live_open` and `live_layout_state`. */
typedef struct {
    Settings settings;
    size_t channels_count;
    int per_channel; /* 1: one vibration per channel of sound; 0: one vibration of the mono mix */
    Fft fft, short_fft;
    LiveState *state;
    Channel *channels;
    Arena memory; /* start of the state's memory */
    size_t memory_bytes;
    const double *mix_weights; /* weights of the mono mix, in the settings; or NULL: plain mean */
    DisplayPartials display;
    GlideLog log; /* recording of glides; off until core_record starts it */

    double *mono, *side, *windowed, *real, *imaginary, *fft_space, *synthesis_space, *onset_space;
    double *speech_space, *oscillator_space, *low_rate; /* low_rate: a tick of vibration at the low rate */
    double *newest; /* newest band-passed frames of a channel, the oldest first */
    void *analysis_space;
    TrackingWork tracking;
    Principals found;
    double *hz, *amplitude;
    Glides glides, onset_glides;
} Live;

/* Create a transform from valid settings, with memory from the arena, but without its state. If arena->base
 * is NULL, only count bytes. Return 0 if an FFT length has prime factors above 5. */
int live_open(Live *live, const Settings *settings, size_t channels, int per_channel, Arena *arena);

/* Reserve the state's memory in the arena and set the pointers into it; do not initialise its values. If
 * arena->base is NULL, only count bytes. */
void live_layout_state(Live *live, Arena *arena);

/* Reset to the state of a new stream; keep the counts of replaced and limited samples. */
void live_reset(Live *live);

/* If loudness is on, reset a channel's band powers, strength and drive; keep programme and sound_ticks. */
void live_rest(Live *live, Channel *channel);

/* Transform sound into vibration. vibration: receives frames x channels_count numbers, frame by frame. */
void live_process(Live *live, CoreSound sound, size_t channels, size_t frames, double *vibration);

/* Set the amplitudes of the principal frequencies; return whether the ceiling limited them. If the strength
 * follows loudness, only the ratios of amplitudes matter; speech suppression then sets
 * strength.speech_left. */
int levels_set(Live *live, Channel *channel, size_t count);

/* Return the factor on amplitudes that gives the strength `wanted`, limited by gain_max and the ceiling; 0 if
 * the perceived power is 0. */
double levels_gain(const Live *live, double wanted, size_t count);

/* Return the r.m.s. level that the tonal amplitude mapping gives, divided by the level that the energy
 * mapping gives. Return 1 if the energy mapping is used or `count` is 0. */
double levels_left_by_law(const Live *live, size_t count);

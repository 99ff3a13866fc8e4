/* The live form of one stream: sound in, vibration out, a tick behind. */

#pragma once

#include "analysis.h"
#include "downmix.h"
#include "input_stage.h"
#include "onset_partials.h"
#include "oscillators.h"
#include "strength.h"

/* One channel of vibration. Everything in it is state, and lies in Live's `state`. */
typedef struct {
    double *band;   /* of the band-pass */
    double *past;   /* the last window_frames, a ring that begins at Live's `oldest` */
    double *peaks;  /* of the last hops_in_window, the one under way the last */
    double *output_tick; /* the tick that is being delivered */
    double *hop_low_rate; /* partials at the low rate; where loudness is followed, `oscillators` has them */
    Onsets onsets;
    OnsetPartial *onset_partials;
    Slots slots;
    BandPowers powers;
    Strength *strength;
    Oscillators oscillators;
    double *begun; /* frames of the stream that were delivered, up to its first full one */
    Smoothing smoothing;
    double *tail; /* hops that the low-pass still rings */
    Speech *speech;
} Channel;

#define DISPLAY_PARTIALS_MAX 16

/* What the latest hop of all channels vibrates, the first found first. For showing it: no state. */
typedef struct {
    uint64_t hops; /* so far */
    size_t count;
    double audio_hz[DISPLAY_PARTIALS_MAX], hz[DISPLAY_PARTIALS_MAX], amplitude[DISPLAY_PARTIALS_MAX];
} DisplayPartials;

/* Settings, work space, and the state of every channel. Nothing is allocated after `live_open`. */
typedef struct {
    Settings settings;
    size_t channels_count;
    int per_channel; /* a vibration for each channel of sound, else one of their mix */
    Fft fft, short_fft;
    Channel *channels;
    const double *mix_weights; /* of the mono mix, NULL for a plain mean; in the settings */
    DownmixState *downmix_state;     /* part of `state` */
    double *state;
    size_t state_length; /* doubles */
    size_t filled;       /* frames of the tick under way */
    size_t tick;         /* whole ticks of the hop under way */
    size_t oldest;       /* of the ring */
    size_t silent;       /* frames that were exactly 0 of late, up to window_frames */
    uint64_t replaced, limited, delivered;
    DisplayPartials display;
    GlideLog log; /* no state: off until Python switches it on */

    double *mono, *side, *windowed, *real, *imaginary, *fft_space, *synthesis_space, *onset_space;
    double *speech_space, *oscillator_space, *low_rate; /* low_rate: the tick under way */
    double *newest; /* the last short_frames, or window_frames, in order */
    void *analysis_space, *tracking_space;
    Principals found;
    double *hz, *amplitude;
    Glides glides, onset_glides;
} Live;

/* Make a kernel of settings that fit, with memory of the arena; without memory, only count it. Return
 * 0 if fft_length has other factors than 2, 3 and 5. */
int live_open(Live *live, const Settings *settings, size_t channels, int per_channel, Arena *arena);

/* Return to the state of a new stream; the counters go on. */
void live_reset(Live *live);

/* Let a channel forget all but the programme, after a long silence. */
void live_rest(Live *live, Channel *channel);

/* Take so many frames of sound and write as many of vibration, (frames, channels). */
void live_process(Live *live, Sound sound, size_t frames, double *vibration);

/* Whether what stands in `state`, `filled`, `tick`, `oldest` and `silent` can be gone on with. */
int live_state_is_valid(const Live *live);

/* Set the amplitudes of what was found; return whether they were scaled down to the ceiling. Where loudness
 * is followed only their proportion matters, and what speech loses is noted for the strength. */
int levels_set(Live *live, Channel *channel, size_t count);

/* The factor that makes amplitudes as strong as is wanted, as far as the ceiling allows. */
double levels_gain(const Live *live, double wanted, size_t count);

/* What the law leaves of the level of what was found, 1 of one tone. */
double levels_left_by_law(const Live *live, size_t count);

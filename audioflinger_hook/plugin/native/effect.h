/* The plugin as any host uses it: sound in, vibration out, with level, delay and bypass. */

#pragma once

#include "design_file.h"

/* A factor that moves to each new goal: in a straight line, or from 0 to 1 and back smoothly. */
typedef struct {
    double now, goal, step;
} Fade;

/* A delay of samples, changed without a click. */
typedef struct {
    float *past;     /* a ring */
    size_t capacity; /* of the ring, a power of 2 */
    size_t next;     /* where the next sample goes */
    size_t delay;    /* frames */
    size_t before;   /* the delay that is faded out */
    size_t fading;   /* frames of the cross-fade that are left */
    size_t fade_frames;
} DelayLine;

enum { EFFECT_CHANNELS = 2, EFFECT_PIECE_FRAMES = 1024 };

typedef struct {
    LoadedCore loaded;
    CoreControls controls;
    CoreReadings readings;
    DelayLine delay;
    Fade gain, open;
    float sound[EFFECT_PIECE_FRAMES * EFFECT_CHANNELS], vibration[EFFECT_PIECE_FRAMES];
    int fresh; /* nothing was processed since the last reset */
} Effect;

typedef struct {
    double gain_db;
    double delay_ms;
    int bypass; /* silence */
} EffectControls;

/* Make an effect. Where its design cannot be used, one line on stderr says so, and it gives silence: the
 * host goes on. NULL, after one line on stderr, where there is no design. Allocates. */
Effect *effect_open(const char *profile, unsigned long samplerate);

void effect_close(Effect *effect);

void effect_reset(Effect *effect);

/* Process any number of frames. Real-time safe. One channel counts as two equal ones. Outputs may be
 * inputs; all outputs are the same. */
void effect_process(Effect *effect, EffectControls controls, const float *const *inputs,
                    size_t channels, float *const *outputs, size_t outputs_count, size_t frames);

/* Frames by which the vibration follows its sound. */
double effect_latency_frames(const Effect *effect);

/* The peaks of sound and vibration in dBFS, -150 at least. */
double effect_sound_dbfs(const Effect *effect);
double effect_vibration_dbfs(const Effect *effect);

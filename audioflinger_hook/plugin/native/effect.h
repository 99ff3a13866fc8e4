/* The plugin as any host uses it: sound in, vibration out, with level, delay and bypass. */

#ifndef CUSHION_EFFECT_H
#define CUSHION_EFFECT_H

#include "delay_line.h"
#include "fade.h"
#include "source.h"

#define EFFECT_CHANNELS_MAX CHANNELS_MAX
#define DELAY_MAX_S 1.0

typedef struct {
    Source *source;
    DelayLine delay;
    Fade gain, open;
    float vibration[PIECE_FRAMES];
    int fresh; /* nothing was processed since the last reset */
} Effect;

typedef struct {
    double gain_db;
    double delay_ms;
    int bypass; /* silence */
} EffectControls;

/* Make an effect, NULL after one line on stderr. Allocates. */
Effect *effect_open(const char *profile, unsigned long samplerate, size_t channels);

void effect_close(Effect *effect);

void effect_reset(Effect *effect);

/* Process any number of frames. Real-time safe. Outputs may be inputs; all outputs are the same. */
void effect_process(Effect *effect, EffectControls controls, const float *const *inputs,
                    size_t channels, float *const *outputs, size_t outputs_count, size_t frames);

/* Frames by which the vibration follows its sound. */
double effect_latency_frames(const Effect *effect);

/* The peak of a meter in dBFS, -150 at least. */
double peak_dbfs(const LevelMeter *meter);

#endif

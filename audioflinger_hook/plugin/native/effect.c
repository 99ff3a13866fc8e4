/* The plugin for general hosts: the core, then gain, delay and bypass. */

#include "parts.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "../../transform/native/exact.h"

#define GAIN_MIN_DB (-60.0)
#define GAIN_MAX_DB 20.0
#define BYPASS_FADE_S 0.04
#define FLOOR_DBFS (-150.0)
#define DELAY_MAX_S 1.0
#define DELAY_FADE_S 0.02
#define PIECE_FRAMES 1024

/* A factor that changes linearly to its goal; step: change per frame. */
typedef struct {
    double now, goal, step;
} Fade;

/* A delay line that cross-fades to each new delay. */
typedef struct {
    float *past;     /* ring buffer */
    size_t capacity; /* length of the ring buffer, a power of 2 */
    size_t next;     /* index of the next sample to write */
    size_t delay;    /* frames */
    size_t before;   /* previous delay, frames */
    size_t fading;   /* remaining frames of the cross-fade */
    size_t fade_frames;
} DelayLine;

struct Effect {
    LoadedCore loaded;
    CoreControls controls;
    CoreReadings readings;
    DelayLine delay;
    Fade gain, open;
    float sound[PIECE_FRAMES * EFFECT_CHANNELS], vibration[PIECE_FRAMES];
    int fresh; /* no frame has been processed since the last reset */
};

/* Set a goal, which the fade reaches after max(1, frames) frames. */
static void fade_to(Fade *fade, double goal, size_t frames)
{
    if (goal == fade->goal)
        return;
    fade->goal = goal;
    fade->step = (goal - fade->now) / (double)(frames ? frames : 1);
}

/* Multiply samples by the fade. smooth: during a fade, map the factor x to x² (3 - 2 x). */
static void fade_apply(Fade *fade, float *samples, size_t count, int smooth)
{
    for (size_t at = 0; at < count; at++) {
        double factor = fade->now;
        if (fade->now != fade->goal) {
            const double x = fade->now + fade->step;
            const int past = fade->step > 0.0 ? x >= fade->goal : x <= fade->goal;
            fade->now = factor = past ? fade->goal : x;
            if (smooth)
                factor = factor * factor * (3.0 - 2.0 * factor);
        }
        if (factor != 1.0)
            samples[at] = (float)(factor * samples[at]);
    }
}

/* Allocate room for delays up to longest_s; return 0 if memory runs out. */
static int delay_open(DelayLine *line, double longest_s, double samplerate)
{
    const double frames = longest_s * samplerate + 1.0;
    for (line->capacity = 1; (double)line->capacity < frames;)
        line->capacity *= 2;
    line->fade_frames = (size_t)(DELAY_FADE_S * samplerate) + 1;
    line->past = calloc(line->capacity, sizeof(float));
    return line->past != NULL;
}

/* Clear the ring buffer. Set the delay, in frames, without a fade. */
static void delay_reset(DelayLine *line, size_t frames)
{
    memset(line->past, 0, line->capacity * sizeof(float));
    line->next = line->fading = 0;
    line->delay = line->before = frames < line->capacity ? frames : line->capacity - 1;
}

/* Delay samples in place by `frames` frames, at most capacity - 1. */
static void delay_process(DelayLine *line, float *samples, size_t count, size_t frames)
{
    const size_t mask = line->capacity - 1;
    frames = frames < mask ? frames : mask;
    for (size_t at = 0; at < count; at++) {
        if (frames != line->delay && !line->fading) {
            line->before = line->delay;
            line->delay = frames;
            line->fading = line->fade_frames;
        }
        line->past[line->next] = samples[at];
        float sample = line->past[(line->next - line->delay) & mask];
        if (line->fading) {
            const float share = (float)line->fading-- / (float)line->fade_frames;
            sample += share * (line->past[(line->next - line->before) & mask] - sample);
        }
        samples[at] = sample;
        line->next = (line->next + 1) & mask;
    }
}

Effect *effect_open(const char *profile, unsigned long samplerate)
{
    Effect *effect = calloc(1, sizeof *effect);
    if (!effect)
        return NULL;
    effect->controls.sound_gain = 1.0;
    const CoreInfo *info = &effect->loaded.info;
    const int found = core_find(&effect->loaded, profile, samplerate);
    if (found == 1 && (info->inputs != EFFECT_CHANNELS || info->vibrations != 1 || info->actuators)) {
        fprintf(stderr, "haptic_cushion: the design is for other channels; allowed: two, and no actuator\n");
        core_unload(&effect->loaded);
    }
    if (!found || !delay_open(&effect->delay, DELAY_MAX_S, (double)samplerate)) {
        effect_close(effect);
        return NULL;
    }
    effect_reset(effect);
    return effect;
}

void effect_close(Effect *effect)
{
    if (!effect)
        return;
    free(effect->delay.past);
    core_unload(&effect->loaded);
    free(effect);
}

void effect_reset(Effect *effect)
{
    if (effect->loaded.core)
        core_reset(effect->loaded.core, 0);
    effect->fresh = 1;
}

/* Clip a control to its range; NaN becomes the default, 0. */
static double within(double value, double least, double most)
{
    return isnan(value) ? 0.0 : clip(value, least, most);
}

static double dbfs(double peak)
{
    return peak > 0.0 ? fmax(FLOOR_DBFS, 20.0 * exact_log10(peak)) : FLOOR_DBFS;
}

static EffectReadings readings_of(const Effect *effect)
{
    const CoreLevel *sound = effect->readings.sound, *vibration = effect->readings.vibration;
    return (EffectReadings){(double)(effect->loaded.info.latency_frames + effect->delay.delay),
                            dbfs(fmax(sound[0].peak, sound[1].peak)), dbfs(vibration[0].peak)};
}

EffectReadings effect_process(Effect *effect, EffectControls controls, const float *const *inputs,
                              size_t channels, float *const *outputs, size_t outputs_count, size_t frames)
{
    const double samplerate = (double)effect->loaded.info.samplerate;
    const double gain_db = within(controls.gain_db, GAIN_MIN_DB, GAIN_MAX_DB);
    const double gain = gain_db == 0.0 ? 1.0 : exact_amplitude(gain_db);
    const double delay_s = within(1e-3 * controls.delay_ms, 0.0, DELAY_MAX_S);
    const size_t delay = (size_t)(delay_s * samplerate + 0.5);
    const double open = controls.bypass ? 0.0 : 1.0;
    for (size_t output = 0; !effect->loaded.core && output < outputs_count; output++)
        if (outputs[output])
            memset(outputs[output], 0, frames * sizeof(float));
    if (!frames || !effect->loaded.core)
        return readings_of(effect);
    if (effect->fresh) {
        delay_reset(&effect->delay, delay);
        effect->gain = (Fade){gain, gain, 0.0};
        effect->open = (Fade){open, open, 0.0};
        effect->fresh = 0;
    }
    fade_to(&effect->gain, gain, frames);
    fade_to(&effect->open, open, (size_t)(BYPASS_FADE_S * samplerate));
    for (size_t done = 0; done < frames;) {
        const size_t left = frames - done, part = left < PIECE_FRAMES ? left : PIECE_FRAMES;
        for (size_t channel = 0; channel < EFFECT_CHANNELS; channel++) {
            const float *input = inputs[channel < channels ? channel : 0];
            for (size_t frame = 0; frame < part; frame++)
                effect->sound[frame * EFFECT_CHANNELS + channel] = input ? input[done + frame] : 0.0f;
        }
        const CoreSound sound = {effect->sound, EFFECT_CHANNELS * sizeof(float), sizeof(float), 0};
        core_process(effect->loaded.core, &effect->controls, sound, effect->vibration, part,
                     &effect->readings);
        fade_apply(&effect->gain, effect->vibration, part, 0);
        delay_process(&effect->delay, effect->vibration, part, delay);
        fade_apply(&effect->open, effect->vibration, part, 1);
        for (size_t output = 0; output < outputs_count; output++)
            if (outputs[output])
                memcpy(outputs[output] + done, effect->vibration, part * sizeof(float));
        done += part;
    }
    return readings_of(effect);
}

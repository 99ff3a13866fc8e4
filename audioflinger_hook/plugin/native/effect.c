/* The plugin as any host uses it. */

#include "effect.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "../../transform/native/exact.h"

#define GAIN_MIN_DB (-60.0)
#define GAIN_MAX_DB 20.0
#define BYPASS_FADE_S 0.04
#define FLOOR_DBFS (-150.0)

Effect *effect_open(const char *profile, unsigned long samplerate, size_t channels)
{
    Effect *effect = calloc(1, sizeof *effect);
    if (!effect)
        return NULL;
    effect->source = source_open(profile, samplerate, channels);
    if (!effect->source || !delay_open(&effect->delay, DELAY_MAX_S, (double)samplerate)) {
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
    delay_close(&effect->delay);
    source_close(effect->source);
    free(effect);
}

void effect_reset(Effect *effect)
{
    source_reset(effect->source);
    effect->fresh = 1;
}

/* A control within its range; its default where it is not a number. */
static double within(double value, double least, double most, double otherwise)
{
    if (isnan(value))
        return otherwise;
    return value < least ? least : value > most ? most : value;
}

void effect_process(Effect *effect, EffectControls controls, const float *const *inputs,
                    size_t channels, float *const *outputs, size_t outputs_count, size_t frames)
{
    const float *at[EFFECT_CHANNELS_MAX];
    const double samplerate = effect->source->sound.samplerate;
    const double gain_db = within(controls.gain_db, GAIN_MIN_DB, GAIN_MAX_DB, 0.0);
    const double gain = gain_db == 0.0 ? 1.0 : exact_amplitude(gain_db);
    const double delay_s = within(1e-3 * controls.delay_ms, 0.0, DELAY_MAX_S, 0.0);
    const size_t delay = (size_t)(delay_s * samplerate + 0.5);
    const double open = controls.bypass ? 0.0 : 1.0;
    if (effect->fresh && frames) {
        delay_reset(&effect->delay, delay);
        fade_reset(&effect->gain, gain);
        fade_reset(&effect->open, open);
        effect->fresh = 0;
    }
    fade_to(&effect->gain, gain, frames);
    fade_to(&effect->open, open, (size_t)(BYPASS_FADE_S * samplerate));
    for (size_t done = 0; done < frames;) {
        const size_t left = frames - done, part = left < PIECE_FRAMES ? left : PIECE_FRAMES;
        for (size_t channel = 0; channel < channels; channel++)
            at[channel] = inputs[channel] ? inputs[channel] + done : NULL;
        source_process(effect->source, at, effect->vibration, part);
        fade_apply(&effect->gain, effect->vibration, part);
        delay_process(&effect->delay, effect->vibration, part, delay);
        fade_apply_smoothly(&effect->open, effect->vibration, part);
        for (size_t output = 0; output < outputs_count; output++)
            if (outputs[output])
                memcpy(outputs[output] + done, effect->vibration, part * sizeof(float));
        done += part;
    }
}

double effect_latency_frames(const Effect *effect)
{
    return (double)(effect->source->design.latency_frames + effect->delay.delay);
}

double peak_dbfs(const LevelMeter *meter)
{
    return meter->peak > BELOW ? fmax(FLOOR_DBFS, 20.0 * exact_log10(meter->peak)) : FLOOR_DBFS;
}

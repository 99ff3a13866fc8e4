/* What arrives, made safe: unusable samples become 0 and are counted, channels become one, and the
 * band of the analysis is all that is left. */

#include "input_stage.h"

#include "filter.h"

INLINED double sample_at(const char *place, int is_float)
{
    if (is_float) {
        float sample;
        memcpy(&sample, place, sizeof sample);
        return (double)sample;
    }
    double sample;
    memcpy(&sample, place, sizeof sample);
    return sample;
}

/* ------------------------------------------------------------------------------------- silence */

/* Frames that are looked at together. */
#define FEW_FRAMES 16

static int is_silent(Sound sound, size_t frame)
{
    const char *place = sound.at + (ptrdiff_t)frame * sound.frame_bytes;
    for (size_t channel = 0; channel < sound.channels; channel++, place += sound.channel_bytes)
        if (sample_at(place, sound.is_float) != 0.0)
            return 0;
    return 1;
}

/* Whether frames lie one behind the other without a gap. */
static int is_dense(Sound sound)
{
    const ptrdiff_t sample_bytes = sound.is_float ? sizeof(float) : sizeof(double);
    return sound.channel_bytes == sample_bytes &&
           sound.frame_bytes == sample_bytes * (ptrdiff_t)sound.channels;
}

/* Whether nothing but a sign is in any of these bytes, a multiple of 8 of them. */
SIMD_CLONES static int are_zeros(const char *at, size_t bytes, uint64_t signs)
{
    uint64_t all = 0;
    for (size_t place = 0; place < bytes; place += sizeof all) {
        uint64_t here;
        memcpy(&here, at + place, sizeof here);
        all |= here;
    }
    return !(all & ~signs);
}

/* Whether a few frames of dense sound are silent. */
static int few_are_silent(Sound sound, size_t first)
{
    const uint64_t signs = sound.is_float ? UINT64_C(0x8000000080000000) : UINT64_C(1) << 63;
    const char *at = sound.at + (ptrdiff_t)first * sound.frame_bytes;
    return are_zeros(at, FEW_FRAMES * (size_t)sound.frame_bytes, signs);
}

size_t input_silent_first(Sound sound, size_t frames)
{
    size_t silent = 0;
    if (is_dense(sound))
        while (frames - silent >= FEW_FRAMES && few_are_silent(sound, silent))
            silent += FEW_FRAMES;
    while (silent < frames && is_silent(sound, silent))
        silent++;
    return silent;
}

size_t input_silent_last(Sound sound, size_t frames)
{
    size_t sounding = frames;
    if (!frames || !is_silent(sound, frames - 1))
        return 0; /* as in all that sounds */
    if (is_dense(sound))
        while (sounding >= FEW_FRAMES && few_are_silent(sound, sounding - FEW_FRAMES))
            sounding -= FEW_FRAMES;
    while (sounding && is_silent(sound, sounding - 1))
        sounding--;
    return frames - sounding;
}

/* ---------------------------------------------------------------------------------------- intake */

/* A sample, 0 where it is unusable, which is counted. Denormal numbers, which are slow to add and
 * divide, count as 0, too: they vanish in the guard that is added before the band-pass. */
INLINED double usable_at(const char *place, int is_float, double limit, size_t *unusable)
{
    const double sample = sample_at(place, is_float);
    const int usable = fabs(sample) <= limit;
    *unusable += (size_t)!usable;
    return usable && fabs(sample) >= TINY ? sample : 0.0;
}

/* Channels are added one by one, times their weights, or divided by their number: the same order for any
 * block. */
INLINED size_t mix(Sound sound, int is_float, const double *weights, double limit, size_t frames,
                   double *restrict mono, double *restrict side)
{
    const size_t channels = sound.channels;
    size_t unusable = 0;
    for (size_t frame = 0; frame < frames; frame++) {
        const char *place = sound.at + (ptrdiff_t)frame * sound.frame_bytes;
        double of_mean = 0.0, of_side = 0.0;
        for (size_t channel = 0; channel < channels; channel++, place += sound.channel_bytes) {
            const double sample = usable_at(place, is_float, limit, &unusable);
            of_mean += weights ? sample * weights[channel] : sample;
            of_side += weights ? sample * weights[channels + channel] : 0.0;
        }
        mono[frame] = weights || channels == 1 ? of_mean : of_mean / (double)channels;
        if (weights)
            side[frame] = of_side;
    }
    return unusable;
}

SIMD_CLONES static int32_t unusable_floats(const float *restrict samples, size_t count, float limit)
{
    int32_t unusable = 0;
    for (size_t one = 0; one < count; one++)
        unusable += !(fabsf(samples[one]) <= limit);
    return unusable;
}

SIMD_CLONES static void mix_pairs(const float *restrict pairs, size_t frames, double *restrict mono,
                           double *restrict side)
{
    for (size_t frame = 0; frame < frames; frame++) {
        const double left = (double)pairs[2 * frame], right = (double)pairs[2 * frame + 1];
        mono[frame] = (left + right) / 2.0;
        side[frame] = (left - right) / 2.0;
    }
}

/* Whether sound is what a sound server delivers, pairs of 32-bit samples, and all of it usable. */
static int is_usable_stereo(Sound sound, size_t frames, double limit)
{
    const float as_float = (float)limit;
    return sound.is_float && sound.channels == 2 && sound.frame_bytes == 8 &&
           sound.channel_bytes == 4 && (uintptr_t)sound.at % sizeof(float) == 0 &&
           (double)as_float == limit &&
           !unusable_floats((const float *)sound.at, 2 * frames, as_float);
}

size_t input_mix(const Settings *settings, Sound sound, const double *weights, size_t frames,
                 double *mono, double *side)
{
    const double limit = settings->magnitude_max;
    if (!weights)
        return sound.is_float ? mix(sound, 1, NULL, limit, frames, mono, NULL)
                              : mix(sound, 0, NULL, limit, frames, mono, NULL);
    if (is_usable_stereo(sound, frames, limit)) {
        /* The weights of stereo are halves: the same bits as theirs. */
        mix_pairs((const float *)sound.at, frames, mono, side);
        return 0;
    }
    return sound.is_float ? mix(sound, 1, weights, limit, frames, mono, side)
                          : mix(sound, 0, weights, limit, frames, mono, side);
}

INLINED double filter_band(const Settings *settings, double *state, size_t order, double *mono,
                           size_t frames)
{
    double b[ORDER_MAX + 1], a[ORDER_MAX + 1], held[ORDER_MAX], loudest = 0.0;
    memcpy(b, settings->band_b.at, (order + 1) * sizeof(double));
    memcpy(a, settings->band_a.at, (order + 1) * sizeof(double));
    memcpy(held, state, order * sizeof(double));
    for (size_t frame = 0; frame < frames; frame++) {
        mono[frame] = filter_step(b, a, held, order, mono[frame] + settings->denormal_guard);
        loudest = larger(fabs(mono[frame]), loudest);
    }
    memcpy(state, held, order * sizeof(double));
    return loudest;
}

double input_band_pass(const Settings *settings, double *state, double *mono, size_t frames)
{
    const size_t order = settings->band_b.length - 1;
    if (order == 4)
        return filter_band(settings, state, 4, mono, frames);
    if (order == 2)
        return filter_band(settings, state, 2, mono, frames);
    return filter_band(settings, state, order, mono, frames);
}

double input_band_pass_silence(const Settings *settings, double *state, double *mono, size_t frames)
{
    const size_t bytes = (settings->band_b.length - 1) * sizeof(double);
    double before[ORDER_MAX];
    memcpy(before, state, bytes);
    memset(mono, 0, frames * sizeof(double));
    const double first = input_band_pass(settings, state, mono, 1);
    if (memcmp(before, state, bytes) != 0)
        return larger(input_band_pass(settings, state, mono + 1, frames - 1), first);
    /* It has come to rest, in 0.4 s of silence: every frame leaves it as the first has. */
    for (size_t frame = 1; frame < frames; frame++)
        mono[frame] = mono[0];
    return first;
}

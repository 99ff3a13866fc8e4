/* Replaces unusable samples with 0, mixes channels to mono, and applies the band-pass of the analysis. */

#include "input_stage.h"
#include "filter.h"

/* ------------------------------------------------------------------------------------- silence */

#define FEW_FRAMES 16 /* frames tested for silence at once */

static int is_silent(CoreSound sound, size_t channels, size_t frame)
{
    const char *place = (const char *)sound.at + (ptrdiff_t)frame * sound.frame_bytes;
    for (size_t channel = 0; channel < channels; channel++, place += sound.channel_bytes)
        if (sample_of(place, sound.is_double) != 0.0)
            return 0;
    return 1;
}

/* Return whether all samples are contiguous in memory. */
static int is_dense(CoreSound sound, size_t channels)
{
    const ptrdiff_t sample_bytes = sound.is_double ? sizeof(double) : sizeof(float);
    return sound.channel_bytes == sample_bytes &&
           sound.frame_bytes == sample_bytes * (ptrdiff_t)channels;
}

/* Return whether, in each group of 8 bytes, all bits outside the mask `signs` are 0. bytes: a multiple of 8. */
SIMD_CLONES static int are_zeros(const char *at, size_t bytes, uint64_t signs)
{
    uint64_t all = 0, here;
    for (size_t place = 0; place < bytes; place += sizeof here) {
        memcpy(&here, at + place, sizeof here);
        all |= here;
    }
    return !(all & ~signs);
}

/* Return whether FEW_FRAMES frames from `first` on are silent. They must be contiguous in memory. */
static int few_are_silent(CoreSound sound, size_t first)
{
    const uint64_t signs = sound.is_double ? UINT64_C(1) << 63 : UINT64_C(0x8000000080000000);
    const char *at = (const char *)sound.at + (ptrdiff_t)first * sound.frame_bytes;
    return are_zeros(at, FEW_FRAMES * (size_t)sound.frame_bytes, signs);
}

size_t input_silent_first(CoreSound sound, size_t channels, size_t frames)
{
    size_t silent = 0;
    if (is_dense(sound, channels))
        while (frames - silent >= FEW_FRAMES && few_are_silent(sound, silent))
            silent += FEW_FRAMES;
    while (silent < frames && is_silent(sound, channels, silent))
        silent++;
    return silent;
}

size_t input_silent_last(CoreSound sound, size_t channels, size_t frames)
{
    size_t sounding = frames;
    if (!frames || !is_silent(sound, channels, frames - 1))
        return 0; /* fast path for sound that does not end with silence */
    if (is_dense(sound, channels))
        while (sounding >= FEW_FRAMES && few_are_silent(sound, sounding - FEW_FRAMES))
            sounding -= FEW_FRAMES;
    while (sounding && is_silent(sound, channels, sounding - 1))
        sounding--;
    return frames - sounding;
}

/* ---------------------------------------------------------------------------------------- mixing */

/* Return a sample, or 0 for NaN, a magnitude above `limit`, or a denormal number, which would be slow. For
 * NaN and magnitudes above `limit`, increment *unusable. */
INLINED double usable_at(const char *place, int is_double, double limit, size_t *unusable)
{
    const double sample = sample_of(place, is_double);
    const int usable = fabs(sample) <= limit;
    *unusable += (size_t)!usable;
    return usable && fabs(sample) >= TINY ? sample : 0.0;
}

/* Write the weighted sums of each frame to mono and side; without weights, write the mean to mono. Return the
 * number of unusable samples. */
INLINED size_t mix(CoreSound sound, size_t channels, int is_double, const double *weights, double limit,
                   size_t frames, double *restrict mono, double *restrict side)
{
    size_t unusable = 0;
    for (size_t frame = 0; frame < frames; frame++) {
        const char *place = (const char *)sound.at + (ptrdiff_t)frame * sound.frame_bytes;
        double of_mean = 0.0, of_side = 0.0;
        for (size_t channel = 0; channel < channels; channel++, place += sound.channel_bytes) {
            const double sample = usable_at(place, is_double, limit, &unusable);
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

/* Mix stereo to the same bits as `mix` with the weights 0.5, 0.5 in mid and 0.5, -0.5 in side. */
SIMD_CLONES static void mix_pairs(const float *restrict pairs, size_t frames, double *restrict mono,
                           double *restrict side)
{
    for (size_t frame = 0; frame < frames; frame++) {
        const double left = (double)pairs[2 * frame], right = (double)pairs[2 * frame + 1];
        mono[frame] = (left + right) / 2.0;
        side[frame] = (left - right) / 2.0;
    }
}

/* Return whether `mix_pairs` can mix this sound: contiguous, aligned stereo floats of magnitude up to
 * `limit`, with the weights HALVES. */
static int is_usable_stereo(CoreSound sound, size_t channels, const double *weights, size_t frames,
                            double limit)
{
    static const double HALVES[] = {0.5, 0.5, 0.5, -0.5};
    const float as_float = (float)limit;
    return !sound.is_double && channels == 2 && sound.frame_bytes == 8 &&
           sound.channel_bytes == 4 && !memcmp(weights, HALVES, sizeof HALVES) &&
           (uintptr_t)sound.at % sizeof(float) == 0 && (double)as_float == limit &&
           !unusable_floats(sound.at, 2 * frames, as_float);
}

INLINED double filter_band(const Settings *s, double *state, size_t order, double *mono, size_t frames)
{
    double b[ORDER_MAX + 1], a[ORDER_MAX + 1], held[ORDER_MAX], loudest = 0.0;
    memcpy(b, s->band_b.at, (order + 1) * sizeof(double));
    memcpy(a, s->band_a.at, (order + 1) * sizeof(double));
    memcpy(held, state, order * sizeof(double));
    for (size_t frame = 0; frame < frames; frame++) {
        mono[frame] = filter_step(b, a, held, order, mono[frame] + s->denormal_guard);
        loudest = larger(fabs(mono[frame]), loudest);
    }
    memcpy(state, held, order * sizeof(double));
    return loudest;
}

double input_band_pass(const Settings *s, double *state, double *mono, size_t frames)
{
    const size_t order = s->band_b.length - 1;
    if (order == 4)
        return filter_band(s, state, 4, mono, frames);
    if (order == 2)
        return filter_band(s, state, 2, mono, frames);
    return filter_band(s, state, order, mono, frames);
}

double input_band_pass_silence(const Settings *s, double *state, double *mono, size_t frames)
{
    const size_t bytes = (s->band_b.length - 1) * sizeof(double);
    double before[ORDER_MAX];
    memcpy(before, state, bytes);
    memset(mono, 0, frames * sizeof(double));
    const double first = input_band_pass(s, state, mono, 1);
    if (memcmp(before, state, bytes) != 0)
        return larger(input_band_pass(s, state, mono + 1, frames - 1), first);
    /* Silence no longer changes the state, so the output is constant. */
    for (size_t frame = 1; frame < frames; frame++)
        mono[frame] = mono[0];
    return first;
}

/* ---------------------------------------------------------------------------------- cancellation */

/* mix_weights lists layouts: number of channels, channel weights in mid, channel weights in side. */
const double *downmix_weights(const Settings *s, size_t channels)
{
    const Table *table = &s->mix_weights;
    for (size_t at = 0; at < table->length;) {
        const size_t count = (size_t)table->at[at];
        if (count == channels)
            return table->at + at + 1;
        at += 1 + 2 * count;
    }
    return NULL;
}

INLINED double smoothed(double before, double share, double power)
{
    return share * power + (1.0 - share) * before;
}

/* Add `guard` to each of MIX_GROUP samples; return the mean square of these sums. The fixed order of
 * additions gives the same bits on every machine. */
INLINED double power_of(const double *samples, double guard)
{
    double sums[4];
    for (size_t lane = 0; lane < 4; lane++) {
        const double one = samples[lane] + guard, two = samples[lane + 4] + guard;
        const double three = samples[lane + 8] + guard, four = samples[lane + 12] + guard;
        sums[lane] = (one * one + two * two) + (three * three + four * four);
    }
    return ((sums[0] + sums[2]) + (sums[1] + sums[3])) / MIX_GROUP;
}

/* Return the balance, updated with the mean squares of mid and side in a group of frames. */
INLINED MixBalance after_group(const Settings *s, MixBalance old, double of_mean, double of_side)
{
    MixBalance now = {
        .mean = smoothed(old.mean, s->mix_slow, of_mean),
        .side = smoothed(old.side, s->mix_slow, of_side),
        .newest = smoothed(old.newest, s->mix_newest, of_mean + of_side),
        .start = old.end,
    };
    const double both = now.mean + now.side, mean = now.mean + s->mix_evidence * now.newest;
    if (mean < s->mix_cancels_from * both) {
        const double left = s->mix_cancels_from - mean / both;
        const double most = smaller(left / (s->mix_cancels_from - s->mix_cancels_up_to), 1.0);
        now.end = most * most * (3.0 - 2.0 * most);
    }
    return now;
}

/* Add side to mono; the factor of side changes linearly over the group. filled: frames of the group already
 * processed. */
INLINED void add_side(MixBalance now, double filled, double *mono, const double *side, size_t frames)
{
    if (!(now.start > 0.0 || now.end > 0.0))
        return;
    for (size_t frame = 0; frame < frames; frame++) {
        const double share = (filled + (double)frame + 1.0) / MIX_GROUP;
        mono[frame] += (now.start + (now.end - now.start) * share) * side[frame];
    }
}

/* Process frames up to the end of the current group; return the number of processed frames. */
INLINED size_t continue_group(const Settings *s, DownmixState *powers, double *mono, const double *side,
                              size_t frames)
{
    const size_t filled = (size_t)powers->frames, room = MIX_GROUP - filled;
    const size_t part = frames < room ? frames : room;
    const MixBalance now = powers->balance;
    const double *of_mean = mono, *of_side = side;
    if (part < MIX_GROUP) {
        memcpy(powers->of_mean + filled, mono, part * sizeof(double));
        memcpy(powers->of_side + filled, side, part * sizeof(double));
        of_mean = powers->of_mean;
        of_side = powers->of_side;
    }
    if (part == room)
        powers->balance = after_group(s, now, power_of(of_mean, s->mix_power_guard),
                                      power_of(of_side, s->mix_power_guard));
    add_side(now, powers->frames, mono, side, part);
    powers->frames = part == room ? 0.0 : powers->frames + (double)part;
    return part;
}

static void downmix_restore(const Settings *s, DownmixState *powers, double *mono, const double *side,
                            size_t frames)
{
    for (size_t done = 0; done < frames;)
        done += continue_group(s, powers, mono + done, side + done, frames - done);
}

size_t input_mix(const Settings *s, DownmixState *powers, CoreSound sound, size_t channels,
                 const double *weights, size_t frames, double *mono, double *side)
{
    const double limit = s->magnitude_max;
    size_t unusable = 0;
    if (weights && is_usable_stereo(sound, channels, weights, frames, limit))
        mix_pairs(sound.at, frames, mono, side);
    else
        unusable = sound.is_double ? mix(sound, channels, 1, weights, limit, frames, mono, side)
                                   : mix(sound, channels, 0, weights, limit, frames, mono, side);
    if (weights)
        downmix_restore(s, powers, mono, side, frames);
    return unusable;
}

void downmix_rest(const Settings *s, DownmixState *powers, size_t frames)
{
    double mono[MIX_GROUP] = {0.0}, side[MIX_GROUP] = {0.0};
    while (frames) {
        const DownmixState before = *powers;
        const size_t part = frames < MIX_GROUP ? frames : MIX_GROUP;
        downmix_restore(s, powers, mono, side, part);
        frames -= part;
        if (!memcmp(&before, powers, sizeof before))
            frames %= MIX_GROUP; /* the state has become constant, so whole groups are skipped */
    }
}

/* Sound as a host hands it over: measured, scaled and mixed. */

#include "core_parts.h"

#include "../transform/native/exact.h"

#define RMS_TIME_S 0.3
#define PEAK_FALL_DB_PER_S 20.0
#define INAUDIBLE 2.8e-8 /* -151 dBFS counts as silence, so that nothing becomes denormal */

/* Add samples to their largest magnitude and the sum of their squares; what is not finite is left out. Four
 * sums side by side do not wait for each other. */
#define GATHER(type)                                                                               \
    for (size_t frame = 0; frame < frames; frame++, at += sound.frame_bytes) {                     \
        const double size = fabs((double)*(const type *)(const void *)at);                         \
        const double sample = size < INFINITY ? size : 0.0;                                        \
        loudest[frame % 4] = larger(sample, loudest[frame % 4]);                                   \
        sums[frame % 4] += sample * sample;                                                        \
    }

void sound_measure(CoreLevel *level, CoreSound sound, size_t channel, size_t frames, double samplerate)
{
    const char *at = (const char *)sound.at + (ptrdiff_t)channel * sound.channel_bytes;
    double loudest[4] = {0.0}, sums[4] = {0.0};
    if (sound.is_double)
        GATHER(double)
    else
        GATHER(float)
    const double sum = (sums[0] + sums[1]) + (sums[2] + sums[3]);
    const double seconds = (double)frames / samplerate, keep = exact_exp(-seconds / RMS_TIME_S);
    const double held = level->peak * exact_amplitude(-seconds * PEAK_FALL_DB_PER_S);
    const double most = larger(larger(loudest[0], loudest[1]), larger(loudest[2], loudest[3]));
    const double peak = larger(most, held);
    const double square = keep * level->mean_square + (1.0 - keep) * sum / (double)frames;
    level->peak = peak > INAUDIBLE ? peak : 0.0;
    level->mean_square = square > INAUDIBLE * INAUDIBLE && square < INFINITY ? square : 0.0;
}

void sound_scale(Core *core, CoreSound sound, size_t frames, double from, double to, double first,
                        double call_frames)
{
    const size_t inputs = core->design.info.inputs;
    const int amplifies = from > 1.0 || to > 1.0;
    const CoreDesign *design = &core->design;
    const double usable = design->has_transform ? design->settings.magnitude_max : INFINITY;
    double *out = core->sound;
    for (size_t frame = 0; frame < frames; frame++) {
        const double share = (first + (double)frame + 1.0) / call_frames;
        const double gain = from + (to - from) * share;
        for (size_t channel = 0; channel < inputs; channel++) {
            const double given = sample_at(sound, frame, channel);
            double sample = gain * given;
            if (amplifies && fabs(given) <= usable)
                sample = sample > 1.0 ? 1.0 : sample < -1.0 ? -1.0 : sample;
            *out++ = sample;
        }
    }
}

void sound_mix(Core *core, CoreSound sound, size_t frames)
{
    const size_t inputs = core->design.info.inputs, sources = core->design.info.vibrations;
    const Settings *settings = &core->design.settings;
    double *mean = core->mixed + PIECE_FRAMES * sources, *side = mean + PIECE_FRAMES;
    for (size_t source = 0; source < sources; source++) {
        const double *in_mean = core->design.weights + 2 * source * inputs;
        const double *in_side = in_mean + inputs;
        for (size_t frame = 0; frame < frames; frame++) {
            mean[frame] = side[frame] = 0.0;
            for (size_t channel = 0; channel < inputs; channel++) {
                double sample = sample_at(sound, frame, channel);
                if (!(fabs(sample) <= settings->magnitude_max)) {
                    sample = 0.0;
                    core->replaced += source == 0;
                }
                mean[frame] += sample * in_mean[channel];
                side[frame] += sample * in_side[channel];
            }
        }
        downmix_restore(settings, &core->powers[source], mean, side, frames);
        for (size_t frame = 0; frame < frames; frame++)
            core->mixed[frame * sources + source] = mean[frame];
    }
}

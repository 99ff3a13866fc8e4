/* The daemon's transform. */

#include "daemon_transform.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../../transform/native/downmix.h"
#include "../../transform/native/live.h"
#include "design_file.h"
#include "level_meter.h"

#define PIECE_FRAMES 1024

struct DaemonTransform {
    Page *page;
    TransformWishes wishes;
    Design design;
    Live live;
    LevelMeter sound, vibration;
    LevelMeter channels[PAGE_CHANNELS]; /* of the sound */
    uint64_t frames, replaced, hops;
    double sound_gain; /* of the last frame */
    int is_silent;     /* the design is for another samplerate: the daemon makes another chain */
    float samples[PIECE_FRAMES * PAGE_CHANNELS];
    MixPowers powers[PAGE_CHANNELS]; /* of the mixes */
    double mean[PIECE_FRAMES], side[PIECE_FRAMES];
    double mixed[PIECE_FRAMES * PAGE_CHANNELS];
    double computed[PIECE_FRAMES * PAGE_CHANNELS];
};

static int wishes_fit(const TransformWishes *wishes)
{
    const uint64_t channels = wishes->channels, outputs = wishes->outputs;
    return channels >= 1 && channels <= PAGE_CHANNELS && outputs >= 1 && outputs <= PAGE_CHANNELS &&
           (wishes->mixed || outputs == 1 || outputs == channels);
}

/* Read the design of the daemon's page. A host that runs at another rate than the daemon expected is
 * told so by the page, and gets silence until the daemon has made a chain for its rate. */
static int open_design(DaemonTransform *transform, unsigned long samplerate)
{
    const char *path = getenv("HAPTIC_CUSHION_DESIGN");
    if (!transform->page || !path)
        return design_find(&transform->design, "paper", samplerate);
    PAGE_STORE(transform->page->readings.samplerate, samplerate);
    const char *problem = design_read(&transform->design, path);
    if (problem) {
        fprintf(stderr, "haptic_cushion: the design %s cannot be used: %s\n", path, problem);
        return 0;
    }
    transform->is_silent = transform->design.samplerate != samplerate;
    return 1;
}

DaemonTransform *daemon_transform_open(unsigned long samplerate)
{
    DaemonTransform *transform = calloc(1, sizeof *transform);
    if (!transform)
        return NULL;
    transform->page = page_open();
    if (transform->page)
        transform->wishes = transform->page->transform;
    else
        transform->wishes = (TransformWishes){.channels = 2, .outputs = 1};
    const TransformWishes *wishes = &transform->wishes;
    if (!wishes_fit(wishes)) {
        fprintf(stderr, "haptic_cushion: the daemon's page does not fit this plugin\n");
        daemon_transform_close(transform);
        return NULL;
    }
    const size_t channels = (size_t)(wishes->mixed ? wishes->outputs : wishes->channels);
    const int each = wishes->mixed || wishes->outputs > 1;
    if (!open_design(transform, samplerate) ||
        live_open(&transform->live, &transform->design.settings, channels, each)) {
        daemon_transform_close(transform);
        return NULL;
    }
    transform->sound_gain = 1.0;
    if (transform->page)
        PAGE_LOAD(transform->page->sound_gain, transform->sound_gain);
    transform->sound.samplerate = transform->vibration.samplerate = (double)samplerate;
    for (size_t channel = 0; channel < PAGE_CHANNELS; channel++)
        transform->channels[channel].samplerate = (double)samplerate;
    return transform;
}

void daemon_transform_close(DaemonTransform *transform)
{
    if (!transform)
        return;
    live_close(&transform->live);
    design_close(&transform->design);
    page_close(transform->page);
    free(transform);
}

void daemon_transform_reset(DaemonTransform *transform)
{
    live_reset(&transform->live);
    memset(transform->powers, 0, sizeof transform->powers);
}

/* Mix by the weights, channel by channel in order, as transform/input_stage.py does. */
static void mix(DaemonTransform *transform, size_t frames)
{
    const TransformWishes *wishes = &transform->wishes;
    const size_t channels = (size_t)wishes->channels, outputs = (size_t)wishes->outputs;
    const double most = transform->design.settings.magnitude_max;
    for (size_t at = 0; at < frames * channels; at++) {
        if (!(fabsf(transform->samples[at]) <= most)) {
            transform->samples[at] = 0.0f;
            transform->replaced++;
        }
    }
    for (size_t output = 0; output < outputs; output++) {
        const double *in_mean = wishes->weights[output][0], *in_side = wishes->weights[output][1];
        for (size_t frame = 0; frame < frames; frame++) {
            const float *samples = transform->samples + frame * channels;
            double of_mean = 0.0, of_side = 0.0;
            for (size_t channel = 0; channel < channels; channel++) {
                of_mean += (double)samples[channel] * in_mean[channel];
                of_side += (double)samples[channel] * in_side[channel];
            }
            transform->mean[frame] = of_mean;
            transform->side[frame] = of_side;
        }
        downmix_restore(&transform->design.settings, &transform->powers[output], transform->mean,
                        transform->side, frames);
        for (size_t frame = 0; frame < frames; frame++)
            transform->mixed[frame * outputs + output] = transform->mean[frame];
    }
}

/* Undo the listener's volume, as daemon/capture_queue.py does. */
static void apply_gain(DaemonTransform *transform, size_t frames)
{
    double wanted = 1.0;
    if (transform->page)
        PAGE_LOAD(transform->page->sound_gain, wanted);
    const double before = transform->sound_gain;
    if (wanted == 1.0 && before == 1.0)
        return;
    const size_t channels = (size_t)transform->wishes.channels;
    transform->sound_gain = wanted;
    const int loud = wanted > 1.0 || before > 1.0; /* no sample over full scale then */
    for (size_t frame = 0; frame < frames; frame++) {
        const float gain = (float)(before + (wanted - before) * (double)(frame + 1) / (double)frames);
        for (size_t channel = 0; channel < channels; channel++) {
            float *const sample = &transform->samples[frame * channels + channel];
            *sample *= gain;
            if (loud && *sample > 1.0f)
                *sample = 1.0f;
            else if (loud && *sample < -1.0f)
                *sample = -1.0f;
        }
    }
}

static void process_piece(DaemonTransform *transform, float *const *inputs, float *const *outputs,
                          size_t done, size_t frames)
{
    const TransformWishes *wishes = &transform->wishes;
    const size_t channels = (size_t)wishes->channels, count = (size_t)wishes->outputs;
    for (size_t channel = 0; channel < channels; channel++)
        for (size_t frame = 0; frame < frames; frame++)
            transform->samples[frame * channels + channel] =
                inputs[channel] ? inputs[channel][done + frame] : 0.0f;
    apply_gain(transform, frames);
    level_add(&transform->sound, transform->samples, frames * channels, channels);
    for (size_t channel = 0; channel < channels; channel++)
        level_add_channel(&transform->channels[channel], transform->samples + channel, frames,
                          channels);
    if (wishes->mixed)
        mix(transform, frames);
    const size_t width = wishes->mixed ? sizeof(double) : sizeof(float);
    const size_t taken = wishes->mixed ? count : channels;
    const Sound sound = {
        .at = wishes->mixed ? (const char *)transform->mixed : (const char *)transform->samples,
        .frame_bytes = (ptrdiff_t)(taken * width),
        .channel_bytes = (ptrdiff_t)width,
        .channels = taken,
        .is_float = !wishes->mixed,
    };
    live_process(&transform->live, sound, frames, transform->computed);
    for (size_t at = 0; at < frames * count; at++)
        transform->samples[at] = (float)transform->computed[at];
    level_add(&transform->vibration, transform->samples, frames * count, count);
    for (size_t output = 0; output < PAGE_CHANNELS; output++) {
        if (!outputs[output])
            continue;
        for (size_t frame = 0; frame < frames; frame++)
            outputs[output][done + frame] =
                output < count ? transform->samples[frame * count + output] : 0.0f;
    }
}

/* Tell what the latest hop vibrates, once for each hop. */
static void tell(DaemonTransform *transform)
{
    const Told *told = &transform->live.told;
    if (told->hops == transform->hops)
        return;
    transform->hops = told->hops;
    PartialReadings *readings = &transform->page->partials;
    const uint64_t sequence = readings->sequence, count = told->count;
    PAGE_STORE(readings->sequence, sequence + 1);
    __atomic_thread_fence(__ATOMIC_RELEASE);
    PAGE_STORE(readings->count, count);
    for (size_t one = 0; one < told->count; one++) {
        PAGE_STORE(readings->partials[one][0], told->audio_hz[one]);
        PAGE_STORE(readings->partials[one][1], told->hz[one]);
        PAGE_STORE(readings->partials[one][2], told->amplitude[one]);
    }
    __atomic_thread_fence(__ATOMIC_RELEASE);
    PAGE_STORE(readings->sequence, sequence + 2);
}

void daemon_transform_process(DaemonTransform *transform, float *const *inputs,
                              float *const *outputs, size_t frames)
{
    for (size_t output = 0; transform->is_silent && output < PAGE_CHANNELS; output++)
        if (outputs[output])
            memset(outputs[output], 0, frames * sizeof *outputs[output]);
    for (size_t done = 0; !transform->is_silent && done < frames;) {
        const size_t left = frames - done, part = left < PIECE_FRAMES ? left : PIECE_FRAMES;
        process_piece(transform, inputs, outputs, done, part);
        done += part;
    }
    transform->frames += frames;
    if (transform->page) {
        TransformReadings *readings = &transform->page->readings;
        PAGE_STORE(readings->frames, transform->frames);
        PAGE_STORE(readings->cycle_frames, frames);
        PAGE_STORE(readings->replaced, transform->replaced + transform->live.replaced);
        PAGE_STORE(readings->limited, transform->live.limited);
        PAGE_STORE(readings->sound_peak, transform->sound.peak);
        PAGE_STORE(readings->sound_square, transform->sound.square);
        PAGE_STORE(readings->vibration_peak, transform->vibration.peak);
        PAGE_STORE(readings->vibration_square, transform->vibration.square);
        for (size_t channel = 0; channel < (size_t)transform->wishes.channels; channel++) {
            PAGE_STORE(readings->channels[channel][0], transform->channels[channel].peak);
            PAGE_STORE(readings->channels[channel][1], transform->channels[channel].square);
        }
        tell(transform);
    }
}

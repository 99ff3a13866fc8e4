/* The transform of one source, and where its design is found. */

#ifndef _GNU_SOURCE
#define _GNU_SOURCE /* dladdr */
#endif

#include "source.h"

#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PATH_BYTES 4096

/* ------------------------------------------------------------------------------- where designs are */

/* The folders in which designs are looked for: the user's data folder, then beside the plugin. */
static int folder_of(size_t which, char *folder)
{
    const char *data = getenv("XDG_DATA_HOME"), *home = getenv("HOME");
    Dl_info found;
    int length = -1;
    if (which == 0 && data && *data == '/')
        length = snprintf(folder, PATH_BYTES, "%s/haptic-cushion", data);
    else if (which == 0 && home && *home == '/')
        length = snprintf(folder, PATH_BYTES, "%s/.local/share/haptic-cushion", home);
    if (which == 1 && dladdr((const void *)(uintptr_t)&source_open, &found) && found.dli_fname) {
        const char *end = strrchr(found.dli_fname, '/');
        const size_t bytes = end ? (size_t)(end - found.dli_fname) : 0;
        length = snprintf(folder, PATH_BYTES, "%.*s", (int)bytes, end ? found.dli_fname : ".");
    }
    return length > 0 && length < PATH_BYTES;
}

/* Read the design of a profile; return whether it fits. A file that does not fit ends the search,
 * so that an old design is never used without a word. */
static int find_design(Design *design, const char *profile, unsigned long samplerate)
{
    char folder[PATH_BYTES], path[PATH_BYTES + 64];
    const char *given = getenv("HAPTIC_CUSHION_DESIGN");
    const char *problem = NULL;
    for (size_t which = 0; which < 2; which++) {
        if (given && *given)
            snprintf(path, sizeof path, "%s", given);
        else if (folder_of(which, folder))
            snprintf(path, sizeof path, "%s/designs/%s-%lu.design", folder, profile, samplerate);
        else
            continue;
        FILE *file = fopen(path, "rb");
        if (!file)
            continue;
        fclose(file);
        problem = design_read(design, path);
        if (!problem && design->samplerate != samplerate) {
            design_close(design);
            problem = "it is for another samplerate";
        }
        if (problem)
            fprintf(stderr,
                    "haptic_cushion: the design %s cannot be used: %s; make it again with "
                    "`cushion plugin install --rate %lu`\n",
                    path, problem, samplerate);
        return !problem;
    }
    fprintf(stderr,
            "haptic_cushion: no design of profile %s for %lu Hz; make it with "
            "`cushion plugin install --rate %lu`\n",
            profile, samplerate, samplerate);
    return 0;
}

/* --------------------------------------------------------------------------------------- a source */

Source *source_open(const char *profile, unsigned long samplerate, size_t channels)
{
    Source *source = channels <= CHANNELS_MAX ? calloc(1, sizeof *source) : NULL;
    if (!source)
        return NULL;
    if (!find_design(&source->design, profile, samplerate)) {
        free(source);
        return NULL;
    }
    if (live_open(&source->live, &source->design.settings, channels, 0)) {
        fprintf(stderr, "haptic_cushion: not enough memory for profile %s\n", profile);
        design_close(&source->design);
        free(source);
        return NULL;
    }
    source->sound.samplerate = source->vibration.samplerate = (double)samplerate;
    return source;
}

void source_close(Source *source)
{
    if (!source)
        return;
    live_close(&source->live);
    design_close(&source->design);
    free(source);
}

void source_reset(Source *source)
{
    live_reset(&source->live);
    source->sound.peak = source->sound.square = 0.0;
    source->vibration.peak = source->vibration.square = 0.0;
}

void source_process(Source *source, const float *const *inputs, float *vibration, size_t frames)
{
    const size_t channels = source->live.channels;
    for (size_t channel = 0; channel < channels; channel++)
        for (size_t frame = 0; frame < frames; frame++)
            source->samples[frame * channels + channel] =
                inputs[channel] ? inputs[channel][frame] : 0.0f;
    const Sound sound = {
        .at = (const char *)source->samples,
        .frame_bytes = (ptrdiff_t)(channels * sizeof(float)),
        .channel_bytes = sizeof(float),
        .channels = channels,
        .is_float = 1,
    };
    live_process(&source->live, sound, frames, source->computed);
    for (size_t frame = 0; frame < frames; frame++)
        vibration[frame] = (float)source->computed[frame];
    source->frames += frames;
    level_add(&source->sound, source->samples, frames * channels, channels);
    level_add(&source->vibration, vibration, frames, 1);
}

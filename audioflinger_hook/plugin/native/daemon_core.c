/* The plugin that the daemon controls through a page of shared memory. */

#include "parts.h"

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#define PIECE_FRAMES 1024

struct DaemonCore {
    Page *page;
    LoadedCore loaded;
    CoreControls controls; /* defaults for use without a page: all actuators are audible */
    int is_silent; /* the design is unusable, or its sample rate differs from the host's */
    float sound[PIECE_FRAMES * DAEMON_INPUTS], signals[PIECE_FRAMES * CORE_ACTUATORS];
};

/* Map the file that HAPTIC_CUSHION_PAGE names. Return NULL without this variable or a usable file. */
static Page *page_open(void)
{
    const char *path = getenv("HAPTIC_CUSHION_PAGE");
    struct stat facts;
    if (!path || !*path)
        return NULL;
    const int file = open(path, O_RDWR | O_CLOEXEC);
    if (file < 0)
        return NULL;
    Page *page = NULL;
    if (!fstat(file, &facts) && facts.st_size == sizeof(Page)) {
        void *place = mmap(NULL, sizeof(Page), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
        page = place == MAP_FAILED ? NULL : place;
    }
    close(file);
    if (page && (page->magic != PAGE_MAGIC || page->size != sizeof(Page))) {
        munmap(page, sizeof(Page));
        return NULL;
    }
    return page;
}

/* Write the host's sample rate into the page. With a page, load the design that HAPTIC_CUSHION_DESIGN names.
 * Without a page or this variable, use core_find, and return 0 if no core is found. If the design is unusable
 * or has another rate, output silence. */
static int load(DaemonCore *daemon, unsigned long samplerate)
{
    const char *path = daemon->page ? getenv("HAPTIC_CUSHION_DESIGN") : NULL;
    const char *misfit = NULL;
    if (daemon->page)
        __atomic_store_n(&daemon->page->samplerate, samplerate, __ATOMIC_RELAXED);
    if (path)
        misfit = core_load(&daemon->loaded, path);
    else if (core_find(&daemon->loaded, "paper", samplerate) != 1)
        return 0;
    if (!misfit && daemon->loaded.info.inputs > DAEMON_INPUTS)
        misfit = "it has too many channels";
    if (misfit) {
        fprintf(stderr, "haptic_cushion: the design %s cannot be used: %s\n", path ? path : "found", misfit);
        core_unload(&daemon->loaded);
    }
    daemon->is_silent = misfit || daemon->loaded.info.samplerate != samplerate;
    return 1;
}

DaemonCore *daemon_core_open(unsigned long samplerate)
{
    DaemonCore *daemon = calloc(1, sizeof *daemon);
    if (!daemon)
        return NULL;
    daemon->page = page_open();
    const int is_refused = !daemon->page && getenv("HAPTIC_CUSHION_PAGE");
    if (is_refused)
        fprintf(stderr, "haptic_cushion: the daemon's page cannot be used: it is of another version\n");
    daemon->controls.sound_gain = 1.0;
    for (size_t which = 0; which < CORE_ACTUATORS; which++) {
        daemon->controls.actuators[which].gain = 1.0;
        daemon->controls.actuators[which].audible = 1;
    }
    if (is_refused || !load(daemon, samplerate)) {
        daemon_core_close(daemon);
        return NULL;
    }
    return daemon;
}

void daemon_core_close(DaemonCore *daemon)
{
    if (!daemon)
        return;
    core_unload(&daemon->loaded);
    if (daemon->page)
        munmap(daemon->page, sizeof(Page));
    free(daemon);
}

void daemon_core_reset(DaemonCore *daemon)
{
    if (daemon->loaded.core)
        core_reset(daemon->loaded.core, 0);
}

static void process_piece(DaemonCore *daemon, float *const *inputs, float *const *outputs, size_t first,
                          size_t frames)
{
    const CoreInfo *info = &daemon->loaded.info;
    const size_t channels = info->inputs;
    const size_t signals = info->actuators ? info->actuators : info->vibrations;
    for (size_t channel = 0; channel < channels; channel++)
        for (size_t frame = 0; frame < frames; frame++)
            daemon->sound[frame * channels + channel] =
                inputs[channel] ? inputs[channel][first + frame] : 0.0f;
    const CoreSound sound = {daemon->sound, (ptrdiff_t)(channels * sizeof(float)), sizeof(float), 0};
    core_process(daemon->loaded.core, daemon->page ? &daemon->page->controls : &daemon->controls, sound,
                 daemon->signals, frames, daemon->page ? &daemon->page->readings : NULL);
    for (size_t output = 0; output < DAEMON_OUTPUTS; output++)
        for (size_t frame = 0; outputs[output] && frame < frames; frame++)
            outputs[output][first + frame] =
                output < signals ? daemon->signals[frame * signals + output] : 0.0f;
}

void daemon_core_process(DaemonCore *daemon, float *const inputs[DAEMON_INPUTS],
                         float *const outputs[DAEMON_OUTPUTS], size_t frames)
{
    for (size_t output = 0; daemon->is_silent && output < DAEMON_OUTPUTS; output++)
        if (outputs[output])
            memset(outputs[output], 0, frames * sizeof(float));
    for (size_t done = 0; !daemon->is_silent && done < frames;) {
        const size_t left = frames - done, part = left < PIECE_FRAMES ? left : PIECE_FRAMES;
        process_piece(daemon, inputs, outputs, done, part);
        done += part;
    }
    if (daemon->page)
        __atomic_store_n(&daemon->page->cycle_frames, (uint64_t)frames, __ATOMIC_RELAXED);
}

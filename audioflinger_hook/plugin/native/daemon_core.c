/* The plugin that the daemon controls through a page of shared memory. */

#include "parts.h"
#include "../../transform/native/exact.h"
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#define PIECE_FRAMES 1024
#define HEARS_S 0.2 /* sound that a new core plays before it is audible; no onset is then new to it */
#define FADE_S 0.04 /* cross-fade to the new core */

struct DaemonCore {
    Page *page;
    DesignLoader *loader;
    NumberedCore *core;      /* the audible core; not loaded: silence */
    NumberedCore *following; /* the next core, or NULL */
    size_t heard;            /* frames that `following` has processed */
    size_t hears;            /* frames that it processes before it is audible */
    double samplerate;
    CoreControls controls; /* defaults for use without a page: all actuators are audible */
    float sound[PIECE_FRAMES * DAEMON_INPUTS];
    float signals[PIECE_FRAMES * CORE_ACTUATORS], next_signals[PIECE_FRAMES * CORE_ACTUATORS];
};

/* Map the file at `path`. Return NULL without a path or a usable file. */
static Page *page_open(const char *path)
{
    struct stat facts;
    const int file = path ? open(path, O_RDWR | O_CLOEXEC) : -1;
    const int is_whole = file >= 0 && !fstat(file, &facts) && facts.st_size == sizeof(Page);
    const int access = PROT_READ | PROT_WRITE;
    Page *page = is_whole ? mmap(NULL, sizeof(Page), access, MAP_SHARED, file, 0) : MAP_FAILED;
    close(file);
    if (page == MAP_FAILED)
        return NULL;
    if (page->magic == PAGE_MAGIC && page->size == sizeof(Page))
        return page;
    munmap(page, sizeof(Page));
    return NULL;
}

/* Create the first core. With a page, write the host's sample rate and load the page's design; if it is
 * unusable, output silence. Without a page, use core_find, and return 0 if no core is found. */
static int load(DaemonCore *daemon, unsigned long samplerate)
{
    Page *page = daemon->page;
    const char *misfit = NULL;
    if (page) {
        __atomic_store_n(&page->samplerate, samplerate, __ATOMIC_RELAXED);
        misfit = numbered_core_load(daemon->core, page, samplerate);
        __atomic_store_n(&page->playing, daemon->core->number, __ATOMIC_RELEASE);
        daemon->loader = design_loader_open(page, samplerate);
    } else if (core_find(&daemon->core->loaded, "paper", samplerate) != 1) {
        return 0;
    } else if (daemon->core->loaded.info.inputs > DAEMON_INPUTS) {
        misfit = "it has too many channels";
        core_unload(&daemon->core->loaded);
    }
    if (misfit)
        fprintf(stderr, "haptic_cushion: the design cannot be used: %s\n", misfit);
    return 1;
}

DaemonCore *daemon_core_open(unsigned long samplerate)
{
    DaemonCore *daemon = calloc(1, sizeof *daemon);
    if (!daemon)
        return NULL;
    daemon->core = calloc(1, sizeof *daemon->core);
    daemon->samplerate = (double)samplerate;
    const char *set = getenv("HAPTIC_CUSHION_PAGE"), *path = set && *set ? set : NULL; /* empty: unset */
    daemon->page = page_open(path);
    const int is_refused = !daemon->page && path;
    if (is_refused)
        fprintf(stderr, "haptic_cushion: the daemon's page cannot be used: it is of another version\n");
    daemon->controls.sound_gain = 1.0;
    for (size_t which = 0; which < CORE_ACTUATORS; which++) {
        daemon->controls.actuators[which].gain = 1.0;
        daemon->controls.actuators[which].audible = 1;
    }
    if (is_refused || !daemon->core || !load(daemon, samplerate)) {
        daemon_core_close(daemon);
        return NULL;
    }
    return daemon;
}

void daemon_core_close(DaemonCore *daemon)
{
    if (!daemon)
        return;
    design_loader_close(daemon->loader);
    numbered_cores_free(daemon->core);
    numbered_cores_free(daemon->following);
    if (daemon->page)
        munmap(daemon->page, sizeof(Page));
    free(daemon);
}

void daemon_core_reset(DaemonCore *daemon)
{
    NumberedCore *cores[] = {daemon->core, daemon->following};
    for (size_t which = 0; which < 2; which++)
        if (cores[which] && cores[which]->loaded.core)
            core_reset(cores[which]->loaded.core, 0);
}

/* Signals of one core, (frames, count), in interleaved frames. */
typedef struct {
    const float *at;
    size_t count;
} Signals;

static Signals process_core(DaemonCore *daemon, NumberedCore *core, float *const *inputs, float *out,
                            size_t first, size_t frames)
{
    const CoreInfo *info = &core->loaded.info;
    const size_t channels = info->inputs;
    PageBank *bank = daemon->page ? &daemon->page->banks[core->number % PAGE_BANKS] : NULL;
    if (!core->loaded.core)
        return (Signals){out, 0};
    for (size_t channel = 0; channel < channels; channel++)
        for (size_t frame = 0; frame < frames; frame++)
            daemon->sound[frame * channels + channel] =
                inputs[channel] ? inputs[channel][first + frame] : 0.0f;
    const CoreSound sound = {daemon->sound, (ptrdiff_t)(channels * sizeof(float)), sizeof(float), 0};
    core_process(core->loaded.core, bank ? &bank->controls : &daemon->controls, sound, out, frames,
                 bank ? &bank->readings : NULL);
    return (Signals){out, info->actuators ? info->actuators : info->vibrations};
}

static float signal_at(Signals signals, size_t output, size_t frame)
{
    return output < signals.count ? signals.at[frame * signals.count + output] : 0.0f;
}

/* Take the next core, if there is one. It first fills its delay lines, then processes HEARS_S of sound. */
static void take_following(DaemonCore *daemon)
{
    const NumberedCore *next = daemon->following = design_loader_take(daemon->loader);
    const PageBank *bank = &daemon->page->banks[next ? next->number % PAGE_BANKS : 0];
    double delay = 0.0;
    for (size_t which = 0; which < CORE_ACTUATORS; which++)
        delay = fmax(delay, bank->controls.actuators[which].delay_frames);
    daemon->heard = 0;
    daemon->hears = (size_t)(HEARS_S * daemon->samplerate + delay);
}

/* Return how much of `following` is audible in a frame of this piece, 0 to 1. */
static float share_of_following(const DaemonCore *daemon, size_t frame)
{
    const double after = (double)(daemon->heard + frame + 1) - (double)daemon->hears;
    return (float)smooth_step(clip(after / (FADE_S * daemon->samplerate), 0.0, 1.0));
}

static void process_piece(DaemonCore *daemon, float *const *inputs, float *const *outputs, size_t first,
                          size_t frames)
{
    if (daemon->loader && !daemon->following)
        take_following(daemon);
    const int changes = daemon->following != NULL;
    const Signals now = process_core(daemon, daemon->core, inputs, daemon->signals, first, frames);
    const Signals next = !changes ? (Signals){NULL, 0}
        : process_core(daemon, daemon->following, inputs, daemon->next_signals, first, frames);
    for (size_t output = 0; output < DAEMON_OUTPUTS; output++)
        for (size_t frame = 0; outputs[output] && frame < frames; frame++) {
            const float share = changes ? share_of_following(daemon, frame) : 0.0f;
            float sample = signal_at(share < 1.0f ? now : next, output, frame);
            if (share > 0.0f && share < 1.0f)
                sample += share * (signal_at(next, output, frame) - sample);
            outputs[output][first + frame] = sample;
        }
    daemon->heard += frames;
    if (changes && share_of_following(daemon, 0) >= 1.0f) {
        design_loader_return(daemon->loader, daemon->core);
        daemon->core = daemon->following;
        daemon->following = NULL;
        __atomic_store_n(&daemon->page->playing, daemon->core->number, __ATOMIC_RELEASE);
    }
}

void daemon_core_process(DaemonCore *daemon, float *const inputs[DAEMON_INPUTS],
                         float *const outputs[DAEMON_OUTPUTS], size_t frames)
{
    for (size_t done = 0; done < frames;) {
        const size_t left = frames - done, part = left < PIECE_FRAMES ? left : PIECE_FRAMES;
        process_piece(daemon, inputs, outputs, done, part);
        done += part;
    }
    if (daemon->page)
        __atomic_store_n(&daemon->page->cycle_frames, (uint64_t)frames, __ATOMIC_RELAXED);
}

/* Loads the designs that the daemon wants, while the host's audio thread continues. */

#include "parts.h"
#include <fcntl.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#define PATH_BYTES 4096

struct DesignLoader {
    pthread_t thread;
    int changes; /* the FIFO, open for reading and writing, so that reading never reaches its end */
    int ends;
    unsigned long samplerate;
    Page *page;
    NumberedCore *offered;  /* for the audio thread, or NULL */
    NumberedCore *returned; /* list of cores that the audio thread has given back */
};

const char *numbered_core_load(NumberedCore *core, const Page *page, unsigned long samplerate)
{
    char path[PATH_BYTES];
    const char *base = getenv("HAPTIC_CUSHION_DESIGN");
    core->number = __atomic_load_n(&page->wanted, __ATOMIC_ACQUIRE);
    int length = snprintf(path, sizeof path, "%s", base ? base : "");
    if (core->number)
        length = snprintf(path, sizeof path, "%s.%llu", base ? base : "", (unsigned long long)core->number);
    if (length < 0 || length >= PATH_BYTES)
        return "its path is too long";
    const char *misfit = core_load(&core->loaded, path);
    if (!misfit && core->loaded.info.inputs > DAEMON_INPUTS)
        misfit = "it has too many channels";
    if (!misfit && core->loaded.info.samplerate != samplerate)
        misfit = "it is for another samplerate";
    if (misfit)
        core_unload(&core->loaded);
    return misfit;
}

void numbered_cores_free(NumberedCore *core)
{
    while (core) {
        NumberedCore *next = core->next;
        core_unload(&core->loaded);
        free(core);
        core = next;
    }
}

/* Load the wanted design and offer it instead of an earlier one. */
static void offer(DesignLoader *loader)
{
    NumberedCore *core = calloc(1, sizeof *core);
    const char *misfit = core ? numbered_core_load(core, loader->page, loader->samplerate)
                              : "there is not enough memory";
    if (misfit) {
        const uint64_t wanted = core ? core->number : loader->page->wanted;
        fprintf(stderr, "haptic_cushion: the changed design cannot be used: %s\n", misfit);
        __atomic_store_n(&loader->page->refused, wanted, __ATOMIC_RELEASE);
        free(core);
        return;
    }
    numbered_cores_free(__atomic_exchange_n(&loader->offered, core, __ATOMIC_ACQ_REL));
}

static void *follow_changes(void *given)
{
    DesignLoader *loader = given;
    const struct sched_param normal = {0};
    char byte;
    pthread_setschedparam(pthread_self(), SCHED_OTHER, &normal); /* not that of a real-time thread */
    while (read(loader->changes, &byte, 1) == 1 && !__atomic_load_n(&loader->ends, __ATOMIC_ACQUIRE)) {
        numbered_cores_free(__atomic_exchange_n(&loader->returned, NULL, __ATOMIC_ACQ_REL));
        offer(loader);
    }
    return NULL;
}

DesignLoader *design_loader_open(Page *page, unsigned long samplerate)
{
    const char *path = getenv("HAPTIC_CUSHION_CHANGES");
    DesignLoader *loader = path ? calloc(1, sizeof *loader) : NULL;
    if (!loader)
        return NULL;
    loader->page = page;
    loader->samplerate = samplerate;
    loader->changes = open(path, O_RDWR | O_CLOEXEC);
    if (loader->changes >= 0 && !pthread_create(&loader->thread, NULL, follow_changes, loader))
        return loader;
    close(loader->changes);
    free(loader);
    return NULL;
}

void design_loader_close(DesignLoader *loader)
{
    if (!loader)
        return;
    __atomic_store_n(&loader->ends, 1, __ATOMIC_RELEASE);
    if (write(loader->changes, "", 1) == 1)
        pthread_join(loader->thread, NULL);
    close(loader->changes);
    numbered_cores_free(loader->offered);
    numbered_cores_free(loader->returned);
    free(loader);
}

NumberedCore *design_loader_take(DesignLoader *loader)
{
    return __atomic_exchange_n(&loader->offered, NULL, __ATOMIC_ACQ_REL);
}

/* The thread only ever empties the list, so the loop repeats at most once. */
void design_loader_return(DesignLoader *loader, NumberedCore *core)
{
    core->next = __atomic_load_n(&loader->returned, __ATOMIC_RELAXED);
    while (!__atomic_compare_exchange_n(&loader->returned, &core->next, core, 0, __ATOMIC_RELEASE,
                                        __ATOMIC_RELAXED))
        continue;
}

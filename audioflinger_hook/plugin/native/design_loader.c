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

static void free_cores(NumberedCore *core)
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
    free_cores(__atomic_exchange_n(&loader->offered, core, __ATOMIC_ACQ_REL));
}

static void *follow_changes(void *given)
{
    DesignLoader *loader = given;
    char byte;
    while (read(loader->changes, &byte, 1) == 1 && !__atomic_load_n(&loader->ends, __ATOMIC_ACQUIRE)) {
        free_cores(__atomic_exchange_n(&loader->returned, NULL, __ATOMIC_ACQ_REL));
        offer(loader);
    }
    return NULL;
}

/* Start the thread. It must not inherit the priority of a real-time thread. */
static int start(DesignLoader *loader)
{
    const struct sched_param normal = {0};
    pthread_attr_t attributes;
    if (pthread_attr_init(&attributes))
        return 0;
    const int started = !pthread_attr_setinheritsched(&attributes, PTHREAD_EXPLICIT_SCHED) &&
                        !pthread_attr_setschedpolicy(&attributes, SCHED_OTHER) &&
                        !pthread_attr_setschedparam(&attributes, &normal) &&
                        !pthread_create(&loader->thread, &attributes, follow_changes, loader);
    pthread_attr_destroy(&attributes);
    return started;
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
    if (loader->changes >= 0 && start(loader))
        return loader;
    if (loader->changes >= 0)
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
    free_cores(loader->offered);
    free_cores(loader->returned);
    free(loader);
}

NumberedCore *design_loader_take(DesignLoader *loader)
{
    if (!__atomic_load_n(&loader->offered, __ATOMIC_RELAXED))
        return NULL;
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

/* Finds design files and creates cores from them. */

#ifndef _GNU_SOURCE
#define _GNU_SOURCE /* dladdr */
#endif

#include "parts.h"

#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SIZE_MAX_BYTES ((long)64 << 20) /* largest accepted file */
#define ALIGNMENT 16

static char *contents(const char *path, size_t *size)
{
    char *bytes = NULL;
    FILE *file = fopen(path, "rb");
    if (!file)
        return NULL;
    long length = fseek(file, 0, SEEK_END) ? -1 : ftell(file);
    if (length > 0 && length <= SIZE_MAX_BYTES && !fseek(file, 0, SEEK_SET))
        bytes = malloc((size_t)length);
    if (bytes && fread(bytes, 1, (size_t)length, file) != (size_t)length) {
        free(bytes);
        bytes = NULL;
    }
    fclose(file);
    *size = bytes ? (size_t)length : 0;
    return bytes;
}

const char *core_load(LoadedCore *loaded, const char *path)
{
    size_t size;
    memset(loaded, 0, sizeof *loaded);
    loaded->design = contents(path, &size);
    if (!loaded->design)
        return "it cannot be read";
    const char *misfit = core_check(loaded->design, size, &loaded->info);
    if (!misfit) {
        const size_t bytes = (size_t)loaded->info.memory_bytes;
        loaded->memory = aligned_alloc(ALIGNMENT, (bytes + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT);
        if (loaded->memory)
            loaded->core = core_open(loaded->design, size, loaded->memory);
        if (!loaded->core)
            misfit = "there is not enough memory";
    }
    if (misfit)
        core_unload(loaded);
    return misfit;
}

void core_unload(LoadedCore *loaded)
{
    free(loaded->memory);
    free(loaded->design);
    memset(loaded, 0, sizeof *loaded);
}

#define PATH_BYTES 4096

/* Write the path of the user's data folder (which = 0) or of the plugin's folder (1). Return 0 on failure. */
static int folder_of(size_t which, char *folder)
{
    const char *data = getenv("XDG_DATA_HOME"), *home = getenv("HOME");
    Dl_info found;
    int length = -1;
    if (which == 0 && data && *data == '/')
        length = snprintf(folder, PATH_BYTES, "%s/haptic-cushion", data);
    else if (which == 0 && home && *home == '/')
        length = snprintf(folder, PATH_BYTES, "%s/.local/share/haptic-cushion", home);
    if (which == 1 && dladdr((const void *)(uintptr_t)&core_find, &found) && found.dli_fname) {
        const char *end = strrchr(found.dli_fname, '/');
        const size_t bytes = end ? (size_t)(end - found.dli_fname) : 0;
        length = snprintf(folder, PATH_BYTES, "%.*s", (int)bytes, end ? found.dli_fname : ".");
    }
    return length > 0 && length < PATH_BYTES;
}

/* An unusable file ends the search, because the next folder might hold an outdated design. */
int core_find(LoadedCore *loaded, const char *profile, unsigned long samplerate)
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
        problem = core_load(loaded, path);
        if (!problem && loaded->info.samplerate != samplerate) {
            core_unload(loaded);
            problem = "it is for another samplerate";
        }
        if (problem)
            fprintf(stderr,
                    "haptic_cushion: the design %s cannot be used: %s; make it again with "
                    "`cushion plugin install --rate %lu`\n",
                    path, problem, samplerate);
        return problem ? -1 : 1;
    }
    fprintf(stderr,
            "haptic_cushion: no design of profile %s for %lu Hz; make it with "
            "`cushion plugin install --rate %lu`\n",
            profile, samplerate, samplerate);
    return 0;
}

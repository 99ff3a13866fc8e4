/* Where designs are found. */

#ifndef _GNU_SOURCE
#define _GNU_SOURCE /* dladdr */
#endif

#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "design_file.h"

#define PATH_BYTES 4096

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
    if (which == 1 && dladdr((const void *)(uintptr_t)&core_find, &found) && found.dli_fname) {
        const char *end = strrchr(found.dli_fname, '/');
        const size_t bytes = end ? (size_t)(end - found.dli_fname) : 0;
        length = snprintf(folder, PATH_BYTES, "%.*s", (int)bytes, end ? found.dli_fname : ".");
    }
    return length > 0 && length < PATH_BYTES;
}

/* A file that does not fit ends the search, so that an old design is never used without a word. */
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

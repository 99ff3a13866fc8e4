/* Makes cores of design files. */

#include "design_file.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SIZE_MAX_BYTES ((long)64 << 20) /* designs have under 10 MB */
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

/* Reads design files. */

#include "design_file.h"

#include <stdio.h>
#include <stdlib.h>

#define SIZE_MAX_BYTES ((long)64 << 20) /* designs have under 1 MB */

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

const char *design_read(Design *design, const char *path)
{
    size_t size;
    char *bytes = contents(path, &size);
    if (!bytes)
        return "it cannot be read";
    const char *problem = design_open(design, bytes, size);
    if (problem) {
        free(bytes);
        design->bytes = NULL;
    }
    return problem;
}

void design_close(Design *design)
{
    free(design->bytes);
    design->bytes = NULL;
}

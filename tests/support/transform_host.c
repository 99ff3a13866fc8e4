/* Plays sound through the live form without Python: transform_host DESIGN CHANNELS EACH BLOCK
 *
 * Float samples on stdin, (frames, CHANNELS), become double samples on stdout, in blocks of BLOCK
 * frames. EACH: 1 for one vibration a channel, 0 for that of the mono mix. */

#include <stdio.h>
#include <stdlib.h>

#include "design_blob.h"
#include "live.h"

static char *contents(const char *path, size_t *size)
{
    FILE *file = fopen(path, "rb");
    char *bytes = malloc((size_t)1 << 26);
    *size = file && bytes ? fread(bytes, 1, (size_t)1 << 26, file) : 0;
    if (file)
        fclose(file);
    return bytes;
}

int main(int count, char **arguments)
{
    if (count != 5)
        return 2;
    size_t size;
    char *bytes = contents(arguments[1], &size);
    const size_t channels = (size_t)atoi(arguments[2]), block = (size_t)atoi(arguments[4]);
    Design design;
    Live live;
    const char *problem = design_open(&design, bytes, size);
    if (problem || live_open(&live, &design.settings, channels, atoi(arguments[3]))) {
        fprintf(stderr, "%s\n", problem ? problem : "no memory");
        return 1;
    }
    float *frames = malloc(block * channels * sizeof *frames);
    double *vibration = malloc(block * channels * sizeof *vibration);
    size_t taken;
    while ((taken = fread(frames, channels * sizeof *frames, block, stdin)) > 0) {
        const Sound sound = {
            .at = (const char *)frames,
            .frame_bytes = (ptrdiff_t)(channels * sizeof *frames),
            .channel_bytes = sizeof *frames,
            .channels = channels,
            .is_float = 1,
        };
        live_process(&live, sound, taken, vibration);
        fwrite(vibration, live.voices_count * sizeof *vibration, taken, stdout);
    }
    live_close(&live);
    free(frames);
    free(vibration);
    free(bytes);
    return 0;
}

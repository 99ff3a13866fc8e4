/* Plays sound through a core without Python: core_host DESIGN BLOCK
 *
 * Reads float samples, (frames, inputs), from stdin, BLOCK frames at once. Writes the actuators' signals to
 * stdout as floats, or the vibration as doubles if the design has no actuators. Actuator k plays vibration k,
 * modulo the number of vibrations; every second actuator has a gain of -0.5. */

#include <stdio.h>
#include <stdlib.h>

#include "core.h"

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
    static CoreControls controls = {.sound_gain = 1.0};
    static CoreReadings readings;
    size_t size, taken;
    CoreInfo info;
    if (count != 3)
        return 2;
    char *design = contents(arguments[1], &size);
    const size_t block = (size_t)atoi(arguments[2]);
    const char *misfit = core_check(design, size, &info);
    if (misfit) {
        fprintf(stderr, "%s\n", misfit);
        return 1;
    }
    Core *core = core_open(design, size, malloc((size_t)info.memory_bytes));
    for (size_t which = 0; which < info.actuators; which++) {
        controls.actuators[which].gain = which % 2 ? -0.5 : 1.0;
        controls.actuators[which].source = which % info.vibrations;
        controls.actuators[which].audible = 1;
    }
    float *sound = malloc(block * info.inputs * sizeof *sound);
    float *signals = malloc(block * (info.actuators + 1) * sizeof *signals);
    double *vibration = malloc(block * info.vibrations * sizeof *vibration);
    while ((taken = fread(sound, info.inputs * sizeof *sound, block, stdin)) > 0) {
        const CoreSound given = {sound, (ptrdiff_t)(info.inputs * sizeof *sound), sizeof *sound, 0};
        if (info.actuators) {
            core_process(core, &controls, given, signals, taken, &readings);
            fwrite(signals, info.actuators * sizeof *signals, taken, stdout);
        } else {
            core_vibrate(core, given, vibration, taken, &readings);
            fwrite(vibration, info.vibrations * sizeof *vibration, taken, stdout);
        }
    }
    return 0;
}

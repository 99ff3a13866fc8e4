/* Runs the second plugin of a LADSPA library. For a tracer, a call of getppid marks the start and the end. */
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>
#include "ladspa_abi.h"
int main(int argc, char **argv)
{
    (void)argc;
    void *library = dlopen(argv[1], RTLD_NOW);
    const LadspaDescriptor *(*describe)(unsigned long) =
        (const LadspaDescriptor *(*)(unsigned long))dlsym(library, "ladspa_descriptor");
    int *armed = dlsym(RTLD_DEFAULT, "trap_armed");
    const LadspaDescriptor *variant = describe(1);
    void *instance = variant->instantiate(variant, 48000);
    static float in[2][4096], out[2][4096], controls[6];
    if (!instance)
        return 3;
    for (int c = 0; c < 2; c++) {
        variant->connect_port(instance, c, in[c]);
        variant->connect_port(instance, 2 + c, out[c]);
    }
    for (int c = 0; c < 6; c++)
        variant->connect_port(instance, 4 + c, &controls[c]);
    variant->activate(instance);
    if (armed)
        *armed = 1;
    syscall(SYS_getppid);
    for (int block = 0; block < 200; block++) {
        for (int i = 0; i < 4096; i++)
            in[0][i] = in[1][i] = (block / 10) % 2 ? (i * 7919 + block) % 200 / 300.0f - 0.3f : 0;
        controls[0] = (float)(block % 7) - 3;
        controls[1] = (float)(block % 5) * 40;
        controls[2] = block % 50 == 0;
        variant->run(instance, block % 3 ? 4096 : 1023);
    }
    syscall(SYS_getppid);
    if (armed)
        *armed = 0;
    variant->cleanup(instance);
    return 0;
}

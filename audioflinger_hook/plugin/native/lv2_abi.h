/* The binary interface of LV2's core, as hosts expect it (lv2plug.in/ns/lv2core). */

#ifndef CUSHION_LV2_ABI_H
#define CUSHION_LV2_ABI_H

#include <stdint.h>

typedef struct {
    const char *uri;
    void *data;
} Lv2Feature;

typedef struct Lv2Descriptor {
    const char *uri;
    void *(*instantiate)(const struct Lv2Descriptor *descriptor, double samplerate,
                         const char *bundle_path, const Lv2Feature *const *features);
    void (*connect_port)(void *instance, uint32_t port, void *data);
    void (*activate)(void *instance);
    void (*run)(void *instance, uint32_t frames);
    void (*deactivate)(void *instance);
    void (*cleanup)(void *instance);
    const void *(*extension_data)(const char *uri);
} Lv2Descriptor;

#endif

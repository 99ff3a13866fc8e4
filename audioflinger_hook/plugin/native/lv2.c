/* The plugin for LV2 hosts: the public LADSPA plugins with the same ports, under URIs.
 *
 * plugin/variants.py writes the bundle's Turtle files from the LADSPA descriptors. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "ladspa_abi.h"

/* The binary interface of LV2's core, as hosts expect it (lv2plug.in/ns/lv2core). */
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

#define PREFIX "urn:haptic-cushion:"

const LadspaDescriptor *ladspa_descriptor(unsigned long index);

/* In the order of the LADSPA plugins. */
static const char *const URIS[] = {PREFIX "paper", PREFIX "cinema", PREFIX "game", PREFIX "music",
                                   PREFIX "speech", PREFIX "mono"};

#define URIS_COUNT (sizeof URIS / sizeof *URIS)

static Lv2Descriptor descriptors[URIS_COUNT];

static void *instantiate(const Lv2Descriptor *descriptor, double samplerate,
                         const char *bundle_path, const Lv2Feature *const *features)
{
    (void)bundle_path;
    (void)features;
    const LadspaDescriptor *plugin = ladspa_descriptor((unsigned long)(descriptor - descriptors));
    return samplerate > 0.0 ? plugin->instantiate(plugin, (unsigned long)lrint(samplerate)) : NULL;
}

/* All plugins share their functions, so any of them will do. */
static void connect_port(void *instance, uint32_t port, void *data)
{
    ladspa_descriptor(0)->connect_port(instance, port, data);
}

static void activate(void *instance) { ladspa_descriptor(0)->activate(instance); }

static void run(void *instance, uint32_t frames) { ladspa_descriptor(0)->run(instance, frames); }

static void cleanup(void *instance) { ladspa_descriptor(0)->cleanup(instance); }

__attribute__((constructor)) static void describe_all(void)
{
    for (size_t which = 0; which < URIS_COUNT; which++)
        descriptors[which] = (Lv2Descriptor){
            .uri = URIS[which],
            .instantiate = instantiate,
            .connect_port = connect_port,
            .activate = activate,
            .run = run,
            .cleanup = cleanup,
        };
}

__attribute__((visibility("default"))) const Lv2Descriptor *lv2_descriptor(uint32_t index);

const Lv2Descriptor *lv2_descriptor(uint32_t index)
{
    return index < URIS_COUNT ? &descriptors[index] : NULL;
}

/* LADSPA and LV2 interfaces of the plugins. The daemon's plugin has no LV2 interface. plugin/variants.py
 * reads the LADSPA descriptors and writes the Turtle files, which describe the plugins for LV2 hosts. */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "ladspa_abi.h"
#include "parts.h"

#define PORTS_MAX (DAEMON_INPUTS + DAEMON_OUTPUTS)
#define DEFAULT_PROFILE "cinema" /* equals LIVE_DEFAULT of config/profiles.py */

typedef enum { EFFECT, DAEMON } Kind;

typedef struct {
    unsigned long id; /* LADSPA's UniqueID, below 0x1000000 */
    const char *label, *name, *profile, *uri;
    Kind kind;
    unsigned inputs, outputs;
} PluginVariant;

#define URI "urn:haptic-cushion:"

static const PluginVariant VARIANTS[] = {
    {5180, "haptic_cushion_paper", "Haptic Cushion (paper)", "paper", URI "paper", EFFECT, 2, 2},
    {5181, "haptic_cushion_cinema", "Haptic Cushion (cinema)", "cinema", URI "cinema", EFFECT, 2, 2},
    {5182, "haptic_cushion_game", "Haptic Cushion (game)", "game", URI "game", EFFECT, 2, 2},
    {5183, "haptic_cushion_music", "Haptic Cushion (music)", "music", URI "music", EFFECT, 2, 2},
    {5186, "haptic_cushion_speech", "Haptic Cushion (speech)", "speech", URI "speech", EFFECT, 2, 2},
    {5184, "haptic_cushion_mono", "Haptic Cushion (mono)", DEFAULT_PROFILE, URI "mono", EFFECT, 1, 1},
    {5185, "haptic_cushion_daemon", "Haptic Cushion of the daemon", "", NULL, DAEMON,
     DAEMON_INPUTS, DAEMON_OUTPUTS},
};

#define VARIANTS_COUNT (sizeof VARIANTS / sizeof *VARIANTS)

enum { GAIN, DELAY, BYPASS, LATENCY, SOUND_PEAK, VIBRATION_PEAK, EFFECT_CONTROLS };

#define RANGE (LADSPA_BOUNDED_BELOW | LADSPA_BOUNDED_ABOVE | LADSPA_DEFAULT_0)

static const struct {
    const char *name;
    int port;
    LadspaRange range;
} CONTROLS[EFFECT_CONTROLS] = {
    {"Gain (dB)", LADSPA_INPUT, {RANGE, -60.0f, 20.0f}},
    {"Delay (ms)", LADSPA_INPUT, {RANGE, 0.0f, 1000.0f}},
    {"Bypass", LADSPA_INPUT, {LADSPA_TOGGLED | LADSPA_DEFAULT_0, 0.0f, 1.0f}},
    {"latency", LADSPA_OUTPUT, {0, 0.0f, 0.0f}}, /* hosts find the latency port by this name */
    {"Peak of the sound (dBFS)", LADSPA_OUTPUT, {0, 0.0f, 0.0f}},
    {"Peak of the vibration (dBFS)", LADSPA_OUTPUT, {0, 0.0f, 0.0f}},
};

typedef struct {
    const PluginVariant *variant;
    float *ports[PORTS_MAX];
    Effect *effect;
    DaemonCore *daemon;
} Instance;

static void cleanup(void *instance)
{
    Instance *made = instance;
    if (!made) /* FFmpeg calls this function even if `instantiate` failed */
        return;
    effect_close(made->effect);
    daemon_core_close(made->daemon);
    free(made);
}

static void *instantiate(const LadspaDescriptor *descriptor, unsigned long samplerate)
{
    const PluginVariant *variant = descriptor->implementation;
    Instance *made = calloc(1, sizeof *made);
    if (!made)
        return NULL;
    made->variant = variant;
    if (variant->kind == DAEMON)
        made->daemon = daemon_core_open(samplerate);
    else
        made->effect = effect_open(variant->profile, samplerate);
    if (!made->effect && !made->daemon) {
        cleanup(made);
        return NULL;
    }
    return made;
}

static void connect_port(void *instance, unsigned long port, float *data)
{
    if (port < PORTS_MAX)
        ((Instance *)instance)->ports[port] = data;
}

static void activate(void *instance)
{
    Instance *made = instance;
    if (made->effect)
        effect_reset(made->effect);
    if (made->daemon)
        daemon_core_reset(made->daemon);
}

static float control_of(const Instance *made, unsigned which, float otherwise)
{
    const float *place = made->ports[made->variant->inputs + made->variant->outputs + which];
    return place ? *place : otherwise;
}

static void report(const Instance *made, unsigned which, double value)
{
    float *place = made->ports[made->variant->inputs + made->variant->outputs + which];
    if (place)
        *place = (float)value;
}

static void run_effect(Instance *made, unsigned long frames)
{
    const PluginVariant *variant = made->variant;
    const EffectControls controls = {
        .gain_db = control_of(made, GAIN, 0.0f),
        .delay_ms = control_of(made, DELAY, 0.0f),
        .bypass = control_of(made, BYPASS, 0.0f) > 0.0f,
    };
    const float *inputs[EFFECT_CHANNELS] = {NULL};
    for (unsigned channel = 0; channel < variant->inputs; channel++)
        inputs[channel] = made->ports[channel];
    const EffectReadings now =
        effect_process(made->effect, controls, inputs, variant->inputs, made->ports + variant->inputs,
                       variant->outputs, frames);
    report(made, LATENCY, now.latency_frames);
    report(made, SOUND_PEAK, now.sound_dbfs);
    report(made, VIBRATION_PEAK, now.vibration_dbfs);
}

static void run(void *instance, unsigned long frames)
{
    Instance *made = instance;
    if (made->effect)
        run_effect(made, frames);
    else
        daemon_core_process(made->daemon, made->ports, made->ports + DAEMON_INPUTS, frames);
}

static int port_descriptors[VARIANTS_COUNT][PORTS_MAX];
static const char *port_names[VARIANTS_COUNT][PORTS_MAX];
static LadspaRange port_ranges[VARIANTS_COUNT][PORTS_MAX];
static LadspaDescriptor descriptors[VARIANTS_COUNT];

static char audio_names[2][DAEMON_OUTPUTS][8]; /* "In 1", "Out 1" */

static void describe_audio(size_t which, unsigned *port, unsigned count, int is_output)
{
    for (unsigned channel = 0; channel < count; channel++, ++*port) {
        char *name = audio_names[is_output][channel];
        snprintf(name, sizeof audio_names[0][0], is_output ? "Out %u" : "In %u", channel + 1);
        port_descriptors[which][*port] = (is_output ? LADSPA_OUTPUT : LADSPA_INPUT) | LADSPA_AUDIO;
        port_names[which][*port] = name;
    }
}

static void describe(size_t which)
{
    const PluginVariant *variant = &VARIANTS[which];
    unsigned port = 0;
    describe_audio(which, &port, variant->inputs, 0);
    describe_audio(which, &port, variant->outputs, 1);
    for (unsigned control = 0; variant->kind == EFFECT && control < EFFECT_CONTROLS; control++, port++) {
        port_descriptors[which][port] = CONTROLS[control].port | LADSPA_CONTROL;
        port_names[which][port] = CONTROLS[control].name;
        port_ranges[which][port] = CONTROLS[control].range;
    }
    descriptors[which] = (LadspaDescriptor){
        .unique_id = variant->id,
        .label = variant->label,
        .properties = LADSPA_HARD_RT_CAPABLE,
        .name = variant->name,
        .maker = "Haptic Cushion",
        .copyright = "Apache-2.0",
        .port_count = port,
        .port_descriptors = port_descriptors[which],
        .port_names = port_names[which],
        .port_ranges = port_ranges[which],
        .implementation = (void *)variant,
        .instantiate = instantiate,
        .connect_port = connect_port,
        .activate = activate,
        .run = run,
        .cleanup = cleanup,
    };
}

/* The binary interface of LV2 (lv2plug.in/ns/lv2core). */
typedef struct Lv2Descriptor {
    const char *uri;
    void *(*instantiate)(const struct Lv2Descriptor *descriptor, double samplerate,
                         const char *bundle_path, const void *const *features);
    void (*connect_port)(void *instance, uint32_t port, void *data);
    void (*activate)(void *instance);
    void (*run)(void *instance, uint32_t frames);
    void (*deactivate)(void *instance);
    void (*cleanup)(void *instance);
    const void *(*extension_data)(const char *uri);
} Lv2Descriptor;

enum { LV2_COUNT = VARIANTS_COUNT - 1 }; /* all variants except the last, which is the daemon's */

static Lv2Descriptor lv2_descriptors[LV2_COUNT];

static void *lv2_instantiate(const Lv2Descriptor *descriptor, double samplerate,
                             const char *bundle_path, const void *const *features)
{
    (void)bundle_path;
    (void)features;
    const LadspaDescriptor *plugin = &descriptors[descriptor - lv2_descriptors];
    return samplerate > 0.0 ? instantiate(plugin, (unsigned long)lrint(samplerate)) : NULL;
}

static void lv2_connect_port(void *instance, uint32_t port, void *data) { connect_port(instance, port, data); }
static void lv2_run(void *instance, uint32_t frames) { run(instance, frames); }

__attribute__((constructor)) static void describe_all(void)
{
    for (size_t which = 0; which < VARIANTS_COUNT; which++)
        describe(which);
    for (size_t which = 0; which < LV2_COUNT; which++)
        lv2_descriptors[which] = (Lv2Descriptor){
            .uri = VARIANTS[which].uri,
            .instantiate = lv2_instantiate,
            .connect_port = lv2_connect_port,
            .activate = activate,
            .run = lv2_run,
            .cleanup = cleanup,
        };
}

/* Hosts look up these two functions by name. */
CORE_API const LadspaDescriptor *ladspa_descriptor(unsigned long index);
CORE_API const Lv2Descriptor *lv2_descriptor(uint32_t index);

const LadspaDescriptor *ladspa_descriptor(unsigned long index)
{
    return index < VARIANTS_COUNT ? &descriptors[index] : NULL;
}

const Lv2Descriptor *lv2_descriptor(uint32_t index)
{
    return index < LV2_COUNT ? &lv2_descriptors[index] : NULL;
}

/* The plugin for LADSPA hosts.
 *
 * For any host: haptic_cushion_paper, _cinema, _game, _music and _speech (stereo to stereo), and _mono.
 * For the daemon: haptic_cushion_daemon, which follows the page that the daemon shares. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "daemon_core.h"
#include "effect.h"
#include "ladspa_abi.h"

#define PORTS_MAX (DAEMON_INPUTS + DAEMON_OUTPUTS)
#define DEFAULT_PROFILE "cinema" /* LIVE_DEFAULT of config/profiles.py */

/* ---------------------------------------------------------------------------------- what there is */

typedef enum { EFFECT, DAEMON } Kind;

typedef struct {
    unsigned long id; /* of the range for development; LADSPA gives out no other any more */
    const char *label, *name, *profile;
    Kind kind;
    unsigned inputs, outputs;
} PluginVariant;

static const PluginVariant VARIANTS[] = {
    {5180, "haptic_cushion_paper", "Haptic Cushion (paper)", "paper", EFFECT, 2, 2},
    {5181, "haptic_cushion_cinema", "Haptic Cushion (cinema)", "cinema", EFFECT, 2, 2},
    {5182, "haptic_cushion_game", "Haptic Cushion (game)", "game", EFFECT, 2, 2},
    {5183, "haptic_cushion_music", "Haptic Cushion (music)", "music", EFFECT, 2, 2},
    {5186, "haptic_cushion_speech", "Haptic Cushion (speech)", "speech", EFFECT, 2, 2},
    {5184, "haptic_cushion_mono", "Haptic Cushion (mono)", DEFAULT_PROFILE, EFFECT, 1, 1},
    {5185, "haptic_cushion_daemon", "Haptic Cushion of the daemon", "", DAEMON, DAEMON_INPUTS,
     DAEMON_OUTPUTS},
};

#define VARIANTS_COUNT (sizeof VARIANTS / sizeof *VARIANTS)

enum { GAIN, DELAY, BYPASS, LATENCY, SOUND_PEAK, VIBRATION_PEAK, EFFECT_CONTROLS };

static const struct {
    const char *name;
    int port;
    LadspaRange range;
} CONTROLS[EFFECT_CONTROLS] = {
    {"Gain (dB)",
     LADSPA_INPUT | LADSPA_CONTROL,
     {LADSPA_BOUNDED_BELOW | LADSPA_BOUNDED_ABOVE | LADSPA_DEFAULT_0, -60.0f, 20.0f}},
    {"Delay (ms)",
     LADSPA_INPUT | LADSPA_CONTROL,
     {LADSPA_BOUNDED_BELOW | LADSPA_BOUNDED_ABOVE | LADSPA_DEFAULT_0, 0.0f, 1000.0f}},
    {"Bypass", LADSPA_INPUT | LADSPA_CONTROL, {LADSPA_TOGGLED | LADSPA_DEFAULT_0, 0.0f, 1.0f}},
    {"latency", LADSPA_OUTPUT | LADSPA_CONTROL, {0, 0.0f, 0.0f}}, /* the name that hosts look for */
    {"Peak of the sound (dBFS)", LADSPA_OUTPUT | LADSPA_CONTROL, {0, 0.0f, 0.0f}},
    {"Peak of the vibration (dBFS)", LADSPA_OUTPUT | LADSPA_CONTROL, {0, 0.0f, 0.0f}},
};

/* --------------------------------------------------------------------------------------- instances */

typedef struct {
    const PluginVariant *variant;
    float *ports[PORTS_MAX];
    Effect *effect;
    DaemonCore *daemon;
} Instance;

static void cleanup(void *instance)
{
    Instance *made = instance;
    if (!made) /* FFmpeg ends what it could not instantiate, too */
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
    effect_process(made->effect, controls, inputs, variant->inputs, made->ports + variant->inputs,
                   variant->outputs, frames);
    report(made, LATENCY, effect_latency_frames(made->effect));
    report(made, SOUND_PEAK, effect_sound_dbfs(made->effect));
    report(made, VIBRATION_PEAK, effect_vibration_dbfs(made->effect));
}

static void run(void *instance, unsigned long frames)
{
    Instance *made = instance;
    if (made->effect)
        run_effect(made, frames);
    else
        daemon_core_process(made->daemon, made->ports, made->ports + DAEMON_INPUTS, frames);
}

/* ------------------------------------------------------------------------------------- descriptors */

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
        port_descriptors[which][port] = CONTROLS[control].port;
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

__attribute__((constructor)) static void describe_all(void)
{
    for (size_t which = 0; which < VARIANTS_COUNT; which++)
        describe(which);
}

__attribute__((visibility("default"))) const LadspaDescriptor *ladspa_descriptor(unsigned long index);

const LadspaDescriptor *ladspa_descriptor(unsigned long index)
{
    return index < VARIANTS_COUNT ? &descriptors[index] : NULL;
}

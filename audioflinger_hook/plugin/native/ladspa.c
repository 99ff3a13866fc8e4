/* The LADSPA face.
 *
 * For any host: haptic_cushion_paper, _cinema, _game and _music (stereo to stereo), and _mono.
 * For the daemon: haptic_cushion_daemon and haptic_cushion_actuator, which follow the page that the
 * daemon shares. The control `slot` of an actuator is its place there. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "actuator.h"
#include "daemon_transform.h"
#include "effect.h"
#include "ladspa_abi.h"

#define FIRST_ID 5180 /* of the range for development; LADSPA gives out no other any more */
#define PORTS_MAX (2 * PAGE_CHANNELS)
#define DEFAULT_PROFILE "cinema" /* LIVE_DEFAULT of config/profiles.py */

/* ---------------------------------------------------------------------------------- what there is */

typedef enum { EFFECT, TRANSFORM, ACTUATOR } Kind;

typedef struct {
    const char *label, *name, *profile;
    Kind kind;
    unsigned inputs, outputs;
} Face;

static const Face FACES[] = {
    {"haptic_cushion_paper", "Haptic Cushion (paper)", "paper", EFFECT, 2, 2},
    {"haptic_cushion_cinema", "Haptic Cushion (cinema)", "cinema", EFFECT, 2, 2},
    {"haptic_cushion_game", "Haptic Cushion (game)", "game", EFFECT, 2, 2},
    {"haptic_cushion_music", "Haptic Cushion (music)", "music", EFFECT, 2, 2},
    {"haptic_cushion_mono", "Haptic Cushion (mono)", DEFAULT_PROFILE, EFFECT, 1, 1},
    {"haptic_cushion_daemon", "Haptic Cushion of the daemon", "", TRANSFORM, PAGE_CHANNELS,
     PAGE_CHANNELS},
    {"haptic_cushion_actuator", "Haptic Cushion actuator", "", ACTUATOR, 1, 1},
};

#define FACES_COUNT (sizeof FACES / sizeof *FACES)

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
    const Face *face;
    float *ports[PORTS_MAX];
    Effect *effect;
    Actuator *actuator;
    DaemonTransform *transform;
} Instance;

static void cleanup(void *instance)
{
    Instance *made = instance;
    if (!made) /* FFmpeg ends what it could not instantiate, too */
        return;
    effect_close(made->effect);
    actuator_close(made->actuator);
    daemon_transform_close(made->transform);
    free(made);
}

static void *instantiate(const LadspaDescriptor *descriptor, unsigned long samplerate)
{
    const Face *face = descriptor->implementation;
    Instance *made = calloc(1, sizeof *made);
    if (!made)
        return NULL;
    made->face = face;
    if (face->kind == ACTUATOR)
        made->actuator = actuator_open(samplerate);
    else if (face->kind == TRANSFORM)
        made->transform = daemon_transform_open(samplerate);
    else
        made->effect = effect_open(face->profile, samplerate, face->inputs);
    if (!made->effect && !made->actuator && !made->transform) {
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
    if (made->actuator)
        actuator_reset(made->actuator);
    if (made->transform)
        daemon_transform_reset(made->transform);
}

static float control_of(const Instance *made, unsigned which, float otherwise)
{
    const float *place = made->ports[made->face->inputs + made->face->outputs + which];
    return place ? *place : otherwise;
}

static void report(const Instance *made, unsigned which, double value)
{
    float *place = made->ports[made->face->inputs + made->face->outputs + which];
    if (place)
        *place = (float)value;
}

static size_t slot_of(const Instance *made)
{
    const float slot = control_of(made, 0, 0.0f);
    return slot >= 0.0f && slot < (float)PAGE_ACTUATORS ? (size_t)slot : PAGE_ACTUATORS;
}

static void run_effect(Instance *made, unsigned long frames)
{
    const Face *face = made->face;
    const EffectControls controls = {
        .gain_db = control_of(made, GAIN, 0.0f),
        .delay_ms = control_of(made, DELAY, 0.0f),
        .bypass = control_of(made, BYPASS, 0.0f) > 0.0f,
    };
    const float *inputs[EFFECT_CHANNELS_MAX] = {NULL};
    for (unsigned channel = 0; channel < face->inputs; channel++)
        inputs[channel] = made->ports[channel];
    effect_process(made->effect, controls, inputs, face->inputs, made->ports + face->inputs,
                   face->outputs, frames);
    report(made, LATENCY, effect_latency_frames(made->effect));
    report(made, SOUND_PEAK, peak_dbfs(&made->effect->source->sound));
    report(made, VIBRATION_PEAK, peak_dbfs(&made->effect->source->vibration));
}

static void run(void *instance, unsigned long frames)
{
    Instance *made = instance;
    if (made->effect)
        run_effect(made, frames);
    else if (made->transform)
        daemon_transform_process(made->transform, made->ports, made->ports + PAGE_CHANNELS, frames);
    else
        actuator_process(made->actuator, slot_of(made), made->ports[0], made->ports[1], frames);
}

/* ------------------------------------------------------------------------------------- descriptors */

static int port_descriptors[FACES_COUNT][PORTS_MAX];
static const char *port_names[FACES_COUNT][PORTS_MAX];
static LadspaRange port_ranges[FACES_COUNT][PORTS_MAX];
static LadspaDescriptor descriptors[FACES_COUNT];

static const char *const INPUT_NAMES[] = {"In 1", "In 2", "In 3", "In 4",
                                          "In 5", "In 6", "In 7", "In 8"};
static const char *const OUTPUT_NAMES[] = {"Out 1", "Out 2", "Out 3", "Out 4",
                                           "Out 5", "Out 6", "Out 7", "Out 8"};

static void describe(size_t which)
{
    const Face *face = &FACES[which];
    unsigned port = 0;
    for (unsigned channel = 0; channel < face->inputs; channel++, port++) {
        port_descriptors[which][port] = LADSPA_INPUT | LADSPA_AUDIO;
        port_names[which][port] = INPUT_NAMES[channel];
    }
    for (unsigned channel = 0; channel < face->outputs; channel++, port++) {
        port_descriptors[which][port] = LADSPA_OUTPUT | LADSPA_AUDIO;
        port_names[which][port] = OUTPUT_NAMES[channel];
    }
    for (unsigned control = 0; face->kind == EFFECT && control < EFFECT_CONTROLS; control++, port++) {
        port_descriptors[which][port] = CONTROLS[control].port;
        port_names[which][port] = CONTROLS[control].name;
        port_ranges[which][port] = CONTROLS[control].range;
    }
    if (face->kind == ACTUATOR) {
        port_descriptors[which][port] = LADSPA_INPUT | LADSPA_CONTROL;
        port_names[which][port] = "slot";
        port_ranges[which][port] =
            (LadspaRange){LADSPA_BOUNDED_BELOW | LADSPA_BOUNDED_ABOVE | LADSPA_INTEGER |
                              LADSPA_DEFAULT_0,
                          0.0f, (float)(PAGE_ACTUATORS - 1)};
        port++;
    }
    descriptors[which] = (LadspaDescriptor){
        .unique_id = FIRST_ID + which,
        .label = face->label,
        .properties = LADSPA_HARD_RT_CAPABLE,
        .name = face->name,
        .maker = "Haptic Cushion",
        .copyright = "Apache-2.0",
        .port_count = port,
        .port_descriptors = port_descriptors[which],
        .port_names = port_names[which],
        .port_ranges = port_ranges[which],
        .implementation = (void *)face,
        .instantiate = instantiate,
        .connect_port = connect_port,
        .activate = activate,
        .run = run,
        .cleanup = cleanup,
    };
}

__attribute__((constructor)) static void describe_all(void)
{
    for (size_t which = 0; which < FACES_COUNT; which++)
        describe(which);
}

__attribute__((visibility("default"))) const LadspaDescriptor *ladspa_descriptor(unsigned long index);

const LadspaDescriptor *ladspa_descriptor(unsigned long index)
{
    return index < FACES_COUNT ? &descriptors[index] : NULL;
}

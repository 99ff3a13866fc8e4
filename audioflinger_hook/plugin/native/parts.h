/* Parts of the plugins: cores from design files, the effect for general hosts, and the daemon's core. */

#pragma once

#include "../../core/core.h"

/* A core with its design and memory. */
typedef struct {
    Core *core; /* NULL: not loaded */
    CoreInfo info;
    void *design, *memory;
} LoadedCore;

/* Create a core from a design file. Return NULL or an error message. Allocates. */
const char *core_load(LoadedCore *loaded, const char *path);

/* Create a core from the file that HAPTIC_CUSHION_DESIGN names. If this variable is not set, search the
 * user's data folder, then the plugin's folder. Return 1 on success, 0 without a design, -1 for an unusable
 * design. A failure writes one line to stderr. Allocates. */
int core_find(LoadedCore *loaded, const char *profile, unsigned long samplerate);

void core_unload(LoadedCore *loaded);

enum { EFFECT_CHANNELS = 2 };

/* Computes one vibration from stereo sound, with gain, delay and bypass. */
typedef struct Effect Effect;

typedef struct {
    double gain_db;
    double delay_ms;
    int bypass; /* 1: output silence */
} EffectControls;

typedef struct {
    double latency_frames;             /* latency of the core for onsets, plus the delay */
    double sound_dbfs, vibration_dbfs; /* peaks of the sound and of the core's output; at least -150 */
} EffectReadings;

/* Create an effect; return NULL without a design or memory. With an unusable design, the effect outputs
 * silence so that the host continues. If the design is missing or unusable, write to stderr. Allocates. */
Effect *effect_open(const char *profile, unsigned long samplerate);
void effect_close(Effect *effect);
void effect_reset(Effect *effect);

/* Process any number of frames. Real-time safe. A single input is both left and right; a NULL input is
 * silence. All outputs get the same vibration. An output may be NULL or share its buffer with an input. */
EffectReadings effect_process(Effect *effect, EffectControls controls, const float *const *inputs,
                              size_t channels, float *const *outputs, size_t outputs_count, size_t frames);

enum { DAEMON_INPUTS = CORE_CHANNELS, DAEMON_OUTPUTS = 32 };

/* Controls and readings of one design. */
typedef struct {
    CoreControls controls;
    CoreReadings readings;
} PageBank;

enum { PAGE_BANKS = 2 };

/* Memory shared with the daemon, in the file that HAPTIC_CUSHION_PAGE names; see daemon/native/layout.py. The
 * daemon writes magic, size, wanted and controls; the plugin writes the rest. Each value has 8 bytes and is
 * aligned. Design n uses banks[n % PAGE_BANKS]. Design 0 is in the file that HAPTIC_CUSHION_DESIGN names; for a
 * later design, "." and its number follow this name. */
#define PAGE_MAGIC UINT64_C(0x3645474150485543) /* "CUHPAGE6" */

typedef struct {
    uint64_t magic;
    uint64_t size;         /* bytes of the page */
    uint64_t samplerate;   /* of the host, Hz; the output is silent if the design has another rate */
    uint64_t cycle_frames; /* frames of the host's latest call */
    uint64_t wanted;       /* number of the design to play */
    uint64_t playing;      /* number of the design that plays */
    uint64_t refused;      /* number of the latest unusable design, except design 0 */
    PageBank banks[PAGE_BANKS];
} Page;

/* A core made from a numbered design, in a list. */
typedef struct NumberedCore {
    LoadedCore loaded;
    uint64_t number;
    struct NumberedCore *next;
} NumberedCore;

/* Free a list of cores, which may be NULL. */
void numbered_cores_free(NumberedCore *core);

/* Create the core of the page's wanted design. Return NULL or an error message. Allocates. */
const char *numbered_core_load(NumberedCore *core, const Page *page, unsigned long samplerate);

/* Loads designs in a thread without real-time priority. */
typedef struct DesignLoader DesignLoader;

/* Start the thread. It loads the wanted design at each byte in the FIFO that HAPTIC_CUSHION_CHANGES names.
 * Return NULL without this variable or on failure. Allocates. */
DesignLoader *design_loader_open(Page *page, unsigned long samplerate);
void design_loader_close(DesignLoader *loader);

/* Return the latest loaded core once, else NULL. Real-time safe. */
NumberedCore *design_loader_take(DesignLoader *loader);

/* Give a core back; the thread frees it later. Real-time safe. */
void design_loader_return(DesignLoader *loader, NumberedCore *core);

/* Computes all actuators' signals from captured sound, as the page's controls specify. */
typedef struct DaemonCore DaemonCore;

/* Create the daemon's core. Return NULL if HAPTIC_CUSHION_PAGE is set and not empty, but the page is unusable, if core_find
 * is needed and finds no core, or if memory runs out. Allocates. */
DaemonCore *daemon_core_open(unsigned long samplerate);
void daemon_core_close(DaemonCore *daemon);
void daemon_core_reset(DaemonCore *daemon);

/* Process any number of frames. Real-time safe. A NULL input is silence; a NULL output is skipped. A new
 * design first processes 0.2 s of sound, then a cross-fade of 40 ms makes it audible. */
void daemon_core_process(DaemonCore *daemon, float *const inputs[DAEMON_INPUTS],
                         float *const outputs[DAEMON_OUTPUTS], size_t frames);

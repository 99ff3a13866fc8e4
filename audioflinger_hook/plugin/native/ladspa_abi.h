/* The parts of LADSPA 1.1's binary interface (www.ladspa.org) that the plugins use. */

#pragma once

enum { LADSPA_INPUT = 1, LADSPA_OUTPUT = 2, LADSPA_CONTROL = 4, LADSPA_AUDIO = 8 };

enum { LADSPA_HARD_RT_CAPABLE = 4 };

enum {
    LADSPA_BOUNDED_BELOW = 0x1,
    LADSPA_BOUNDED_ABOVE = 0x2,
    LADSPA_TOGGLED = 0x4,
    LADSPA_DEFAULT_0 = 0x200,
};

typedef struct {
    int descriptor;
    float lower, upper;
} LadspaRange;

typedef struct LadspaDescriptor {
    unsigned long unique_id;
    const char *label;
    int properties;
    const char *name, *maker, *copyright;
    unsigned long port_count;
    const int *port_descriptors;
    const char *const *port_names;
    const LadspaRange *port_ranges;
    void *implementation;
    void *(*instantiate)(const struct LadspaDescriptor *descriptor, unsigned long samplerate);
    void (*connect_port)(void *instance, unsigned long port, float *data);
    void (*activate)(void *instance);
    void (*run)(void *instance, unsigned long frames);
    void (*run_adding)(void *instance, unsigned long frames);
    void (*set_run_adding_gain)(void *instance, float gain);
    void (*deactivate)(void *instance);
    void (*cleanup)(void *instance);
} LadspaDescriptor;
